"""What moves the load beside single references: trajectories, setpoints, goals, and a service that holds it."""

from typing import Protocol

from std_msgs.msg import Float32, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from backlash_ros.control import Servo
from backlash_ros.control.motion.in_position import InPosition
from backlash_ros.control.motion.stream import Stream
from backlash_ros.control.motion.trajectory import TrajectoryError, points_of, trajectory_of
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.foundation.signals import Measurement
from backlash_ros.nodes.fixed_parameters import ControllerParameters
from backlash_ros.nodes.follow_trajectory import FollowTrajectory
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.timer import in_ns
from backlash_ros.ros.topics import RECEIVE_STREAM, SEND, TRANSIENT_LOCAL

try:
    from control_msgs.action import FollowJointTrajectory
except ImportError:  # it comes with ros2_control
    FollowJointTrajectory = None

_FIELDS = 2, 3
"""Numbers of a setpoint: position and velocity, and acceleration if it is known."""


class Taken(Protocol):
    """Is told of each message, with the reason if it is refused, and whether such messages may come ``often``."""

    def __call__(self, refusal: str, *, often: bool) -> None: ...  # noqa: D102


class Motion:
    """Takes trajectories and setpoints for the load's joint, and says whether the load is in position.

    Parameters
    ----------
    given : joints and times
    """

    def __init__(self, node: ManagedNode, servo: Servo, given: ControllerParameters, taken: Taken) -> None:
        self._node, self._servo, self._joint, self._taken = node, servo, given.joints[1], taken
        self._timeout = in_ns(given.state_timeout)
        self._stream, self._ran = Stream(servo, given.setpoint_timeout), False
        self.newest_sample = 0
        """Stamp of the newest sample that was taken, ns; 0 if it has none."""
        self._watch, self._told = InPosition(servo), ""
        self._in_position = node.speak(String, "~/in_position", TRANSIENT_LOCAL)
        node.listen(JointTrajectory, "joint_trajectory", self._on_trajectory, SEND)
        node.listen(Float32, "speed_scaling", self._on_speed_scaling)
        node.listen(JointTrajectory, "setpoint", self._on_setpoint, RECEIVE_STREAM)
        node.create_service(Trigger, "~/hold", self._on_hold)
        self._action: FollowTrajectory | None = None
        if FollowJointTrajectory is not None:
            self._action = FollowTrajectory(
                node, servo, self._joint, lambda: self._watch.window, lambda: self._now, FollowJointTrajectory
            )

    def configure(self) -> None:
        """Say that nothing is held yet: the topic is new."""
        self._told = ""
        self.tell()

    def look(self, measured: Measurement, elapsed: float) -> None:
        """Take an answered sample, ``elapsed`` s after the previous one."""
        if self._ran and not self._stream.runs:
            self._end_stream()
        if self._action is not None:
            self._action.look(elapsed)
        self._watch.look(measured, elapsed)
        self.tell()

    def tell(self) -> None:
        """Publish whether the load is in position, if that has changed."""
        if (state := self._watch.state) != self._told:
            self._told = state
            self._in_position.publish(String(data=state))

    def released(self) -> None:
        """Say at once that no position is held any more."""
        if self._action is not None:
            self._action.released()
        self._watch.release()
        self.tell()

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self._taken(self._follow(message), often=False)

    def _follow(self, message: JointTrajectory) -> str:
        """Follow a trajectory from the newest sample on; return why it is refused."""
        if not self._node.active:
            return "joint_trajectory came while not active"
        try:
            path = trajectory_of(message, self._joint, self._now)
            refusal = self._servo.follow(path, at_once=True, paced=True)
        except TrajectoryError as error:
            refusal = str(error)
        if refusal:
            return f"joint_trajectory is refused: {refusal}"
        points, left, end = path.times.size, path.times[-1] - path.age, self._servo.reference
        slowed = "" if self._servo.pace == 1.0 else f", {self._scaled}"
        self._node.get_logger().info(
            f"follows a trajectory of {points} points, to {end:.6g} rad in {left:.3g} s{slowed}",
            throttle_duration_sec=1.0,
        )
        return ""

    @property
    def _scaled(self) -> str:
        return f"at {self._servo.pace:g} of its speed by speed_scaling"

    def _on_speed_scaling(self, message: Float32) -> None:
        before, refusal = self._servo.pace, self._servo.set_pace(message.data)
        if refusal:
            self._taken(refusal, often=True)
        elif message.data != before:
            self._node.get_logger().info(f"follows a trajectory {self._scaled}", throttle_duration_sec=1.0)

    @property
    def _now(self) -> int:
        """The time of the newest sample, ns, on the clock of the messages' stamps.

        A plan goes on with the samples. By their stamps, all axes that get the same message start at the same one. A
        drive with a clock of its own tells nothing of the time that the message means.
        """
        now = self._node.get_clock().now().nanoseconds
        return self.newest_sample if abs(now - self.newest_sample) < self._timeout else now

    def _on_setpoint(self, message: JointTrajectory) -> None:
        if refusal := self._follow_setpoint(message):
            self._taken(f"setpoint is refused: {refusal}", often=True)
        elif not self._ran:
            self._ran = True
            self._taken("", often=True)
            self._node.get_logger().info(
                f"follows setpoints {self._stream.delay:.3g} s after their time", throttle_duration_sec=1.0
            )

    def _follow_setpoint(self, message: JointTrajectory) -> str:
        """Follow one more setpoint; return why it is refused."""
        if not self._node.active:
            return "it came while not active"
        try:
            times, states = points_of(message, self._joint)
        except TrajectoryError as error:
            return str(error)
        if times.size != 1:
            return f"it must have one point, got {times.size}"
        if states.shape[1] not in _FIELDS:
            return "velocities must be given, got positions alone: those belong on the topic reference"
        if not (stamp := stamp_ns(message.header.stamp)):
            return "header.stamp must be the time of the setpoint, got 0: its arrival says too little of it"
        return self._stream.take(stamp + in_ns(times[0]), states[0], self._now)

    def _end_stream(self) -> None:
        self._ran = False
        if not self._stream.stops:
            return  # at rest, or for something else, which was told
        self._servo.asked = False
        self._taken("", often=True)
        self._node.get_logger().warning(
            f"no setpoint for {self._stream.timeout:g} s: comes to rest at {self._servo.reference:.6g} rad and holds it"
        )

    def _on_hold(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        refusal = self._node.refusal or self._servo.stop()
        if not refusal:
            self._taken("", often=False)
        response.success = not refusal
        response.message = refusal or f"comes to rest at {self._servo.reference:.6g} rad and holds it"
        return response
