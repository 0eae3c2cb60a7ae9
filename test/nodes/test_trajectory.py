"""Trajectories over DDS: two axes follow one message from the same sample on, refuse what they cannot, and hold."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Duration, Time
from graph import Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from backlash_ros.control.motion.setpoint import evaluate
from backlash_ros.control.motion.trajectory import Trajectory
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, Setpoint

Start = Callable[..., Process]
AXES = "shoulder", "elbow"
SIX = (*AXES, "wrist_1", "wrist_2", "wrist_3", "gripper")
TIMES = 0.4, 0.8, 1.2
PATHS = {
    "shoulder": np.array([[0.2, 1.0, 0.0], [0.6, 1.0, 0.0], [0.8, 0.0, 0.0]]),
    "elbow": np.array([[-0.1, 0.0, 0.0], [0.3, 1.0, 0.0], [0.5, 0.0, 0.0]]),
}
PATHS |= {axis: PATHS["shoulder"] / (k + 2) for k, axis in enumerate(SIX[2:])}
B = NOMINAL_DRIVE.gear.backlash_angle


class Axes:
    """Some axes in lockstep, with joints of their own names and one topic for trajectories."""

    def __init__(
        self, start: Start, peer: Peer, folder: Path, names: tuple[str, ...] = AXES, **parameters: object
    ) -> None:
        self.peer, self.names = peer, names
        self.loads: dict[str, dict[int, float]] = {axis: {} for axis in names}
        self.newest = dict.fromkeys(names, 0)
        node, deep = peer.node, QoSProfile(depth=100_000)
        for axis in names:
            node.create_subscription(JointState, f"{axis}/joint_states", lambda m, a=axis: self._on_state(a, m), deep)
        self.sent = node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        self.scaling = node.create_publisher(Float32, "speed_scaling", 10)
        self.holds = {axis: node.create_client(Trigger, f"{axis}/controller/hold") for axis in names}
        file = folder / "axes.yaml"
        joints = {axis: {"motor_joint": f"{axis}_motor", "load_joint": axis} for axis in names}
        told = {"backlash_angle": B, "identified": True, "state_timeout": 10.0, **parameters}
        file.write_text(
            json.dumps(
                {f"/{axis}/controller": {"ros__parameters": own | told} for axis, own in joints.items()}
                | {f"/{axis}/plant_simulator": {"ros__parameters": own} for axis, own in joints.items()}
            )
        )
        deepened = {f"qos_overrides./{axis}/joint_states.publisher.depth": 10_000 for axis in names}
        self.controller = start(
            "controller",
            *("--params-file", str(file), "-r", "joint_trajectory:=/joint_trajectory"),
            *("-r", "speed_scaling:=/speed_scaling"),
            non_ros=["--axes", *names],
            use_sim_time=True,
        )
        peer.wait("the controllers", lambda: self.sent.get_subscription_count() == len(names))
        start(
            "plant_simulator",
            *("--params-file", str(file)),
            non_ros=["--axes", *names],
            lockstep=True,
            real_time_factor=0.0,
            **deepened,
        )
        self.run_until(0.2)

    def _on_state(self, axis: str, message: JointState) -> None:
        stamp = stamp_ns(message.header.stamp)
        self.loads[axis][stamp] = message.position[message.name.index(axis)]
        self.newest[axis] = max(self.newest[axis], stamp)

    @property
    def time(self) -> float:
        """Stamp of the newest sample of every axis, s."""
        return 1e-9 * min(self.newest.values())

    def run_until(self, time: float) -> None:
        self.peer.wait("simulated time", lambda: self.time > time)

    def send(
        self, start: float = 0.0, names: tuple[str, ...] = (), last_speed: float = 0.0, slower: float = 1.0
    ) -> None:
        names = names or self.names
        message = JointTrajectory(joint_names=list(names))
        message.header.stamp = Time(sec=int(start), nanosec=round(1e9 * (start % 1)))
        for k, time in enumerate(TIMES):
            states = np.array([PATHS[axis][k] for axis in names])
            if k == len(TIMES) - 1:
                states[:, 1] = last_speed
            states /= [1.0, slower, slower**2]
            time *= slower  # noqa: PLW2901
            due = Duration(sec=int(time), nanosec=round(1e9 * (time % 1)))
            message.points.append(
                JointTrajectoryPoint(
                    positions=states[:, 0], velocities=states[:, 1], accelerations=states[:, 2], time_from_start=due
                )
            )
        self.sent.publish(message)

    def path(self, axis: str) -> tuple[Array, Array]:
        """Return the times of the samples, s, and the load's angles, rad."""
        stamps = sorted(self.loads[axis])
        return 1e-9 * np.array(stamps), np.array([self.loads[axis][stamp] for stamp in stamps])


def wanted(axis: str, since: Array) -> Array:
    """Return where the load is to be so many seconds after the start, at the path's own speed."""
    rows = Trajectory(np.array(TIMES), PATHS[axis]).segments(Setpoint(np.zeros(3)))
    out, positions = Setpoint(np.zeros(3)), np.zeros(since.size)
    for k, time in enumerate(since):
        evaluate(rows, max(time, 0.0), out)
        positions[k] = out[POSITION]
    return positions


def test_axes_follow_one_message_from_the_same_stamp_on(start: Start, peer: Peer, tmp_path: Path) -> None:
    axes = Axes(start, peer, tmp_path)
    begins = float(np.ceil(axes.time)) + 10.0  # far more than the message takes: the machine may be busy
    axes.send(begins)
    axes.run_until(begins + TIMES[-1] + 0.5)
    for axis in AXES:
        times, loads = axes.path(axis)
        bridged = np.array(wanted(axis, times - begins))
        after = times - begins > TIMES[0]  # before, it goes to the first point from when the message came
        assert np.max(np.abs(loads - bridged)[after]) < B, axis
        assert abs(loads[-1] - PATHS[axis][-1, 0]) < 0.25 * B, axis
    assert "refused" not in axes.controller.output()


def test_what_cannot_be_followed_is_refused_and_changes_nothing(start: Start, peer: Peer, tmp_path: Path) -> None:
    """Each with its reason, however soon after another; a message for one axis is followed by that alone."""
    axes = Axes(start, peer, tmp_path)
    axes.send(last_speed=0.5)
    axes.send(names=("elbow",), last_speed=0.5)
    for axis, text in (
        ("elbow", "joint_trajectory is refused: velocities of the last point must be 0 rad/s, got 0.5"),
        ("shoulder", "joint_trajectory is refused: joint_names must contain 'shoulder', got ['elbow']"),
    ):
        said = f"[{axis}.controller]: {text}"
        peer.wait("the refusal", lambda said=said: said in axes.controller.output())
    axes.run_until(axes.time + 1.0)
    for axis in AXES:
        assert np.ptp(axes.path(axis)[1]) < B
    axes.send(names=("elbow",))
    peer.wait("the motion", lambda: axes.path("elbow")[1][-1] > 0.4)
    assert np.ptp(axes.path("shoulder")[1]) < B


def test_hold_ends_a_trajectory_at_rest(start: Start, peer: Peer, tmp_path: Path) -> None:
    axes = Axes(start, peer, tmp_path)
    axes.send()
    peer.wait("the motion", lambda: axes.path("shoulder")[1][-1] > 0.1)
    answers = {axis: client.call_async(Trigger.Request()) for axis, client in axes.holds.items()}
    peer.wait("the answers", lambda: all(future.done() for future in answers.values()))
    assert all(future.result().success for future in answers.values())
    held = {axis: float(future.result().message.split()[4]) for axis, future in answers.items()}
    assert held["shoulder"] < 0.8
    axes.run_until(axes.time + 1.0)
    for axis in AXES:
        assert abs(axes.path(axis)[1][-1] - held[axis]) < 0.25 * B, axis


def test_a_trajectory_stands_still_and_goes_on_by_speed_scaling(start: Start, peer: Peer, tmp_path: Path) -> None:
    axes = Axes(start, peer, tmp_path)

    def says(text: str) -> None:
        for axis in AXES:
            peer.wait(text, lambda axis=axis: f"[{axis}.controller]: {text}" in axes.controller.output())

    axes.send()
    peer.wait("the motion", lambda: axes.path("shoulder")[1][-1] > 0.1)
    axes.scaling.publish(Float32(data=30.0))
    says("speed_scaling must be a share from 0 to 1, got 30")
    axes.send(slower=20.0)
    axes.scaling.publish(Float32(data=0.0))
    says("follows a trajectory at 0 of its speed by speed_scaling")
    axes.run_until(axes.time + 1.0)
    since = axes.time
    axes.run_until(since + 1.0)
    for axis in AXES:
        times, loads = axes.path(axis)
        assert np.ptp(loads[times > since]) < 0.25 * B, axis
    axes.scaling.publish(Float32(data=1.0))
    peer.wait("the end", lambda: all(abs(axes.path(axis)[1][-1] - PATHS[axis][-1, 0]) < 0.25 * B for axis in AXES))


def test_where_one_of_six_axes_of_a_group_fails_the_others_come_to_rest_until_it_is_reset(
    start: Start, peer: Peer, tmp_path: Path
) -> None:
    """All begin at the same stamp."""
    axes = Axes(start, peer, tmp_path, SIX, group="arm")
    elbow = Parameters(peer, "elbow/plant_simulator")

    def says(axis: str, text: str) -> None:
        peer.wait(text, lambda: f"[{axis}.controller]: {text}" in axes.controller.output())

    begins, slower = float(np.ceil(axes.time)) + 10.0, 20.0
    axes.send(begins, slower=slower)
    axes.run_until(begins + slower * TIMES[0] + 1.0)
    for axis in SIX:
        times, loads = axes.path(axis)
        after = times - begins > slower * TIMES[0]
        assert np.max(np.abs(loads - wanted(axis, (times - begins) / slower))[after]) < B, axis
    assert elbow.set(sensors__load_offset=0.5)[0]
    says("elbow", "ENCODERS_DISAGREE")
    barred = "follows nothing while /elbow/controller of group 'arm' has the fault ENCODERS_DISAGREE"
    others = [axis for axis in SIX if axis != "elbow"]
    for axis in others:
        says(axis, f"comes to rest, and {barred}")
    axes.run_until(axes.time + 1.0)
    at_rest = axes.time
    held = axes.path("shoulder")[1][-1]
    assert held < 0.7
    axes.send(names=("shoulder",))
    says("shoulder", f"joint_trajectory is refused: reference 0.8 rad came {barred.removeprefix('follows nothing ')}")
    axes.run_until(axes.time + 1.0)
    for axis in others:
        times, loads = axes.path(axis)
        assert np.ptp(loads[times > at_rest]) < 0.25 * B, axis
    assert elbow.set(sensors__load_offset=0.0)[0]
    assert peer.call(Trigger, "elbow/controller/reset_fault", Trigger.Request()).success
    says("shoulder", "all axes of group 'arm' can move")
    axes.run_until(axes.time + 1.0)
    assert abs(axes.path("shoulder")[1][-1] - held) < 0.25 * B  # nothing moves by itself
    axes.send()
    peer.wait("the motion", lambda: axes.path("shoulder")[1][-1] > held + 0.1)
    axes.run_until(axes.time + 2.0)
    learn = peer.node.create_client(Trigger, "shoulder/controller/learn").call_async(Trigger.Request())
    says("shoulder", "learning the backlash")
    assert elbow.set(sensors__load_offset=0.5)[0]
    peer.wait("the end of learning", learn.done)
    assert not learn.result().success
    assert barred.removeprefix("follows nothing ") in learn.result().message


def test_an_axis_of_a_group_that_ends_without_a_word_is_missed(start: Start, peer: Peer) -> None:
    alone, other = (start("controller", "-r", f"__ns:=/{name}", group="arm") for name in ("a", "b"))
    said, b = "of group 'arm'", Lifecycle(peer, "b/controller")

    def says(text: str, times: int = 1) -> None:
        peer.wait(text, lambda: alone.output().count(text) >= times)

    peer.wait("b", lambda: b.state == "active")
    assert b.change(Transition.TRANSITION_DEACTIVATE)
    says(f"follows nothing while /b/controller {said} is not active")
    before = alone.output().count("can move")
    assert b.change(Transition.TRANSITION_ACTIVATE)
    says("can move", before + 1)
    other.kill()
    says(f"follows nothing while 1 of 2 axes {said} do not answer: call reset_fault to go on without")
    refused = peer.call(Trigger, "a/controller/learn", Trigger.Request())
    assert refused.message.startswith(f"cannot learn while 1 of 2 axes {said} do not answer")
    assert peer.call(Trigger, "a/controller/reset_fault", Trigger.Request()).success
    says("can move", before + 2)
