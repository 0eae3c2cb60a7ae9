"""Homing on a simulated drive with a stop: it finds the stop, never presses harder, and never takes another place."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from backlash_ros.control import GainSet, Limits, Servo, ServoSettings
from backlash_ros.control.experiment import Outcome, Refusal, ZeroEstimate
from backlash_ros.control.homing import HomingSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive, Effects
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.signals import OMEGA_L, THETA_L, Measurement, at_rest
from backlash_ros.simulation import SimulatedDrive

B = NOMINAL_DRIVE.gear.backlash_angle
STOP = 1.3
HOME = HomingSettings(speed=0.5, way=3.0, position=1.0, back_off=0.1)
BOUND = HOME.bound(NOMINAL_DRIVE, Limits.of(NOMINAL_DRIVE))
TRAVEL = replace(Limits.of(NOMINAL_DRIVE), position_lower=-1.0, position_upper=1.0)


class Axis:
    """A servo with a drive that has stops at ``STOP`` to either side, and how hard it pressed at most.

    ``wrong``: error of the load's next reading, rad.
    """

    wrong, tripped = 0.0, False

    def __init__(
        self, gains: GainSet, drive: Drive = NOMINAL_DRIVE, begin: float = 0.0, torque: float = 0.0, **sensors: object
    ) -> None:
        settings = replace(ServoSettings(gains), backlash_angle=B, identified=True)
        effects = Effects(stop_lower=-STOP, stop_upper=STOP)
        state = at_rest()
        state[THETA_L], state[0] = begin, begin / drive.gear.ratio
        self.servo, self.torque, self.pressed, self.farthest = Servo(NOMINAL_DRIVE, settings, TRAVEL), torque, 0.0, 0.0
        self.plant = SimulatedDrive(
            replace(drive, effects=effects), settings.period, sensors=Sensors(**sensors), state=state
        )
        self.step()

    @property
    def angle(self) -> float:
        return float(self.plant.state[THETA_L])

    def step(self) -> None:
        sample = self.plant.sample().copy()
        sample[THETA_L] += self.wrong
        self.wrong = 0.0
        command = self.servo.update(Measurement(sample), self.plant.elapsed)
        if self.servo.experimenting:
            gain = NOMINAL_DRIVE.standstill_torque() / NOMINAL_DRIVE.command_limit
            self.pressed = max(self.pressed, abs(gain * command))
        self.plant.advance(command, self.torque)
        self.farthest = max(self.farthest, abs(self.angle))

    def home(
        self, settings: HomingSettings, name: str = "homing", meanwhile: Callable[["Axis"], None] = lambda _axis: None
    ) -> Outcome:
        self.servo.start_experiment(name, settings)
        for _ in range(10_000):
            self.step()
            meanwhile(self)
            if (outcome := self.servo.take_outcome()) is not None:
                return outcome  # type: ignore[return-value]
        raise AssertionError("homing did not end")

    def rests_at(self, angle: float, window: float = 2.0 * B) -> bool:
        """Go on for two seconds; return whether the load stays there."""
        for _ in range(500):
            self.step()
            if abs(self.angle - angle) > window:
                return False
        return not self.servo.latched and abs(self.plant.state[OMEGA_L]) < 0.5


MOTOR, LOAD = ("theta_m",), ("theta_l",)
EXACT: dict[str, object] = {}


@pytest.mark.parametrize(
    ("direction", "torque", "begin", "sensors"),
    [
        (1.0, 0.4, 0.0, EXACT),
        (-1.0, 0.4, STOP - 0.001, EXACT),  # it begins at the stop, and a torque pulls it away from there
        (-1.0, 0.0, 0.0, {"measured": (*MOTOR, *LOAD), "motor_counts": 2000.0, "load_counts": 4096.0}),
        (1.0, 0.0, 0.0, {"measured": MOTOR, "motor_counts": 2000.0}),
        (1.0, 0.0, 0.0, {"measured": LOAD, "load_counts": 8192.0}),
    ],
)
def test_the_stop_is_found(
    gains: GainSet, direction: float, torque: float, begin: float, sensors: dict[str, object]
) -> None:
    """It is outside of the travel, as that counts before. Then the load rests away from it, in the new positions."""
    home = replace(HOME, speed=direction * HOME.speed, position=direction * HOME.position)
    axis = Axis(gains, begin=direction * begin, torque=torque, **sensors)
    assert axis.servo.experiment_refusal("homing", home) == ""
    found = axis.home(home)
    assert isinstance(found, ZeroEstimate), found
    near = B if len(sensors.get("measured", ())) == 1 else 0.002  # type: ignore[arg-type]
    assert abs(found.zero - direction * (STOP - HOME.position)) < near
    assert axis.pressed <= BOUND * (1.0 + 1e-9)
    assert axis.servo.rejection_reason(TRAVEL, zero=found.zero) == ""
    axis.servo.count_from(found.zero)
    assert axis.rests_at(direction * (STOP - HOME.back_off))
    assert abs(axis.servo.load_angle - direction * (HOME.position - HOME.back_off)) < 2.0 * B


def of_load(**changes: float) -> Drive:
    return replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, **changes))


@pytest.mark.parametrize(
    ("drive", "torque", "settings", "why"),
    [
        (of_load(gravity_torque=2.5), 0.0, HOME, "friction or its own torque may have held it"),
        (of_load(coulomb_friction=1.5), 0.0, HOME, "the load moves neither way with 1.2 N m"),
        (NOMINAL_DRIVE, -1.5, HOME, "the other way: its own torque is larger"),
        (NOMINAL_DRIVE, 0.0, replace(HOME, way=0.5), "homing.way = 0.5 rad"),
    ],
)
def test_what_is_no_stop_is_not_taken_for_one(
    gains: GainSet, drive: Drive, torque: float, settings: HomingSettings, why: str
) -> None:
    """The load stays where that ended."""
    axis = Axis(gains, drive, torque=torque)
    found = axis.home(settings)
    assert not found.valid
    assert why in found.reason
    assert axis.pressed <= BOUND * (1.0 + 1e-9)
    assert axis.farthest < STOP + 0.001
    assert torque or axis.rests_at(axis.angle)


def _trip_at(place: float, wrong: float, axis: Axis) -> None:
    if axis.angle > place and axis.servo.experimenting:
        axis.servo.trip()
        axis.wrong, axis.tripped = 0.0 if axis.tripped else wrong, True


@pytest.mark.parametrize("wrong", [0.0, 0.05])
def test_a_switch_ends_it_at_once_whatever_one_reading_says(gains: GainSet, wrong: float) -> None:
    axis = Axis(gains)
    found = axis.home(HOME, "homing_by_switch", partial(_trip_at, 0.4, wrong))
    assert isinstance(found, ZeroEstimate)
    assert abs(found.zero - (0.4 - HOME.position)) < 3 * HOME.speed * axis.servo.settings.period
    assert axis.farthest < 0.4 + B
    assert axis.rests_at(0.4 - HOME.back_off)


def test_a_stop_before_it_is_no_switch(gains: GainSet) -> None:
    found = Axis(gains).home(HOME, "homing_by_switch")
    assert found.reason.startswith("not homed: the load stood still after 1.3 rad")


def test_it_ends_at_rest_when_it_is_cancelled_or_a_sample_is_no_number(gains: GainSet) -> None:
    def cancel(axis: Axis) -> None:
        if axis.angle > 0.3:
            axis.servo.cancel("asked")

    def lose(axis: Axis) -> None:
        if axis.angle > 0.3:
            assert axis.servo.update(Measurement(np.full(5, math.nan))) == 0.0

    axis = Axis(gains)
    assert axis.home(HOME, meanwhile=cancel) == Refusal("not homed: asked")
    assert axis.rests_at(0.3)
    assert not Axis(gains).home(HOME, meanwhile=lose).valid


def test_it_is_refused_with_the_parameter_that_is_wrong(gains: GainSet) -> None:
    servo = Axis(gains).servo
    for changes, why in (
        ({"speed": 0.0}, "homing.speed must not be 0 rad/s"),
        ({"way": 0.0}, "homing.way must be > homing.back_off = 0.1 rad, got 0"),
        ({"speed": 9.0}, "homing.speed = 9 rad/s alone takes"),
        ({"torque": 0.7}, "from faults.load_torque = 3.6 N m on that is a fault"),
        ({"position": 1.2}, "(homing.back_off) from homing.position, but reference must be within limits."),
    ):
        assert why in servo.experiment_refusal("homing", replace(HOME, **changes))
