"""The learning unit on the simulated drive: what it finds, by which method, and when it says that it found nothing."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from samples import EVERYTHING, sample_of

from backlash_ros.control import GainSet, LimitCycleSettings, Limits, Method, Servo, ServoSettings
from backlash_ros.control.experiments.limit_cycle import BacklashEstimate, BacklashLearner
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, POSITION, THETA_L, Estimate
from backlash_ros.simulation import SimulatedDrive, learn_backlash

LOAD_ONLY = ("theta_l", "omega_l")


def with_inertia(factor: float) -> Drive:
    return replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, inertia=5e-4 * factor))


def with_backlash(factor: float) -> Drive:
    return replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, backlash_angle=0.02 * factor))


SMALL = with_backlash(0.2)
LEARNED = [
    *[(drive, rate) for drive in (NOMINAL_DRIVE, with_inertia(4), with_backlash(5)) for rate in (250, 500, 1000)],
    *[(SMALL, rate) for rate in (500, 1000)],
]


@pytest.mark.parametrize(
    ("drive", "rate"),
    LEARNED,
    ids=lambda value: value if isinstance(value, int) else f"{value.gear.backlash_angle} {value.load.inertia}",
)
def test_both_encoders_give_the_backlash_within_five_percent(gains: GainSet, drive: Drive, rate: int) -> None:
    estimate = learn_backlash(drive, ServoSettings(gains, period=1 / rate).with_experiment("limit_cycle"))
    assert estimate.valid, estimate.reason
    assert estimate.method is Method.GAP_TRAVEL
    assert estimate.cycles >= 10
    assert estimate.angle == pytest.approx(drive.gear.backlash_angle, rel=0.05)


def test_load_encoder_alone_is_corrected_for_the_inertias(gains: GainSet) -> None:
    """Within 15 %: beside the momentum share there is the give of the contact and the dead time of the samples."""
    for factor in (0.5, 1, 4):
        drive = with_inertia(factor)
        settings = ServoSettings(gains, period=0.001).with_experiment("limit_cycle")
        estimate = learn_backlash(drive, settings, sensors=Sensors(measured=LOAD_ONLY))
        assert estimate.valid, estimate.reason
        assert estimate.method is Method.LOAD_AMPLITUDE
        assert estimate.angle == pytest.approx(0.02, rel=0.15)
        assert estimate.angle == pytest.approx(estimate.amplitude / drive.motor_share)


def test_learning_answers_no_cycle_under_load_torque(gains: GainSet) -> None:
    estimate = learn_backlash(NOMINAL_DRIVE, ServoSettings(gains).with_experiment("limit_cycle"), load_torque=0.1)
    assert not estimate.valid
    assert estimate.angle == 0.0
    assert estimate.reason.startswith("no valid cycle: the load comes to rest or moves less than 0.0002 rad")
    assert "after 3 kicks of 0.025 rad" in estimate.reason


@pytest.mark.corners(2)
@pytest.mark.parametrize("bits", [12, 14])
@pytest.mark.parametrize("rate", [250, 1000])
def test_flicker_of_the_load_encoder_is_not_taken_for_a_cycle(gains: GainSet, rate: int, bits: int) -> None:
    """Under a load torque the teeth stay on one flank, and the loop drives the load to and fro between two counts."""
    settings = ServoSettings(gains, period=1 / rate).with_experiment("limit_cycle")
    encoder = Sensors(measured=("theta_l",), load_counts=2.0**bits)
    found = learn_backlash(NOMINAL_DRIVE, settings, load_torque=0.1, sensors=encoder)
    assert not found.valid
    assert "less than 4 steps of its encoder" in found.reason
    free = learn_backlash(NOMINAL_DRIVE, settings, sensors=encoder)
    assert free.valid
    assert 1.0 < free.angle / 0.02 < 1.5  # the speed that is worked out lags: the cycle is larger than the gap


def test_learning_answers_no_cycle_within_the_limit(gains: GainSet) -> None:
    impatient = LimitCycleSettings(measure_time=0.1, attempts=1)
    estimate = learn_backlash(NOMINAL_DRIVE, ServoSettings(gains).with_experiment("limit_cycle", impatient))
    assert not estimate.valid
    assert "of 10 cycles within 0.1 s" in estimate.reason


def test_the_limit_cycle_needs_the_load_encoder(gains: GainSet) -> None:
    motor_only = Sensors(measured=("theta_m", "omega_m", "current"))
    settings = ServoSettings(gains).with_experiment("limit_cycle")
    estimate = learn_backlash(NOMINAL_DRIVE, settings, sensors=motor_only)
    assert not estimate.valid
    assert "the load encoder is missing" in estimate.reason


def test_learning_does_not_touch_the_settings_and_returns_to_the_reference(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, backlash_angle=0.015))
    sample = np.array([0.0, 0.0, 0.0, 0.0, 0.0])
    servo.update(sample)
    settings = servo.settings
    servo.start_experiment("limit_cycle")
    assert servo.update(sample) > 0  # the kick
    servo.release("test")
    estimate = servo.take_outcome()
    assert estimate is not None
    assert not estimate.valid
    assert estimate.reason == "no valid cycle: test"
    assert servo.settings is settings
    assert servo.update(sample) == 0.0


@pytest.mark.parametrize("end", [0.01, -0.01])
def test_a_kick_does_not_lead_beyond_an_end_that_has_come_nearer(gains: GainSet, end: float) -> None:
    """The first one leads up, the second one down."""
    settings, limits = ServoSettings(gains), Limits.of(NOMINAL_DRIVE)
    servo, plant, offsets = Servo(NOMINAL_DRIVE, settings, limits), SimulatedDrive(NOMINAL_DRIVE, PERIOD), []
    servo.update(plant.sample())
    servo.start_experiment("limit_cycle", replace(MEASURED_AT_ONCE, measure_time=0.1, attempts=2))
    servo.use(settings, replace(limits, **{"position_upper" if end > 0.0 else "position_lower": end}))
    while servo.experimenting and servo.take_outcome() is None:
        plant.advance(servo.update(plant.sample()), 0.0)
        offsets.append(float(servo.memory.setpoint[POSITION]))
    assert (max(offsets), min(offsets)) == ((0.01, -0.025) if end > 0.0 else (0.025, -0.01))


def test_learning_twice_at_once_is_refused(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    servo.start_experiment("limit_cycle")
    with pytest.raises(RuntimeError, match="already learning"):
        servo.start_experiment("limit_cycle")


def rigid_gear(servo: Servo, resolution: float) -> None:
    """Let the servo learn on a load angle that was computed from the motor's: it swings, and there is no gap."""
    servo.start_experiment("limit_cycle")
    for k in range(5000):
        phase = 2 * np.pi * 12.0 * k * servo.settings.period
        angle, speed = 0.005 * np.sin(phase), 0.005 * 2 * np.pi * 12.0 * np.cos(phase)
        if resolution:
            angle = np.round(angle / resolution) * resolution
        servo.update(np.array([10 * angle, 10 * speed, angle, speed, 0.0]))


@pytest.mark.parametrize("resolution", [0.0, 2 * np.pi / 2**16])
def test_swing_without_a_gap_is_not_a_backlash_of_zero(gains: GainSet, resolution: float) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    rigid_gear(servo, resolution)
    estimate = servo.take_outcome()
    assert estimate is not None
    assert not estimate.valid
    assert "is the load's angle measured behind the gear?" in estimate.reason


@pytest.mark.parametrize("name", ["attempts", "cycles"])
def test_counts_are_whole_numbers(name: str) -> None:
    with pytest.raises(ValueError, match=rf"learning.limit_cycle.{name} must be a whole number .*, got 4.5"):
        LimitCycleSettings(**{name: 4.5})


PERIOD = 0.004
MEASURED_AT_ONCE = LimitCycleSettings(kick_time=PERIOD, settle_time=0.0, attempts=1)


def swings(cycles: Sequence[tuple[float, int]]) -> Iterator[Estimate]:
    """Estimates of a load that swings by so much, rad peak to peak, in so many samples, while the motor rests."""
    for amplitude, samples in cycles:
        phase = 2 * np.pi * np.arange(samples) / samples
        rate = 2 * np.pi / (samples * PERIOD)
        for angle, speed in zip(0.5 * amplitude * np.sin(phase), 0.5 * amplitude * rate * np.cos(phase), strict=True):
            yield Estimate(np.array([0.0, 0.0, angle, speed, 0.0, 0.0]))


def learn_from(
    cycles: Sequence[tuple[float, int]], settings: LimitCycleSettings, motor_until: int = 10_000
) -> BacklashEstimate:
    learner = BacklashLearner(NOMINAL_DRIVE, settings, PERIOD, Limits.of(NOMINAL_DRIVE))
    for k, estimate in enumerate(swings(cycles)):
        learner.step(sample_of(estimate, EVERYTHING if k < motor_until else LOAD_ONLY), estimate, 0.0, PERIOD, 0.0)
    assert learner.outcome is not None
    return learner.outcome


@pytest.mark.parametrize("attempts", [1, 2, 5])
def test_each_attempt_kicks_to_the_other_side(attempts: int) -> None:
    learner = BacklashLearner(
        NOMINAL_DRIVE, replace(MEASURED_AT_ONCE, measure_time=0.1, attempts=attempts), PERIOD, Limits.of(NOMINAL_DRIVE)
    )
    offsets = [learner.step(np.zeros(5), np.zeros(6), 0.0, PERIOD, 0.0).offset for _ in range(200)]
    assert [offset for offset in offsets if offset] == ([0.025, -0.025] * 3)[:attempts]
    assert learner.outcome is not None
    assert f"(after {attempts} kicks of 0.025 rad)" in learner.outcome.reason


def test_a_cycle_of_few_samples_is_refused() -> None:
    """Its turning points are not seen."""
    refused, taken = (learn_from([(0.02, samples)] * 100, MEASURED_AT_ONCE) for samples in (6, 8))
    assert not refused.valid
    assert "a cycle of 0.024 s has fewer than 8 samples" in refused.reason
    assert taken.valid


@pytest.mark.corners(7)
@pytest.mark.population
@pytest.mark.parametrize("late", range(7))
@pytest.mark.parametrize("inertia", [0.2, 1, 4])
def test_late_samples_do_not_take_the_load_beyond_the_swing(gains: GainSet, late: int, inertia: float) -> None:
    """They make the fast gains' cycle grow, which is seen in time; the over-damped law then brings the load to rest."""
    drive = with_inertia(inertia)
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    plant = SimulatedDrive(drive, PERIOD, sensors=Sensors(measured=POSITIONS), delay=Delay(sample=late * PERIOD))
    servo.update(plant.sample())
    servo.start_experiment("limit_cycle")
    swing = 0.0
    while (outcome := servo.take_outcome()) is None:
        plant.advance(servo.update(plant.sample(), plant.elapsed))
        swing = max(swing, abs(float(plant.state[THETA_L])))
    assert isinstance(outcome, BacklashEstimate)
    assert swing <= LimitCycleSettings().swing
    assert not outcome.valid or outcome.angle == pytest.approx(drive.gear.backlash_angle, rel=0.2)
    if late > 4:
        assert "would have left learning.limit_cycle.swing = 0.3 rad" in outcome.reason


@pytest.mark.corners(5)
@pytest.mark.parametrize("signal", [OMEGA_M, OMEGA_L, CURRENT])
@pytest.mark.parametrize("factor", [0.0, 0.1, -1.0, 9.55, 57.3])
def test_a_wrong_unit_or_sign_gives_no_wrong_gap(gains: GainSet, signal: int, factor: float) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    plant = SimulatedDrive(NOMINAL_DRIVE, PERIOD)
    servo.update(plant.sample())
    servo.start_experiment("limit_cycle")
    swing, outcome = 0.0, None
    while outcome is None and not servo.latched:
        measured = plant.sample()
        measured[signal] *= factor
        plant.advance(servo.update(measured, plant.elapsed))
        swing = max(swing, abs(float(plant.state[THETA_L])))
        outcome = servo.take_outcome()
    assert swing <= LimitCycleSettings().swing
    assert servo.latched or isinstance(outcome, BacklashEstimate)
    if isinstance(outcome, BacklashEstimate) and outcome.valid:
        assert outcome.angle == pytest.approx(0.02, rel=0.2)


def test_a_kick_beyond_the_swing_is_refused() -> None:
    with pytest.raises(ValueError, match=r"learning\.limit_cycle\.kick must be < swing = 0\.1 rad, got 0\.2"):
        LimitCycleSettings(swing=0.1, kick=0.2)


def test_cycles_of_one_attempt_do_not_count_in_the_next() -> None:
    estimate = learn_from([(0.02, 20)] * 15, replace(MEASURED_AT_ONCE, measure_time=0.5, attempts=2))
    assert not estimate.valid
    assert "of 10 cycles within 0.5 s" in estimate.reason


@pytest.mark.parametrize(
    ("irregular", "text"),
    [
        ((0.03, 20), "differ by 0 % in period and 40 % in amplitude"),
        ((0.02, 30), "40 % in period and 0 % in amplitude"),
    ],
)
def test_cycles_that_differ_are_not_a_limit_cycle(irregular: tuple[float, int], text: str) -> None:
    estimate = learn_from([(0.02, 20), irregular] * 15, MEASURED_AT_ONCE)
    assert not estimate.valid
    assert text in estimate.reason


def test_bad_start_is_forgotten() -> None:
    estimate = learn_from([*[(0.03, 20)] * 5, *[(0.02, 20)] * 21], MEASURED_AT_ONCE)
    assert estimate.valid, estimate.reason
    assert estimate.angle == pytest.approx(0.02)


@pytest.mark.parametrize(("motor_until", "method"), [(10_000, Method.GAP_TRAVEL), (50, Method.LOAD_AMPLITUDE)])
def test_motor_encoder_lost_meanwhile_leaves_the_load_amplitude(motor_until: int, method: Method) -> None:
    estimate = learn_from([(0.02, 20)] * 26, MEASURED_AT_ONCE, motor_until)
    assert estimate.valid, estimate.reason
    assert estimate.method is method
