"""The simulator on real DDS: the interface of a drive, its beat, its watchdog."""

import json
import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from graph import Parameters, Peer, Process
from pair import stamp_of
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import get_rmw_implementation_identifier
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.foundation.signals import THETA_L
from backlash_ros.gates import Fault
from backlash_ros.nodes.plant_simulator import PlantSimulator
from backlash_ros.ros.messages import answer, stamp_label
from backlash_ros.ros.timer import in_ns

Start = Callable[..., Process]


class Listener:
    """Collects joint states and drives the motor."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self.states: list[JointState] = []
        deep = QoSProfile(depth=5000)
        peer.node.create_subscription(JointState, "joint_states", self.states.append, deep)
        self._command = peer.node.create_publisher(Float64MultiArray, "command", deep)
        self._torque = peer.node.create_publisher(Float64, "load_torque", deep)

    def ready(self) -> "Listener":
        self.peer.wait("joint states", lambda: len(self.states) > 5)
        self.peer.wait("the simulator to listen", lambda: self._command.get_subscription_count() > 0)
        self.peer.wait("the simulator to listen", lambda: self._torque.get_subscription_count() > 0)
        return self

    def command(self, *data: float) -> None:
        self._command.publish(Float64MultiArray(data=data))

    def answer(self, voltage: float, sample: JointState) -> None:
        self._command.publish(answer(voltage, stamp_label(sample.header.stamp)))

    def torque(self, value: float) -> None:
        self._torque.publish(Float64(data=value))

    @property
    def last(self) -> JointState:
        return self.states[-1]

    def drive_until(self, voltage: float, what: str, condition: Callable[[], bool]) -> None:
        """Command ``voltage`` again and again, as a controller does, until ``condition`` holds."""

        def commanded() -> bool:
            self.command(voltage)
            return condition()

        self.peer.wait(what, commanded)


def test_publishes_both_joints_at_the_rate(start: Start, peer: Peer) -> None:
    start("plant_simulator", rate=200.0)
    listener = Listener(peer).ready()
    listener.states.clear()
    peer.wait("three seconds of samples", lambda: len(listener.states) >= 600)
    message = listener.last
    assert list(message.name) == ["motor", "load"]
    assert len(message.position) == len(message.velocity) == len(message.effort) == 2
    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in listener.states])
    # The beat keeps to the steady clock: a late sample comes late or not at all, none is made up, the phase is kept.
    beats = (stamps - stamps[0]) * 200.0
    steps = np.diff(np.round(beats))
    assert np.median(steps) == 1
    assert len(stamps) - 1 <= round(beats[-1]) + 1
    assert np.median(np.abs(np.diff(stamps) * 200.0 - np.round(np.diff(stamps) * 200.0))) < 0.25


def test_stamps_are_its_own_whatever_use_sim_time_says(start: Start, peer: Peer) -> None:
    """Nobody publishes /clock here: ROS time would stand at 0, and every sample look like the one before."""
    start("plant_simulator", use_sim_time=True)
    listener = Listener(peer).ready()
    peer.wait("samples", lambda: len(listener.states) >= 20)
    stamps = [(m.header.stamp.sec, m.header.stamp.nanosec) for m in listener.states]
    assert len(set(stamps)) == len(stamps)
    assert stamps[0][0] > 1e9


def test_voltage_turns_the_motor_and_the_gear_the_load(start: Start, peer: Peer) -> None:
    start("plant_simulator", motor_joint="m", load_joint="l")
    listener = Listener(peer).ready()
    assert list(listener.last.name) == ["m", "l"]
    listener.drive_until(3.0, "the load to turn", lambda: listener.last.position[1] > 0.5)
    position, effort = listener.last.position, listener.last.effort
    assert position[0] == pytest.approx(10 * position[1], abs=0.2)  # within the backlash
    assert effort[0] > 0
    assert listener.last.velocity[1] > 0


def test_sensors_can_be_changed_while_it_runs_and_are_checked_whole(start: Start, peer: Peer) -> None:
    start("plant_simulator", sensors__motor_counts=64, sensors__load_offset=0.25)
    listener = Listener(peer).ready()
    parameters = Parameters(peer, "plant_simulator")
    listener.drive_until(1.0, "the motor to turn", lambda: listener.last.position[0] > 2.0)
    count = 2 * math.pi / 64
    for message in listener.states:
        assert message.position[0] / count == pytest.approx(round(message.position[0] / count), abs=1e-9)
    assert listener.states[0].position[1] == 0.25
    assert parameters.set(sensors__motor_counts=0.0, sensors__measured=["theta_m", "theta_l"]) == (True, "")

    def exact_and_without_speeds() -> bool:
        last = listener.last
        return all(map(math.isnan, last.velocity)) and math.isnan(last.effort[0])

    listener.drive_until(1.0, "the change", exact_and_without_speeds)
    accepted, reason = parameters.set(sensors__load_noise=0.1, sensors__measured=["omega_m"])
    assert not accepted
    assert "sensors.measured must be of" in reason
    assert parameters.get("sensors.load_noise", "sensors.measured") == [0.0, ["theta_m", "theta_l"]]
    accepted, reason = parameters.set(sensors__load_noise=-0.1)
    assert (accepted, reason) == (False, "sensors.load_noise must be >= 0 rad and <= 1000 rad, got -0.1")


def test_a_joint_without_an_encoder_is_left_out(start: Start, peer: Peer) -> None:
    start("plant_simulator", sensors__measured="[theta_l, omega_l]")
    listener = Listener(peer).ready()
    assert list(listener.last.name) == ["load"]
    assert len(listener.last.position) == len(listener.last.velocity) == 1


def test_load_torque_turns_the_load(start: Start, peer: Peer) -> None:
    start("plant_simulator")
    listener = Listener(peer).ready()
    listener.torque(-0.2)
    peer.wait("the load to turn back", lambda: listener.last.position[1] < -0.1)


def test_motor_gets_no_voltage_on_silence(start: Start, peer: Peer) -> None:
    process = start("plant_simulator", command_timeout=0.3)
    listener = Listener(peer).ready()
    listener.drive_until(6.0, "speed", lambda: listener.last.velocity[1] > 5.0)
    peer.wait("the motor to stop", lambda: abs(listener.last.velocity[1]) < 0.05)
    assert abs(listener.last.effort[0]) < 1e-3
    assert "no command for 0.3 s: motor at 0 V" in process.output()
    assert peer.call(Trigger, "plant_simulator/reset_fault", Trigger.Request()).success
    listener.drive_until(6.0, "it to go on", lambda: listener.last.velocity[1] > 5.0)


class Answering:
    """Answers the samples of a simulator with 6 V, each ``delay`` s after its stamp."""

    def __init__(self, listener: Listener, delay: float) -> None:
        self._listener, self.delay = listener, delay
        self._answered = 0.0

    def until(self, what: str, condition: Callable[[], bool], seconds: float = 0.0) -> None:
        """Answer until ``condition`` holds, and for ``seconds`` by the stamps."""
        states = self._listener.states
        begun = stamp_of(states[-1])

        def answered() -> bool:
            newest = stamp_of(states[-1])
            due = next((m for m in reversed(states) if stamp_of(m) <= newest - self.delay), None)
            if due is not None and stamp_of(due) > self._answered:
                self._listener.answer(6.0, due)
                self._answered = stamp_of(due)
            return newest > begun + seconds and condition()

        self._listener.peer.wait(what, answered)


def test_answer_is_as_old_as_the_sample_that_it_names(start: Start, peer: Peer) -> None:
    """What waited on the way for longer than the watchdog's time moves nothing, and puts the watchdog off no more."""
    process = start("plant_simulator", command_timeout=2.0)
    listener = Listener(peer).ready()
    Answering(listener, delay=2.5).until("the warning", lambda: "older than command_timeout" in process.output(), 4.0)
    assert listener.last.velocity[1] == 0.0
    assert "until reset_fault" not in process.output()
    Answering(listener, delay=0.2).until("speed", lambda: listener.last.velocity[1] > 5.0, 4.0)
    assert "until reset_fault" not in process.output()
    Answering(listener, delay=2.5).until("the fault", lambda: "until reset_fault" in process.output())
    assert "no command for 2 s, only answers to older samples: motor at 0 V" in process.output()


def test_zero_is_obeyed_however_old_it_is(start: Start, peer: Peer) -> None:
    process = start("plant_simulator", command_timeout=3.0)
    listener = Listener(peer).ready()
    later = stamp_of(listener.last) + 3.5
    peer.wait("a while", lambda: stamp_of(listener.last) > later)
    old = iter(listener.states)
    listener.drive_until(6.0, "speed", lambda: listener.last.velocity[1] > 5.0)

    def stopped() -> bool:
        listener.answer(0.0, next(old))
        return abs(listener.last.velocity[1]) < 0.05

    peer.wait("the motor to stop", stopped)
    assert "until reset_fault" not in process.output()


def test_label_that_names_no_sample_means_nothing(start: Start, peer: Peer) -> None:
    """Somebody plays a recording, or stamps the samples anew on their way to the controller."""
    process = start("plant_simulator", command_timeout=10.0)
    listener = Listener(peer).ready()
    voltage = 6.0

    def commanded(label: str) -> bool:
        stamp = listener.last.header.stamp
        stamp.nanosec = min(stamp.nanosec + 1, 999_999_999)
        listener._command.publish(answer(voltage, stamp_label(stamp) if label == "one ns later" else label))
        return voltage * listener.last.velocity[1] > 30.0

    for label in ("voltage", "5.000000000", "one ns later"):
        peer.wait(f"speed, with {label}", lambda label=label: commanded(label))
        voltage = -voltage
    assert "until reset_fault" not in process.output()


@pytest.mark.grid
def test_motor_of_a_simulator_that_stood_still_had_voltage_until_the_watchdog_took_it_off(
    start: Start, peer: Peer
) -> None:
    process = start("plant_simulator", command_timeout=3.0)
    listener = Listener(peer).ready()
    listener.drive_until(6.0, "speed", lambda: listener.last.velocity[1] > 5.0)
    told = peer.node.get_clock().now().nanoseconds * 1e-9
    peer.wait("what was on its way", lambda: stamp_of(listener.last) > told + 0.2)
    process.signal(signal.SIGSTOP)
    end = time.monotonic() + 6.0
    peer.wait("a long pause", lambda: time.monotonic() > end)
    last = listener.last
    listener.states.clear()
    process.signal(signal.SIGCONT)
    # The stop may fall between a sample's stamp and its sending: that sample comes late and is from before the pause.
    late = stamp_of(last) + 0.1
    first = peer.wait("a sample after it", lambda: [state for state in listener.states if stamp_of(state) > late])[0]
    assert stamp_of(first) - stamp_of(last) > 5.0
    way = first.position[1] - last.position[1]
    assert way / last.velocity[1] == pytest.approx(told + 3.0 - stamp_of(last), abs=1.0)
    assert "no command for 3 s" in process.output()


def test_motor_of_a_simulator_that_comes_late_had_voltage_until_the_watchdog_took_it_off(
    in_process: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its clock alone, which leaps by 3 s."""
    simulator = PlantSimulator()
    try:
        simulator.trigger_configure()
        simulator.trigger_activate()
        begin, expected = simulator._timer.due, simulator._at_rest()
        for time in (0.0, 3.0):
            monkeypatch.setattr("backlash_ros.nodes.plant_simulator.now", lambda time=time: begin + time)
            simulator._go_on()
            simulator._gate.command([6.0], None, in_ns(begin))
        (timeout,) = (p.value for p in simulator.get_parameters(["command_timeout"]))
        for k in range(750):
            expected.advance(6.0 if k < timeout * 250 else 0.0, 0.0)
        assert simulator._gate.fault is Fault.NO_COMMANDS
        assert simulator._simulated.state[THETA_L] == pytest.approx(expected.state[THETA_L], rel=1e-6)
        assert expected.state[THETA_L] > 1.0
    finally:
        simulator.destroy_node()


def test_motor_gets_no_voltage_on_a_command_that_is_not_finite(start: Start, peer: Peer) -> None:
    start("plant_simulator", command_timeout=10.0)
    listener = Listener(peer).ready()
    for bad in ([math.nan], [math.inf], []):
        listener.drive_until(6.0, "speed", lambda: listener.last.velocity[1] > 5.0)
        listener.command(*bad)
        peer.wait("the motor to stop", lambda: abs(listener.last.velocity[1]) < 0.05)
        listener.states.clear()
        listener.drive_until(6.0, "good commands to be of no use", lambda: len(listener.states) > 100)
        assert max(abs(state.velocity[1]) for state in listener.states) < 0.5
        reset = peer.call(Trigger, "plant_simulator/reset_fault", Trigger.Request()).message
        assert "the first value of command must be finite, in V" in reset
    listener.drive_until(6.0, "it to go on", lambda: listener.last.velocity[1] > 5.0)


def test_load_torque_that_cannot_be_simulated_changes_nothing(start: Start, peer: Peer) -> None:
    process = start("plant_simulator")
    listener = Listener(peer).ready()
    for torque in (math.nan, math.inf, -61.0, 1e300):
        says = f"load_torque must be within +-60 N m, ten times what the motor holds, got {torque:g}: 0 stays"

        def told(torque: float = torque, says: str = says) -> bool:
            listener.torque(torque)  # one line a second at most
            return says in process.output()

        peer.wait("the warning", told)
    listener.states.clear()
    peer.wait("more samples", lambda: len(listener.states) > 20)
    assert all(math.isfinite(value) for m in listener.states for value in (*m.position, *m.velocity, *m.effort))
    assert listener.last.velocity[1] == 0.0
    assert "until reset_fault" not in process.output()


def test_stops_cleanly(start: Start, peer: Peer) -> None:
    process = start("plant_simulator")
    Listener(peer).ready()
    process.signal(signal.SIGINT)  # others in test_faults.py
    assert process.wait() == 0
    assert "Traceback" not in process.output()
    assert "stopped after" in process.output()


of_fast_dds = pytest.mark.skipif(
    not get_rmw_implementation_identifier().startswith("rmw_fastrtps"), reason="is of Fast DDS"
)


def shares_memory(process: Process) -> bool:
    return "/dev/shm/fast" in Path(f"/proc/{process.pid}/maps").read_text()


@of_fast_dds
def test_in_these_tests_it_stays_on_the_machine_without_shared_memory(start: Start, peer: Peer) -> None:
    process = start("plant_simulator")
    Listener(peer).ready()
    assert not shares_memory(process)
    table = Path(f"/proc/{process.pid}/net/udp").read_text().splitlines()[1:]
    inodes = {os.readlink(entry) for entry in Path(f"/proc/{process.pid}/fd").iterdir() if entry.is_symlink()}
    addresses = {words[1].split(":")[0] for words in map(str.split, table) if f"socket:[{words[9]}]" in inodes}
    assert "0100007F" in addresses  # 127.0.0.1
    assert addresses <= {"0100007F", "0100FFEF"}  # 239.255.0.1, joined on the loopback device


@pytest.mark.grid
def test_goes_on_when_the_terminal_is_closed_under_nohup(start: Start, peer: Peer) -> None:
    process = start("plant_simulator", under=["nohup"])
    listener = Listener(peer).ready()
    process.signal(signal.SIGHUP)
    later = peer.node.get_clock().now().nanoseconds * 1e-9 + 1.0
    peer.wait("samples of a second later", lambda: stamp_of(listener.last) > later)
    assert process.stop() == 0


def test_quality_of_service_can_be_overridden_and_a_mismatch_is_reported(start: Start, peer: Peer) -> None:
    process = start("plant_simulator", **{"qos_overrides./joint_states.publisher.reliability": "best_effort"})
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    heard: list[JointState] = []
    peer.node.create_subscription(JointState, "joint_states", heard.append, best_effort)
    peer.wait("a sample", lambda: heard)
    peer.node.create_subscription(JointState, "joint_states", heard.append, QoSProfile(depth=10))
    peer.wait("the report", lambda: "incompatible QoS" in process.output())


@pytest.mark.corners(1)
@pytest.mark.parametrize(
    ("a", "b"),
    [((True, 250.0), (True, 100.0)), ((False, 250.0), (True, 250.0)), ((True, 250.0), (False, 100.0))],
    ids=str,
)
def test_axes_in_lockstep_that_cannot_step_together_are_refused(
    start: Start, tmp_path: Path, a: tuple[bool, float], b: tuple[bool, float]
) -> None:
    file = tmp_path / "axes.yaml"
    axes = {axis: dict(zip(("lockstep", "rate"), values, strict=True)) for axis, values in {"a": a, "b": b}.items()}
    file.write_text(
        json.dumps({f"/{axis}/plant_simulator": {"ros__parameters": values} for axis, values in axes.items()})
    )
    process = start("plant_simulator", "--params-file", str(file), non_ros=["--axes", *axes])
    assert process.wait() == 2
    assert "lockstep and rate must be the same for all axes of one process" in process.output()
