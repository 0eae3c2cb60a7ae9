"""An encoder that is lost while the other one lives: the axis goes on, where it may, and the load stays where it is."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from backlash_ros.control import GainSet, Servo, ServoSettings
from backlash_ros.control.encoders import Encoders
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.messages import BadSampleError, read_joint_state
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement
from backlash_ros.gates import Fault, SampleGate
from backlash_ros.gates.sample_gate import Action
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import draw_member
from backlash_ros.studies.evaluation.task import first_reading, settings_for, true_reading

B = NOMINAL_DRIVE.gear.backlash_angle
ANGLES = {"motor": THETA_M, "load": THETA_L}
SENSORS = Sensors(measured=("theta_m", "theta_l"), motor_counts=16384, load_counts=65536, motor_offset=7.0)
each_side = pytest.mark.parametrize("side", ANGLES)

Wrong = Callable[[Measurement, int], None]


def missing(measured: Measurement, angle: int) -> None:
    measured[angle] = np.nan


def leapt(measured: Measurement, angle: int) -> None:
    measured[angle] += 2.0 if angle == THETA_L else 20.0


class Frozen:
    """Stands still from the first call on."""

    def __init__(self) -> None:
        self._at: float | None = None

    def __call__(self, measured: Measurement, angle: int) -> None:
        self._at = float(measured[angle]) if self._at is None else self._at
        measured[angle] = self._at


def settings_of(gains: GainSet, law: str = "planned", what: str = "continue") -> ServoSettings:
    return ServoSettings(gains, law=law, backlash_angle=B, identified=True, on_lost_encoder=what)


class Axis:
    """The nominal drive, whose encoders have different zeros, with a load torque of 0.2 N m."""

    def __init__(self, settings: ServoSettings) -> None:
        self.servo = Servo(NOMINAL_DRIVE, settings)
        self.plant = SimulatedDrive(NOMINAL_DRIVE, settings.period, sensors=SENSORS)

    def play(self, count: int, wrong: Wrong | None = None, side: str = "load") -> Array:
        """Return the load's angles, rad."""
        way = np.zeros(count)
        for k in range(count):
            measured = self.plant.sample()
            if wrong is not None:
                wrong(measured, ANGLES[side])
            self.plant.advance(self.servo.update(measured, self.plant.elapsed), 0.2)
            way[k] = self.plant.state[THETA_L]
        return way


class Loss(NamedTuple):
    """A random drive that loses an encoder within 2 s, at rest or in motion; figures in gaps."""

    fault: str
    lost: str
    departure: float  # beyond where the load was to go
    error: float  # in the end


def loss(number: int, side: str, wrong: Wrong) -> Loss:
    member, random = draw_member(270827, number, "core"), np.random.default_rng(number)
    drive, b, start = member.drive, member.drive.gear.backlash_angle, first_reading(member)
    settings = replace(
        settings_for(drive, member), law="planned", backlash_angle=b, identified=True, on_lost_encoder="continue"
    )
    servo = Servo(drive, settings)
    plant = SimulatedDrive(drive, settings.period, sensors=member.sensors, delay=member.delay, seed=number)
    target, lost = start + random.uniform(-1.0, 1.0), random.uniform(0.5, 2.0)
    way = []
    for k in range(round(4.0 / settings.period)):
        measured, time = plant.sample(), k * settings.period
        if k == round(1.0 / settings.period):
            servo.set_reference(target)
        if time >= lost:
            wrong(measured, ANGLES[side])
        plant.advance(servo.update(measured, plant.elapsed), member.load_torque)
        if time >= lost:
            way.append(plant.state[THETA_L])
    angles = true_reading(member, np.array(way)) / b
    ends = [target / b, angles[0], *([start / b] if lost < 1.0 else [])]
    departure = max(np.max(angles) - max(ends), min(ends) - np.min(angles))
    error = np.max(np.abs(angles[-round(0.5 / settings.period) :] - target / b))
    return Loss(servo.fault, servo.lost_encoder, float(departure), float(error))


@each_side
@pytest.mark.parametrize("wrong", [missing, leapt])
@pytest.mark.parametrize("count", [4, pytest.param(100, marks=[pytest.mark.grid, pytest.mark.population])])
def test_at_any_time_the_load_departs_little_and_comes_back(count: int, wrong: Wrong, side: str) -> None:
    losses = [loss(number, side, wrong) for number in range(count)]
    assert {(each.fault, each.lost) for each in losses} == {("", side)}
    assert np.mean([each.departure <= 1.0 and each.error <= 0.25 for each in losses]) >= 0.85


@each_side
def test_one_that_stands_still_is_found_by_the_other_one(gains: GainSet, side: str) -> None:
    axis = Axis(settings_of(gains))
    axis.play(250)
    frozen = Frozen()
    axis.play(100, frozen, side)
    axis.servo.set_reference(0.5)
    way = axis.play(1000, frozen, side)
    assert (axis.servo.fault, axis.servo.lost_encoder) == ("", side)
    assert np.max(np.abs(way[-250:] - 0.5)) <= 0.25 * B


def test_a_shaft_that_rests_beside_a_motor_that_trembles_is_not_taken_for_a_lost_encoder() -> None:
    """Nor is a leap of the motor's reading for motion: it comes in the sample of the fault itself."""
    encoders, count = Encoders(1.0), 1e-3
    encoders.first = "both"
    for k in range(1000):
        encoders.look(Measurement(np.array([count * (k % 2), 0.0, 0.5, 0.0, 0.0])), math.nan)
    assert encoders.lost_by(Fault.ENCODERS_DISAGREE, 0.1) == ""
    for k in range(100):
        encoders.look(Measurement(np.array([count * k, 0.0, 0.5, 0.0, 0.0])), math.nan)
    assert encoders.lost_by(Fault.ENCODERS_DISAGREE, 0.1) == "load"


@pytest.mark.parametrize(
    ("law", "side"),
    [*((law, side) for law in ("two_region", "cascade") for side in ANGLES), ("dual_loop", "load")],
)
def test_every_law_goes_on_where_the_load_is(gains: GainSet, law: str, side: str) -> None:
    """Though the encoders' zeros are 0.7 rad apart at the output.

    `dual_loop` needs both, so the over-damped gains act. With the load's alone these sag under a load torque.
    """
    axis = Axis(settings_of(gains, law))
    before = axis.play(1000)[-250:]
    after = axis.play(1000, missing, side)
    assert (axis.servo.fault, axis.servo.lost_encoder) == ("", side)
    assert np.max(np.abs(after - np.mean(before))) <= np.ptp(before) + 5.0 * B


@each_side
def test_it_is_not_used_again_before_a_reset(gains: GainSet, side: str) -> None:
    axis = Axis(settings_of(gains))
    axis.play(250)
    axis.play(1, missing, side)
    way = axis.play(250)
    assert axis.servo.lost_encoder == side
    assert np.ptp(way) <= 0.25 * B
    axis.servo.reset()
    axis.play(1)
    assert (axis.servo.lost_encoder, axis.servo.settings.encoders) == ("", "both")


def test_the_motor_s_encoder_is_believed_on_in_the_zero_of_the_load_s(gains: GainSet) -> None:
    """Its angle leaps by the difference of the zeros, which is no motion."""
    axis = Axis(settings_of(gains))
    axis.play(250)
    axis.play(1, missing, "load")
    assert axis.servo.lost_encoder == "load"
    motor = axis.servo.memory.plausibility.motor
    assert motor.implausible_angles == 0.0
    assert abs(motor.mean_speed) < 0.5


@each_side
def test_the_last_encoder_is_a_fault(gains: GainSet, side: str) -> None:
    axis = Axis(settings_of(gains))
    axis.play(250)
    axis.play(10, missing, side)
    other = next(each for each in ANGLES if each != side)
    axis.play(1, missing, other)
    assert axis.servo.lost_encoder == side  # the first one is not used again, so nothing is left
    assert axis.servo.latched.name == "NOT_FINITE"


@each_side
def test_by_default_it_is_a_fault(gains: GainSet, side: str) -> None:
    axis = Axis(settings_of(gains, what="stop"))
    axis.play(250)
    axis.play(1, leapt, side)
    assert (axis.servo.latched.name, axis.servo.command) == (f"{side.upper()}_JUMP", 0.0)


def test_an_experiment_ends(gains: GainSet) -> None:
    axis = Axis(settings_of(gains))
    axis.play(250)
    axis.servo.start_experiment()
    axis.play(20)
    axis.play(250, missing)
    assert "the load's encoder is lost" in str(axis.servo.take_outcome())
    assert (axis.servo.fault, axis.servo.lost_encoder) == ("", "load")


def test_another_choice_is_refused(gains: GainSet) -> None:
    with pytest.raises(ValueError, match=r"faults.on_lost_encoder must be one of \['stop', 'continue'\], got 'ignore'"):
        settings_of(gains, what="ignore")


def test_a_position_that_is_not_a_number_says_that_its_joint_is_absent_unless_none_is_left() -> None:
    def read(motor: float, load: float) -> Measurement:
        message = SimpleNamespace(name=["motor", "load"], position=[motor, load], velocity=[1.0, 2.0], effort=[])
        return read_joint_state(message, "motor", "load", 0.05, nan_is_absent=True)

    np.testing.assert_array_equal(read(0.5, math.nan), [0.5, 1.0, math.nan, math.nan, math.nan])
    with pytest.raises(BadSampleError, match="no position of our joints is a number"):
        read(math.nan, math.nan)


def test_the_gate_takes_a_joint_for_lost_after_three_samples_without_it() -> None:
    gate = SampleGate(10**9, 10**8)
    gate.may_lose = True
    now = 0

    def judged(motor: bool, load: bool) -> Action:
        nonlocal now
        now += 4_000_000
        return gate.sample(now, now, joints=(motor, load)).action

    assert judged(True, True) is Action.TAKE
    assert [judged(True, False) for _ in range(2)] == [Action.REFUSE] * 2
    assert judged(True, True) is Action.TAKE
    assert [judged(True, False) for _ in range(4)] == [Action.REFUSE] * 2 + [Action.TAKE] * 2
    assert judged(True, True) is Action.TAKE  # the servo does not use it
    gate.open()
    gate.may_lose = False
    assert judged(True, True) is Action.TAKE
    assert [judged(True, False) for _ in range(4)] == [Action.REFUSE] * 4
