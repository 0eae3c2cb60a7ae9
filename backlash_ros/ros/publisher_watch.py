"""Listens whether two publishers send the same joints, beside the loop that takes their samples."""

from collections.abc import Iterable

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from sensor_msgs.msg import JointState

from backlash_ros.gates import Publishers
from backlash_ros.ros.timer import now_ns
from backlash_ros.ros.topics import WATCH

_UNKNOWN = "_NODE_NAME_UNKNOWN_"


class PublisherWatch:
    """A subscription of its own to a topic of joint states, of which only the newest messages are looked at.

    A subscription that the events executor knows crashes it if it also asks for the numbers of the messages, so this
    one is read directly, and only while the graph has more than one publisher.
    """

    def __init__(self, node: Node, topic: str, joints: Iterable[str]) -> None:
        self._node, self._topic = node, node.resolve_topic_name(topic)
        self._publishers = Publishers(joints)
        with node.handle:
            self._reader = rclpy_implementation.Subscription(
                node.handle, JointState, self._topic, WATCH.get_c_qos_profile()
            )

    def close(self) -> None:
        """Unsubscribe."""
        self._reader.destroy_when_not_in_use()

    def forget(self) -> None:
        """Forget what was heard."""
        self._publishers.forget()

    @property
    def count(self) -> int:
        """Number of publishers in the graph."""
        return int(self._node.count_publishers(self._topic))

    def look(self) -> str:
        """Return which joint two publishers send, and their names; empty if none."""
        if self.count < 2:
            self._publishers.forget()
            return ""
        while (taken := self._take()) is not None:
            message, info = taken
            if joint := self._publishers.heard(message.name, info["publication_sequence_number"], now_ns()):
                return f"two publishers on joint_states send joint {joint!r}: {self._names()}"
        return ""

    def _take(self) -> tuple[JointState, dict[str, int | None]] | None:
        with self._reader:
            taken: tuple[JointState, dict[str, int | None]] | None = self._reader.take_message(JointState, False)
        return taken

    def _names(self) -> str:
        found = self._node.get_publishers_info_by_topic(self._topic)
        names = (
            "a publisher without a name" if each.node_name == _UNKNOWN else f"{each.node_namespace}/{each.node_name}"
            for each in found
        )
        return ", ".join(sorted(name.replace("//", "/") for name in names))
