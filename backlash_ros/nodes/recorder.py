"""Recorder for places without ros2 bag: writes the interface's topics to a rosbag2 directory (mcap).

`ros2 bag`, PlotJuggler, Foxglove and the rosbags library read it. Messages are stored as they came off the wire.
"""

import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from backlash_ros.nodes.parameters import describe
from backlash_ros.nodes.run import StoppableNode, run
from backlash_ros.nodes.timer import Timer

TOPICS = [
    "joint_states",
    "command",
    "reference",
    "load_torque",
    "controller/tracking_error",
    "controller/region",
    "controller/load_torque_estimate",
    "controller/backlash_estimate",
    "parameter_events",
]
"""What is recorded by default: the whole interface, and each change of a parameter."""

_QUEUE = 1000


def _subscription_qos(publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Ask for as much as every publisher of a topic offers."""
    reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=_QUEUE,
    )


def _bag_qos(qos: QoSProfile) -> Qos:
    forever = QosTime(9223372036, 854775807)  # as rosbag2 writes it
    return Qos(
        QosHistory.KEEP_LAST,
        qos.depth,
        QosReliability(int(qos.reliability)),
        QosDurability(int(qos.durability)),
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )


class Recorder(StoppableNode):
    """Writes a bag until it is stopped; topics are taken up as their publishers appear."""

    linger = 0.3

    def __init__(self) -> None:
        super().__init__("recorder")
        default = time.strftime("backlash_%Y_%m_%d-%H_%M_%S")
        text = "folder to write, which must not exist yet"
        output = Path(self.declare_parameter("output", default, describe(text, read_only=True)).value)
        topics = self.declare_parameter("topics", TOPICS, describe("topics to record", read_only=True)).value
        if output.exists():
            raise ValueError(f"output must be a new folder, got {str(output)!r}, which exists")
        if not output.parent.is_dir():
            raise ValueError(f"output must lie in an existing folder, got {str(output)!r}")
        self._wanted = [self.resolve_topic_name(topic) for topic in topics]
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(output, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._counts: dict[str, int] = {}
        self.own_timers = [Timer(0.1, self._look)]
        self._look()
        self.get_logger().info(f"recording {len(self._wanted)} topics to {output}")

    def _look(self) -> None:
        for topic in list(self._wanted):
            publishers = self.get_publishers_info_by_topic(topic)
            if publishers:
                self._wanted.remove(topic)
                self._take_up(topic, publishers)

    def _take_up(self, topic: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        kind = publishers[0].topic_type
        if kind not in self._types.fielddefs:
            self.get_logger().error(f"not recorded: {topic} has the type {kind}, which the recorder does not know")
            return
        qos = _subscription_qos(publishers)
        connection = self._writer.add_connection(
            topic, kind, typestore=self._types, offered_qos_profiles=[_bag_qos(qos)]
        )
        package, _, name = kind.split("/")
        self._counts[topic] = 0
        self.create_subscription(
            getattr(import_module(f"{package}.msg"), name), topic, self._store(topic, connection), qos, raw=True
        )
        self.get_logger().info(f"recording {topic}")

    def _store(self, topic: str, connection: Connection) -> Callable[[Any], None]:
        def store(data: bytes) -> None:
            self._writer.write(connection, self.get_clock().now().nanoseconds, data)
            self._counts[topic] += 1

        return store

    def stop(self) -> None:
        """Close the bag, so that it is whole."""
        self._writer.close()
        listed = ", ".join(f"{count} {topic}" for topic, count in self._counts.items()) or "nothing"
        self.get_logger().info(f"recorded {listed}")


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder."""
    return run(lambda _namespace: Recorder(), args)


if __name__ == "__main__":
    raise SystemExit(main())
