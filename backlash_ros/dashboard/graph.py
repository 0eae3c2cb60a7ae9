"""Finds the axes of a ROS graph, and keeps them while their nodes come and go."""

import asyncio
import time
import traceback
from collections.abc import Callable
from threading import Thread

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node, NodeNameNonExistentError

from backlash_ros.dashboard.axis import Axis, Diagnosis, Names
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.ros.topics import SEND

_LOOK = 0.5
"""Period of the search in the graph, s."""

_JOINTS, _NUMBER, _NUMBERS = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64", "std_msgs/msg/Float64MultiArray"
_PATH = "trajectory_msgs/msg/JointTrajectory"


def _split(full: str) -> tuple[str, str]:
    """Return name and namespace of a node."""
    namespace, _, name = full.rpartition("/")
    return name, namespace or "/"


def _join(namespace: str, name: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


class Graph:
    """The axes by their namespaces, found by a separate thread.

    A controller is a node that offers ``~/learn`` and ``~/identify``. Its topics are recognized by their types, even if
    they are remapped; the simulator of its drive is the one that publishes its joint states. If the thread fails,
    ``broken`` is called in ``loop``.
    """

    def __init__(self, node: Node, loop: asyncio.AbstractEventLoop, broken: Callable[[], None]) -> None:
        self.axes: dict[str, Axis] = {}
        self._broken = broken
        self._node, self._loop = node, loop
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, SEND)
        node.create_timer(_LOOK, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._thread = Thread(target=self._spin, name="ROS", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return
        except Exception as error:  # whatever it is: a page that hears nothing more must not look like one that does
            self._node.get_logger().fatal(f"{type(error).__name__}: {error}\n{traceback.format_exc()}")
            self._loop.call_soon_threadsafe(self._broken)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join(timeout=1.0)

    def look(self) -> None:
        """Find new axes, and note which are gone."""
        offered = {name for name, _ in self._node.get_service_names_and_types()}
        controllers = {name.removesuffix("/learn") for name in offered if name.endswith("/learn")}
        controllers = {name for name in controllers if f"{name}/identify" in offered}
        for axis in list(self.axes.values()):
            axis.present = axis.names.controller in controllers
        for controller in sorted(controllers):
            known = next((axis for axis in self.axes.values() if axis.names.controller == controller), None)
            names = self._names(controller, known.names if known else None)
            if known is None:
                known = Axis(self._node, names, self._loop)
                self.axes[known.title if known.title not in self.axes else controller] = known
            known.found(names)

    def _names(self, controller: str, before: Names | None) -> Names:
        """Return the names of an axis; those from ``before`` if the controller is not configured and has no topics."""
        name, namespace = _split(controller)
        heard = self._topics(self._node.get_subscriber_names_and_types_by_node, name, namespace)
        by_point = self._topics(self._node.get_subscriber_names_and_types_by_node, name, namespace, "setpoint")
        spoken = self._topics(self._node.get_publisher_names_and_types_by_node, name, namespace)
        if before is None:
            topics = ("joint_states", "reference", "command", "load_torque", "setpoint")
            before = Names(controller, *(_join(namespace, topic) for topic in topics))
        joints = heard.get(_JOINTS, before.joint_states)
        simulator, load_torque = self._simulator(joints)
        return Names(
            controller,
            joints,
            heard.get(_NUMBER, before.reference),
            spoken.get(_NUMBERS, before.command),
            load_torque or before.load_torque,
            by_point.get(_PATH, before.setpoint),
            simulator,
        )

    def _simulator(self, joint_states: str) -> tuple[str, str]:
        """Return the simulator that publishes joint states, and its topic for the load torque; empty without one.

        A node that accepts a load torque is a simulator.
        """
        for publisher in self._node.get_publishers_info_by_topic(joint_states):
            heard = self._topics(
                self._node.get_subscriber_names_and_types_by_node, publisher.node_name, publisher.node_namespace
            )
            if _NUMBER in heard and _NUMBERS in heard:
                return _join(publisher.node_namespace, publisher.node_name), heard[_NUMBER]
        return "", ""

    @staticmethod
    def _topics(
        ask: Callable[[str, str], list[tuple[str, list[str]]]], name: str, namespace: str, last: str = ""
    ) -> dict[str, str]:
        """Return a node's topics by type, those with this ``last`` name alone if one is given.

        There are none as long as the middleware knows a publisher without its node's name.
        """
        if not namespace.startswith("/"):
            return {}
        try:
            return {kinds[0]: topic for topic, kinds in ask(name, namespace) if last in ("", topic.rpartition("/")[2])}
        except NodeNameNonExistentError:
            return {}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        at, stamp = time.monotonic(), 1e-9 * stamp_ns(message.header.stamp)
        for status in message.status:
            level = int.from_bytes(status.level, "little")
            values = {entry.key: entry.value for entry in status.values}
            for axis in list(self.axes.values()):
                axis.on_diagnostics(status.name, Diagnosis(level, status.message, values, at, stamp))

    def listeners(self, axis: Axis) -> tuple[int, int]:
        """Return the number of subscribers of an axis's command, and of publishers of its joint states."""
        return (
            self._node.count_subscribers(axis.names.command),
            self._node.count_publishers(axis.names.joint_states),
        )
