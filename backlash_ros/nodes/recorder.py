"""Recorder for machines without ros2 bag: writes the interface's topics to a rosbag2 directory (mcap).

`ros2 bag`, PlotJuggler, Foxglove and the rosbags library read it. Messages are stored as received, each with the time
of receipt (mcap's log time) and of publication (publish time). The bag is complete up to the last second even after
SIGKILL or with a full disk, which ends the recorder with code 1.
"""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial, wraps
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.typesys import Stores, get_typestore

from backlash_ros.nodes.fixed_parameters import declare_recorder, refuse_unknown
from backlash_ros.recordings.bag_writer import BagWriter
from backlash_ros.ros.run import StoppableNode, run
from backlash_ros.ros.timer import Timer
from backlash_ros.ros.topics import HEARS, TOPICS

_QUEUE = 10_000
"""Messages of a topic that can wait for a slow disk: 40 s at 250 Hz. Fast DDS does not report what it drops beyond."""

_SLOW = 1.0
"""Duration of a write that causes a warning, s."""

_DISTROS = {"7": "jazzy", "9": "kilted"}
"""ROS distributions by the major version of their rclpy."""

_Offer = tuple[ReliabilityPolicy, DurabilityPolicy]
"""The part of a publisher's QoS that decides which subscribers match."""


def _ros_distro() -> str:
    """Return the name of the running ROS distribution, from its setup file or the version of rclpy."""
    try:
        by_version = _DISTROS.get(version("rclpy").partition(".")[0], "unknown")
    except PackageNotFoundError:
        by_version = "unknown"
    return os.environ.get("ROS_DISTRO") or by_version


def _type_name(message: type) -> str:
    """Return the ROS name of a message type, such as std_msgs/msg/Float64."""
    return f"{message.__module__.partition('.')[0]}/msg/{message.__name__}"


def _offer(qos: QoSProfile) -> _Offer:
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    transient_local = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return (
        ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE,
    )


def _bag_time(duration: Duration) -> QosTime:
    return QosTime(*divmod(duration.nanoseconds, 10**9))


def _bag_qos(qos: QoSProfile) -> Qos:
    """Return a publisher's offered QoS as the bag describes it.

    DDS discovery does not report history and depth: with Fast DDS these are unknown and 0, and rosbag2 writes the same.
    """
    return Qos(
        QosHistory(int(qos.history)),
        qos.depth,
        QosReliability(int(qos.reliability)),
        QosDurability(int(qos.durability)),
        _bag_time(qos.deadline),
        _bag_time(qos.lifespan),
        QosLiveliness(int(qos.liveliness)),
        _bag_time(qos.liveliness_lease_duration),
        qos.avoid_ros_namespace_conventions,
    )


def _with_info(store: Callable[[bytes, dict[str, Any]], None]) -> Callable[..., None]:
    """Return a callback that calls ``store`` with a message and its info from any executor.

    The events executor of rclpy 7.1.6 passes both as one tuple, the others as two arguments.
    """

    @wraps(store)
    def received(*message: Any) -> None:
        store(*(message if len(message) > 1 else message[0]))

    return received


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {topic}" for topic, count in counts.items()) or "nothing"


@dataclass
class _Topic:
    """A recorded topic.

    ``message``: its type, None until there is a publisher; ``connection``: its entry in the bag, from the first
    publisher or message on; ``heard``: keys of the last messages.
    """

    name: str
    message: type | None = None
    connection: Connection | None = None
    subscriptions: dict[_Offer, Subscription] = field(default_factory=dict)
    heard: dict[tuple[int, int], None] = field(default_factory=dict)
    lost: int = 0

    def is_new(self, info: dict[str, Any]) -> bool:
        """Return whether no other subscription has received this message."""
        key = info["source_timestamp"], info["publication_sequence_number"]
        if key in self.heard:
            return False
        self.heard[key] = None
        if len(self.heard) > _QUEUE:
            del self.heard[next(iter(self.heard))]
        return True


class Recorder(StoppableNode):
    """Writes a bag until it is stopped.

    It subscribes to the topics of the interface at once, so that it also hears publishers that send one message and
    leave, and to other topics when a publisher shows their type. A topic has one subscription for each kind of QoS
    among its publishers, so that it hears them all and loses no reliable message; a message received twice is written
    once.
    """

    linger = 0.3

    def __init__(self) -> None:
        super().__init__("recorder")
        given = declare_recorder(self, time.strftime("backlash_%Y_%m_%d-%H_%M_%S"))
        refuse_unknown(self)
        output, topics = Path(given.output), given.topics
        if not topics:
            raise ValueError("topics must have at least one topic, got none")
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._bag = self._new_bag(output)
        self._broken = False
        types = {self.resolve_topic_name(name): message for name, message in TOPICS.items()}
        self._topics = [_Topic(name, types.get(name)) for name in dict.fromkeys(map(self.resolve_topic_name, topics))]
        self._refused: set[tuple[str, str]] = set()
        for topic in self._topics:
            if topic.message:
                self._listen(topic, (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE))
        self.own_timers = [Timer(0.1, self._look), Timer(1.0, partial(self._keep, self._bag.save))]
        self._look()
        self.get_logger().info(f"recording {len(self._topics)} topics to {output}")

    @staticmethod
    def _new_bag(output: Path) -> BagWriter:
        try:
            if output.exists():
                raise ValueError(f"output must be a new folder, got {str(output)!r}, which exists")
            if not output.parent.is_dir():
                raise ValueError(f"output must lie in an existing folder, got {str(output)!r}")
            return BagWriter(output, _ros_distro())
        except OSError as error:
            raise ValueError(f"output cannot be written: {error}") from error

    def _look(self) -> None:
        for topic in self._topics:
            self._hear_all(topic)

    def _hear_all(self, topic: _Topic) -> None:
        """Subscribe with every QoS that a topic's publishers offer."""
        publishers = [p for p in self.get_publishers_info_by_topic(topic.name) if self._is_known(topic, p.topic_type)]
        for publisher in publishers:
            offer = _offer(publisher.qos_profile)
            if offer not in topic.subscriptions:
                self._listen(topic, offer)
        if publishers and not topic.connection:
            self._take_up(topic, publishers)
            self.get_logger().info(f"recording {topic.name}")

    def _is_known(self, topic: _Topic, kind: str) -> bool:
        """Return whether messages of this type can be recorded for a topic; the first publisher sets the type."""
        if (topic.name, kind) in self._refused:
            return False
        reason = ""
        if topic.message:
            if kind != (known := _type_name(topic.message)):
                reason = f"it is recorded as {known}"
        elif kind not in self._types.fielddefs:
            reason = "the recorder does not know it"
        else:
            package, _, name = kind.split("/")
            try:
                topic.message = getattr(import_module(f"{package}.msg"), name)
            except (ImportError, AttributeError):
                reason = f"{package} is not installed"
        if reason:
            self._refused.add((topic.name, kind))
            self.get_logger().error(f"not recorded: {topic.name} has the type {kind}: {reason}")
        return not reason

    def _listen(self, topic: _Topic, offer: _Offer) -> None:
        reliability, durability = offer
        topic.subscriptions[offer] = self.create_subscription(
            topic.message,
            topic.name,
            _with_info(partial(self._store, topic)),
            QoSProfile(reliability=reliability, durability=durability, history=HistoryPolicy.KEEP_LAST, depth=_QUEUE),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=lambda _: self._hear_all(topic), message_lost=partial(self._miss, topic)
            ),
            raw=True,
        )

    def _take_up(self, topic: _Topic, publishers: Sequence[TopicEndpointInfo]) -> Connection:
        """Create a topic's entry in the bag."""
        assert topic.message
        offered = [_bag_qos(publisher.qos_profile) for publisher in publishers]
        topic.connection = self._bag.add_connection(
            topic.name, _type_name(topic.message), typestore=self._types, offered_qos_profiles=offered
        )
        return topic.connection

    def _store(self, topic: _Topic, data: bytes, info: dict[str, Any]) -> None:
        if not topic.connection:
            self._hear_all(topic)
        first = not topic.heard
        if topic.is_new(info):
            if first:
                self.get_logger().info(f"{HEARS} {topic.name}")
            connection = topic.connection or self._take_up(topic, [])  # from a publisher that has already left
            self._bag.write(connection, self.get_clock().now().nanoseconds, data, info["source_timestamp"])

    def _miss(self, topic: _Topic, event: QoSMessageLostInfo) -> None:
        """Count messages that a publisher dropped before they were fetched."""
        topic.lost = max(topic.lost, event.total_count)  # each subscription has its own count
        self.get_logger().warning(f"lost {topic.lost} {topic.name}", throttle_duration_sec=1.0)

    def _keep(self, write: Callable[[], None]) -> None:
        began = time.monotonic()
        try:
            write()
        except OSError as error:
            self._broken = True
            raise OSError(f"the bag cannot be written: {error.strerror}") from error
        if (took := time.monotonic() - began) > _SLOW:
            self.get_logger().warning(f"writing to the disk took {took:.1f} s; up to {_QUEUE} messages per topic wait")

    def stop(self) -> None:
        """Close the bag properly, and log its content."""
        told = self._broken
        for topic in self._topics:
            if topic.message and not topic.connection:
                self._take_up(topic, [])  # so that the bag lists it, with 0 messages
        try:
            self._keep(self._bag.close)  # also after a full disk: there may be space again
        except OSError:
            if not told:
                raise
        finally:
            self.get_logger().info(f"recorded {_listed(self._bag.saved)}")
            if unknown := [topic.name for topic in self._topics if not topic.message]:
                self.get_logger().warning(f"not recorded because nobody published it: {', '.join(unknown)}")
            if lost := {topic.name: topic.lost for topic in self._topics if topic.lost}:
                self.get_logger().error(f"lost {_listed(lost)}")


ABOUT = """\
Writes the topics of drive and controller to a rosbag2 folder (mcap) until it is stopped.

Without the parameter topics it records those of docs/interface.md, relative to its namespace. Ctrl-C closes the
folder; even without that, it is complete up to the last second.

example: ros2 run backlash_ros recorder --ros-args -p output:=my_run"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder."""
    return run("recorder", ABOUT, _made, args)


def _made(axis: str) -> Recorder:
    if axis:
        raise ValueError(f"the recorder has no --axes: record one axis with --ros-args -r __ns:=/{axis.strip('/')}")
    return Recorder()


if __name__ == "__main__":
    raise SystemExit(main())
