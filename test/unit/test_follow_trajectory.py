"""Goals of the action follow_joint_trajectory end as joint_trajectory_controller's do, and leave a load that is held.

Its type comes with ros2_control, so stand-ins take the place of the server and of the goals' handles.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS")

from builtin_interfaces.msg import Duration
from rclpy.logging import get_logger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from backlash_ros.control import GainSet, Limits, Servo, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import POSITION, VELOCITY, Measurement
from backlash_ros.gates import Fault
from backlash_ros.nodes.follow_trajectory import FollowTrajectory

PERIOD, WINDOW = 0.004, 0.005


class Handle:
    """A goal, and how it ended."""

    def __init__(self, positions: tuple[float, ...] = (0.2, 0.4), **changes: Any) -> None:
        trajectory = JointTrajectory(joint_names=["load"])
        for k, position in enumerate(positions):
            due = Duration(nanosec=400_000_000 * (k + 1))
            trajectory.points.append(JointTrajectoryPoint(positions=[position], time_from_start=due))
        asked = {"path_tolerance": [], "goal_tolerance": [], "goal_time_tolerance": Duration()}
        self.request = SimpleNamespace(trajectory=trajectory, **(asked | changes))
        self.is_cancel_requested = False
        self.said: list[Any] = []
        self.ended, self.code, self.text = "", 1, ""

    def _update_state(self, _event: object) -> None: ...
    def publish_feedback(self, feedback: Any) -> None:
        self.said.append(feedback)

    def succeed(self) -> None:
        self.ended = "succeeded"

    def abort(self) -> None:
        self.ended = "aborted"

    def canceled(self) -> None:
        self.ended = "canceled"


class Server:
    def notify_execute(self, handle: Handle, conclude: Any) -> None:
        assert not handle.ended
        result = conclude(handle)
        handle.code, handle.text = result.error_code, result.error_string


class Goals(FollowTrajectory):
    def serve(self) -> Any:
        return Server()


class Axis:
    """A load that is where its setpoint is, but for ``off``, rad."""

    def __init__(self, gains: GainSet) -> None:
        self.servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), Limits.of(NOMINAL_DRIVE), watched=False)
        self.off, log = 0.0, get_logger("axis")
        self.node: Any = SimpleNamespace(refusal="", get_logger=lambda: log)
        action = SimpleNamespace(
            Result=lambda: SimpleNamespace(error_code=0, error_string=""),
            Feedback=lambda: SimpleNamespace(header=SimpleNamespace()),
        )
        self.goals = Goals(self.node, self.servo, "load", lambda: WINDOW, lambda: 0, action)
        self.leaps = [0.0]
        self.run(0.1)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            before = float(self.servo.memory.setpoint[POSITION])
            load = before + self.off
            self.servo.update(Measurement(np.array([load / NOMINAL_DRIVE.gear.ratio, np.nan, load, np.nan, np.nan])))
            self.goals.look(PERIOD)
            self.leaps.append(abs(float(self.servo.memory.setpoint[POSITION]) - before))

    def start(self, *positions: float, **changes: Any) -> Handle:
        handle = Handle(positions or (0.2, 0.4), **changes)
        self.goals.accept(handle)
        return handle


def bound(position: float, velocity: float = 0.0, name: str = "load", acceleration: float = 0.0) -> list[Any]:
    return [SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=acceleration)]


@pytest.fixture
def axis(gains: GainSet) -> Axis:
    return Axis(gains)


def test_a_goal_succeeds_once_the_load_stays_at_its_end(axis: Axis) -> None:
    goal = axis.start()
    axis.run(0.85)
    assert not goal.ended
    axis.run(0.1)
    assert (goal.ended, goal.code) == ("succeeded", 0)
    assert goal.text
    assert axis.servo.reference == pytest.approx(0.4)
    assert 16 <= len(goal.said) <= 20  # 20 a second
    middle = goal.said[8]
    assert middle.joint_names == ["load"]
    assert middle.desired.positions[0] - middle.actual.positions[0] == pytest.approx(middle.error.positions[0])
    assert middle.desired.velocities[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "off", "ended", "code", "after"),
    [
        ({}, 0.02, "aborted", -5, 0.9 + 2.0),
        ({"goal_time_tolerance": Duration(nanosec=500_000_000)}, 0.02, "aborted", -5, 0.9 + 0.5),
        ({"goal_tolerance": bound(0.03)}, 0.02, "succeeded", 0, 0.9),
        ({"goal_tolerance": bound(-1.0)}, 0.5, "succeeded", 0, 0.9),
        ({"path_tolerance": bound(0.03)}, 0.05, "aborted", -4, 0.0),
        ({"path_tolerance": bound(0.03)}, 0.02, "aborted", -5, 0.9 + 2.0),
        ({"path_tolerance": bound(0.0, 0.2)}, 0.02, "aborted", -4, 0.0),
    ],
)
def test_tolerances_decide_how_a_goal_ends(
    axis: Axis, changes: dict[str, Any], off: float, ended: str, code: int, after: float
) -> None:
    goal = axis.start(**changes)
    axis.off = off
    if after:
        axis.run(after - 0.05)
        assert not goal.ended
    axis.run(0.1)
    assert (goal.ended, goal.code) == (ended, code)
    assert goal.text
    axis.run(0.5)
    assert axis.servo.memory.setpoint[VELOCITY] == 0.0  # it is held
    assert (axis.servo.reference == pytest.approx(0.4)) == (code != -4)


def test_a_refused_goal_changes_nothing(axis: Axis) -> None:
    running = axis.start()
    axis.run(0.2)
    elbow = JointTrajectory(joint_names=["load", "elbow"])
    for code, changes, text in (
        (-2, {"trajectory": elbow}, "joint_names must be ['load'] alone, got ['load', 'elbow']"),
        (-2, {"trajectory": JointTrajectory(joint_names=["elbow"])}, "joint_names must contain 'load', got ['elbow']"),
        (-1, {"trajectory": JointTrajectory(joint_names=["load"])}, "at least one point"),
        (-1, {"path_tolerance": bound(np.nan)}, "path_tolerance must be > 0, 0 for the default, or -1 for none"),
        (-1, {"goal_tolerance": bound(1.0, name="elbow")}, "goal_tolerance must be of joint 'load', got 'elbow'"),
        (-1, {"goal_tolerance": bound(1.0, acceleration=1.0)}, "must not bound the acceleration"),
        (-1, {"goal_time_tolerance": Duration(sec=-1)}, "goal_time_tolerance must be >= 0 s, got -1"),
        (-1, {"multi_dof_trajectory": SimpleNamespace(points=[1])}, "multi_dof_trajectory must be empty"),
    ):
        refused = Handle()
        vars(refused.request).update(changes)
        axis.goals.accept(refused)
        assert (refused.ended, refused.code) == ("aborted", code)
        assert text in refused.text
    far = axis.start(100.0)
    assert (far.ended, far.code) == ("aborted", -1)
    axis.node.refusal = "the controller must be active, but is inactive"
    assert "the controller must be active, but is inactive" in axis.start().text
    assert not running.ended
    axis.run(0.8)
    assert running.ended == "succeeded"


def test_whatever_ends_a_goal_in_motion_makes_no_leap(axis: Axis) -> None:
    first = axis.start()
    axis.run(0.3)
    second = axis.start(0.3, 0.1)
    assert (first.ended, first.text) == ("aborted", "another goal has replaced this one")
    axis.run(0.3)
    axis.goals.cancel(second)
    second.is_cancel_requested = True
    axis.run(0.2)
    assert second.ended == "canceled"
    assert "comes to rest at" in second.text
    assert not np.any(axis.servo.memory.setpoint[VELOCITY:])
    third = axis.start(0.3, 0.1)
    axis.run(0.1)
    assert not axis.servo.stop()
    axis.run(0.1)
    assert (third.ended, third.text) == ("aborted", "another command has replaced the trajectory")
    assert max(axis.leaps) < 1.1 * PERIOD  # of 1 rad/s
    last = axis.start()
    axis.servo.fail(Fault.LOAD_JUMP, "a test")
    axis.goals.released()
    assert (last.ended, last.text) == ("aborted", "LOAD_JUMP: a test")
