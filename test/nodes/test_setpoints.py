"""A stream of setpoints over DDS, in lockstep: followed as one path, stopped where it ends, and never a leap."""

import math
from collections.abc import Callable

import numpy as np
from graph import Peer, Process
from lockstep_drive import LockstepDrive
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.foundation.record import Array
from backlash_ros.ros.topics import TRANSIENT_LOCAL

Start = Callable[..., Process]
B = NOMINAL_DRIVE.gear.backlash_angle
INTERVAL, TIMEOUT = 0.01, 0.1
W = math.pi  # rad/s: 0.5 Hz


def wanted(time: float) -> list[float]:
    """Return position, velocity and acceleration of a sine of 0.5 rad that begins at rest."""
    return [0.5 * (1.0 - math.cos(W * time)), 0.5 * W * math.sin(W * time), 0.5 * W * W * math.cos(W * time)]


class Planner:
    """Who plans elsewhere: it sends setpoints to a drive in lockstep, whose stamps are the time."""

    def __init__(self, start: Start, peer: Peer) -> None:
        self.peer, self.drive = peer, LockstepDrive(peer)
        self.sent = peer.node.create_publisher(JointTrajectory, "setpoint", 10)
        self.words: list[str] = []
        peer.node.create_subscription(
            String, "controller/in_position", lambda message: self.words.append(message.data), TRANSIENT_LOCAL
        )
        self.node = start(
            "controller",
            use_sim_time=True,
            state_timeout=10.0,
            backlash_angle=B,
            identified=True,
            setpoint_timeout=TIMEOUT,
        )
        self.drive.matched()
        peer.wait("the topic", lambda: self.sent.get_subscription_count() > 0)
        self.drive.run(50)

    @property
    def now(self) -> float:
        return 1e-9 * stamp_ns(self.drive.sample().header.stamp)

    def send(self, time: float, state: list[float], **changes: object) -> None:
        """Send a setpoint of ``time``, s."""
        point = JointTrajectoryPoint(positions=state[:1], velocities=state[1:2], accelerations=state[2:])
        message = JointTrajectory(joint_names=["load"], points=[point])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(1e9 * time), 10**9)
        for field, value in changes.items():
            setattr(message, field, value)
        self.sent.publish(message)

    def stream(self, seconds: float, between: Callable[[float, int], None] | None = None) -> tuple[Array, Array]:
        """Send the sine for so long; return the times, s from its start, and where the load is."""
        begins, sent, seen = self.now, 0, []
        while (time := self.now - begins) < seconds:
            while sent * INTERVAL <= time + 1e-6:
                self.send(begins + sent * INTERVAL, wanted(sent * INTERVAL))
                if between:
                    between(begins + sent * INTERVAL, sent)
                sent += 1
            seen.append((time, self.drive.load_angle))
            self.drive.step()
        times, loads = np.array(seen).T
        return times, loads

    @property
    def delay(self) -> float:
        return float(self.node.output().split("follows setpoints ")[1].split()[0])


def test_a_stream_is_followed_and_where_it_ends_the_load_stops(start: Start, peer: Peer) -> None:
    planner = Planner(start, peer)
    times, loads = planner.stream(3.4)
    late = times - planner.delay
    path = np.array([wanted(max(time, 0.0))[0] for time in late])
    assert np.max(np.abs(loads - path)) < 0.1 * B
    assert wanted(float(late[-1]))[1] < -1.0  # it moves as the stream ends
    after = planner.drive.run(250)
    peer.wait("the stop", lambda: "comes to rest" in planner.node.output())
    rest = float(planner.node.output().split("comes to rest at ")[1].split()[0])
    assert np.max(np.abs(np.diff(after))) < 1.1 * 0.5 * W * planner.drive.period
    assert rest < loads[-1] - 0.1
    assert abs(after[-1] - rest) < 0.25 * B
    peer.wait("the word", lambda: planner.words[-1] == "holding")


def test_what_is_refused_changes_nothing(start: Start, peer: Peer) -> None:
    """A first setpoint far away, and one of each kind of bad one for each good one that is followed."""
    planner = Planner(start, peer)
    held = planner.drive.load_angle
    planner.send(planner.now, [1.0, 0.0])
    assert np.ptp(planner.drive.run(100)) < 0.1 * B
    assert "setpoint is refused: the first one must be within 0.05 rad of the setpoint in use" in planner.node.output()
    node = planner.node
    bad: list[Callable[[float], None]] = [
        lambda time: planner.send(time + 0.001, wanted(0.0), joint_names=["elbow"]),
        lambda time: planner.send(time + 0.001, wanted(0.0), joint_names=["load", "load"]),
        lambda time: planner.send(time + 0.001, wanted(0.0), points=[]),
        lambda time: planner.send(time + 0.001, [math.nan, 0.0]),
        lambda time: planner.send(time + 0.001, [0.0, math.inf]),
        lambda time: planner.send(time + 0.001, [0.0]),
        lambda time: planner.send(time + 0.001, [-1.0, 0.0, 0.0]),
        lambda time: planner.send(time + 0.001, [0.2, 1000.0, 0.0]),
        lambda time: planner.send(time - 0.005, wanted(0.0)),
        lambda time: planner.send(time + 10.0, wanted(0.0)),
        lambda _time: planner.send(0.0, wanted(0.0)),
    ]
    times, loads = planner.stream(1.5, lambda time, k: bad[k % len(bad)](time) if k else None)
    path = np.array([held + wanted(max(time - planner.delay, 0.0))[0] for time in times])
    assert np.max(np.abs(loads - path)) < 0.1 * B
    assert "latched" not in node.output()


def test_hold_ends_a_stream_that_goes_on(start: Start, peer: Peer) -> None:
    planner = Planner(start, peer)
    hold = peer.node.create_client(Trigger, "controller/hold")
    peer.wait("the service", hold.service_is_ready)
    asked = []
    times, loads = planner.stream(
        1.4, lambda _time, k: asked.append(hold.call_async(Trigger.Request())) if k == 50 else None
    )
    peer.wait("the answer", asked[0].done)
    rest = float(asked[0].result().message.split()[4])
    assert rest < 0.6
    assert np.all(np.abs(loads[times > 1.0] - rest) < 0.25 * B)
    assert "another one begins after a pause of 0.1 s" in planner.node.output()
