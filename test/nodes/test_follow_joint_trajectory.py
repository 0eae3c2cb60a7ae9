"""The action follow_joint_trajectory over DDS: goals end as the pages say, and the load is held."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import follow_joint_trajectory
import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from graph import Lifecycle, Peer, Process
from lifecycle_msgs.msg import Transition
from lockstep_drive import LockstepDrive
from rclpy.action import ActionClient
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from backlash_ros.drivetrain import NOMINAL_DRIVE

Start = Callable[..., Process]
B = NOMINAL_DRIVE.gear.backlash_angle
NAME = "controller/follow_joint_trajectory"
KNOWN = {"state_timeout": 10.0, "backlash_angle": B, "identified": True}
PATH = {0.4: 0.2, 0.8: 0.6, 1.2: 0.8}
"""Times, s, and positions, rad."""
FASTEST = 1.5
"""More than the path's largest speed, rad/s."""


@pytest.fixture(scope="module")
def action(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Give the type, for processes that are started as well; without ROS 2's control_msgs, one that is built here."""
    with pytest.MonkeyPatch.context() as patch:
        if find_spec("control_msgs") is None:
            path = str(follow_joint_trajectory.importable(tmp_path_factory.mktemp("action")))
            patch.syspath_prepend(path)
            patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [path, os.environ.get("PYTHONPATH")])))
        yield import_module("control_msgs.action").FollowJointTrajectory


class Axis:
    """A controller, its drive, and a client."""

    def __init__(self, start: Start, peer: Peer, action: Any) -> None:
        self.peer, self.action, self.feedback = peer, action, []
        self.controller = start("controller", fresh=True, **KNOWN)  # what tests fork nodes from has not seen the type
        self.drive = LockstepDrive(peer).matched()
        self.client = ActionClient(peer.node, action, NAME)
        peer.wait("the action", self.client.server_is_ready)
        self.drive.run(50)

    def goal(self, joint: str = "load", path: dict[float, float] | None = None, **fields: Any) -> Any:
        """Return a goal; ``fields`` replace those of the message."""
        trajectory = JointTrajectory(joint_names=[joint])
        for time, position in (path or PATH).items():
            due = Duration(sec=int(time), nanosec=round(1e9 * (time % 1)))
            trajectory.points.append(JointTrajectoryPoint(positions=[position], time_from_start=due))
        return self.action.Goal(trajectory=trajectory, **fields)

    def sent(self, goal: Any) -> Any:
        """Send a goal once, let the drive go on until it is accepted, and return its handle."""
        accepted = self.client.send_goal_async(goal, feedback_callback=self.feedback.append)
        self.drive.until(accepted.done)
        assert accepted.result().accepted
        return accepted.result()

    def result(self, handle: Any) -> tuple[int, int, str]:
        """Let the drive go on until the goal has ended; return its status, the code and the text."""
        future = handle.get_result_async()
        self.drive.until(future.done)
        answer = future.result()
        return answer.status, answer.result.error_code, answer.result.error_string

    def moves(self, beyond: float = 0.1) -> None:
        self.drive.until(lambda: self.drive.load_angle > beyond)

    def comes_to_rest(self) -> float:
        """Return where the load comes to rest, rad, which it does without a leap."""
        path = [self.drive.load_angle, *self.drive.run(250)]
        assert max(abs(np.diff(path))) < FASTEST * self.drive.period
        assert np.ptp(path[-50:]) < 0.1 * B
        return path[-1]

    def is_released(self, result: Any) -> None:
        self.peer.wait("the result", result.done)
        answer = result.result()
        assert (answer.status, answer.result.error_code) == (GoalStatus.STATUS_ABORTED, -1)
        assert answer.result.error_string == "the load was released"
        self.peer.wait("the last command", lambda: self.drive.commands[-1] == 0.0)

    def tolerance(self, position: float) -> list[Any]:
        kind = import_module("control_msgs.msg").JointTolerance
        return [kind(name="load", position=position)]


@pytest.fixture
def axis(start: Start, peer: Peer, action: Any) -> Iterator[Axis]:
    made = Axis(start, peer, action)
    yield made
    made.client.destroy()


def test_a_goal_is_followed_to_success(axis: Axis) -> None:
    goal, before = axis.sent(axis.goal()), axis.drive.tick
    status, code, text = axis.result(goal)
    took = (axis.drive.tick - before) * axis.drive.period
    assert (status, code) == (GoalStatus.STATUS_SUCCEEDED, 0), text
    assert text.startswith("there, ")
    assert abs(axis.comes_to_rest() - 0.8) < 0.25 * B
    said = [message.feedback for message in axis.feedback]
    assert len(said) == pytest.approx(20.0 * took, rel=0.1)
    for each in said:
        assert each.joint_names == ["load"]
        assert each.error.positions[0] == pytest.approx(each.desired.positions[0] - each.actual.positions[0])
    assert np.ptp([each.desired.positions[0] for each in said]) > 0.7


def test_a_refused_goal_says_why_and_moves_nothing(axis: Axis) -> None:
    for goal, code, text in (
        (axis.goal("elbow"), -2, "the goal is refused: joint_names must contain 'load', got ['elbow']"),
        (axis.goal(path={0.4: 100.0}), -1, "the goal is refused: "),
        (axis.goal(path={0.4: np.nan}), -1, "the goal is refused: "),
        (axis.goal(path_tolerance=axis.tolerance(-2.0)), -1, "the goal is refused: path_tolerance must be > 0"),
    ):
        status, got, said = axis.result(axis.sent(goal))
        assert (status, got) == (GoalStatus.STATUS_ABORTED, code)
        assert said.startswith(text)
    assert max(abs(axis.drive.run(100))) < 0.1 * B
    running = axis.sent(axis.goal())
    axis.moves()
    assert axis.result(axis.sent(axis.goal("elbow")))[1] == -2
    assert axis.result(running)[:2] == (GoalStatus.STATUS_SUCCEEDED, 0)


def test_a_canceled_goal_ends_at_rest_and_is_held(axis: Axis) -> None:
    handle = axis.sent(axis.goal())
    axis.moves()
    canceled = handle.cancel_goal_async()
    axis.drive.until(canceled.done)
    assert len(canceled.result().goals_canceling) == 1
    status, code, text = axis.result(handle)
    assert (status, code) == (GoalStatus.STATUS_CANCELED, 0)
    rest = axis.comes_to_rest()
    assert 0.1 < rest < 0.5
    assert text == f"canceled: comes to rest at {float(text.split()[5]):.6g} rad and holds it"
    assert abs(rest - float(text.split()[5])) < 0.25 * B
    again = handle.cancel_goal_async()  # of a goal that has ended: nothing happens
    axis.drive.until(again.done)
    assert not again.result().goals_canceling
    assert abs(axis.comes_to_rest() - rest) < 0.1 * B


def test_what_replaces_a_goal_aborts_it(axis: Axis) -> None:
    """A second goal, a reference, or hold, each without a leap."""
    first = axis.sent(axis.goal())
    axis.moves()
    second = axis.sent(axis.goal(path={0.5: 0.6, 1.0: 0.4}))
    replaced = GoalStatus.STATUS_ABORTED, -1
    assert axis.result(first) == (*replaced, "another goal has replaced this one")
    assert axis.result(second)[:2] == (GoalStatus.STATUS_SUCCEEDED, 0)
    assert abs(axis.comes_to_rest() - 0.4) < 0.25 * B

    third = axis.sent(axis.goal())
    axis.moves(0.5)
    hold = axis.peer.node.create_client(Trigger, "controller/hold").call_async(Trigger.Request())
    assert axis.result(third) == (*replaced, "another command has replaced the trajectory")
    axis.drive.until(hold.done)
    assert abs(axis.comes_to_rest() - float(hold.result().message.split()[4])) < 0.25 * B

    fourth = axis.sent(axis.goal(path={0.5: 0.3, 1.0: 0.2}))
    axis.drive.run(50)
    axis.drive._reference.publish(Float64(data=0.5))
    assert axis.result(fourth) == (*replaced, "another command has replaced the trajectory")
    axis.drive.run(500)
    assert abs(axis.comes_to_rest() - 0.5) < 0.25 * B


def test_a_load_that_is_held_up_violates_the_path_and_is_held(axis: Axis) -> None:
    handle = axis.sent(axis.goal(path_tolerance=axis.tolerance(0.05)))
    axis.moves()
    axis.drive.load_torque = -2.0
    status, code, text = axis.result(handle)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, -4), text
    assert text.endswith("path_tolerance is 0.05 rad and inf rad/s: comes to rest and holds")
    axis.drive.load_torque = 0.0
    axis.drive.run(250)
    assert axis.comes_to_rest() < 0.6


def test_a_load_that_does_not_arrive_violates_the_goal_and_is_held(axis: Axis) -> None:
    handle = axis.sent(
        axis.goal(goal_tolerance=axis.tolerance(1e-9), goal_time_tolerance=Duration(nanosec=200_000_000))
    )
    status, code, text = axis.result(handle)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, -5), text
    assert abs(axis.comes_to_rest() - 0.8) < 0.25 * B


def test_a_node_that_is_deactivated_or_ends_aborts_its_goal(axis: Axis) -> None:
    lifecycle = Lifecycle(axis.peer, "controller")
    first = axis.sent(axis.goal())
    axis.moves()
    future = first.get_result_async()
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    axis.is_released(future)
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    axis.drive.run(250)
    second = axis.sent(axis.goal(path={0.5: 0.6, 1.0: 0.4}))
    future = second.get_result_async()
    axis.drive.run(20)
    assert axis.controller.stop() == 0
    axis.is_released(future)


CLIENT = f"""
import time
import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectoryPoint

rclpy.init()
node = rclpy.create_node("client")
client = ActionClient(node, FollowJointTrajectory, "{NAME}")
assert client.wait_for_server(60.0)
goal = FollowJointTrajectory.Goal()
goal.trajectory.joint_names = ["load"]
goal.trajectory.points = [JointTrajectoryPoint(positions=[0.8], time_from_start=Duration(sec=2))]
accepted = client.send_goal_async(goal, feedback_callback=lambda _: None)
rclpy.spin_until_future_complete(node, accepted)
accepted.result().get_result_async()
rclpy.spin(node)
"""


def test_a_client_that_is_killed_leaves_its_goal_to_be_followed_to_its_end(axis: Axis) -> None:
    client = subprocess.Popen([sys.executable, "-c", CLIENT])
    try:
        axis.moves()
    finally:
        client.send_signal(signal.SIGKILL)
        client.wait()
    assert axis.drive.load_angle < 0.7
    axis.drive.until(lambda: "follow_joint_trajectory: there, " in axis.controller.output())
    assert abs(axis.comes_to_rest() - 0.8) < 0.25 * B
    assert axis.result(axis.sent(axis.goal(path={0.5: 0.6, 1.0: 0.4})))[:2] == (GoalStatus.STATUS_SUCCEEDED, 0)
    assert axis.controller.stop() == 0
