"""Faults injected into live processes. The page docs/faults.md is made of the names: fault, motor, recovery."""

import math
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph import Peer, Process
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lockstep_drive import LockstepDrive
from pair import TIMEOUT, Pair, stamp_of
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.ros.messages import answer, to_stamp

Start = Callable[..., Process]
Measure = Callable[[float], None]
SLACK = 1.0
"""What a loaded machine may add to a watchdog's time before a test calls it broken, s."""


@pytest.fixture
def pair(start: Start, peer: Peer) -> Pair:
    return Pair(start, peer).loaded()


# Processes that die, stop and end.


def test_controller_is_killed__the_drive_takes_the_voltage_off__restart_it_and_reset_the_drive(
    pair: Pair, measure: Measure
) -> None:
    began = pair.now()
    pair.controller.signal(signal.SIGKILL)
    measure(took := pair.unpowered(began))
    assert took < TIMEOUT + SLACK
    pair.faulty("plant_simulator", "no command for 1 s")
    pair.restart_controller()
    assert pair.reset("plant_simulator") == "reset NO_COMMANDS: no command for 1 s"
    pair.works()


def test_controller_stands_still_for_a_while__the_drive_takes_the_voltage_off__reset_both(
    pair: Pair, measure: Measure
) -> None:
    began = pair.now()
    pair.controller.signal(signal.SIGSTOP)
    measure(took := pair.unpowered(began))
    assert took < TIMEOUT + SLACK
    pair.faulty("plant_simulator", "no command for 1 s")
    pair.controller.signal(signal.SIGCONT)
    pair.reset("controller")
    pair.reset("plant_simulator")
    pair.reset("controller")  # its commands did nothing while the drive had its fault
    pair.works()


@pytest.mark.corners(1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP], ids=lambda number: number.name)
def test_controller_is_terminated__it_puts_0_v_out_before_it_goes__restart_it(
    pair: Pair, measure: Measure, number: signal.Signals
) -> None:
    began = pair.now()
    pair.controller.signal(number)
    measure(pair.unpowered(began))
    assert pair.controller.wait() == 0
    pair.peer.wait("the last command", lambda: pair.commands[-1][1] == [0.0])
    pair.restart_controller()
    pair.works()
    assert pair.value("plant_simulator", "fault") == ""


def test_drive_is_killed__the_controller_commands_0_v__restart_it_and_reset_the_controller(
    pair: Pair, measure: Measure
) -> None:
    began = pair.now()
    pair.simulator.signal(signal.SIGKILL)
    measure(took := pair.told_zero(began))
    assert took < TIMEOUT + SLACK
    pair.faulty("controller", "no joint_states for 1 s")
    pair.start_simulator()
    assert pair.reset("controller") == "reset NO_SAMPLES: no joint_states for 1 s"
    pair.works()


@pytest.mark.grid
def test_drive_stands_still_for_a_while__the_controller_commands_0_v__reset_both(pair: Pair, measure: Measure) -> None:
    began = pair.now()
    pair.simulator.signal(signal.SIGSTOP)
    measure(took := pair.told_zero(began))
    assert took < TIMEOUT + SLACK
    pair.faulty("controller", "no joint_states for 1 s")
    pair.simulator.signal(signal.SIGCONT)
    pair.unpowered(began)
    pair.reset("plant_simulator")
    pair.reset("controller")
    pair.works()


@pytest.mark.grid
def test_drive_is_terminated__the_controller_commands_0_v__restart_it_and_reset_the_controller(
    pair: Pair, measure: Measure
) -> None:
    began = pair.now()
    pair.simulator.signal(signal.SIGTERM)
    measure(took := pair.told_zero(began))
    assert took < TIMEOUT + SLACK
    assert pair.simulator.wait() == 0
    pair.faulty("controller", "no joint_states for 1 s")
    pair.start_simulator()
    pair.reset("controller")
    pair.works()


@pytest.mark.grid
def test_listener_stands_still__the_loop_goes_on__none_needed(pair: Pair, start: Start, tmp_path: Path) -> None:
    listener = start("recorder", output=tmp_path / "bag")
    for topic in ("/joint_states", "/command"):
        pair.peer.wait(f"the recorder on {topic}", lambda t=topic: f"recording {t}\n" in listener.output())
    pair.works()
    for number in (signal.SIGSTOP, signal.SIGCONT) * 20:
        listener.signal(number)
        later = pair.now() + 0.02
        pair.peer.wait("samples", lambda later=later: stamp_of(pair.states[-1]) > later)
    pair.works()
    for node in ("controller", "plant_simulator"):
        assert pair.value(node, "fault") == ""


def change(pair: Pair, node: str, transition: int) -> None:
    request = ChangeState.Request(transition=Transition(id=transition))
    assert pair.peer.call(ChangeState, f"{node}/change_state", request).success


def test_drive_falls_silent__the_controller_commands_0_v__let_it_speak_and_reset_the_controller(
    pair: Pair, measure: Measure
) -> None:
    began = pair.now()
    change(pair, "plant_simulator", Transition.TRANSITION_DEACTIVATE)
    measure(took := pair.told_zero(began))
    assert took < TIMEOUT + SLACK + 1.0
    pair.faulty("controller", "no joint_states for 1 s")
    change(pair, "plant_simulator", Transition.TRANSITION_ACTIVATE)
    pair.reset("controller")
    pair.works()


def test_controller_is_deactivated__it_puts_0_v_out_first__activate_it(pair: Pair, measure: Measure) -> None:
    began = pair.now()
    change(pair, "controller", Transition.TRANSITION_DEACTIVATE)
    measure(pair.unpowered(began))
    change(pair, "controller", Transition.TRANSITION_ACTIVATE)
    pair.works()
    assert pair.value("plant_simulator", "fault") == ""


# Commands that the drive cannot obey.


def publisher_of_commands(pair: Pair) -> Any:
    publisher = pair.peer.node.create_publisher(Float64MultiArray, "command", QoSProfile(depth=10))
    pair.peer.wait("the simulator", lambda: publisher.get_subscription_count() >= 2)  # it, and the test's own
    return publisher


def intruded(pair: Pair, publish: Callable[[], None]) -> float:
    """Publish until the drive latches a fault: of a queue of depth 1 the next answer may push a message out.

    Return the time from the last publication to 0 V.
    """
    sent = []

    def latched() -> bool:
        if not sent or pair.now() > sent[-1] + 0.3:
            sent.append(pair.now())
            publish()
        return "until reset_fault" in pair.simulator.output()

    pair.peer.wait("the fault", latched)
    return pair.unpowered(sent[-1])


@pytest.mark.corners(1)
@pytest.mark.parametrize("data", [[math.nan], [-math.inf], []], ids=["nan", "infinite", "empty"])
def test_command_is_not_a_number__the_drive_takes_the_voltage_off__reset_both(
    pair: Pair, measure: Measure, data: list[float]
) -> None:
    publisher = publisher_of_commands(pair)
    measure(took := intruded(pair, lambda: publisher.publish(Float64MultiArray(data=data))))
    assert took < SLACK
    pair.faulty("plant_simulator", "the first value of command must be finite, in V")
    pair.reset("plant_simulator")
    pair.reset("controller")
    pair.works()


def test_second_publisher_on_command__the_drive_takes_the_voltage_off__stop_it_and_reset_both(
    pair: Pair, measure: Measure
) -> None:
    publisher = publisher_of_commands(pair)
    pair.peer.wait("a warning of it", lambda: "publishers on command" in pair.level("/controller: servo")[1])
    measure(took := intruded(pair, lambda: publisher.publish(answer(5.0))))
    assert took < SLACK
    pair.faulty("plant_simulator", "a second publisher on command: 5 V between a controller's answers")
    pair.peer.node.destroy_publisher(publisher)
    pair.reset("plant_simulator")
    pair.reset("controller")
    pair.works()


def test_second_controller__the_drive_takes_the_voltage_off__stop_it_and_reset_both(
    pair: Pair, start: Start, measure: Measure
) -> None:
    second = start("controller", "-r", "__node:=second", state_timeout=TIMEOUT)
    began = pair.peer.wait("a sample answered twice", pair.answered_twice)
    pair.faulty("plant_simulator", "two controllers publish command: one sample was answered twice")
    measure(pair.unpowered(began))
    assert second.stop() == 0
    pair.reset("plant_simulator")
    pair.reset("controller")
    pair.works()


# Joint states that the controller cannot use: the test is the drive.


class Watched:
    """A controller under voltage, the drive in the test's hands, and the controller's diagnostics."""

    def __init__(self, start: Start, peer: Peer, **parameters: object) -> None:
        self.peer = peer
        settings = {"law": "fast", "torque_bandwidth": 0.0, "state_timeout": 10.0, **parameters}
        self.process = start("controller", **settings)
        self.drive = LockstepDrive(peer).matched()
        self.drive.set_reference(1.0)
        assert self.drive.step() > 1.0
        self.messages: list[str] = []

    def at_rest(self) -> LockstepDrive:
        """Let a load torque end the limit cycle: at rest, held by 0.8 V, samples may repeat and time may jump."""
        self.drive.load_torque = 0.2
        angles = self.drive.run(750)
        assert np.ptp(angles[-100:]) < 1e-6
        return self.drive

    def latched(self, reason: str) -> None:
        said = re.compile(f"{re.escape(reason)}.*until reset_fault")
        self.peer.wait(f"the fault {reason!r}", lambda: said.search(self.process.output()) is not None)
        assert self.drive.exchange(self.drive.sample()) == 0.0  # good samples do not bring the voltage back

    def reset(self) -> None:
        response = self.peer.call(Trigger, "controller/reset_fault", Trigger.Request())
        assert response.success
        assert response.message.startswith("reset ")

    def recovers(self) -> None:
        """Reset: the load is held where it is, whatever the reference was, and goes where the next one says."""
        self.reset()
        angles = self.drive.run(250)
        assert np.ptp(angles[150:]) < 0.05
        assert self.drive.follows(angles[-1] - 0.3)

    def until_zero(self, message: Callable[[], JointState], measure: Measure, most: float) -> None:
        """Play the drive with ``message`` as its joint states until the command is 0; measured in the drive's time."""
        periods = 0
        while self.drive.exchange(message()) != 0.0:
            self.drive.plant.advance(self.drive.commands[-1], 0.0, self.drive.period)
            periods += 1
            assert periods * self.drive.period < most
        measure(periods * self.drive.period)

    def silence_follows(self, message: Callable[[], JointState], measure: Measure) -> None:
        """Send ``message`` again and again until 0 V is commanded, as after silence."""
        drive, began = self.drive, self.peer.node.get_clock().now()
        drive.commands.clear()

        def zero() -> bool:
            drive._states.publish(message())
            self.peer.spin(0.004)
            return 0.0 in drive.commands

        self.peer.wait("0 V", zero)
        measure(took := (self.peer.node.get_clock().now() - began).nanoseconds * 1e-9)
        assert took < TIMEOUT + SLACK


BAD = {
    "nan": {"position": [0.0, math.nan]},
    "infinite": {"position": [math.inf, 0.0]},
    "arrays of different lengths": {"position": [0.0]},
    "load's joint missing": {"name": ["motor"], "position": [0.0], "velocity": [0.0], "effort": [0.0]},
    "motor's joint missing": {"name": ["load"], "position": [0.0], "velocity": [0.0], "effort": [0.0]},
}


@pytest.mark.corners(2)
@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
def test_one_sample_that_cannot_be_used__0_v_for_that_period__none_needed(
    start: Start, peer: Peer, measure: Measure, bad: dict[str, Any]
) -> None:
    watched = Watched(start, peer)
    drive = watched.drive
    watched.until_zero(lambda: drive.sample(**bad), measure, 0.004)
    assert drive.exchange(drive.sample()) > 1.0
    peer.wait("the log", lambda: "unusable joint_states" in watched.process.output())


@pytest.mark.corners(2)
@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
def test_no_sample_that_can_be_used__0_v_at_once__mend_it_and_reset_the_controller(
    start: Start, peer: Peer, measure: Measure, bad: dict[str, Any]
) -> None:
    watched = Watched(start, peer, state_timeout=TIMEOUT)
    drive = watched.drive
    watched.until_zero(lambda: drive.sample(**bad), measure, 0.004)

    def latched() -> bool:
        drive._states.publish(drive.sample(**bad))
        peer.spin(0.01)
        return "no joint_states for 1 s, only unusable" in watched.process.output()

    peer.wait("the fault", latched)
    watched.latched("no joint_states for 1 s, only unusable")
    watched.recovers()


def test_an_encoder_is_lost_while_the_other_one_may_be_enough__0_v_for_two_periods_then_it_goes_on__reset_uses_both(
    start: Start, peer: Peer, measure: Measure
) -> None:
    """With faults.on_lost_encoder: continue; the load's joint is missing from a sample on."""
    watched = Watched(start, peer, law="two_region", faults__on_lost_encoder="continue")
    drive = watched.drive
    missing = BAD["load's joint missing"]

    def without_load() -> JointState:
        plant = drive.plant
        return drive.sample(**missing | {"position": [plant.motor_angle], "velocity": [plant.motor_speed]})

    commands = [drive.exchange(without_load()) for _ in range(4)]
    assert [command == 0.0 for command in commands] == [True, True, False, False]
    measure(2.0 * drive.period)
    words = "the load's encoder is lost: the axis goes on, slower, with the other one alone"
    peer.wait("the log", lambda: words in watched.process.output())
    watched.recovers()


def test_joints_in_another_order_or_among_others__nothing__none_needed(
    start: Start, peer: Peer, measure: Measure
) -> None:
    drive = Watched(start, peer).at_rest()
    expected = drive.exchange(drive.sample())
    assert abs(expected) > 0.5
    plain = drive.sample()
    for order in ([1, 0, 2], [2, 1, 0], [1, 2, 0]):
        fields = {
            name: [[*getattr(plain, name), extra][k] for k in order]
            for name, extra in (("name", "gripper"), ("position", 99.0), ("velocity", -99.0), ("effort", 9.0))
        }
        assert drive.exchange(drive.sample(**fields)) == expected


def test_stamp_repeated_once__the_answer_is_repeated__none_needed(start: Start, peer: Peer, measure: Measure) -> None:
    watched = Watched(start, peer)
    drive = watched.drive
    expected = drive.exchange(drive.sample())
    drive.tick -= 1
    assert drive.exchange(drive.sample(position=[0.0, -5.0])) == expected
    assert drive.exchange(drive.sample()) == pytest.approx(expected, rel=0.1)


def test_stamp_stands_still__the_controller_commands_0_v__mend_it_and_reset_the_controller(
    start: Start, peer: Peer, measure: Measure
) -> None:
    watched = Watched(start, peer, state_timeout=TIMEOUT)
    same = watched.drive.sample()
    watched.drive.exchange(same)
    watched.silence_follows(lambda: same, measure)
    watched.latched("no joint_states for 1 s, only joint_states repeated")
    watched.recovers()


def test_sample_older_than_the_newest__the_command_stays__none_needed(
    start: Start, peer: Peer, measure: Measure
) -> None:
    watched = Watched(start, peer)
    drive = watched.at_rest()
    expected = drive.exchange(drive.sample())
    assert abs(expected) > 0.5
    drive.tick -= 3
    old = drive.sample(position=[0.0, -5.0])
    drive.tick += 3
    drive._states.publish(old)
    peer.wait("the log", lambda: "joint_states out of order" in watched.process.output())
    assert drive.exchange(drive.sample()) == pytest.approx(expected, rel=0.1)


@pytest.mark.corners(1)
@pytest.mark.parametrize("clocks", ["clocks a little apart", "the same clock"])
def test_second_drive_on_joint_states__0_v_at_once__stop_it_and_reset_the_controller(
    start: Start, peer: Peer, measure: Measure, clocks: str
) -> None:
    watched = Watched(start, peer)
    drive = watched.at_rest()
    assert abs(drive.exchange(drive.sample())) > 0.5
    for _ in range(4):
        drive.exchange(drive.sample())
        other = drive.sample(position=[1.0, 0.1])
        other.header.stamp = to_stamp(
            stamp_ns(other.header.stamp) - (4_000_000 if clocks == "the same clock" else 5_000_000)
        )
        drive._states.publish(other)
        peer.spin(0.05)
    watched.latched("a second drive: joint_states")
    drive.load_torque = 0.0
    watched.recovers()


def test_second_publisher_of_the_joints__no_position_is_held__stop_it_and_reset_the_controller(
    start: Start, peer: Peer, measure: Measure
) -> None:
    """A joint_state_publisher that fills in zeros, beside a drive at rest at 0."""
    other = Node("joint_state_publisher", context=peer.context)
    zeros = other.create_publisher(JointState, "joint_states", 10)
    start("plant_simulator", lockstep=True)
    controller = start("controller", use_sim_time=True, state_timeout=10.0)

    def found() -> bool:
        message = JointState(name=["load", "motor"], position=[0.0, 0.0])
        message.header.stamp = other.get_clock().now().to_msg()
        zeros.publish(message)
        peer.spin(0.05)
        return "until reset_fault" in controller.output()

    peer.wait("the fault", found)
    assert "SECOND_DRIVE: two publishers on joint_states send joint" in controller.output()
    assert "/joint_state_publisher, /plant_simulator: command 0 V until" in controller.output()
    other.destroy_node()
    names = peer.node.get_publishers_info_by_topic
    peer.wait("it to be gone", lambda: len(names("joint_states")) == 1)
    response = peer.call(Trigger, "controller/reset_fault", Trigger.Request())
    assert response.message.startswith("reset SECOND_DRIVE")


class OfTwoDrivers:
    """Publishes each joint in a message of its own, its position between -pi and pi."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self.get_subscription_count = publisher.get_subscription_count
        self._swap = False

    def publish(self, message: JointState) -> None:
        self._swap = not self._swap
        for k in (1, 0) if self._swap else (0, 1):
            joint = JointState(header=message.header, name=[message.name[k]])
            joint.velocity, joint.effort = [message.velocity[k]], [message.effort[k]]
            joint.position = [(message.position[k] + math.pi) % (2 * math.pi) - math.pi]
            self._publisher.publish(joint)


def test_joints_in_messages_of_their_own_and_positions_that_begin_again__nothing__none_needed(
    start: Start, peer: Peer, measure: Measure
) -> None:
    """With motor_wrap and load_wrap: the loop is that of whole samples whose positions go on."""
    angles = []
    for apart in (False, True):
        turn = 2 * math.pi * apart
        process = start("controller", state_timeout=10.0, motor_wrap=turn, load_wrap=turn)
        drive = LockstepDrive(peer)
        if apart:
            drive._states = OfTwoDrivers(drive._states)
        drive.matched().set_reference(4.0)
        angles.append(drive.run(400))
        assert "until reset_fault" not in process.output()
        process.stop()
    assert angles[0][-1] == pytest.approx(4.0, abs=0.1)
    assert angles[1] == pytest.approx(angles[0], abs=1e-6)


def test_only_messages_of_another_machine__the_controller_commands_0_v__mend_it_and_reset_the_controller(
    start: Start, peer: Peer, measure: Measure
) -> None:
    watched = Watched(start, peer, state_timeout=TIMEOUT)
    watched.silence_follows(lambda: watched.drive.sample(name=["a", "b"]), measure)
    watched.latched("no joint_states for 1 s")
    watched.recovers()


@pytest.mark.corners(2)
@pytest.mark.parametrize("jump", [-3600.0, -0.1, 3600.0], ids=lambda jump: f"by {jump:g} s")
def test_clock_of_the_drive_jumps__the_loop_goes_on__none_needed(
    start: Start, peer: Peer, measure: Measure, jump: float
) -> None:
    watched = Watched(start, peer)
    drive = watched.at_rest()
    expected = drive.exchange(drive.sample())
    assert abs(expected) > 0.5
    drive.tick += round(jump / drive.period)
    if -10.0 < jump < 0:  # taken for a stray sample, once
        drive._states.publish(drive.sample())
        drive.tick += 1
        peer.wait("the log", lambda: "joint_states out of order" in watched.process.output())
    assert drive.exchange(drive.sample()) == pytest.approx(expected, rel=0.1)
    drive.run(50)
    peer.wait("the log", lambda: "the clock of joint_states jumped" in watched.process.output())
    assert "until reset_fault" not in watched.process.output()


def test_quality_of_service_that_does_not_match__0_v_goes_on__mend_it(
    start: Start, peer: Peer, measure: Measure
) -> None:
    process = start("controller", **{"qos_overrides./joint_states.subscription.reliability": "reliable"})
    commands: list[float] = []
    node = peer.node
    node.create_subscription(Float64MultiArray, "command", lambda m: commands.append(m.data[0]), 100)
    unreliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    wrong = node.create_publisher(JointState, "joint_states", unreliable)
    peer.wait("the report", lambda: "a publisher on joint_states offers an incompatible QoS" in process.output())
    wrong.publish(JointState(name=["motor", "load"], position=[5.0, 0.5]))
    seen = len(commands)
    peer.wait("more commands", lambda: len(commands) > seen + 2)
    assert set(commands) == {0.0}
    node.destroy_publisher(wrong)
    drive = LockstepDrive(peer).matched()
    drive.run(20)


# References.


BEYOND = {"2.5 rad": 2.5, "-3 rad": -3.0, "a step of 1.6 rad": -0.6, "nan": math.nan}


@pytest.mark.corners(2)
@pytest.mark.parametrize("target", BEYOND.values(), ids=BEYOND)
def test_reference_beyond_the_limits__the_old_reference_is_kept__none_needed(
    start: Start, peer: Peer, measure: Measure, target: float
) -> None:
    watched = Watched(start, peer, limits__position_lower=-2.0, limits__position_upper=2.0, limits__step=1.2)
    drive = watched.drive
    drive.run(250)
    drive._reference.publish(Float64(data=target))
    peer.wait("the log", lambda: "messages dropped so far" in watched.process.output())
    assert "reference must be" in watched.process.output()
    assert drive.run(250)[-1] == pytest.approx(1.0, abs=0.05)


def test_load_is_pushed_beyond_the_end_of_its_travel__0_v__move_it_back_and_reset_the_controller(
    start: Start, peer: Peer, measure: Measure
) -> None:
    watched = Watched(start, peer, limits__position_upper=1.2)
    drive = watched.drive
    drive.run(250)
    drive.load_torque = 2.0
    pushed = 0
    while drive.step() != 0.0 or pushed == 0:
        pushed += 1
        assert pushed < 1000
    assert drive.plant.load_angle > 1.2
    drive.load_torque = 0.0
    watched.latched("beyond limits.position_upper = 1.2 rad")
    watched.reset()
    drive.run(100)
    held = drive.plant.load_angle
    assert drive.run(500)[-1] == pytest.approx(held, abs=0.02)  # outside as it is: nobody asked for a move
    assert drive.follows(0.9)


# Encoders.


class Encoders:
    """What a drive reports whose encoders went wrong at a given moment."""

    def __init__(self, drive: LockstepDrive) -> None:
        self._drive = drive
        self._frozen = drive.sample()

    def _changed(self, **joints: Callable[[float, float], tuple[float, float]]) -> JointState:
        message = self._drive.sample()
        position, velocity = list(message.position), list(message.velocity)
        for k, joint in enumerate(("motor", "load")):
            if joint in joints:
                position[k], velocity[k] = joints[joint](position[k], velocity[k])
        message.position, message.velocity = position, velocity
        return message

    def _freeze(self, *joints: str) -> JointState:
        held = dict(zip(("motor", "load"), self._frozen.position, strict=True))
        return self._changed(**{joint: lambda _p, _v, at=held[joint]: (at, 0.0) for joint in joints})

    def load_freezes(self) -> JointState:
        return self._freeze("load")

    def motor_freezes(self) -> JointState:
        return self._freeze("motor")

    def both_freeze(self) -> JointState:
        return self._freeze("motor", "load")

    def load_jumps(self) -> JointState:
        return self._changed(load=lambda p, v: (p + 0.5, v))

    def motor_jumps(self) -> JointState:
        return self._changed(motor=lambda p, v: (p - 8.0, v))

    def load_counts_backwards(self) -> JointState:
        return self._changed(load=lambda p, v: (2 * self._frozen.position[1] - p, -v))

    def motor_counts_backwards(self) -> JointState:
        return self._changed(motor=lambda p, v: (2 * self._frozen.position[0] - p, -v))

    def both_count_backwards(self) -> JointState:
        message = self._changed(
            motor=lambda p, v: (2 * self._frozen.position[0] - p, -v),
            load=lambda p, v: (2 * self._frozen.position[1] - p, -v),
        )
        message.effort = []
        return message


@pytest.mark.corners(3)
@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        pytest.param(fault, reason, id=fault.replace("_", " "))
        for fault, reason in {
            "load_freezes": "encoders disagree",
            "motor_freezes": "encoders disagree",
            "both_freeze": "unexplained torque",
            "load_jumps": "encoder",
            "motor_jumps": "motor encoder moved",
            "load_counts_backwards": "encoders disagree",
            "motor_counts_backwards": "encoders disagree",
            "both_count_backwards": "unexplained torque",
        }.items()
    ],
)
def test_encoder__0_v__mend_it_and_reset_the_controller(
    start: Start, peer: Peer, measure: Measure, fault: str, reason: str
) -> None:
    """While a step of 1 rad begins."""
    watched = Watched(start, peer)
    drive = watched.drive
    drive.run(5)
    watched.until_zero(getattr(Encoders(drive), fault), measure, 0.2)
    watched.latched(reason)
    watched.recovers()
