"""The probe while it runs: how far it goes, what ends it, and that the position is held afterwards."""

import math
from dataclasses import replace

import numpy as np
import pytest
from broken_measurements import play as learn_with
from drives import varied
from experiments import Broken, frozen, play, reversed_, swapped
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from searched import searched

from backlash_ros.control import GainSet, GapProbeSettings, Limits, Method, Servo, ServoSettings
from backlash_ros.control.experiment import Deferred
from backlash_ros.control.motion.motor_moves import MotorLoop, Move, Throw
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import OMEGA_L, THETA_L, THETA_M, Measurement
from backlash_ros.simulation import SimulatedDrive, run_experiment
from backlash_ros.studies.evaluation.population import draw_member, told_model
from backlash_ros.studies.evaluation.task import learn, settings_for


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.parametrize(
    ("drive", "torque"),
    [
        (NOMINAL_DRIVE, 0.0),
        (varied(load_coulomb_friction=0.2), 0.0),
        (NOMINAL_DRIVE, 0.2),
        (varied(load_coulomb_friction=0.05, load_inertia=1.5e-3), -0.4),
        (varied(gear_backlash_angle=0.004), 0.1),
        (varied(gear_backlash_angle=0.09), 0.0),
        (varied(load_inertia=3.25e-4, gear_backlash_angle=0.066), -0.5),
    ],
    ids=["free", "friction", "torque", "both", "small gap", "wide gap", "wide gap under a torque"],
)
def test_the_gap_is_measured_whatever_acts_on_the_load(gains: GainSet, drive: Drive, torque: float) -> None:
    sensors = Sensors(measured=POSITIONS, motor_counts=4096.0, load_counts=65536.0)
    estimate = run_experiment(
        drive, ServoSettings(gains), "gap_probe", model=NOMINAL_DRIVE, load_torque=torque, sensors=sensors
    )
    assert estimate.valid, estimate.reason
    assert estimate.method is Method.GAP_PROBE
    assert estimate.angle == pytest.approx(drive.gear.backlash_angle, rel=0.02)
    assert 0.0 < estimate.uncertainty < 0.02 * estimate.angle


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.parametrize(("forward", "backward"), [(0.9, 0.9), (0.75, 0.6)])
def test_a_gear_with_losses_is_measured(gains: GainSet, forward: float, backward: float) -> None:
    gear = replace(NOMINAL_DRIVE.gear, efficiency_forward=forward, efficiency_backward=backward)
    sensors = Sensors(measured=POSITIONS, motor_counts=4096.0, load_counts=65536.0)
    drive = replace(NOMINAL_DRIVE, gear=gear)
    estimate = run_experiment(drive, ServoSettings(gains), "gap_probe", model=NOMINAL_DRIVE, sensors=sensors)
    assert estimate.valid, estimate.reason
    assert estimate.angle == pytest.approx(drive.gear.backlash_angle, rel=0.02)
    assert abs(estimate.angle - drive.gear.backlash_angle) < 2.0 * estimate.uncertainty


@pytest.mark.grid
def test_a_gap_of_no_more_than_a_count_is_refused() -> None:
    """A load that cannot be outrun: a gap of less than a count fits best, where the true one has 27."""
    member = draw_member(515151, 5, "full")
    model = told_model(member, "identified")
    learned, _ = learn(member, model, settings_for(model, member), ("gap_probe",))
    assert not learned.valid
    assert "no more than one encoder count" in learned.reason


def test_one_encoder_is_refused(gains: GainSet) -> None:
    for measured in (("theta_m",), ("theta_l",)):
        estimate = run_experiment(NOMINAL_DRIVE, ServoSettings(gains), "gap_probe", sensors=Sensors(measured=measured))
        assert not estimate.valid
        assert estimate.reason == "no gap measured: measuring the gap needs two encoders, and one is missing"


@pytest.mark.grid
def test_auto_takes_what_the_encoders_allow(gains: GainSet) -> None:
    both = run_experiment(NOMINAL_DRIVE, ServoSettings(gains))
    assert both.method is Method.GAP_PROBE
    for measured in (("theta_l",), ("theta_m",)):
        one = run_experiment(NOMINAL_DRIVE, ServoSettings(gains), sensors=Sensors(measured=measured))
        assert one.method is Method.RELAY


@pytest.mark.corners(3)
@pytest.mark.parametrize("torque", [0.0, 0.3, -0.45])
@pytest.mark.parametrize("swing", [0.05, 0.15, 0.3])
@pytest.mark.parametrize("inertia", [1.3e-4, 2e-3])
def test_the_load_stays_within_the_swing(gains: GainSet, torque: float, swing: float, inertia: float) -> None:
    drive = varied(load_inertia=inertia)
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    plant = SimulatedDrive(drive, servo.settings.period, sensors=Sensors(measured=POSITIONS))
    servo.update(plant.sample())
    servo.start_experiment("gap_probe", GapProbeSettings(swing=swing, travel=min(0.06, swing)))
    assert play(servo, plant, 5000, torque) <= swing + drive.gear.backlash_angle
    outcome = servo.take_outcome()
    assert outcome is not None
    assert isinstance(outcome, Deferred) or "beyond learning.gap_probe.swing" in outcome.reason


@pytest.mark.corners(2)
@pytest.mark.population
@pytest.mark.parametrize("volts", [3.0, 6.0])
@pytest.mark.parametrize("torque", [0.1, 0.3])
@pytest.mark.parametrize("inertia", [2e-4, 5e-4, 2e-3])
def test_a_motor_of_which_little_may_be_used_stays_within_the_swing(
    gains: GainSet, volts: float, torque: float, inertia: float
) -> None:
    """It plans with what limits.command leaves, and so can brake."""
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), command=volts))
    plant = SimulatedDrive(varied(load_inertia=inertia), servo.settings.period, sensors=Sensors(measured=POSITIONS))
    servo.update(plant.sample())
    servo.start_experiment("gap_probe")
    assert play(servo, plant, 5000, torque) <= 0.3
    assert isinstance(servo.take_outcome(), Deferred)
    assert servo.fault == ""


@pytest.mark.corners(1)
@pytest.mark.parametrize("time", [1.0, 2.0])
@pytest.mark.parametrize("torque", [0.0, 0.3])
def test_it_ends_when_its_time_is_over(gains: GainSet, time: float, torque: float) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    plant = SimulatedDrive(NOMINAL_DRIVE, servo.settings.period, sensors=Sensors(measured=POSITIONS))
    servo.update(plant.sample())
    servo.start_experiment("gap_probe", GapProbeSettings(time=time))
    play(servo, plant, 5000, torque)
    assert isinstance(servo.take_outcome(), Deferred)
    assert time <= plant.time <= time + 1.0


@pytest.mark.corners(2)
@pytest.mark.population
@pytest.mark.parametrize("torque", [0.0, 0.3])
@pytest.mark.parametrize("start", [1, 400], ids=["from the start", "on the way"])
@pytest.mark.parametrize("signal", [THETA_M, THETA_L], ids=["motor", "load"])
@pytest.mark.parametrize("broken", [frozen, reversed_, swapped])
def test_a_broken_encoder_ends_it_within_the_swing_and_gives_no_gap(
    gains: GainSet, broken: Broken, signal: int, start: int, torque: float
) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    plant = SimulatedDrive(NOMINAL_DRIVE, servo.settings.period, sensors=Sensors(measured=POSITIONS))
    servo.update(plant.sample())
    servo.start_experiment("gap_probe")
    swing, outcome, before = 0.0, None, plant.sample().copy()
    for k in range(5000):
        measured = plant.sample()
        if k >= start:
            broken(measured, before, signal)
        before = measured.copy()
        command = servo.update(measured, plant.elapsed)
        outcome = servo.take_outcome()
        if outcome is not None or servo.latched:
            break
        plant.advance(command, torque)
        swing = max(swing, abs(float(plant.state[THETA_L])))
    assert swing <= 0.3 + NOMINAL_DRIVE.gear.backlash_angle
    if isinstance(outcome, Deferred):
        outcome = outcome.work()
    assert servo.latched or (outcome is not None and not outcome.valid)


@pytest.mark.population
@pytest.mark.parametrize("number", [71, 104])
def test_a_far_flank_that_was_not_met_gives_no_gap(number: int) -> None:
    """A load torque that the motor just outruns, and late samples: any gap explains the motion."""
    assert not learn_with("samples 3 periods late", number, 20261125, "full").valid


@pytest.mark.population
@pytest.mark.parametrize("number", [3, 135])
def test_a_load_is_not_thrown_by_a_motor_that_does_not_stand(number: int) -> None:
    """Samples that are 3 periods late make its loop unstable."""
    found = learn_with("samples 3 periods late", number, 20261126, "full")
    assert not found.valid
    assert found.beyond == 0.0


@pytest.mark.population
def test_two_lost_samples_in_a_throw_take_the_load_no_farther_than_b_beyond_the_swing() -> None:
    """The servo brakes with the very sample that shows the load beyond the swing."""
    assert 0.0 < learn_with("5 % of the samples lost", 11, 20261125, "full").beyond < 1.0


@pytest.mark.parametrize("lost", [1, 3, 20])
def test_lost_samples_make_no_kick(lost: int) -> None:
    """A motor that follows its move is at the same speed after a silence."""
    loop, move, period = MotorLoop(NOMINAL_DRIVE, 0.004, 5.0), Move.of(0.0, 3.0, 20.0, 20.0, 4.0), 0.004
    for k in range(1, 61):
        even = loop.torque(move.at(k * period)[0], move.at(k * period), period)
    at = move.at((60 + 1 + lost) * period)
    after = loop.torque(at[0], at, (1 + lost) * period)
    assert after == pytest.approx(even, abs=0.02)


@searched(12, 25, given(after=st.integers(1, 900), torque=st.sampled_from([0.0, 0.25, -0.1])))
def test_it_is_cancelled_at_any_sample_and_ends_at_rest(gains: GainSet, after: int, torque: float) -> None:
    drive = varied(load_coulomb_friction=0.02)
    servo = Servo(drive, ServoSettings(gains).with_law("overdamped"))
    plant = SimulatedDrive(drive, servo.settings.period)
    servo.update(plant.sample())
    servo.start_experiment("gap_probe")
    play(servo, plant, after, torque)
    servo.cancel("test")
    outcome = servo.take_outcome()
    assert outcome is not None
    play(servo, plant, 1500, torque)
    assert servo.fault == ""
    assert abs(float(plant.state[OMEGA_L])) < 0.01
    assert abs(servo.tracking_error) < 0.5 * drive.gear.backlash_angle


@examples(max_examples=25, deadline=None)
@given(
    at=st.integers(1, 900),
    samples=st.sampled_from([1, 3, 10]),
    signal=st.sampled_from([THETA_M, THETA_L]),
    size=st.floats(0.005, 1e4),
    way=st.sampled_from([1.0, -1.0]),
    torque=st.sampled_from([0.0, 0.2]),
)
def test_wrong_samples_do_not_take_the_load_beyond_the_swing(
    gains: GainSet, at: int, samples: int, signal: int, size: float, way: float, torque: float
) -> None:
    """An encoder jumps for a few samples: a fault, the end of the probe, or a load that stays where it may be."""
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    plant = SimulatedDrive(NOMINAL_DRIVE, servo.settings.period, sensors=Sensors(measured=POSITIONS))
    servo.update(plant.sample())
    servo.start_experiment("gap_probe")
    swing = 0.0
    for k in range(1200):
        measured = plant.sample()
        if at <= k < at + samples:
            measured[signal] += way * size
        command = servo.update(measured, plant.elapsed)
        if servo.take_outcome() is not None or servo.latched:
            break
        plant.advance(command, torque)
        swing = max(swing, abs(float(plant.state[THETA_L])))
    assert swing <= 0.3 + NOMINAL_DRIVE.gear.backlash_angle


def test_limits_that_are_nearer_than_the_swing_refuse_it(gains: GainSet) -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_upper=0.25)
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), limits)
    servo.update(Measurement(np.zeros(5)))
    assert "it swings by learning.gap_probe.swing = 0.3 rad to either side, but" in servo.experiment_refusal()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"swing": 0.0}, r"learning\.gap_probe\.swing must be > 0 rad and <= 3\.2 rad, got 0"),
        ({"torque": 1.5}, r"learning\.gap_probe\.torque must be > 0 and <= 1, got 1\.5"),
        ({"time": math.nan}, r"learning\.gap_probe\.time must be a finite number"),
    ],
)
def test_settings_out_of_bounds_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GapProbeSettings(**change)


@given(
    start=st.floats(-1, 1),
    end=st.floats(-1, 1),
    up=st.floats(1, 3000),
    down=st.floats(1, 3000),
    speed=st.floats(0.1, 50),
)
def test_a_move_goes_from_rest_to_rest(start: float, end: float, up: float, down: float, speed: float) -> None:
    move = Move.of(start, end, up, down, speed)
    times = np.linspace(0.0, move.length, 400)
    position, rate, acceleration = np.array([move.at(time) for time in times]).T
    assert position[0] == pytest.approx(start, abs=1e-9)
    assert position[-1] == pytest.approx(end, abs=1e-9)
    assert np.all(np.abs(rate) <= speed * (1 + 1e-9))
    assert np.all(np.abs(acceleration) <= max(up, down) * (1 + 1e-9))
    assert np.max(np.abs(np.diff(position))) <= 1.01 * speed * (move.length / 399) + 1e-9
    assert np.all((position >= min(start, end) - 1e-9) & (position <= max(start, end) + 1e-9))


@given(
    home=st.floats(-1, 1),
    side=st.sampled_from([1.0, -1.0]),
    way=st.floats(0.001, 0.5),
    soft=st.floats(1, 3000),
    hard=st.floats(1, 3000),
)
def test_a_throw_goes_to_one_side_and_back_from_rest_to_rest(
    home: float, side: float, way: float, soft: float, hard: float
) -> None:
    throw = Throw(home, side, Throw.fastest(way, soft, hard), soft, hard)
    times = np.linspace(0.0, throw.length, 401)
    position, rate, acceleration = np.array([throw.at(time) for time in times]).T
    gone, step = side * (position - home), throw.length / 400
    assert (gone[0], gone[-1]) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert (rate[0], rate[-1]) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert np.min(gone) == pytest.approx(-way, rel=1e-6)
    assert np.max(gone) <= 1e-9
    assert np.max(np.abs(rate)) <= throw.speed * (1.0 + 1e-9)
    assert side * acceleration[200] == pytest.approx(hard)
    # Position and speed are integrals of what is said to be their rate.
    assert np.max(np.abs(np.diff(position) - 0.5 * step * (rate[1:] + rate[:-1]))) <= max(soft, hard) * step**2
    assert np.max(np.abs(np.diff(rate))) <= max(soft, hard) * step * (1.0 + 1e-9)
    assert throw.at(throw.length + 0.1) == (home, 0.0, 0.0)
