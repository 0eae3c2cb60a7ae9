"""Whether the load is in position: what is said in words, and that it is never said of a load that is not."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backlash_ros.control import GainSet, Limits, Servo, ServoSettings
from backlash_ros.control.motion.in_position import HOLDING, LIMIT, MOVING, RELEASED, SETTLED, STATES, InPosition
from backlash_ros.control.motion.trajectory import Trajectory
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.gates.faults import Fault
from backlash_ros.simulation import SimulatedDrive

B = NOMINAL_DRIVE.gear.backlash_angle
PERIOD = 0.004


class Axis:
    """A servo with its drive, and what is said of its position."""

    def __init__(self, gains: GainSet, counts: float = 65536.0, law: str = "planned", **limits: float) -> None:
        chosen = replace(ServoSettings(gains).with_law(law), backlash_angle=B, identified=True)
        self.servo = Servo(NOMINAL_DRIVE, chosen, replace(Limits.of(NOMINAL_DRIVE), **limits))
        encoders = Sensors(measured=POSITIONS, motor_counts=65536.0, load_counts=counts)
        self.plant = SimulatedDrive(NOMINAL_DRIVE, PERIOD, sensors=encoders)
        self.watch = InPosition(self.servo)
        self.torque = 0.0

    @property
    def angle(self) -> float:
        return float(self.plant.state[THETA_L])

    def run(self, seconds: float) -> list[str]:
        """Go on; return what was said, each once in its order."""
        said = [self.watch.state]
        for _ in range(round(seconds / PERIOD)):
            measured = self.plant.sample()
            command = self.servo.update(measured, PERIOD)
            said.append(self.watch.look(measured, PERIOD))
            self.plant.advance(command, self.torque)
        return [state for state, before in zip(said, ["", *said], strict=False) if state != before]


def test_a_load_that_was_found_is_held_and_one_that_has_come_to_its_reference_is_settled(gains: GainSet) -> None:
    axis = Axis(gains)
    assert axis.run(0.5) == [RELEASED, MOVING, HOLDING]
    assert axis.servo.set_reference(1.0) == ""
    assert axis.run(1.0) == [HOLDING, MOVING, SETTLED]
    assert abs(axis.angle - 1.0) <= 0.25 * B
    assert axis.servo.set_reference(1.0 + 0.1 * B) == ""  # within the window: a motion all the same
    assert axis.run(1.0) == [SETTLED, MOVING, SETTLED]
    assert axis.servo.set_reference(axis.servo.reference) == ""
    assert axis.run(0.1) == [SETTLED]


def test_a_trajectory_that_pauses_is_not_at_its_end(gains: GainSet) -> None:
    axis = Axis(gains)
    axis.run(0.5)
    path = Trajectory(np.array([0.5, 1.5, 2.0]), np.array([[0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    assert axis.servo.follow(path, at_once=True) == ""
    assert axis.run(1.9) == [HOLDING, MOVING]
    assert axis.run(0.5) == [MOVING, SETTLED]


def test_a_load_that_was_stopped_is_held(gains: GainSet) -> None:
    axis = Axis(gains)
    axis.run(0.5)
    assert axis.servo.follow(Trajectory(np.array([1.0]), np.array([[1.0]])), at_once=True) == ""
    axis.run(0.3)
    assert axis.servo.stop() == ""
    assert axis.run(1.0) == [MOVING, HOLDING]


def test_a_load_that_torque_keeps_off_is_at_a_limit_until_it_is_let_go(gains: GainSet) -> None:
    """The law in use holds against a torque by an error."""
    axis = Axis(gains, law="overdamped")
    axis.servo.use(replace(axis.servo.settings, torque_bandwidth=0.0))
    axis.run(0.5)
    axis.torque = 0.15
    assert axis.servo.set_reference(0.5) == ""
    said = axis.run(4.0)
    assert said[-1] == LIMIT
    assert axis.servo.fault == ""
    assert abs(axis.angle - 0.5) > 0.25 * B
    axis.torque = 0.0
    assert axis.run(4.0)[-1] == SETTLED


def test_a_fault_a_release_and_an_experiment_end_it_at_once(gains: GainSet) -> None:
    axis = Axis(gains)
    axis.run(0.5)
    axis.servo.fail(Fault.TRACKING, "away")
    assert axis.run(PERIOD) == [HOLDING, RELEASED]
    axis.servo.reset()
    assert axis.run(0.5) == [RELEASED, MOVING, HOLDING]
    axis.servo.start_experiment()
    assert axis.run(0.1) == [HOLDING, MOVING]
    axis.watch.release()
    assert axis.watch.state == RELEASED


def test_the_window_is_a_quarter_of_the_gap_or_a_count(gains: GainSet) -> None:
    fine, coarse = Axis(gains), Axis(gains, counts=512.0)
    for axis in (fine, coarse):
        axis.run(0.2)
        assert axis.servo.set_reference(1.0) == ""
        axis.run(1.5)
    assert fine.watch.window == pytest.approx(0.25 * B)
    assert coarse.watch.window == pytest.approx(2.0 * math.pi / 512.0)
    assert coarse.watch.state == SETTLED
    unknown = Axis(gains)
    unknown.servo.use(replace(unknown.servo.settings, backlash_angle=0.0))
    assert unknown.watch.window == pytest.approx(0.25 * B)  # by the data sheet


@settings(deadline=None, max_examples=15)
@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(0.02, 1.0)), min_size=1, max_size=5), st.floats(-0.1, 0.1))
def test_it_is_never_said_of_a_load_that_is_away(
    gains: GainSet, moves: list[tuple[float, float]], torque: float
) -> None:
    """Neither of one that passes its reference, nor of one that still has to go there."""
    axis = Axis(gains)
    axis.run(0.2)
    axis.torque = torque
    for reference, seconds in moves:
        assert axis.servo.set_reference(reference) == ""
        for _ in range(round(seconds / PERIOD)):
            axis.run(PERIOD)
            if axis.watch.state == SETTLED:
                assert abs(axis.servo.load_angle - reference) <= axis.watch.window


def test_every_state_is_explained() -> None:
    page = (Path(__file__).parents[2] / "docs" / "interface.md").read_text()
    for state, meaning in STATES.items():
        assert f"| `{state}` | {meaning} |" in page
