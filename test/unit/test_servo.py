"""The servo: what no sample and no change of settings may do to the motor."""

import math
from dataclasses import replace

import numpy as np
import pytest
from samples import sample_of

from backlash_ros.control import (
    FAST_REGION,
    LAWS,
    OVERDAMPED_REGION,
    BacklashEstimate,
    GainSet,
    Limits,
    Servo,
    ServoSettings,
)
from backlash_ros.control.laws.two_region import TwoRegionParameters
from backlash_ros.control.observer import ObserverMemory, observer_memory_at, observer_step
from backlash_ros.drivetrain import NOMINAL_DRIVE, Plant
from backlash_ros.drivetrain.sensors import POSITIONS
from backlash_ros.foundation.record import row_of
from backlash_ros.foundation.signals import LOAD_TORQUE, OMEGA_L, Measurement

AT_REST = np.zeros(5)
INSIDE_THE_HYSTERESIS = np.array([0.3, 0.0, 0.03, 0.0, 0.0])


def two_region(gains: GainSet, **parameters: float) -> ServoSettings:
    settings = ServoSettings(gains, backlash_angle=0.02)
    return settings.with_law("two_region", TwoRegionParameters(**parameters))


@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("value", [1e306, -1.7e308, math.inf])
def test_absurd_sample_gives_zero_volts_and_is_forgotten(gains: GainSet, place: int, value: float) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, backlash_angle=0.02))
    servo.update(AT_REST)
    for absurd in (value, -value):
        sample = AT_REST.copy()
        sample[place] = absurd
        assert abs(servo.update(sample)) <= 24.0  # finite
    for _ in range(1000):
        voltage = servo.update(AT_REST)
        assert math.isfinite(voltage)
    servo.release("test")
    assert servo.update(AT_REST) == 0.0


def test_sample_that_is_not_a_number_gives_zero_volts(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    servo.update(AT_REST)
    assert servo.set_reference(1.0) == ""
    assert servo.update(AT_REST) > 1.0
    assert servo.update(np.full(5, math.nan)) == 0.0
    assert not servo.holding
    assert servo.update(AT_REST) == 0.0


def test_torque_bandwidth_is_changed_without_a_step(gains: GainSet) -> None:
    """Twenty seconds with the estimate off and a load torque on, then on: it rises to the torque, no further."""
    settings = ServoSettings(gains, law="fast", torque_bandwidth=0.0)
    servo, plant = Servo(NOMINAL_DRIVE, settings), Plant(NOMINAL_DRIVE)
    estimates = []
    for k in range(5500):
        if k == 5000:
            servo.use(replace(settings, torque_bandwidth=40.0))
        plant.advance(servo.update(sample_of(plant.state)), 0.05, settings.period)
        estimates.append(servo.load_torque_estimate)
    assert set(estimates[:5000]) == {0.0}
    assert min(estimates[5000:]) >= 0.0
    assert max(estimates[5000:]) == pytest.approx(0.05, rel=0.02)
    assert estimates[-1] == pytest.approx(0.05, rel=1e-3)


def test_changed_law_acts_from_the_next_sample_on(gains: GainSet) -> None:
    settings = two_region(gains, min_dwell=10.0)
    servo = Servo(NOMINAL_DRIVE, settings)
    servo.update(AT_REST)
    assert servo.region == OVERDAMPED_REGION
    servo.use(settings.with_law("fast"))
    servo.update(AT_REST)
    assert servo.region == FAST_REGION
    servo.use(settings)
    servo.start_experiment("limit_cycle")
    servo.update(AT_REST)
    assert servo.region == FAST_REGION


def test_gains_are_changed_without_forgetting_the_region(gains: GainSet) -> None:
    settings = two_region(gains, hysteresis=1.0)
    servo = Servo(NOMINAL_DRIVE, settings)
    servo.update(AT_REST)
    for _ in range(10):
        servo.update(INSIDE_THE_HYSTERESIS)
    assert servo.region == OVERDAMPED_REGION
    servo.use(replace(settings, gains=GainSet(gains.fast, replace(gains.overdamped, position=1.5))))
    servo.update(INSIDE_THE_HYSTERESIS)
    assert servo.region == OVERDAMPED_REGION


def test_law_starts_anew_after_learning(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, two_region(gains, hysteresis=1.0))
    servo.update(AT_REST)
    assert servo.region == OVERDAMPED_REGION
    servo.start_experiment("limit_cycle")
    servo.update(AT_REST)
    servo.cancel("test")
    servo.update(INSIDE_THE_HYSTERESIS)
    assert servo.region == FAST_REGION


def test_the_law_answers_the_sample_with_which_an_experiment_ends(gains: GainSet) -> None:
    """A load that leaves the swing fast is braked at once, and not one sample later."""
    drive, period = NOMINAL_DRIVE, ServoSettings(gains).period
    servo = Servo(drive, ServoSettings(gains).with_law("overdamped"))
    for k in range(3):
        servo.update(Measurement(np.zeros(5)))
        if not k:
            servo.start_experiment("gap_probe")
    position, speed = 0.31, 5.0
    sample = np.array([position / drive.gear.ratio, speed / drive.gear.ratio, position, speed, 0.0])
    command = servo.update(Measurement(sample), period)
    outcome = servo.take_outcome()
    assert isinstance(outcome, BacklashEstimate)
    assert "beyond learning.gap_probe.swing" in outcome.reason
    assert command < -1.0


@pytest.mark.parametrize("law", sorted(LAWS))
def test_reset_with_the_load_elsewhere_is_no_kick(gains: GainSet, law: str) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, law=law))
    for angle in (0.0, 1.0):
        servo.reset()
        assert servo.update(np.array([10 * angle, math.nan, angle, math.nan, math.nan])) == 0.0


@pytest.mark.parametrize(
    ("side", "end"), [("position_lower", -0.29), ("position_upper", 0.29), ("position_lower", -0.31)]
)
def test_learning_is_refused_where_it_swings_beyond_an_end(gains: GainSet, side: str, end: float) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), **{side: end}))
    servo.update(AT_REST)
    assert (f"limits.{side} = {end:g} rad" in servo.experiment_refusal("limit_cycle")) == (abs(end) < 0.3)


@pytest.mark.parametrize("rate", [250.0, 1000.0])
@pytest.mark.parametrize("bandwidth", [50.0, 200.0])
def test_velocity_bandwidth_is_the_bandwidth(gains: GainSet, rate: float, bandwidth: float) -> None:
    """A ramp that sets in: the speed reaches 63 % after 1/bandwidth."""
    constants = ServoSettings(gains, period=1 / rate, velocity_bandwidth=bandwidth).observer(NOMINAL_DRIVE)
    memory = observer_memory_at(row_of(ObserverMemory))
    reached = math.inf
    for k in range(2000):
        position = max(0, k - 1) / rate
        sample = np.array([math.nan, math.nan, position, math.nan, math.nan])
        observer_step(constants, memory, sample, 0.0, 1 / rate, constants.torque_bandwidth)
        if memory.estimate[OMEGA_L] >= 1 - math.exp(-1) and math.isinf(reached):
            reached = (k - 1) / rate
    assert reached == pytest.approx(1 / bandwidth, abs=1 / rate)
    assert memory.estimate[LOAD_TORQUE] == 0.0


def close_loop(servo: Servo, plant: Plant, periods: int) -> None:
    for _ in range(periods):
        plant.advance(servo.update(sample_of(plant.state)), 0.0, 0.004)


def test_ends_of_the_travel_are_moved_while_it_runs(gains: GainSet) -> None:
    settings, near = ServoSettings(gains, law="overdamped"), Limits.of(NOMINAL_DRIVE)
    near = replace(near, position_lower=-0.5, position_upper=0.5)
    servo, plant = Servo(NOMINAL_DRIVE, settings, near), Plant(NOMINAL_DRIVE)
    close_loop(servo, plant, 1)
    assert "limits.position_upper = 0.5 rad" in servo.set_reference(1.0)
    servo.use(settings, replace(near, position_upper=2.0))
    assert servo.set_reference(1.0) == ""
    close_loop(servo, plant, 1000)
    assert servo.fault == ""
    assert plant.load_angle == pytest.approx(1.0, abs=0.02)
    assert "position_upper = 0.5 rad, got 1" in servo.rejection_reason(near)


def test_a_load_outside_of_new_ends_comes_back_in(gains: GainSet) -> None:
    settings, wide = ServoSettings(gains, law="overdamped"), Limits.of(NOMINAL_DRIVE)
    servo, plant = Servo(NOMINAL_DRIVE, settings, wide), Plant(NOMINAL_DRIVE, [10.0, 0.0, 1.0, 0.0, 0.0])
    close_loop(servo, plant, 1)
    assert servo.set_reference(0.2) == ""
    narrow = replace(wide, position_upper=0.4)
    assert servo.rejection_reason(narrow) == ""
    servo.use(settings, narrow)
    close_loop(servo, plant, 1000)
    assert servo.fault == ""
    assert plant.load_angle == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize("missing", [2, 5])
def test_missing_samples_do_not_look_like_speed(gains: GainSet, missing: int) -> None:
    """By positions alone: the way of several periods in one sample is the way of several periods."""
    settings = ServoSettings(gains, law="overdamped")
    far = replace(Limits.of(NOMINAL_DRIVE), step=10.0)
    servo, plant = Servo(NOMINAL_DRIVE, settings, far), Plant(NOMINAL_DRIVE)
    servo.update(AT_REST)
    assert servo.set_reference(10.0) == ""
    elapsed, ratios = settings.period, []
    for k in range(120):
        command = servo.update(sample_of(plant.state, POSITIONS), elapsed)
        if elapsed > settings.period:
            ratios.append(float(servo.estimate[OMEGA_L]) / plant.load_speed)
        elapsed = settings.period * (1 + missing if k % 10 == 9 else 1)
        plant.advance(command, 0.0, elapsed)
    assert servo.fault == ""
    assert max(ratios) < 1.2
    assert min(ratios) > 0.6


def test_a_servo_that_others_bar_follows_nothing_but_can_be_stopped(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, backlash_angle=0.02))
    servo.update(AT_REST)
    assert servo.set_reference(0.5) == ""
    servo.update(AT_REST)
    servo.barred = "while another axis is not active"
    assert servo.set_reference(1.0) == "reference 1 rad came while another axis is not active"
    assert servo.reference == 0.5
    assert servo.stop() == ""
    assert servo.reference == 0.0
