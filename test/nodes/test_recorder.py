"""The recorder: every message in the bag, in order, as other tools read it, whatever ends the recorder."""

import re
import resource
import signal
import time
from collections.abc import Callable
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
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.analysis import read_bag
from backlash_ros.analysis.bag_writer import BagWriter
from backlash_ros.nodes.recorder import Recorder

Start = Callable[..., Process]

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
    information = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["bag.mcap"]
    topics = {t["topic_metadata"]["name"]: t["topic_metadata"] for t in information["topics_with_message_count"]}
    assert topics["/joint_states"]["type"] == "sensor_msgs/msg/JointState"
    assert topics["/joint_states"]["serialization_format"] == "cdr"
    assert topics["/joint_states"]["type_description_hash"].startswith("RIHS01_")
    assert topics["/controller/backlash_estimate"]["offered_qos_profiles"][0]["durability"] == "transient_local"

    with AnyReader([folder]) as reader:
        assert {connection.topic for connection in reader.connections} >= {"/joint_states", "/command"}
    with (folder / "bag.mcap").open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/joint_states"])
        positions = [message.position[1] for _, _, _, message in decoded]
    assert positions == [float(k) for k in range(20)]
    assert_says_its_span(folder)


def assert_says_its_span(folder: Path) -> None:
    information = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    with (folder / "bag.mcap").open("rb") as stream:
        times = [message.log_time for _, _, message in make_reader(stream).iter_messages()]
    assert information["starting_time"]["nanoseconds_since_epoch"] == min(times)
    assert information["duration"]["nanoseconds"] == max(times) - min(times) > 0


def test_transitions_and_simulated_time_are_in_the_bag(start: Start, peer: Peer, tmp_path: Path) -> None:
    recorder = start("recorder", output=tmp_path / "bag")
    start("controller", autostart=False, state_timeout=10.0)
    start("plant_simulator", autostart=False, lockstep=True)
    clocks: list[Clock] = []
    peer.node.create_subscription(Clock, "/clock", clocks.append, QoSProfile(depth=1000))
    for node in ("controller", "plant_simulator"):
        topic = f"/{node}/transition_event"
        peer.wait(topic, lambda said=f"recording {topic}": said in recorder.output())
        lifecycle = Lifecycle(peer, node)
        assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
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
    assert "cannot start: topics must name at least one topic" in process.output()
    assert not (tmp_path / "bag").exists()


def test_axes_are_refused_before_anything_is_written(start: Start, tmp_path: Path) -> None:
    recorder = start("recorder", non_ros=["--axes", "axis1", "axis2"], output=tmp_path / "bag")
    assert recorder.wait() == 2
    assert "the recorder takes no --axes: record one axis with --ros-args -r __ns:=/axis1" in recorder.output()
    assert not (tmp_path / "bag").exists()


def test_folder_that_cannot_be_made_is_refused(start: Start, tmp_path: Path) -> None:
    process = start("recorder", output=tmp_path / "no" / "bag")
    assert process.wait() == 2
    assert "output must lie in an existing folder" in process.output()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
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


def read_by_other_tools(folder: Path) -> list[int]:
    """Return how many joint states the rosbags library and the mcap library find, by their indexes."""
    with AnyReader([folder]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == "/joint_states"]
        counts = [sum(connection.msgcount for connection in connections), len([*reader.messages(connections)])]
    with (folder / "bag.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        decoded = [*reader.iter_decoded_messages(["/joint_states"])]
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


def test_other_tools_read_what_a_killed_recorder_leaves(start: Start, peer: Peer, tmp_path: Path) -> None:
    stream = Stream(start, peer, tmp_path / "bag")
    stream.wait_for_saved(300)
    stream.recorder.kill()
    stream.assert_saved()
    count = read_bag(tmp_path / "bag").messages["/joint_states"]
    assert read_by_other_tools(tmp_path / "bag") == [count] * 3
    assert_says_its_span(tmp_path / "bag")


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
    assert re.search(rf"recorded .*\b{count} /joint_states", output)
    assert "Traceback" not in output
