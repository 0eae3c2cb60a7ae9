"""The action of MoveIt and ros2_control: a trajectory with tolerances, feedback and a result.

It is served where control_msgs is installed, which has its type. A goal follows the same plan as a message on the topic
joint_trajectory; what is watched here is how well, and when it is done.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import GoalEvent
from trajectory_msgs.msg import JointTrajectoryPoint

from backlash_ros.control import Servo
from backlash_ros.control.motion.setpoint import DURATION
from backlash_ros.control.motion.trajectory import trajectory_of
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, POSITION, VELOCITY
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.messages import to_stamp

SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5
"""Results, as control_msgs/FollowJointTrajectory numbers them."""

STAYS = 0.1
"""Time for which the load must stay within the tolerances after the end, s, as ~/in_position has it."""
PATIENCE = 2.0
"""Time after the trajectory's end within which the load must arrive if the goal does not say it, s."""
FEEDBACK = 0.05
"""Time between two messages of feedback, s."""


class GoalError(ValueError):
    """A goal that cannot be followed; the text says why."""


@dataclass(frozen=True)
class Tolerances:
    """How far the load may be off: position, rad, and velocity, rad/s, and the time after the end, s."""

    path: tuple[float, float]
    goal: tuple[float, float]
    time: float

    @classmethod
    def of(cls, request: Any, joint: str, window: float) -> "Tolerances":
        """Return those of a goal; ``window``: that of the position by default, rad. GoalError names a wrong one."""
        time = float(request.goal_time_tolerance.sec) + 1e-9 * float(request.goal_time_tolerance.nanosec)
        if time < 0.0:
            raise GoalError(f"goal_time_tolerance must be >= 0 s, got {time:g}")
        path = _tolerance("path_tolerance", request.path_tolerance, joint, (math.inf, math.inf))
        goal = _tolerance("goal_tolerance", request.goal_tolerance, joint, (window, math.inf))
        return cls(path, goal, time or PATIENCE)


def _tolerance(field: str, given: Any, joint: str, default: tuple[float, float]) -> tuple[float, float]:
    """Return the bounds for a joint: 0 stands for the default, -1 for none."""
    bounds = default
    for each in given:
        if each.name != joint:
            raise GoalError(f"{field} must be of joint {joint!r}, got {each.name!r}")
        if each.acceleration > 0.0:
            raise GoalError(
                f"{field} must not bound the acceleration, which is not measured, got {each.acceleration:g}"
            )
        values = each.position, each.velocity
        if not all(math.isfinite(value) and (value >= 0.0 or value == -1.0) for value in values):
            raise GoalError(f"{field} must be > 0, 0 for the default, or -1 for none, got {list(values)}")
        bounds = tuple(  # type: ignore[assignment]
            usual if value == 0.0 else math.inf if value < 0.0 else value
            for value, usual in zip(values, default, strict=True)
        )
    return bounds


@dataclass
class _Goal:
    handle: Any
    tolerances: Tolerances
    rows: Array  # the plan
    ends: float  # time in it, s
    unsaid: float = math.inf  # time since the last feedback, s
    inside: float = 0.0  # time within the tolerances after the end, s


class FollowTrajectory:
    """Follows one goal after the other; a new one replaces the one before it.

    Parameters
    ----------
    joint : name of the load's joint
    window : returns the distance within which the load has arrived by default, rad
    now : returns the time of the newest sample, ns
    action : control_msgs.action.FollowJointTrajectory
    """

    def __init__(
        self,
        node: ManagedNode,
        servo: Servo,
        joint: str,
        window: Callable[[], float],
        now: Callable[[], int],
        action: Any,
    ) -> None:
        self._node, self._servo, self._joint, self._action = node, servo, joint, action
        self._window, self._now = window, now
        self._goal: _Goal | None = None
        self._server = self.serve()

    def serve(self) -> Any:
        """Return the server."""
        return ActionServer(
            self._node,
            self._action,
            "~/follow_joint_trajectory",
            lambda _handle: self._action.Result(),  # never called: each goal ends by `_end`
            handle_accepted_callback=self.accept,
            cancel_callback=self.cancel,
        )

    def accept(self, handle: Any) -> None:
        """Follow a new goal. One that cannot be followed is aborted with the reason, and changes nothing."""
        handle._update_state(GoalEvent.EXECUTE)  # without a callback that would have to wait for the end
        try:
            goal = self._begin(handle)
        except Exception as error:  # one that left this callback would crash the events executor
            code = INVALID_JOINTS if str(error).startswith("joint_names") else INVALID_GOAL
            self._end(handle, "abort", code, f"the goal is refused: {error}")
            return
        before, self._goal = self._goal, goal
        if before is not None:
            self._end(before.handle, "abort", INVALID_GOAL, "another goal has replaced this one")

    def _begin(self, handle: Any) -> _Goal:
        request, servo = handle.request, self._servo
        if refusal := self._node.refusal:
            raise GoalError(refusal)
        if len(names := list(request.trajectory.joint_names)) > 1:
            raise GoalError(f"joint_names must be [{self._joint!r}] alone, got {names}")
        other = getattr(request, "multi_dof_trajectory", None)
        if other is not None and len(other.points):
            raise GoalError("multi_dof_trajectory must be empty")
        tolerances = Tolerances.of(request, self._joint, self._window())
        path = trajectory_of(request.trajectory, self._joint, self._now())
        if refusal := servo.follow(path, at_once=True, paced=True):
            raise GoalError(refusal)
        ends = float(servo.segments[:, DURATION].sum())
        return _Goal(handle, tolerances, servo.segments, 0.0 if math.isinf(ends) else ends)

    def cancel(self, handle: Any) -> CancelResponse:
        """Come to rest along the path; the next sample ends the goal."""
        goal = self._goal
        if goal is not None and goal.handle is handle and goal.rows is self._servo.segments:
            self._servo.stop()
            goal.rows = self._servo.segments
        return CancelResponse.ACCEPT

    def released(self) -> None:
        """End the goal, since no position is held any more."""
        why = f"{self._servo.latched.name}: {self._servo.fault}" if self._servo.latched else "the load was released"
        self._close("abort", INVALID_GOAL, why)

    def look(self, elapsed: float) -> None:
        """Take an answered sample, ``elapsed`` s after the previous one."""
        goal, servo = self._goal, self._servo
        if goal is None:
            return
        if not servo.holding:
            self.released()
            return
        if goal.handle.is_cancel_requested:
            self._close("canceled", SUCCESSFUL, f"canceled: comes to rest at {servo.reference:.6g} rad and holds it")
            return
        if goal.rows is not servo.segments:
            self._close("abort", INVALID_GOAL, "another command has replaced the trajectory")
            return
        desired = np.array(servo.setpoint)
        actual = np.array([servo.load_angle, servo.estimate[OMEGA_L]])
        goal.unsaid += elapsed
        if goal.unsaid >= FEEDBACK:
            goal.unsaid = 0.0
            goal.handle.publish_feedback(self._feedback(desired, actual))
        self._judge(goal, desired, actual, elapsed)

    def _judge(self, goal: _Goal, desired: Array, actual: Array, elapsed: float) -> None:
        """End a goal that has been reached, or whose tolerances are exceeded."""
        off, speed = abs(desired[POSITION] - actual[POSITION]), abs(desired[VELOCITY] - actual[VELOCITY])
        late = self._servo.memory.plan_time - goal.ends
        seen = f"{off:.4g} rad and {speed:.4g} rad/s off"
        if late < 0.0:
            position, velocity = goal.tolerances.path
            if off > position or speed > velocity:
                self._servo.stop()
                text = f"{seen}, path_tolerance is {position:g} rad and {velocity:g} rad/s"
                self._close("abort", PATH_TOLERANCE_VIOLATED, f"{text}: comes to rest and holds")
            return
        position, velocity = goal.tolerances.goal
        goal.inside = goal.inside + elapsed if off <= position and speed <= velocity else 0.0
        if goal.inside >= STAYS:
            self._close("succeed", SUCCESSFUL, f"there, {seen}")
        elif late > STAYS + goal.tolerances.time:
            text = f"{seen}, goal_tolerance is {position:g} rad and {velocity:g} rad/s"
            self._close("abort", GOAL_TOLERANCE_VIOLATED, f"{text}, {goal.tolerances.time:g} s after the end")

    def _feedback(self, desired: Array, actual: Array) -> Any:
        feedback = self._action.Feedback()
        feedback.header.stamp = to_stamp(self._now())
        feedback.joint_names = [self._joint]
        feedback.desired = JointTrajectoryPoint(
            positions=desired[:1], velocities=desired[1:2], accelerations=desired[2:]
        )
        feedback.actual = JointTrajectoryPoint(positions=actual[:1], velocities=actual[1:])
        error = desired[:2] - actual
        feedback.error = JointTrajectoryPoint(positions=error[:1], velocities=error[1:])
        return feedback

    def _close(self, how: str, code: int, text: str) -> None:
        """End the goal that is followed, if there is one."""
        goal, self._goal = self._goal, None
        if goal is not None:
            self._end(goal.handle, how, code, text)

    def _end(self, handle: Any, how: str, code: int, text: str) -> None:
        """End a goal: ``how`` is the handle's method that does it."""
        result = self._action.Result()
        result.error_code, result.error_string = code, text
        if code == SUCCESSFUL:
            self._node.get_logger().info(f"follow_joint_trajectory: {text}")
        else:
            self._node.get_logger().warning(f"follow_joint_trajectory: {text}")

        def conclude(ended: Any) -> Any:
            getattr(ended, how)()
            return result

        self._server.notify_execute(handle, conclude)
