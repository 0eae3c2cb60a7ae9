"""How the nodes talk: by UDP unless told otherwise, as far as the user says, held up by nobody who comes or leaves."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import pytest
from graph import PATIENCE, Process
from machine import Machine
from rclpy.utilities import get_rmw_implementation_identifier

from backlash_ros.ros.transport import LOOPBACK, PROFILES, avoid_shared_memory

Start = Callable[..., Process]

pytestmark = pytest.mark.skipif(
    not get_rmw_implementation_identifier().startswith("rmw_fastrtps"), reason="is of Fast DDS"
)

RANGE, ONLY, TRANSPORTS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "FASTDDS_BUILTIN_TRANSPORTS"
LOCALHOST = {RANGE: "LOCALHOST"}
LOCALHOST_ONLY = {ONLY: "1"}
OTHERS = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "SKIP_DEFAULT_XML_FILE")
JOINING = Path(__file__).parents[1] / "support" / "joining.py"
MACHINE = 0.05
"""Seconds of waiting for the machine with which a watchdog of 0.1 s may trip by that alone."""


@pytest.fixture
def say(domain: int, monkeypatch: pytest.MonkeyPatch) -> Callable[[Mapping[str, str]], None]:
    """Let the environment say this of how to talk, and nothing else; the domain stays the test's own."""

    def set_to(variables: Mapping[str, str]) -> None:
        for name in (RANGE, ONLY, TRANSPORTS, *PROFILES, *OTHERS):
            monkeypatch.setenv(name, "")  # so that what the code sets ends with the test, too
            monkeypatch.delenv(name)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)

    return set_to


def shares_memory(process: Process) -> bool:
    return "/dev/shm/fast" in Path(f"/proc/{process.pid}/maps").read_text()


def wait_for(process: Process, text: str, look: Callable[[], None] = lambda: None) -> None:
    end = time.monotonic() + PATIENCE
    while text not in process.output():
        assert time.monotonic() < end, f"waited {PATIENCE:g} s for {text!r}"
        look()
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("variables", "shared"),
    [({RANGE: "OFF"}, False), ({RANGE: "OFF", TRANSPORTS: "DEFAULT"}, True)],
    ids=["by itself", "told to"],
)
def test_by_itself_a_node_shares_no_memory(
    start: Start, say: Callable[[Mapping[str, str]], None], variables: dict[str, str], shared: bool
) -> None:
    say(variables)  # alone, but with the transports of SUBNET
    process = start("plant_simulator")
    wait_for(process, "simulating")
    assert shares_memory(process) == shared


@pytest.mark.corners(1)
@pytest.mark.parametrize("variables", [LOCALHOST, LOCALHOST_ONLY], ids=["range", "only"])
def test_asked_for_this_machine_alone_a_node_stays_on_it_and_shares_no_memory(
    start: Start, say: Callable[[Mapping[str, str]], None], variables: dict[str, str]
) -> None:
    say(variables)
    process = start("plant_simulator")
    wait_for(process, "simulating")
    assert not shares_memory(process)
    table = Path(f"/proc/{process.pid}/net/udp").read_text().splitlines()[1:]
    inodes = {os.readlink(entry) for entry in Path(f"/proc/{process.pid}/fd").iterdir() if entry.is_symlink()}
    addresses = {words[1].split(":")[0] for words in map(str.split, table) if f"socket:[{words[9]}]" in inodes}
    assert addresses == {"0100007F", "0100FFEF"}  # 127.0.0.1, and 239.255.0.1 joined on the loopback device


@pytest.mark.parametrize(
    "variables",
    [
        {},
        {RANGE: "SUBNET"},
        {RANGE: "SYSTEM_DEFAULT"},
        {RANGE: "OFF"},
        {ONLY: "0"},
        LOCALHOST | {TRANSPORTS: "DEFAULT"},
        LOCALHOST | {PROFILES[0]: "/my/profile.xml"},
        LOCALHOST | {PROFILES[1]: "/my/profile.xml"},
        LOCALHOST | {"ROS_STATIC_PEERS": "192.168.0.2"},
        LOCALHOST_ONLY | {"ROS_STATIC_PEERS": "192.168.0.2"},
        LOCALHOST | {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811"},
    ],
    ids=lambda variables: " ".join(f"{name}={value}" for name, value in variables.items()) or "nothing",
)
def test_what_the_user_chose_stays(say: Callable[[Mapping[str, str]], None], variables: dict[str, str]) -> None:
    say(variables)
    before = dict(os.environ)
    avoid_shared_memory()
    assert dict(os.environ) == {TRANSPORTS: "UDPv4"} | before


@pytest.mark.parametrize("name", ["DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml"])
@pytest.mark.parametrize("skipped", [False, True])
def test_a_profile_in_the_working_folder_stays(
    say: Callable[[Mapping[str, str]], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, skipped: bool
) -> None:
    """Fast DDS reads it too, and its transports might lead off this machine where LOCALHOST is asked for no more."""
    (tmp_path / name).write_text("")
    monkeypatch.chdir(tmp_path)
    say(LOCALHOST | ({"SKIP_DEFAULT_XML_FILE": "1"} if skipped else {}))
    avoid_shared_memory()
    assert os.environ[RANGE] == ("SUBNET" if skipped else "LOCALHOST")
    assert os.environ.get(PROFILES[0]) == (str(LOOPBACK) if skipped else None)


TALK = """
import sys, time
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("talking")
samples = []
node.create_subscription(JointState, "joint_states", samples.append, qos_profile_sensor_data)
publisher = node.create_publisher(Float64, "load_torque", 10)
client = node.create_client(Trigger, "plant_simulator/reset_fault")
print("there", flush=True)
end = time.monotonic() + float(sys.argv[1])
answer, asked = None, 0.0
while time.monotonic() < end:
    publisher.publish(Float64(data=1e9))  # refused, with a line in the log
    if client.service_is_ready() and time.monotonic() > asked + 2.0:  # a first answer can be lost
        answer, asked = client.call_async(Trigger.Request()), time.monotonic()
    rclpy.spin_once(node, timeout_sec=0.05)
    if samples and answer is not None and answer.done() and "plant_simulator" in node.get_node_names():
        sys.exit(0)
sys.exit(f"samples: {len(samples)}, answer: {answer}, nodes: {node.get_node_names()}")
"""


@pytest.mark.corners(2)
@pytest.mark.parametrize("variables", [LOCALHOST, LOCALHOST_ONLY], ids=["range", "only"])
@pytest.mark.parametrize("first", ["node", "user"])
def test_node_and_user_that_are_asked_for_this_machine_alone_find_each_other(
    start: Start, say: Callable[[Mapping[str, str]], None], variables: dict[str, str], first: str
) -> None:
    """The user shares memory and finds others by their ports on 127.0.0.1, as ros2 commands with LOCALHOST do."""
    say(variables)
    process = start("plant_simulator") if first == "node" else None
    if process:
        wait_for(process, "simulating")
    with subprocess.Popen([sys.executable, "-c", TALK, str(PATIENCE)], stdout=subprocess.PIPE) as user:
        assert user.stdout is not None
        assert user.stdout.readline() == b"there\n"
        process = process or start("plant_simulator")
        assert user.wait(PATIENCE + 30) == 0
    wait_for(process, "load_torque must be")


@pytest.mark.parametrize(
    ("variables", "joins"),
    [({}, 10), pytest.param(LOCALHOST, 40, marks=pytest.mark.grid)],
    ids=["default", "localhost"],
)
def test_no_fault_latches_while_others_come_and_leave(
    start: Start, say: Callable[[Mapping[str, str]], None], tmp_path: Path, variables: dict[str, str], joins: int
) -> None:
    """With the watchdogs as they are by default, 0.1 s.

    They also trip where the machine takes the nodes off its cores for as long. The kernel counts that, and nothing of
    a writer that waits for a lock or sleeps: so a fault in a second in which the machine kept the nodes waiting says
    nothing, and they are started again for the joins that are left; any other fault fails the test.
    """
    say(variables)
    space = ("-r", "__ns:=/joined")  # by default the domain reaches further than this machine: nobody else is here
    left, end = joins, time.monotonic() + 4 * PATIENCE
    while left:
        assert time.monotonic() < end, f"the machine kept the nodes waiting: {left} of {joins} joins are left"
        nodes = [start(name, *space) for name in ("plant_simulator", "controller")]
        machine = Machine([node.pid for node in nodes])
        for node, text in zip(nodes, ("simulating", "waiting for the drive"), strict=True):
            wait_for(node, text, machine.look)
        began = time.monotonic()
        heard, faulted = joins_until_fault(
            nodes, machine, ["--count", str(left), "--ros-args", *space], tmp_path / f"joins{left}.log"
        )
        left -= heard
        took = time.monotonic() - began
        for node in nodes:
            assert node.stop() == 0
        taken = re.search(r"stopped after (\d+) samples", nodes[1].output())
        assert taken
        assert faulted or int(taken[1]) > 5 * took  # one in 0.1 s at least, or there was no loop


def joins_until_fault(nodes: list[Process], machine: Machine, arguments: list[str], log: Path) -> tuple[int, bool]:
    """Return how many have come and left again, and whether a fault ended that, by the machine alone."""
    command = [sys.executable, str(JOINING), *arguments]
    with log.open("wb") as output, subprocess.Popen(command, stdout=output, start_new_session=True) as joins:
        try:
            while True:
                ended = joins.poll() is not None
                machine.look()
                if any("until reset_fault" in node.output() for node in nodes):
                    assert machine.kept_waiting() > MACHINE, "a fault has latched"
                    return log.read_text().count("heard"), True
                if ended:
                    assert joins.returncode == 0
                    return log.read_text().count("heard"), False
                time.sleep(0.01)
        finally:
            with suppress(ProcessLookupError):  # all have left
                os.killpg(joins.pid, signal.SIGKILL)
