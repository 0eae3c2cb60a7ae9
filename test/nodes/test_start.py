"""How a node starts and ends: what it refuses, whose word counts, and that nobody who reads its output can stop it."""

import fcntl
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from graph import Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.nodes.fixed_parameters import all_names

Start = Callable[..., Process]
CONFIG = Path(__file__).parents[2] / "config"
FATAL = r"\[FATAL\] \[\d+\.\d+\] \[{node}\]: cannot start: "

REFUSED = [
    ("controller", "gear.ratio:=0.1", "there is no parameter 'gear.ratio', got 0.1: did you mean 'gear.reduction'?"),
    ("recorder", "topic:=[command]", "there is no parameter 'topic', got ['command']: did you mean 'topics'?"),
    ("plant_simulator", "gear.backlash_cycles:=3.5", "must be a whole number >= 1 and <= 1000, got 3.5"),
    ("controller", "rate:=", "Couldn't parse parameter override rule: '-p rate:='"),
]
"""Misspelt or impossible: the node, what it is given, and what the line says; more in test/unit/test_tunables.py."""


@pytest.mark.parametrize(("node", "rule", "says"), REFUSED, ids=[f"{node} {rule}" for node, rule, _ in REFUSED])
def test_a_start_that_is_not_understood_is_refused_in_one_line(start: Start, node: str, rule: str, says: str) -> None:
    process = start(node, "-p", rule)
    assert process.wait() == 2
    lines = process.output().splitlines()
    assert len(lines) == 1, lines
    assert re.match(FATAL.format(node=node), lines[0])
    assert says in lines[0]
    assert rule.partition(":")[0] in lines[0]


def test_nothing_moves_and_nothing_is_said_to_a_drive_where_a_start_is_refused(start: Start, peer: Peer) -> None:
    heard: list[Any] = []
    for kind, topic in ((Float64MultiArray, "command"), (JointState, "joint_states")):
        peer.node.create_subscription(kind, topic, heard.append, 10)
    seen: set[str] = set()
    for node in ("controller", "plant_simulator"):
        process = start(node, gear__ratio=0.1)
        while process.running:
            peer.spin(0.01)
            seen |= {topic for topic in ("/command", "/joint_states") if peer.node.count_publishers(topic)}
        assert process.wait() == 2
    assert (heard, seen) == ([], set())


def test_names_of_other_nodes_are_left_alone(start: Start, peer: Peer, tmp_path: Path) -> None:
    """Files are shared: by the nodes of the package, and with others."""
    (tmp_path / "shared.yaml").write_text(
        "/**:\n  ros__parameters:\n    {lockstep: true, law: fast, topics: [a], gain_set_names: [stiff],\n"
        "     gain_sets: {stiff: {fast: {k: [20.0, 0.5, 0.1]}, overdamped: {q: [4.0, 0.0]}}},\n"
        "     frame_id: base, robot: {mass: 3.0}, use_sim_time: true,\n"
        "     qos_overrides: {/joint_states: {publisher: {depth: 3}}}}\n"
        "/**/other:\n  ros__parameters: {gear.ratio: 0.1}\n"
    )
    for node in ("controller", "plant_simulator"):
        start(node, "--params-file", str(tmp_path / "shared.yaml"))
        parameters = Parameters(peer, node)
        assert parameters.get("use_sim_time") == [True]


def test_what_loses_nothing_is_converted(start: Start, peer: Peer) -> None:
    start(
        "controller",
        rate=500,
        gear__backlash_cycles=3.0,
        gains__fast__k="[31, 1, 0]",
        learning__limit_cycle__cycles=5.0,
        motor__voltage_limit=12,
    )
    names = ("rate", "gear.backlash_cycles", "gains.fast.k", "learning.limit_cycle.cycles", "motor.voltage_limit")
    values = Parameters(peer, "controller").get(*names)
    assert values == [500.0, 3, [31.0, 1.0, 0.0], 5, 12.0]
    assert [type(value) for value in values] == [float, int, list, int, float]


def test_every_node_knows_the_names_of_all(start: Start, peer: Peer, tmp_path: Path) -> None:
    from_ros = ("use_sim_time", "start_type_description_service", "qos_overrides.")
    for node in ("controller", "plant_simulator", "recorder"):
        start(node, **({"output": tmp_path / "bag"} if node == "recorder" else {}))
        names = peer.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names
        assert {name for name in names if not name.startswith(from_ros)} <= all_names({})


@pytest.mark.parametrize("namespace", ["/axis1", pytest.param("/", marks=pytest.mark.grid)])
def test_the_command_line_wins_over_every_file(start: Start, peer: Peer, tmp_path: Path, namespace: str) -> None:
    (tmp_path / "own.yaml").write_text("/**/controller:\n  ros__parameters: {law: cascade, backlash_angle: 0.01}\n")
    files = ["--params-file", str(CONFIG / "nominal_drive.yaml"), "--params-file", str(tmp_path / "own.yaml")]
    given = ["-p", "law:=fast", "-p", "rate:=500", "-r", f"__ns:={namespace}"]
    start("controller", *given[:2], *files, *given[2:])
    parameters = Parameters(peer, f"{namespace.rstrip('/')}/controller")
    assert parameters.get("law", "rate", "backlash_angle") == ["fast", 500.0, 0.01]


def test_what_a_launch_file_adds_wins_over_the_shipped_file(start: Start, peer: Peer, tmp_path: Path) -> None:
    """launch_ros writes a dictionary of parameters to a file of its own, under /** where the node has no name."""
    (tmp_path / "launch_params").write_text("/**:\n  ros__parameters: {law: fast, rate: 500}\n")
    files = ["--params-file", str(CONFIG / "nominal_drive.yaml"), "--params-file", str(tmp_path / "launch_params")]
    start("controller", *files, "-r", "__ns:=/axis1")
    assert Parameters(peer, "axis1/controller").get("law", "rate") == ["fast", 500.0]


def test_the_command_line_wins_for_every_axis(start: Start, peer: Peer) -> None:
    file = str(CONFIG / "six_axes.yaml")
    start("controller", "--params-file", file, gain_set="gentle", non_ros=["--axes", "axis1", "axis2"])
    for axis in ("axis1", "axis2"):
        assert Parameters(peer, f"{axis}/controller").get("gain_set") == ["gentle"]


def test_ranges_of_positive_numbers_leave_out_zero(start: Start, peer: Peer) -> None:
    start("controller")
    names = ["velocity_bandwidth", "faults.velocity", "motor.resistance", "torque_bandwidth"]
    request = DescribeParameters.Request(names=names)
    described = peer.call(DescribeParameters, "/controller/describe_parameters", request).descriptors
    ranges = [d.floating_point_range[0].from_value for d in described]
    assert ranges == [1e-12, 1e-12, 1e-12, 0.0]
    assert [d.additional_constraints.split()[:2] for d in described] == [[">", "0"]] * 3 + [[">=", "0"]]


@pytest.mark.corners(1)
@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_all_that_a_node_has_can_be_loaded_again(start: Start, peer: Peer, node: str) -> None:
    """As `ros2 param load` does with what `ros2 param dump` wrote; only what would change is refused."""
    start(node)
    names = list(peer.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names)
    values = peer.call(GetParameters, f"/{node}/get_parameters", GetParameters.Request(names=names)).values
    request = SetParameters.Request(
        parameters=[Parameter(name=name, value=value) for name, value in zip(names, values, strict=True)]
    )
    results = peer.call(SetParameters, f"/{node}/set_parameters", request).results
    assert {name: result.reason for name, result in zip(names, results, strict=True) if not result.successful} == {}
    rate = next(parameter for parameter in request.parameters if parameter.name == "rate")
    assert rate.value.type == ParameterType.PARAMETER_DOUBLE
    rate.value.double_value = 500.0
    result = peer.call(SetParameters, f"/{node}/set_parameters", SetParameters.Request(parameters=[rate])).results[0]
    assert (result.successful, result.reason) == (
        False,
        "rate is read-only: it stays 250.0 while the node runs, got 500.0",
    )


def test_controller_that_was_told_nothing_says_so_once_and_how_far_its_gains_are_from_unstable(
    start: Start, peer: Peer
) -> None:
    process = start("controller")
    peer.wait("the controller", lambda: "waiting for the drive" in process.output())
    lines = process.output().splitlines()
    told = [line for line in lines if "no drive parameters were given" in line]
    assert len(told) == 1
    assert all(name in told[0] for name in ("motor.torque_constant", "gear.reduction", "load.inertia"))
    assert [line for line in lines if "[INFO]" in line and "gain set 'nominal', margins: fast" in line]
    other = start("controller", "-r", "__ns:=/told", motor__inductance=1e-3, loop_delay=0.016)
    peer.wait("the other one", lambda: "waiting for the drive" in other.output())
    assert "no drive parameters were given" not in other.output()
    assert re.search(r"\[WARN\].*gain set 'nominal'.*fast below 30 deg or one period, 4 ms", other.output())


@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_process_ends_when_it_is_shut_down(start: Start, peer: Peer, node: str) -> None:
    process = start(node)
    lifecycle = Lifecycle(peer, node)
    peer.wait("autostart", lambda: lifecycle.state == "active")
    assert lifecycle.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert process.wait(10.0) == 0


def test_process_goes_on_until_its_last_axis_is_shut_down(start: Start, peer: Peer) -> None:
    process = start("plant_simulator", non_ros=["--axes", "axis1", "axis2"])
    axes = [Lifecycle(peer, f"axis{k}/plant_simulator") for k in (1, 2)]
    for axis in axes:
        peer.wait("autostart", lambda axis=axis: axis.state == "active")
    assert axes[0].change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    peer.spin(1.0)
    assert axes[1].state == "active"
    assert axes[1].change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert process.wait(10.0) == 0


class Unread:
    """An end to write to that takes nothing: nobody reads it."""

    def __init__(self, kind: str) -> None:
        self.read, self.write = os.pipe() if kind == "pipe" else pty.openpty()
        if kind == "terminal":
            termios.tcflow(self.write, termios.TCOOFF)  # as Ctrl-S does
            return
        os.set_blocking(self.write, False)
        try:
            while True:
                os.write(self.write, bytes(65536))
        except BlockingIOError:
            os.set_blocking(self.write, True)

    def release(self) -> str:
        """Take it all and return it; Ctrl-Q in a terminal."""
        if os.isatty(self.write):
            termios.tcflow(self.write, termios.TCOON)
        fcntl.fcntl(self.read, fcntl.F_SETFL, os.O_NONBLOCK)
        taken = b""
        end = time.monotonic() + 5.0
        while time.monotonic() < end and b"nothing read the output" not in taken:
            with suppress(BlockingIOError):
                taken += os.read(self.read, 65536)
            time.sleep(0.01)
        return taken.decode(errors="replace")

    def close(self) -> None:
        os.close(self.read)
        os.close(self.write)


@pytest.fixture(params=["pipe", "terminal"])
def unread(request: pytest.FixtureRequest) -> Iterator[Unread]:
    made = Unread(request.param)
    yield made
    made.close()


@pytest.mark.grid
def test_output_that_nobody_reads_stops_neither_the_loop_nor_the_end(domain: int, peer: Peer, unread: Unread) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "backlash_ros.nodes.plant_simulator", "--ros-args", "--log-level", "debug"],
        stdout=unread.write,
        stderr=unread.write,
    )
    try:
        states: list[JointState] = []
        peer.node.create_subscription(JointState, "joint_states", states.append, 100)
        load = peer.node.create_publisher(Float64, "load_torque", 10)
        peer.wait("joint states", lambda: len(states) > 10)
        before, end = len(states), time.monotonic() + 5.0

        def goes_on() -> bool:
            load.publish(Float64(data=float("nan")))  # each is worth a line
            latest = states[max(before, len(states) - 502) :]  # a busy machine may have stopped it before
            gaps = [after - first for first, after in pairwise(map(stamp, latest))]
            return time.monotonic() > end and len(gaps) > 500 and max(gaps) < 1.0

        peer.wait("500 samples without a gap while nobody reads", goes_on)
        assert "nothing read the output for" in unread.release()
    finally:
        process.send_signal(signal.SIGTERM)
        began = time.monotonic()
        code = process.wait(20.0)
    assert (code, time.monotonic() - began < 5.0) == (0, True)


def stamp(state: JointState) -> float:
    return float(state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec)


@pytest.mark.corners(1)
def test_stop_puts_zero_out_though_nobody_reads_the_output(domain: int, peer: Peer, unread: Unread) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "backlash_ros.nodes.controller", "--ros-args", "--log-level", "debug"],
        stdout=unread.write,
        stderr=unread.write,
    )
    try:
        commands: list[float] = []
        peer.node.create_subscription(
            Float64MultiArray, "command", lambda message: commands.append(message.data[0]), 10
        )
        states = peer.node.create_publisher(JointState, "joint_states", 10)
        reference = peer.node.create_publisher(Float64, "reference", 10)

        def moving() -> bool:
            message = JointState(name=["motor", "load"], position=[0.0, 0.0])
            message.header.stamp = peer.node.get_clock().now().to_msg()
            states.publish(message)
            reference.publish(Float64(data=0.02))
            return bool(commands) and commands[-1] != 0.0

        peer.wait("a command", moving)
    finally:
        process.send_signal(signal.SIGTERM)
    commands.clear()
    peer.wait("0 V", lambda: commands and commands[-1] == 0.0, 10.0)
    assert process.wait(10.0) == 0


def test_the_script_of_the_quick_start_learns_and_steps(start: Start, peer: Peer) -> None:
    commands: list[Float64MultiArray] = []
    samples: list[JointState] = []
    peer.node.create_subscription(Float64MultiArray, "command", commands.append, 10)
    peer.node.create_subscription(JointState, "joint_states", samples.append, 10)
    start("plant_simulator", lockstep=True, real_time_factor=5.0, command_timeout=10.0)
    start("controller", use_sim_time=True, state_timeout=10.0)
    peer.wait("the first samples and answers", lambda: samples and commands)
    script = CONFIG.parent / "docs" / "examples" / "learn_and_step.py"
    done = subprocess.run([sys.executable, script, "0.5"], capture_output=True, text=True, timeout=600, check=False)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "/plant_simulator/reset_fault: no fault was latched" in said
    assert "learn: backlash 0.0" in said
    assert "law planned acts" in said
    assert "the controller follows 0.5 rad" in said
    peer.wait("the load at its target", lambda: abs(samples[-1].position[samples[-1].name.index("load")] - 0.5) < 0.02)


@pytest.mark.corners(1)
@pytest.mark.parametrize(
    ("learned", "least", "most", "says"),
    [
        (True, 1, 2, "the drive was not identified: law two_region goes on"),
        (True, 1, 2, "not followed: see the log of the controller"),
        (False, 0, 0, "nothing was learned"),
    ],
)
def test_the_script_of_the_quick_start_gives_up(
    peer: Peer, tmp_path: Path, *, learned: bool, least: int, most: int, says: str
) -> None:
    """If nothing is learned, or a reference is not followed, and says what did not work.

    There is no simulator here whose fault could be reset. It must not go on sending what would move the motor whenever
    the controller takes references again.
    """
    references: list[Float64] = []
    peer.node.create_subscription(Float64, "reference", references.append, 100)

    def answer(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        return response

    def learn(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = learned, "yes" if learned else "no"
        return response

    def fail(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return response

    for service, answers in (("reset_fault", answer), ("learn", learn), ("identify", fail)):
        peer.node.create_service(Trigger, f"controller/{service}", answers)
    script, tries = tmp_path / "learn_and_step.py", "TRIES = 10 "
    shipped = (CONFIG.parent / "docs" / "examples" / script.name).read_text()
    assert tries in shipped
    script.write_text(shipped.replace(tries, "TRIES = 2 "))  # each takes a second
    process = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        peer.wait("the end of the script", lambda: process.poll() is not None)
    finally:
        process.kill()
        said, _ = process.communicate()
    assert process.returncode == 1, said
    assert says in said
    assert least <= len(references) <= most
