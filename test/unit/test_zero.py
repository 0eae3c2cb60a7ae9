"""The zero of the axis: another one moves nothing, whatever acts, and all that goes in and out counts from it."""

from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.control import GainSet, Limits, Servo, ServoSettings
from backlash_ros.control.monitoring.wear import WearWatch
from backlash_ros.control.motion.profile_parameters import ProfileParameters
from backlash_ros.control.motion.stream import Stream
from backlash_ros.control.motion.trajectory import Trajectory, TrajectoryError
from backlash_ros.control.telemetry import telemetry
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.gates.faults import Fault
from backlash_ros.simulation import SimulatedDrive

B = NOMINAL_DRIVE.gear.backlash_angle
ZERO = 0.75
"""Exact in binary, so that what should be the same is the same to the last bit."""
COUNTS = Sensors(measured=POSITIONS, motor_counts=4096.0, load_counts=4096.0)
TRAVEL = replace(Limits.of(NOMINAL_DRIVE), position_lower=-1.0, position_upper=1.0)


class Axis:
    """A servo with its drive, whose load hangs, and all commands so far."""

    def __init__(self, gains: GainSet, law: str = "planned", limits: Limits | None = None) -> None:
        settings = replace(ServoSettings(gains).with_law(law), backlash_angle=B, identified=True)
        self.servo = Servo(NOMINAL_DRIVE, settings, limits)
        self.plant = SimulatedDrive(NOMINAL_DRIVE, settings.period, sensors=COUNTS)
        self.commands: list[float] = []

    def run(self, seconds: float, torque: float = -0.3) -> "Axis":
        for _ in range(round(seconds / self.servo.settings.period)):
            self.commands.append(self.servo.update(self.plant.sample(), self.plant.elapsed))
            self.plant.advance(self.commands[-1], torque)
        return self

    @property
    def angle(self) -> float:
        return float(self.plant.state[THETA_L])

    def told(self) -> dict[str, float]:
        return telemetry(self.servo, WearWatch(self.servo), active=True, parameters_version=1, samples=1, elapsed=0.004)


@pytest.mark.parametrize("law", ["planned", "two_region"])
def test_another_zero_moves_nothing_and_all_that_goes_in_and_out_counts_from_it(gains: GainSet, law: str) -> None:
    """With a twin that keeps its zero: the same commands to the last bit, at rest and in every kind of motion."""
    axis, twin = Axis(gains, law), Axis(gains, law)
    for each in (axis, twin):
        each.run(0.5)
        assert each.servo.set_reference(0.5) == ""
        each.run(1.5)
    before = axis.told()
    assert axis.servo.rejection_reason(axis.servo.limits, zero=ZERO) == ""
    axis.servo.count_from(ZERO)
    moved = {name for name, value in axis.told().items() if abs(value - before[name]) > 1e-12}
    assert moved == {"reference", "setpoint", "motor_angle", "load_angle"}
    assert axis.servo.reference == 0.5 - ZERO
    assert axis.told()["motor_angle"] == before["motor_angle"] - ZERO / NOMINAL_DRIVE.gear.ratio
    for each, zero in ((axis, ZERO), (twin, 0.0)):
        each.run(0.5)
        assert each.servo.set_reference(1.0 - zero) == ""
        each.run(0.5)
        assert each.servo.follow(Trajectory(np.array([0.5]), np.array([[0.5 - zero, 0.0]])), at_once=True) == ""
        each.run(1.0)
        stream = Stream(each.servo, 0.1)
        for k in range(20):
            state = np.array([0.5 - zero + 0.25 * (0.02 * k) ** 2, 0.5 * 0.02 * k])
            assert stream.take(round(2e7 * k) + 10**9, state, round(2e7 * k) + 10**9) == ""
            each.run(0.02)
        assert each.servo.stop() == ""
        each.run(0.5)
        profile = replace(each.servo.settings, profile=ProfileParameters(mode="auto"))
        each.servo.use(profile)
        assert each.servo.set_reference(-0.25 - zero) == ""
        each.run(1.5)
    np.testing.assert_allclose(axis.commands, twin.commands, rtol=0.0, atol=1e-9)
    assert abs(axis.servo.load_angle + ZERO + 0.25) < 2.0 * B


def test_ends_of_the_travel_count_from_the_zero(gains: GainSet) -> None:
    axis = Axis(gains, limits=TRAVEL).run(0.5, 0.0)
    assert axis.servo.set_reference(0.9) == ""
    axis.run(1.0, 0.0)
    axis.servo.count_from(0.75)
    assert "limits.position_upper = 1 rad, got 1.1" in axis.servo.set_reference(1.1)
    assert axis.servo.set_reference(0.95) == ""
    axis.run(1.0, 0.0)
    assert abs(axis.angle - 1.7) < B
    axis.run(0.5, 5.9)  # pulled out of the travel
    assert axis.servo.latched is Fault.UPPER_END
    assert "load at 1.1" in axis.servo.fault


def test_a_zero_is_refused_with_its_reason_and_changes_nothing(gains: GainSet) -> None:
    axis = Axis(gains, limits=TRAVEL)
    servo = axis.servo

    def refused() -> str:
        why = servo.rejection_reason(servo.limits, zero=ZERO)
        assert servo.zero == 0.0
        return why

    assert refused() == ""  # nothing is held
    axis.run(0.5, 0.0)
    assert servo.set_reference(0.5) == ""
    axis.run(0.05, 0.0)
    assert refused() == "the zero must not change while the load moves, or is away from its reference: call hold"
    axis.run(1.0, 0.0)
    assert refused() == ""
    assert "with zero = -2 rad the load is at 2.5" in servo.rejection_reason(servo.limits, zero=-2.0)
    servo.start_experiment("gap_probe")
    axis.run(0.1, 0.0)
    assert refused() == "the zero must not change while learning"
    servo.cancel("test")
    servo.take_outcome()
    servo.fail(Fault.RATE, "test")
    assert refused() == ""  # nothing is held; the node does not ask then


def test_a_path_that_begins_elsewhere_is_refused_with_positions_from_the_zero(gains: GainSet) -> None:
    axis = Axis(gains).run(0.5, 0.0)
    axis.servo.count_from(ZERO)
    with pytest.raises(TrajectoryError, match=r"-0\.75 rad, got 0"):
        axis.servo.follow(Trajectory(np.array([0.0, 1.0]), np.zeros((2, 2))), at_once=True)
