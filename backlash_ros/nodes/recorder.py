"""Recorder for places without ros2 bag: writes the interface's topics to a rosbag2 directory (mcap).

`ros2 bag`, PlotJuggler, Foxglove and the rosbags library read it. Messages are stored as they came off the wire.
The bag is whole up to the last second whatever happens to the recorder, be it SIGKILL or a full disk, which ends it
with code 1.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path

from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.typesys import Stores, get_typestore

from backlash_ros.analysis.bag_writer import BagWriter
from backlash_ros.nodes.parameters import declare_recorder, refuse_unknown
from backlash_ros.ros.run import StoppableNode, run
from backlash_ros.ros.timer import Timer

_QUEUE = 10_000
"""Messages of a topic that can wait for a slow disk: 40 s at 250 Hz. Fast DDS does not tell of what it drops beyond."""

_SLOW = 1.0
"""Seconds of writing that are worth a warning."""


def _subscription_qos(publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Ask for as much as every publisher of a topic offers."""
    reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    transient_local = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE,
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


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {topic}" for topic, count in counts.items()) or "nothing"


class Recorder(StoppableNode):
    """Writes a bag until it is stopped; topics are taken up as their publishers appear."""

    linger = 0.3

    def __init__(self) -> None:
        super().__init__("recorder")
        given = declare_recorder(self, time.strftime("backlash_%Y_%m_%d-%H_%M_%S"))
        refuse_unknown(self)
        output, topics = Path(given.output), given.topics
        if not topics:
            raise ValueError("topics must name at least one topic, got none")
        if output.exists():
            raise ValueError(f"output must be a new folder, got {str(output)!r}, which exists")
        if not output.parent.is_dir():
            raise ValueError(f"output must lie in an existing folder, got {str(output)!r}")
        self._wanted = [self.resolve_topic_name(topic) for topic in topics]
        self._types = get_typestore(Stores.ROS2_JAZZY)
        try:
            self._bag = BagWriter(output)
        except OSError as error:
            raise ValueError(f"output cannot be written: {error}") from error
        self._lost: dict[str, int] = {}
        self._broken = False
        self.own_timers = [Timer(0.1, self._look), Timer(1.0, partial(self._keep, self._bag.save))]
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
        connection = self._bag.add_connection(topic, kind, typestore=self._types, offered_qos_profiles=[_bag_qos(qos)])
        package, _, name = kind.split("/")
        self.create_subscription(
            getattr(import_module(f"{package}.msg"), name),
            topic,
            partial(self._store, connection),
            qos,
            event_callbacks=SubscriptionEventCallbacks(message_lost=partial(self._miss, topic)),
            raw=True,
        )
        self.get_logger().info(f"recording {topic}")

    def _store(self, connection: Connection, data: bytes) -> None:
        self._bag.write(connection, self.get_clock().now().nanoseconds, data)

    def _miss(self, topic: str, event: QoSMessageLostInfo) -> None:
        """Take down what a publisher could not keep until it was fetched."""
        self._lost[topic] = event.total_count
        self.get_logger().warning(f"lost {event.total_count} {topic}", throttle_duration_sec=1.0)

    def _keep(self, write: Callable[[], None]) -> None:
        began = time.monotonic()
        try:
            write()
        except OSError as error:
            self._broken = True
            raise OSError(f"the bag cannot be written: {error.strerror}") from error
        if (took := time.monotonic() - began) > _SLOW:
            self.get_logger().warning(f"the disk took {took:.1f} s; messages wait, {_QUEUE} of a topic at most")

    def stop(self) -> None:
        """Close the bag, so that it is whole, and say what is in it."""
        told = self._broken
        try:
            self._keep(self._bag.close)  # after a full disk too: there may be space again
        except OSError:
            if not told:
                raise
        finally:
            self.get_logger().info(f"recorded {_listed(self._bag.saved)}")
            if self._lost:
                self.get_logger().error(f"lost {_listed(self._lost)}")


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder."""
    return run("recorder", _made, args)


def _made(axis: str) -> Recorder:
    if axis:
        raise ValueError(f"the recorder takes no --axes: record one axis with --ros-args -r __ns:=/{axis.strip('/')}")
    return Recorder()


if __name__ == "__main__":
    raise SystemExit(main())
