"""The recorder: every message in the bag, in order, as other tools read it."""

import signal
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from graph import Peer, Process
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.analysis import read_bag

Start = Callable[..., Process]


def record(start: Start, peer: Peer, folder: Path, count: int) -> Process:
    """Record ``count`` messages of three topics, one of them latched and sent before the recorder started."""
    node, deep = peer.node, QoSProfile(depth=1000)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    states = node.create_publisher(JointState, "joint_states", deep)
    commands = node.create_publisher(Float64MultiArray, "command", deep)
    node.create_publisher(Float64, "controller/backlash_estimate", latched).publish(Float64(data=0.02))
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


def test_existing_folder_is_refused_and_kept(start: Start, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("data")
    process = start("recorder", output=tmp_path / "bag")
    assert process.wait() == 2
    assert "output must be a new folder" in process.output()
    assert (tmp_path / "bag" / "precious").read_text() == "data"


def test_folder_that_cannot_be_made_is_refused(start: Start, tmp_path: Path) -> None:
    process = start("recorder", output=tmp_path / "no" / "bag")
    assert process.wait() == 2
    assert "output must lie in an existing folder" in process.output()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_bag_is_whole_after_a_signal(start: Start, peer: Peer, tmp_path: Path, number: signal.Signals) -> None:
    process = record(start, peer, tmp_path / "bag", 10)
    process.signal(number)
    assert process.wait() == 0
    assert read_bag(tmp_path / "bag").messages["/command"] == 10
