"""The lifecycle of simulator and controller: what each transition does to the motor, and what no request can do."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from graph import Lifecycle, Peer, Process
from lifecycle_msgs.msg import Transition
from lockstep_drive import LockstepDrive
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.control import LAWS, FaultThresholds
from backlash_ros.control.acting import IDLE
from backlash_ros.control.law import LawStep
from backlash_ros.control.laws import design_law
from backlash_ros.control.tick import Tick, tick_with
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.nodes.controller import Controller
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.run import _stopped

Start = Callable[..., Process]
PATIENT = {"state_timeout": 10.0, "law": "fast", "torque_bandwidth": 0.0}


@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_node_comes_up_by_itself_or_on_request(start: Start, peer: Peer, node: str) -> None:
    start(node)
    active = Lifecycle(peer, node)
    peer.wait("autostart", lambda: active.state == "active")
    start(node, "-r", f"__node:=second_{node}", autostart=False)
    second = Lifecycle(peer, f"second_{node}")
    assert second.state == "unconfigured"
    assert second.change(Transition.TRANSITION_CONFIGURE)
    assert second.state == "inactive"
    assert second.change(Transition.TRANSITION_ACTIVATE)
    assert second.state == "active"


@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_impossible_transition_is_refused_and_the_node_lives(start: Start, peer: Peer, node: str) -> None:
    process = start(node, autostart=False)
    lifecycle = Lifecycle(peer, node)
    for impossible in (Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE, 77):
        assert not lifecycle.change(impossible)
        assert lifecycle.state == "unconfigured"
    assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
    assert not lifecycle.change(Transition.TRANSITION_CONFIGURE)
    assert lifecycle.state == "inactive"
    # Ours, or that of a newer rclpy, which refuses by itself.
    assert re.search("not possible in state unconfigured|Unable to start transition", process.output())
    assert process.stop() == 0


@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_round_through_all_states_leaves_the_node_as_new(start: Start, peer: Peer, node: str) -> None:
    process = start(node, autostart=False)
    lifecycle = Lifecycle(peer, node)
    for _ in range(3):
        assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
        assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
        assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
        assert lifecycle.change(Transition.TRANSITION_CLEANUP)
        assert lifecycle.state == "unconfigured"
    topic = "/command" if node == "controller" else "/joint_states"
    assert peer.node.count_publishers(topic) == 0
    assert lifecycle.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert process.wait() == 0


def test_deactivation_puts_zero_volts_out_and_activation_holds_where_the_load_is(start: Start, peer: Peer) -> None:
    start("controller", **PATIENT)
    drive = LockstepDrive(peer).matched()
    lifecycle = Lifecycle(peer, "controller")
    drive.set_reference(1.0)
    drive.run(10)
    assert drive.step() > 1.0
    drive.commands.clear()
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    peer.wait("the last command", lambda: drive.commands)
    assert drive.commands == [0.0]
    drive.commands.clear()
    for _ in range(20):
        drive._states.publish(drive.sample())
        drive.tick += 1
        peer.spin(0.02)
    assert drive.commands == []  # nobody is driven by a node that is not active
    refusal = peer.call(Trigger, "controller/learn", Trigger.Request()).message
    assert refusal == "cannot learn: the controller must be active, but is inactive"
    held = drive.plant.load_angle
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    angles = drive.run(200)
    assert abs(angles[-1] - held) < 0.1  # it was moving when it was let go
    assert abs(angles[-1] - 1.0) > 0.3


@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_fault_outlives_deactivation_and_ends_with_a_new_configuration(start: Start, peer: Peer, node: str) -> None:
    process = start(node, **(PATIENT if node == "controller" else {}))
    lifecycle = Lifecycle(peer, node)
    command = peer.node.create_publisher(Float64MultiArray, "command", 1)
    if node == "controller":
        drive = LockstepDrive(peer).matched()

    asked = [0.0]

    def fail() -> None:
        before = process.output().count("until reset_fault")
        if node == "controller":
            drive.run(10)
            drive.exchange(drive.sample(position=[0.0, 5.0]))
        else:
            peer.wait("the drive", command.get_subscription_count)

        def failed() -> bool:
            if node == "plant_simulator" and time.monotonic() > asked[-1] + 0.5:  # best effort: it may be lost
                asked.append(time.monotonic())
                command.publish(Float64MultiArray())
            return process.output().count("until reset_fault") > before

        peer.wait("the fault", failed)

    def reset() -> str:
        return str(peer.call(Trigger, f"{node}/reset_fault", Trigger.Request()).message)

    fail()
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    assert reset().startswith("reset ")
    fail()
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    assert lifecycle.change(Transition.TRANSITION_CLEANUP)
    assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
    assert reset() == "no fault was latched"


def test_simulator_is_silent_and_still_while_not_active(start: Start, peer: Peer) -> None:
    start("plant_simulator")
    states: list[JointState] = []
    peer.node.create_subscription(JointState, "joint_states", states.append, 100)
    lifecycle = Lifecycle(peer, "plant_simulator")
    peer.wait("joint states", lambda: len(states) > 10)
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    silent_from = peer.node.get_clock().now().nanoseconds
    assert lifecycle.state == "inactive"
    peer.wait("fifty periods", lambda: peer.node.get_clock().now().nanoseconds - silent_from > 200e6)
    silent_until = peer.node.get_clock().now().nanoseconds
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    peer.wait("joint states again", lambda: stamp_ns(states[-1].header.stamp) > silent_until)
    assert not [state for state in states if silent_from < stamp_ns(state.header.stamp) < silent_until]


@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_signals_that_come_while_it_stops_do_not_keep_it_from_ending_well(start: Start, peer: Peer, node: str) -> None:
    """Ctrl-C under `ros2 launch` arrives twice: from the terminal, and passed on."""
    process = start(node)
    lifecycle = Lifecycle(peer, node)
    peer.wait("autostart", lambda: lifecycle.state == "active")
    while process.running:
        process.signal(signal.SIGINT)
        time.sleep(0.001)
    assert process.wait() == 0


@pytest.mark.parametrize("node", ["controller", "plant_simulator", "recorder", "dashboard"])
def test_words_that_nobody_knows_end_the_start(start: Start, node: str) -> None:
    """A parameter file without --ros-args before it would be passed over, and the drive be another one."""
    process = start(node, non_ros=["--params-file", "my_drive.yaml"])
    assert process.wait() == 2
    assert "unrecognized arguments: --params-file my_drive.yaml" in process.output()


@pytest.mark.parametrize(
    ("node", "says"),
    [
        ("controller", ["--axes NAMESPACE", "joint_states", "~/learn", "does not hold a hanging load"]),
        ("plant_simulator", ["--axes NAMESPACE", "load_torque", "~/reset_fault"]),
        ("recorder", ["rosbag2 folder"]),
        ("dashboard", ["host", "read_only"]),
    ],
)
def test_help_is_given_and_nothing_starts(start: Start, node: str, says: list[str]) -> None:
    process = start(node, non_ros=["--help"])
    assert process.wait() == 0
    for words in ("--params-file FILE", f"example: ros2 run backlash_ros {node} ", *says):
        assert words in process.output()
    assert not re.search("ready|simulating|recording|http", process.output())


def test_node_that_cannot_be_configured_ends_with_a_line_that_says_so(start: Start) -> None:
    process = start("controller", **{"qos_overrides./joint_states.subscription.reliability": "nosuch"})
    assert process.wait() == 1
    assert "controller did not come up: still unconfigured" in process.output()


class Failing(ManagedNode):
    """A node that does not get through one of its transitions."""

    def __init__(self, hindered: str, error: Exception) -> None:
        super().__init__("failing", "")
        self._hindered, self._error = hindered, error

        self.ended = 0

    def _go(self, transition: str) -> None:
        if transition == self._hindered:
            self._hindered = ""
            raise self._error

    def configure(self) -> None:
        self.speak(Float64MultiArray, "command")
        self._go("configure")

    def activate(self) -> None:
        self._go("activate")

    def deactivate(self) -> None:
        self._go("deactivate")
        self.ended += 1

    def statuses(self) -> Sequence[DiagnosticStatus]:
        return []


@pytest.mark.parametrize(
    ("hindered", "error"),
    [
        ("configure", ValueError("refused")),
        ("configure", OSError("broken")),
        ("activate", OSError("broken")),
        ("deactivate", OSError("broken")),
    ],
    ids=str,
)
def test_transition_that_fails_leaves_no_topics(in_process: None, hindered: str, error: Exception) -> None:
    node = Failing(hindered, error)
    for trigger in {
        "configure": [node.trigger_configure],
        "activate": [node.trigger_configure, node.trigger_activate],
        "deactivate": [node.trigger_configure, node.trigger_activate, node.trigger_deactivate],
    }[hindered]:
        trigger()
    assert node.state == "unconfigured"
    assert not node.active
    assert node.ended == (hindered == "deactivate")  # 0 V goes out in the end
    assert "/command" not in {publisher.topic_name for publisher in node.publishers}
    node.destroy_node()


def test_node_that_cannot_be_stopped_does_not_keep_the_others_from_it(in_process: None) -> None:
    class Stubborn(Failing):
        def stop(self) -> None:
            raise OSError("broken")

    nodes = [Stubborn("", OSError()), Failing("", OSError())]
    assert [_stopped(node) for node in nodes] == [False, True]
    assert nodes[1].state == "finalized"
    for node in nodes:
        node.destroy_node()


STUCK = """
import ctypes, sys
from backlash_ros.ros import run

class Stuck(run.StoppableNode):
    def start(self):
        self.finished = True

    def stop(self):
        print("stopped", flush=True)

    def destroy_node(self):
        ctypes.PyDLL(None).sleep(3600)  # with Python's lock held

run._LEAVING = 0.5
sys.exit(run.run("stuck", "Gets stuck.", lambda axis: Stuck("stuck"), []))
"""


def test_middleware_that_locks_itself_up_does_not_keep_the_process_that_has_stopped_its_node(domain: int) -> None:
    ended = subprocess.run([sys.executable, "-c", STUCK], check=False, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1
    assert ended.stdout == "stopped\n"
    assert "destroy_node" in ended.stderr


def test_configuring_compiles_what_any_change_of_the_law_needs(
    in_process: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also a law that does not act before the drive is identified: compiling amid motion would be a fault."""
    made: list[LawStep] = []

    def noted(step: LawStep) -> Tick:
        made.append(step)
        return tick_with(step)

    monkeypatch.setattr("backlash_ros.control.acting.tick_with", noted)
    controller = Controller()
    try:
        controller.trigger_configure()
        settings = replace(controller._tunables.in_use.settings, identified=True, backlash_angle=0.02)
        steps = {design_law(NOMINAL_DRIVE, settings.with_law(law)).step for law in LAWS}
        assert steps | {IDLE.step} <= set(made)
    finally:
        controller.destroy_node()


def test_gate_knows_how_fast_each_shaft_may_turn(in_process: None) -> None:
    """Beyond these speeds, each at its own shaft, a jump is taken for a position that begins again."""
    controller = Controller()
    try:
        load = FaultThresholds.of(NOMINAL_DRIVE).velocity
        assert controller._gate.fastest == pytest.approx((load / NOMINAL_DRIVE.gear.ratio, load))
        assert controller.set_parameters_atomically([Parameter("faults.velocity", value=20.0)]).successful
        assert controller._gate.fastest == pytest.approx((200.0, 20.0))
    finally:
        controller.destroy_node()
