"""What moves the load beside single references: trajectories by topic, and a service that holds it; what it does."""

from collections.abc import Callable

from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from backlash_ros.control import Servo
from backlash_ros.control.motion.in_position import InPosition
from backlash_ros.control.motion.trajectory import TrajectoryError, trajectory_of
from backlash_ros.foundation.signals import Measurement
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.timer import in_ns
from backlash_ros.ros.topics import SEND, TRANSIENT_LOCAL


class Motion:
    """Takes trajectories for the load's joint, and says whether the load is in position.

    Parameters
    ----------
    joint : name of the load's joint
    timeout : age beyond which a sample's stamp is not of this node's clock, s
    taken : is told of each message, with the reason if it is refused
    """

    def __init__(
        self, node: ManagedNode, servo: Servo, joint: str, timeout: float, taken: Callable[[str], None]
    ) -> None:
        self._node, self._servo, self._joint, self._taken = node, servo, joint, taken
        self._timeout = in_ns(timeout)
        self.newest_sample = 0
        """Stamp of the newest sample that was taken, ns; 0 if it has none."""
        self._watch, self._told = InPosition(servo), ""
        self._in_position = node.speak(String, "~/in_position", TRANSIENT_LOCAL)
        node.listen(JointTrajectory, "joint_trajectory", self._on_trajectory, SEND)
        node.create_service(Trigger, "~/hold", self._on_hold)

    def configure(self) -> None:
        """Say that nothing is held yet: the topic is new."""
        self._told = ""
        self.tell()

    def look(self, measured: Measurement, elapsed: float) -> None:
        """Take an answered sample, ``elapsed`` s after the previous one."""
        self._watch.look(measured, elapsed)
        self.tell()

    def tell(self) -> None:
        """Publish whether the load is in position, if that has changed."""
        if (state := self._watch.state) != self._told:
            self._told = state
            self._in_position.publish(String(data=state))

    def released(self) -> None:
        """Say at once that no position is held any more."""
        self._watch.release()
        self.tell()

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self._taken(self._follow(message))

    def _follow(self, message: JointTrajectory) -> str:
        """Follow a trajectory from the newest sample on; return why it is refused.

        A plan goes on with the samples. By their stamps, all axes that get the same message start at the same one. A
        drive with a clock of its own tells nothing of the time that the message means.
        """
        if not self._node.active:
            return "joint_trajectory came while not active"
        now = self._node.get_clock().now().nanoseconds
        if abs(now - self.newest_sample) < self._timeout:
            now = self.newest_sample
        try:
            refusal = self._servo.follow(path := trajectory_of(message, self._joint, now), at_once=True)
        except TrajectoryError as error:
            refusal = str(error)
        if refusal:
            return f"joint_trajectory is refused: {refusal}"
        points, left, end = path.times.size, path.times[-1] - path.age, self._servo.reference
        self._node.get_logger().info(
            f"follows a trajectory of {points} points, to {end:.6g} rad in {left:.3g} s", throttle_duration_sec=1.0
        )
        return ""

    def _on_hold(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        refusal = self._servo.stop() if self._node.active else f"the controller is {self._node.state}, not active"
        if not refusal:
            self._taken("")
        response.success = not refusal
        response.message = refusal or f"comes to rest at {self._servo.reference:.6g} rad and holds it"
        return response
