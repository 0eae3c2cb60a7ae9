"""The replay of a bag: equal to the last bit whatever acted on the samples, honest about what the bag lacks."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_offline import NodeOffline, nominal_values

from backlash_ros.cli import main
from backlash_ros.control.design.choice import dynamic_names
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import THETA_L, THETA_M
from backlash_ros.studies.replay.again import Replayed, replay
from backlash_ros.studies.replay.recorded import read_recorded
from backlash_ros.studies.replay.what_if import Changes


def replayed(bag: Path, **changes: Any) -> list[Replayed]:
    recorded = read_recorded(bag)
    pairs = [replay(recorded, each, Changes(changes)) for each in recorded.activations]
    return [done if other is None else other for done, other in pairs]


def moved() -> NodeOffline:
    """Moves, learns, is given other gains and another law, carries a load, and is cancelled, faulted and reset."""
    node = NodeOffline(nominal_values(backlash_angle=0.02, **{"learning.experiment": "limit_cycle"})).run(50)
    node.refer(0.5)
    node.run(103)
    node.use(gains__fast__q=[500.0, 1.0])
    node.run(3).refer(-0.25)
    node.load_torque = 0.1
    node.run(202)
    node.learn()
    node.run(123)
    node.cancel()
    node.refer(0.75)
    node.use(law="planned", identified=True)
    node.use(loop_delay=0.001)
    node.run(101).refer(0.1)
    node.run(150)
    node.sample(again=True)
    node.run(3, without="load").run(40)
    node.silence()
    node.run(7)
    node.reset()
    node.run(60).refer(1.0)
    node.run(77)
    node.active(False)
    node.use(law="cascade")
    node.active(True)
    node.run(50).refer(0.3)
    node.run(50)
    return node


@pytest.fixture(scope="module")
def node() -> NodeOffline:
    return moved()


@pytest.fixture(scope="module")
def bag(node: NodeOffline, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return node.write(tmp_path_factory.mktemp("replay") / "bag")


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    node = NodeOffline(nominal_values(backlash_angle=0.02)).run(20)
    return node.write(tmp_path_factory.mktemp("short") / "bag")


def test_whatever_acted_the_commands_are_equal_to_the_last_bit(bag: Path) -> None:
    first, second = replayed(bag)
    assert (first.equal, first.lost, first.unanswered, first.notes) == (True, 0, 0, ())
    assert (second.equal, len(second.stamps), second.notes) == (True, 100, ())
    assert len(first.stamps) == 50 + 103 + 3 + 202 + 123 + 101 + 150 + 1 + 3 + 40 + 7 + 60 + 77
    assert np.count_nonzero(np.diff(first.recorded)) > 700
    assert second.recorded[-1] != 0.0


def test_an_experiment_that_ends_by_itself_is_replayed_and_so_are_profiles(tmp_path: Path) -> None:
    node = NodeOffline(nominal_values(backlash_angle=0.02)).run(20)
    node.learn()
    while node.servo.experimenting:
        node.run(1)
    node.use(profile__mode="auto", profile__velocity=5.0)
    node.refer(0.5)
    node.run(20).refer(-0.2)  # in flight, and at once another one
    node.refer(1.0)
    node.run(20)
    node.use(profile__velocity=2.0)
    node.run(100)
    (done,) = replayed(node.write(tmp_path / "bag"))
    assert done.equal
    assert len(done.stamps) > 500


HOMED = {
    f"homing.{name}": value for name, value in {"switch": True, "speed": -0.5, "way": 1.0, "back_off": 0.05}.items()
}


def homed() -> NodeOffline:
    """Homes until its switch closes, puts the zero in use and moves on."""
    node = NodeOffline(nominal_values(backlash_angle=0.02, identified=True, **HOMED)).run(20)
    node.learn("homing_by_switch")
    node.run(100)
    node.servo.trip()
    while node.servo.experimenting:
        node.run(1)
    node.use(zero=-0.2)
    node.run(1).refer(0.1)
    return node.run(50)


def test_a_homing_ends_where_its_switch_has_closed(tmp_path: Path) -> None:
    """In an older bag nothing tells that, and the replay says so."""
    node = homed()
    (done,) = replayed(node.write(tmp_path / "bag"))
    assert (done.equal, done.notes) == (True, ())
    for _, values in (each for _, topic, each in node.messages if topic == "/controller/state"):
        del values["tripped"]
    (done,) = replayed(node.write(tmp_path / "old"))
    assert done.differing[0] >= 120
    assert "~/state does not tell when home_switch closed: an older controller's" in done.notes


def in_halves(node: NodeOffline, wrap: float = 0.0) -> NodeOffline:
    """Give each joint a message of its own, and let positions begin again."""
    other = NodeOffline()
    other.messages = []
    for received, topic, content in node.messages:
        if topic == "/joint_states" and not content[2]:
            stamp, measured, _ = content
            measured = measured.copy()
            if wrap:
                angles = measured[[THETA_M, THETA_L]]
                measured[[THETA_M, THETA_L]] = (angles + wrap / 2) % wrap - wrap / 2
            other.messages += [(received, topic, (stamp, measured, without)) for without in ("load", "motor")]
        elif topic == "/controller/parameters_in_use":
            version, values = content
            other.messages.append((received, topic, (version, {**values, "motor_wrap": wrap, "load_wrap": wrap})))
        else:
            other.messages.append((received, topic, content))
    return other


def test_joints_in_messages_of_their_own_are_replayed_as_one_sample(node: NodeOffline, tmp_path: Path) -> None:
    first, second = replayed(in_halves(node).write(tmp_path / "bag"))
    assert (first.equal, first.lost, first.notes, second.equal) == (True, 0, (), True)


def test_positions_that_begin_again_are_replayed_as_they_went_on(tmp_path: Path) -> None:
    node = NodeOffline(nominal_values(backlash_angle=0.02)).run(20)
    node.refer(1.0)
    node.run(100)
    (done,) = replayed(in_halves(node, 2 * np.pi).write(tmp_path / "bag"))
    assert np.ptp(done.recorded) > 20.0
    assert done.replayed == pytest.approx(done.recorded, abs=1e-6)


def test_one_bit_of_one_command_is_seen(node: NodeOffline, tmp_path: Path) -> None:
    k = [k for k, (_, topic, _) in enumerate(node.messages) if topic == "/command"][321]
    received, topic, (stamp, value) = node.messages[k]
    other = NodeOffline()
    other.messages = [
        *node.messages[:k],
        (received, topic, (stamp, np.nextafter(value, 99.0))),
        *node.messages[k + 1 :],
    ]
    first, second = replayed(other.write(tmp_path / "bag"))
    assert first.differing.tolist() == [321]
    assert not first.equal
    assert second.equal


def test_a_bag_without_a_sample_says_so(node: NodeOffline, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gone = [content[0] for _, topic, content in node.messages if topic == "/joint_states"][400]
    path = node.write(tmp_path / "bag", lambda topic, content: topic != "/joint_states" or content[0] != gone)
    first, _ = replayed(path)
    assert (first.equal, first.lost, int(first.differing[0])) == (False, 1, 400)
    assert main(["replay", str(path)]) == 1
    assert "1 samples that commands name are not in the bag" in capsys.readouterr().out


def test_a_bag_without_a_command_says_so(node: NodeOffline, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gone = [content[0] for _, topic, content in node.messages if topic == "/command"][100]
    path = node.write(tmp_path / "bag", lambda topic, content: topic != "/command" or content[0] != gone)
    first, _ = replayed(path)
    assert (first.equal, first.unanswered) == (False, 1)
    assert main(["replay", str(path)]) == 1
    assert "1 samples were taken whose commands are not in the bag" in capsys.readouterr().out


def test_what_is_told_late_is_placed_where_the_commands_show_it(node: NodeOffline, tmp_path: Path) -> None:
    """The first telling of the first reference is missing; the regular one after it tells it, too."""
    told = [
        content[0]
        for _, topic, content in node.messages
        if topic == "/controller/state" and content[1]["reference"] == 0.5
    ]
    path = node.write(tmp_path / "bag", lambda topic, content: topic != "/controller/state" or content[0] != told[0])
    first, _ = replayed(path)
    assert not first.differing.size
    (note,) = first.notes
    assert "is taken to act from stamp" in note


def test_what_other_gains_would_have_commanded_follows_the_recorded_motion(bag: Path) -> None:
    same, _ = replayed(bag, **{"gains.fast.q": [1000.0, 1.0]})
    other, _ = replayed(bag, **{"gains.fast.q": [250.0, 1.0]})
    assert not np.array_equal(same.replayed[155:200], same.recorded[155:200])  # there the others were in use
    assert np.array_equal(same.replayed[:150], same.recorded[:150])
    assert np.max(np.abs(other.replayed - other.recorded)) > 1.0
    # The gains are those of the first step: half the weight, less voltage, from the same state.
    assert 0.0 < other.replayed[50] < other.recorded[50]
    assert np.array_equal(other.stamps, same.stamps)


def test_the_command_prints_writes_and_draws(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, picture = tmp_path / "replay.json", tmp_path / "replay.png"
    words = ["replay", str(bag), "--json", str(file), "--plot", str(picture)]
    assert main([*words, "--set", "gains.fast.q=[250.0, 1.0]"]) == 0
    said = capsys.readouterr().out
    assert "activation 1: 920 commands in" in said
    assert "all equal to the last bit" in said
    assert "Open loop: each command is what these values would have given" in said
    content = json.loads(file.read_text())
    assert (content["equal"], content["set"]) == (True, {"gains.fast.q": [250.0, 1.0]})
    assert content["activations"][0]["changed"]["largest_difference"]["time"] > 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert "--force overwrites it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("gains.fast.q=3", "gains.fast.q must be a list of numbers, got 3"),
        (
            "gains.fasst.q=[1.0, 1.0]",
            "there is no parameter 'gains.fasst.q', got [1.0, 1.0]: did you mean 'gains.fast.q'?",
        ),
        ("motor.inductance=0.003", "motor.inductance cannot change while the controller runs: it was 0.002, got 0.003"),
        ("gains.fast.k=[-1.0, 0.0, 0.0]", "k1 (position) must be > 0 V/rad, got -1.0"),
        ("backlash_angle=5", "backlash_angle must be >= 0 rad and <= 3.2 rad, got 5.0"),
        ("learning.limit_cycle.cycles=2.5", "learning.limit_cycle.cycles must be a whole number, got 2.5"),
        ("law=none", "law must be one of"),
        ("law", "must be name=value, got 'law'"),
    ],
)
def test_a_change_is_refused_as_the_controller_refuses_it(
    short_bag: Path, capsys: pytest.CaptureFixture[str], change: str, text: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(short_bag), "--set", "velocity_bandwidth=400", "--set", change])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert text in said
    assert said.count("\n") == 1


def test_values_are_read_as_ros_reads_them() -> None:
    given = Changes.parsed(["a=2e-5", "b=[1e3, 2.5E-4, 1.0e2]", "c='2e-5'", "d=e5"]).given
    assert given == {"a": 2e-5, "b": [1000.0, 2.5e-4, 100.0], "c": "2e-5", "d": "e5"}


def lacking(topic: str) -> Callable[[str, Any], bool]:
    return lambda its, _: its != topic


@pytest.mark.parametrize(
    ("keep", "text"),
    [
        (lacking("/command"), "there is no message on '/command'"),
        (lacking("/joint_states"), "there is no message on '/joint_states'"),
        (lacking("/controller/state"), "there is no message on '/controller/state'"),
        (lacking("/controller/parameters_in_use"), "there is no message on '/controller/parameters_in_use'"),
        (
            lambda topic, content: (
                topic != "/controller/state" or content[1]["samples"] > 1000 or not content[1]["active"]
            ),
            "no activation of the controller is in the bag",
        ),
        (
            lambda topic, content: topic != "/controller/parameters_in_use" or content[0] < 3,
            "version 4 of the parameters in use is not in the bag",
        ),
    ],
)
def test_a_bag_that_lacks_what_is_needed_is_refused(
    node: NodeOffline, tmp_path: Path, capsys: pytest.CaptureFixture[str], keep: Callable[[str, Any], bool], text: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(node.write(tmp_path / "bag", keep))])
    assert ended.value.code == 2
    assert text in capsys.readouterr().err


def test_commands_of_another_controller_are_refused(tmp_path: Path) -> None:
    node = NodeOffline().run(20)
    node.messages = [(at, topic, (0, what[1]) if topic == "/command" else what) for at, topic, what in node.messages]
    with pytest.raises(ValueError, match="no command on '/command' names the sample that it answers"):
        read_recorded(node.write(tmp_path / "bag"))


def test_a_torn_bag_is_replayed_as_far_as_it_is_whole(bag: Path, tmp_path: Path) -> None:
    file = next(bag.glob("*.mcap"))
    torn = tmp_path / "bag"
    torn.mkdir()
    (torn / file.name).write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    (done,) = replayed(torn)
    assert done.equal
    assert 400 < len(done.stamps) < 920
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="is no rosbag2 that can be read"):
        read_recorded(tmp_path / "empty")
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*nothing'"):
        read_recorded(tmp_path / "nothing")


def test_what_may_change_is_what_the_node_declares_as_dynamic() -> None:
    declare = pytest.importorskip("backlash_ros.nodes.fixed_parameters", reason="needs rclpy").declare_controller
    tunables = pytest.importorskip("backlash_ros.nodes.tunables", reason="needs rclpy").Tunables

    class Node:
        def __init__(self) -> None:
            self.values: dict[str, Any] = {}
            self.dynamic: set[str] = set()

        def declare_parameter(self, name: str, default: Any, _descriptor: Any) -> Any:
            self.values[name] = default
            return type("Parameter", (), {"value": default})

        def set_descriptor(self, name: str, descriptor: Any, _value: Any) -> None:
            if not descriptor.read_only:
                self.dynamic.add(name)

        def get_parameter(self, name: str) -> Any:
            return type("Parameter", (), {"value": self.values[name]})

        def __getattr__(self, name: str) -> Any:
            return lambda *_: None

    node: Any = Node()
    tunables(node, declare(node).drive, 250.0)
    assert node.dynamic == dynamic_names(NOMINAL_DRIVE)
