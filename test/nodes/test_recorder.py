"""The recorder: every message in the bag, in order, as other tools read it, whatever ends the recorder."""

import errno
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from graph import PATIENCE, Lifecycle, Peer, Process
from lifecycle_msgs.msg import Transition
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.nodes.recorder import Recorder
from backlash_ros.recordings import read_bag
from backlash_ros.recordings.bag_writer import BagWriter
from backlash_ros.ros.topics import SEND, TOPICS

Start = Callable[..., Process]

JOINING = Path(__file__).parents[1] / "support" / "joining.py"

LAST = 2.0
"""Seconds that may be missing before a recorder's end: one, and one more for a machine that is busy."""


def record(start: Start, peer: Peer, folder: Path, count: int) -> Process:
    """Record ``count`` messages of three topics, one of them transient local and sent before the recorder started."""
    node, deep = peer.node, QoSProfile(depth=1000)
    transient_local = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    states = node.create_publisher(JointState, "joint_states", deep)
    commands = node.create_publisher(Float64MultiArray, "command", deep)
    node.create_publisher(Float64, "controller/backlash_estimate", transient_local).publish(Float64(data=0.02))
    process = start("recorder", output=folder)
    peer.wait("the recorder", lambda: states.get_subscription_count() > 0 and commands.get_subscription_count() > 0)
    peer.wait("the recorder", lambda: "recording /controller/backlash_estimate" in process.output())
    for k in range(count):
        message = JointState(name=["motor", "load"], position=[10.0 * k, float(k)], effort=[1.0, 2.0])
        message.header.stamp.sec = k
        states.publish(message)
        commands.publish(Float64MultiArray(data=[0.5 * k]))
        if k % 100 == 0:
            peer.spin(0.05)  # not faster than a queue of 1000 can be emptied
    # Reliable: the recorder has acknowledged, and a stop lets it work off what it has.
    assert states.wait_for_all_acked()
    assert commands.wait_for_all_acked()
    return process


def test_every_message_is_in_the_bag(start: Start, peer: Peer, tmp_path: Path) -> None:
    count = 500
    process = record(start, peer, tmp_path / "bag", count)
    assert process.stop() == 0
    recording = read_bag(tmp_path / "bag")
    wanted = {"/joint_states": count, "/command": count, "/controller/backlash_estimate": 1}
    assert {topic: recording.messages[topic] for topic in wanted} == wanted
    assert recording.joint_states.time.tolist() == list(range(count))
    assert recording.joint_states.values[:, 3].tolist() == list(range(count))
    assert recording.scalars["/command"].values.tolist() == [0.5 * k for k in range(count)]


def test_the_bag_is_what_ros2_bag_writes(start: Start, peer: Peer, tmp_path: Path) -> None:
    """Layout, metadata and type definitions, read by two other libraries."""
    folder = tmp_path / "bag"
    process = record(start, peer, folder, 20)
    assert process.stop() == 0
    said = information(folder)
    assert said["version"] == 9
    assert said["storage_identifier"] == "mcap"
    assert said["relative_file_paths"] == ["bag.mcap"]
    topics = {t["topic_metadata"]["name"]: t["topic_metadata"] for t in said["topics_with_message_count"]}
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in said["topics_with_message_count"]}
    assert counts["/joint_states"] == 20
    assert counts["/load_torque"] == 0
    assert set(counts) == {peer.node.resolve_topic_name(name) for name in TOPICS}
    assert topics["/joint_states"]["type"] == "sensor_msgs/msg/JointState"
    assert topics["/joint_states"]["serialization_format"] == "cdr"
    assert topics["/joint_states"]["type_description_hash"].startswith("RIHS01_")
    (offered,) = topics["/controller/backlash_estimate"]["offered_qos_profiles"]
    (publisher,) = peer.node.get_publishers_info_by_topic("controller/backlash_estimate")
    assert offered["durability"] == "transient_local"
    assert offered["reliability"] == "reliable"
    assert offered["history"] == publisher.qos_profile.history.name.lower()  # not told by DDS: unknown, and 0
    assert offered["depth"] == publisher.qos_profile.depth
    assert topics["/load_torque"]["offered_qos_profiles"] == []

    with AnyReader([folder]) as reader:
        assert {connection.topic for connection in reader.connections} >= {"/joint_states", "/command"}
    with (folder / "bag.mcap").open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/joint_states"])
        positions = [message.position[1] for _, _, _, message in decoded]
    with (folder / "bag.mcap").open("rb") as stream:
        assert make_reader(stream).get_header().library == f"rosbags-{version('rosbags')}"
    assert positions == [float(k) for k in range(20)]
    assert_says_its_span(folder)


def assert_says_its_span(folder: Path) -> None:
    said = information(folder)
    with (folder / "bag.mcap").open("rb") as stream:
        times = [message.log_time for _, _, message in make_reader(stream).iter_messages()]
    assert said["starting_time"]["nanoseconds_since_epoch"] == min(times)
    assert said["duration"]["nanoseconds"] == max(times) - min(times) > 0


def information(folder: Path) -> dict[str, Any]:
    """Return what a bag's metadata.yaml says."""
    return yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


@pytest.mark.parametrize("said", ["", "lyrical"])
def test_the_bag_names_the_ros_distribution(
    start: Start, peer: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str
) -> None:
    monkeypatch.setenv("ROS_DISTRO", said)
    recorder = start("recorder", output=tmp_path / "bag")
    peer.wait("the recorder", lambda: "topics to" in recorder.output())
    assert recorder.stop() == 0
    by_version = {"7": "jazzy", "9": "kilted"}[version("rclpy").partition(".")[0]]
    assert information(tmp_path / "bag")["ros_distro"] == (said or by_version)


def test_publish_time_is_the_source_stamp_and_log_time_the_receipt(start: Start, peer: Peer, tmp_path: Path) -> None:
    stamps: list[int] = []
    publisher = peer.node.create_publisher(Float64, "reference", QoSProfile(depth=100))
    peer.node.create_subscription(
        Float64, "reference", lambda _, info: stamps.append(info["source_timestamp"]), QoSProfile(depth=100)
    )
    recorder = start("recorder", output=tmp_path / "bag")
    peer.wait("the recorder", lambda: publisher.get_subscription_count() == 2)
    peer.wait("the recorder", lambda: "recording /reference" in recorder.output())
    for k in range(20):
        publisher.publish(Float64(data=float(k)))
    assert publisher.wait_for_all_acked()
    peer.wait("the messages", lambda: len(stamps) == 20)
    assert recorder.stop() == 0
    with (tmp_path / "bag" / "bag.mcap").open("rb") as stream:
        messages = [message for _, _, message in make_reader(stream).iter_messages(["/reference"])]
    assert [message.publish_time for message in messages] == stamps
    assert all(0 < message.log_time - message.publish_time < 10 * 10**9 for message in messages)


def send_once(values: list[float]) -> None:
    """Publish each value by a new participant as soon as somebody listens; each leaves when it was heard."""
    peers = [Peer() for _ in values]
    publishers = [peer.node.create_publisher(Float64, "reference", 10) for peer in peers]
    waiting = dict(zip(publishers, values, strict=True))
    end = time.monotonic() + PATIENCE
    while waiting:
        assert time.monotonic() < end, f"{waiting.values()} found nobody in {PATIENCE:g} s"
        for publisher in [publisher for publisher in waiting if publisher.get_subscription_count() > 0]:
            publisher.publish(Float64(data=waiting.pop(publisher)))
        time.sleep(0.001)
    for peer, publisher in zip(peers, publishers, strict=True):
        assert publisher.wait_for_all_acked()
        peer.close()


def test_what_is_sent_once_is_in_the_bag(start: Start, peer: Peer, tmp_path: Path) -> None:
    recorder = start("recorder", output=tmp_path / "bag")
    for name in TOPICS:  # before anybody publishes them
        peer.wait(name, lambda topic=name: peer.node.count_subscribers(topic) == 1)
    values = [float(k) for k in range(10)]
    for first in (0, 5):
        send_once(values[first : first + 5])
    assert recorder.stop() == 0
    assert sorted(read_bag(tmp_path / "bag").scalars["/reference"].values.tolist()) == values


@pytest.mark.grid
def test_what_is_sent_once_to_controller_and_recorder_is_in_the_bag(start: Start, peer: Peer, tmp_path: Path) -> None:
    """As `ros2 topic pub --once -w 2 --keep-alive 1` sends it: one that waits for one listener reaches that one."""
    start("controller", state_timeout=10.0)
    recorder = start("recorder", output=tmp_path / "bag")
    peer.wait("both", lambda: peer.node.count_subscribers("reference") == 2)
    sent = [sys.executable, str(JOINING), "--count", "20", "-w", "2", "--keep-alive", "1"]
    subprocess.run(sent, check=True, timeout=4 * PATIENCE)
    assert recorder.stop() == 0
    values = read_bag(tmp_path / "bag").scalars["/reference"].values
    assert sorted(values.tolist()) == [0.01 * (k + 1) for k in range(20)]


def test_every_kind_of_publisher_is_heard_and_nothing_is_written_twice(
    start: Start, peer: Peer, tmp_path: Path
) -> None:
    recorder = start("recorder", output=tmp_path / "bag")
    peer.wait("the recorder", lambda: peer.node.count_subscribers("reference") == 1)
    reliability, durability = ReliabilityPolicy, DurabilityPolicy
    offers = [
        (reliability.RELIABLE, durability.VOLATILE),
        (reliability.BEST_EFFORT, durability.VOLATILE),
        (reliability.RELIABLE, durability.TRANSIENT_LOCAL),
    ]
    publishers = []
    for reliable, durable in offers:
        qos = QoSProfile(depth=100, reliability=reliable, durability=durable)
        publishers.append(peer.node.create_publisher(Float64, "reference", qos))
    publishers[-1].publish(Float64(data=-1.0))  # heard by one subscription after the other, from its history
    # Each publisher is heard by those of the recorder's three subscriptions that ask for no more than it offers.
    peer.wait("the recorder", lambda: [p.get_subscription_count() for p in publishers] == [2, 1, 3])
    for k in range(10):
        for number, publisher in enumerate(publishers):
            publisher.publish(Float64(data=10.0 * number + k))
            peer.spin(0.01)
    assert all(publisher.wait_for_all_acked() for publisher in publishers)
    assert recorder.stop() == 0
    values = read_bag(tmp_path / "bag").scalars["/reference"].values.tolist()
    assert sorted(values) == [-1.0, *(float(k) for k in range(30))]


def test_publisher_of_another_type_is_told(start: Start, peer: Peer, tmp_path: Path) -> None:
    recorder = start("recorder", output=tmp_path / "bag")
    publisher = peer.node.create_publisher(JointState, "reference", 1)
    text = "not recorded: /reference has the type sensor_msgs/msg/JointState: it is recorded as std_msgs/msg/Float64"
    peer.wait("the topic to be left out", lambda: text in recorder.output())
    assert publisher.get_subscription_count() == 0
    assert recorder.stop() == 0
    assert recorder.output().count(text) == 1


def test_topic_of_the_user_is_recorded_and_told_where_nobody_published_it(
    start: Start, peer: Peer, tmp_path: Path
) -> None:
    recorder = start("recorder", output=tmp_path / "bag", topics="[odd, even]")
    publisher = peer.node.create_publisher(Float64, "odd", 10)
    peer.wait("the recorder", lambda: publisher.get_subscription_count() > 0)
    publisher.publish(Float64(data=3.0))
    assert publisher.wait_for_all_acked()
    assert recorder.stop() == 0
    assert read_bag(tmp_path / "bag").messages == {"/odd": 1}
    assert "not recorded because nobody published it: /even" in recorder.output()


@pytest.mark.grid
def test_transitions_and_simulated_time_are_in_the_bag(start: Start, peer: Peer, tmp_path: Path) -> None:
    recorder = start("recorder", output=tmp_path / "bag")
    start("controller", autostart=False, state_timeout=10.0)
    start("plant_simulator", autostart=False, lockstep=True, real_time_factor=0.0)
    clocks: list[Clock] = []
    peer.node.create_subscription(Clock, "/clock", clocks.append, QoSProfile(depth=1000))
    for node in ("controller", "plant_simulator"):
        topic = f"/{node}/transition_event"
        peer.wait(topic, lambda said=f"recording {topic}": said in recorder.output())
        lifecycle = Lifecycle(peer, node)
        assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
        assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
        # The node may send before it knows the recorder that knows the node.
        while f"hears {topic}" not in recorder.output():
            assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
            assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    peer.wait("/clock", lambda: "recording /clock" in recorder.output())
    clocks.clear()
    peer.wait("simulated time", lambda: len(clocks) > 100)
    assert recorder.stop() == 0
    messages = read_bag(tmp_path / "bag").messages
    assert messages["/controller/transition_event"] > 0
    assert messages["/plant_simulator/transition_event"] > 0
    assert messages["/clock"] > 0


def test_messages_that_a_publisher_could_not_keep_are_told(start: Start, peer: Peer, tmp_path: Path) -> None:
    publisher = peer.node.create_publisher(JointState, "joint_states", QoSProfile(depth=1))
    recorder = start("recorder", output=tmp_path / "bag")
    peer.wait("the recorder", lambda: publisher.get_subscription_count() > 0)
    peer.wait("the recorder", lambda: "recording /joint_states" in recorder.output())
    recorder.signal(signal.SIGSTOP)
    large = JointState(name=["x" * 100_000])
    for _ in range(200):
        publisher.publish(large)
    recorder.signal(signal.SIGCONT)

    def told() -> bool:
        publisher.publish(large)
        return re.search(r"lost \d+ /joint_states", recorder.output()) is not None

    peer.wait("the loss to be told", told)
    assert recorder.stop() == 0
    assert re.search(r"\[ERROR\].* lost \d+ /joint_states", recorder.output())


def test_recorder_that_a_busy_machine_holds_up_loses_nothing(start: Start, peer: Peer, tmp_path: Path) -> None:
    states = peer.node.create_publisher(JointState, "joint_states", SEND)
    recorder = start("recorder", output=tmp_path / "bag")
    peer.wait("the recorder", lambda: states.get_subscription_count() > 0)
    recorder.signal(signal.SIGSTOP)
    for k in range(500):
        message = JointState(name=["motor", "load"], position=[0.0, 0.0])
        message.header.stamp.sec = k
        states.publish(message)
    recorder.signal(signal.SIGCONT)
    assert states.wait_for_all_acked()
    assert recorder.stop() == 0
    assert read_bag(tmp_path / "bag").joint_states.time.tolist() == list(range(500))


def no_package(name: str) -> None:
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize(
    ("patch", "reason"),
    [
        (("get_typestore", lambda _: get_typestore(Stores.EMPTY)), "the recorder does not know it"),
        (("import_module", no_package), "std_msgs is not installed"),
    ],
    ids=["unknown", "not_installed"],
)
def test_topic_of_a_type_that_the_recorder_cannot_use_is_told_and_left_out(
    peer: Peer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    patch: Any,
    reason: str,
) -> None:
    name, replacement = patch
    monkeypatch.setattr(f"backlash_ros.nodes.recorder.{name}", replacement)
    publisher = peer.node.create_publisher(Float64, "odd", 1)
    rclpy.init(
        args=["--ros-args", "-p", "topics:=[odd]", "-p", f"output:={tmp_path / 'bag'}"],
        signal_handler_options=SignalHandlerOptions.NO,
    )
    recorder = Recorder()
    said = ""

    def left_out() -> bool:
        nonlocal said
        recorder._look()
        said += capfd.readouterr().err
        return f"not recorded: /odd has the type std_msgs/msg/Float64: {reason}" in said

    peer.wait("the topic to be left out", left_out)
    assert publisher.get_subscription_count() == 0
    recorder.stop()
    recorder.destroy_node()
    rclpy.shutdown()
    assert read_bag(tmp_path / "bag").messages == {}


def test_existing_folder_is_refused_and_kept(start: Start, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("data")
    process = start("recorder", output=tmp_path / "bag")
    assert process.wait() == 2
    assert "output must be a new folder" in process.output()
    assert (tmp_path / "bag" / "precious").read_text() == "data"


def test_recording_nothing_is_refused(start: Start, tmp_path: Path) -> None:
    process = start("recorder", output=tmp_path / "bag", topics="[]")
    assert process.wait() == 2
    assert "cannot start: topics must have at least one topic" in process.output()
    assert not (tmp_path / "bag").exists()


def test_axes_are_refused_before_anything_is_written(start: Start, tmp_path: Path) -> None:
    recorder = start("recorder", non_ros=["--axes", "axis1", "axis2"], output=tmp_path / "bag")
    assert recorder.wait() == 2
    assert "the recorder has no --axes: record one axis with --ros-args -r __ns:=/axis1" in recorder.output()
    assert not (tmp_path / "bag").exists()


def test_folder_that_cannot_be_made_is_refused(start: Start, tmp_path: Path) -> None:
    process = start("recorder", output=tmp_path / "no" / "bag")
    assert process.wait() == 2
    assert "output must lie in an existing folder" in process.output()


@pytest.mark.parametrize(
    ("name", "reason"),
    [("x" * 300, "File name too long"), ("x" * 253, "File name too long"), ("file/bag", "an existing folder")],
    ids=["folder", "file_in_it", "no_folder"],
)
def test_folder_that_cannot_be_written_is_refused(start: Start, tmp_path: Path, name: str, reason: str) -> None:
    """Also where the folder could be made, and only the file in it has too long a name."""
    (tmp_path / "file").touch()
    process = start("recorder", output=tmp_path / name)
    assert process.wait() == 2
    (line,) = process.output().splitlines()
    assert line.startswith("[FATAL] ")
    assert "cannot start: output " in line
    assert reason in line
    assert {path.name for path in tmp_path.iterdir()} == {"file", process.log.name}


@pytest.mark.corners(1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_bag_is_whole_after_a_signal(start: Start, peer: Peer, tmp_path: Path, number: signal.Signals) -> None:
    process = record(start, peer, tmp_path / "bag", 10)
    process.signal(number)
    assert process.wait() == 0
    assert read_bag(tmp_path / "bag").messages["/command"] == 10


class Stream:
    """Joint states at 200 Hz or so into a recorder, stamped and counted."""

    def __init__(self, start: Start, peer: Peer, folder: Path) -> None:
        self.peer, self.bag = peer, folder / "bag.mcap"
        self.sent: list[float] = []
        self._publisher: Publisher = peer.node.create_publisher(JointState, "joint_states", QoSProfile(depth=1000))
        self.recorder = start("recorder", output=folder)
        peer.wait("the recorder", lambda: self._publisher.get_subscription_count() > 0)
        peer.wait("the recorder", lambda: "recording /joint_states" in self.recorder.output())

    def send(self) -> None:
        message = JointState(name=["motor", "load"], position=[0.0, float(len(self.sent))])
        nanoseconds = time.time_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 10**9)
        self.sent.append(1e-9 * nanoseconds)
        self._publisher.publish(message)
        self.peer.spin(0.005)

    def send_until(self, what: str, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"waited {PATIENCE:g} s for {what}"
            self.send()

    def size(self) -> int:
        return self.bag.stat().st_size

    def wait_for_saved(self, count: int) -> None:
        """Go on until the recorder has saved so much; in the second after that it does not write."""

        def saved() -> bool:
            found = re.search(r'message_count"?: (\d+)', (self.bag.parent / "metadata.yaml").read_text())
            return found is not None and int(found[1]) >= count

        self.send_until("the bag to grow", saved)

    def assert_saved(self) -> None:
        """All is in the bag, in order and without a gap, but for the last second."""
        joints = read_bag(self.bag.parent).joint_states
        assert joints.values[:, 3].tolist() == list(range(len(joints.time)))
        assert self.sent[-1] - joints.time[-1] < LAST


def read_by_other_tools(folder: Path, topic: str = "/joint_states") -> list[int]:
    """Return how many messages of a topic the rosbags library and the mcap library find, by their indexes."""
    with AnyReader([folder]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        counts = [sum(connection.msgcount for connection in connections), len([*reader.messages(connections)])]
    with (folder / "bag.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        decoded = [*reader.iter_decoded_messages([topic])]
        return [*counts, len(decoded)]


def test_recorder_is_killed__nothing__the_bag_has_all_but_the_last_second(
    start: Start, peer: Peer, tmp_path: Path
) -> None:
    stream = Stream(start, peer, tmp_path / "bag")
    stream.wait_for_saved(1)
    end = stream.sent[-1] + 2.8
    stream.send_until("time to pass", lambda: stream.sent[-1] > end)
    stream.recorder.kill()
    stream.assert_saved()
    count = read_bag(tmp_path / "bag").messages["/joint_states"]
    assert read_by_other_tools(tmp_path / "bag") == [count] * 3
    assert_says_its_span(tmp_path / "bag")


@pytest.mark.grid
def test_recorder_killed_while_it_writes_loses_only_that(tmp_path: Path) -> None:
    """Wherever the writing of a save stopped: the bag reads up to that save or the one before."""
    types, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/Float64"
    writer = BagWriter(tmp_path / "bag")
    connection = writer.add_connection("/x", kind, typestore=types)
    states = []
    for k in range(0, 600, 200):
        for x in range(k, k + 200):
            data = types.serialize_cdr(types.types[kind](data=float(x)), kind)
            writer.write(connection, x, data)
        writer.save()
        states.append((tmp_path / "bag" / "bag.mcap").read_bytes())
    _, before, after = states
    common = next(k for k, (a, b) in enumerate(zip(before, after, strict=False)) if a != b)
    found = set()
    for written in range(common, len(after), 97):
        torn = after[:written] + before[written:-1]
        (tmp_path / "bag" / "bag.mcap").write_bytes(torn)
        values = read_bag(tmp_path / "bag").scalars["/x"].values.tolist()
        assert values == list(range(len(values)))
        found.add(len(values))
    assert found == {400, 600}


def test_disk_is_full__nothing__the_recorder_says_so_and_ends_and_the_bag_is_whole(
    start: Start, peer: Peer, tmp_path: Path
) -> None:
    stream = Stream(start, peer, tmp_path / "bag")
    stream.wait_for_saved(100)
    limit = stream.size() + 50_000
    resource.prlimit(stream.recorder.pid, resource.RLIMIT_FSIZE, (limit, limit))
    stream.send_until("the recorder to give up", lambda: "[FATAL]" in stream.recorder.output())
    assert stream.recorder.wait() == 1
    stream.assert_saved()
    assert_says_what_was_saved(stream.recorder, tmp_path / "bag")


@pytest.mark.parametrize("full", ["messages", "metadata"])
def test_save_that_fails_counts_nothing_and_the_next_one_counts_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: str
) -> None:
    """Wherever the space ends: what is told to be saved is what both libraries read."""

    def no_space(*_: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    types, kind, folder = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/Float64", tmp_path / "bag"
    data = types.serialize_cdr(types.types[kind](data=1.0), kind)
    writer = BagWriter(folder)
    connection = writer.add_connection("/x", kind, typestore=types)

    def write(count: int) -> None:
        for k in range(count):
            writer.write(connection, k, data)

    def assert_saved(count: int) -> None:
        assert writer.saved == {"/x": count}
        assert information(folder)["message_count"] == count
        assert read_by_other_tools(folder, "/x") == [count] * 3
        assert {path.name for path in folder.iterdir()} == {"bag.mcap", "metadata.yaml"}

    write(100)
    writer.save()
    write(50)
    with monkeypatch.context() as patch:
        if full == "metadata":
            patch.setattr(Path, "write_text", no_space)
        else:
            pwrite, size = os.pwrite, (folder / "bag.mcap").stat().st_size
            patch.setattr(
                os, "pwrite", lambda file, rest, at: no_space() if at + len(rest) > size else pwrite(file, rest, at)
            )
        for end in (writer.save, writer.close):
            with pytest.raises(OSError, match="No space left"):
                end()
            assert_saved(100)
    write(7)
    writer.close()
    assert_saved(157)


@pytest.mark.grid
def test_full_disk_at_the_end_is_told_too(start: Start, peer: Peer, tmp_path: Path) -> None:
    stream = Stream(start, peer, tmp_path / "bag")
    stream.wait_for_saved(100)
    resource.prlimit(stream.recorder.pid, resource.RLIMIT_FSIZE, (stream.size(), stream.size()))
    for _ in range(10):
        stream.send()
    assert stream.recorder.stop() == 1
    stream.assert_saved()
    assert_says_what_was_saved(stream.recorder, tmp_path / "bag")


def assert_says_what_was_saved(recorder: Process, folder: Path) -> None:
    count = read_bag(folder).messages["/joint_states"]
    assert read_by_other_tools(folder) == [count] * 3
    assert {path.name for path in folder.iterdir()} == {"bag.mcap", "metadata.yaml"}
    output = recorder.output()
    assert "[FATAL]" in output
    assert "the bag cannot be written: File too large" in output
    saved = {topic: int(number) for number, topic in re.findall(r"(\d+) (/[\w/]+)", output.partition("recorded ")[2])}
    assert saved == read_bag(folder).messages
    assert saved == {
        topic["topic_metadata"]["name"]: topic["message_count"]
        for topic in information(folder)["topics_with_message_count"]
    }
    assert "Traceback" not in output
