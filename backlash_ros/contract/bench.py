"""The bench of the drive contract kit: starts a drive in its own domain, moves it, records its samples."""

import contextlib
import math
import os
import shlex
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rclpy
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from backlash_ros.drive_file.drive_file import Axis, read_axis, read_parameters
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.ros.isolation import isolated
from backlash_ros.ros.messages import stamp_label

START_LIMIT = 60.0
"""Time a drive has from its start to its first sample, s."""

END_LIMIT = 10.0
"""Time a drive has to end after SIGINT or SIGTERM, s."""

REST = 0.3
"""Duration of the command 0 after a move, s."""

REACH = {"voltage": 3.0, "current": 6.0}
"""Travel at which the kit gives up and commands 0, as a multiple of the previous move's, or a lossless motor's.

A sound motor that takes a current coasts at 0 A, after a move and a command timeout, for at most 4.5 travels.
"""

TEST_VALUE = {"voltage": 1.0, "current": 0.05}
"""Default command of the test moves, V or A."""

RATE = 250.0
"""Default rate of the samples, Hz."""

FEWEST = 10
"""Smallest number of samples for judging a stretch."""

_MORE_THAN_A_TURN = 1.05 * 2 * math.pi
"""Travel that passes the angle at which a position begins again, wherever that is, rad."""

ATTEMPTS = 10
"""Attempts at a move if samples are missing for so long that the drive may have missed commands."""


@dataclass(frozen=True)
class Expected:
    """The user's description of the drive: command line, interface, Hz, V or A, names, N m/A, ohm, kg m^2, s."""

    command: str
    interface: str
    rate: float
    value: float
    motor_joint: str
    load_joint: str
    gear_ratio: float
    torque_constant: float
    resistance: float
    inertia: float
    command_timeout: float

    @property
    def joints(self) -> list[str]:
        """The drive's joints, the motor's first."""
        return [name for name in (self.motor_joint, self.load_joint) if name]

    @property
    def takes_current(self) -> bool:
        """Whether a command is a current, which accelerates the motor, and not a voltage, which sets its speed."""
        return self.interface == "current"

    @property
    def unit(self) -> str:
        """Unit of the command."""
        return "A" if self.takes_current else "V"

    @property
    def move(self) -> float:
        """Duration of a move, s."""
        return 0.2 if self.takes_current else 0.4

    @property
    def double_move(self) -> float:
        """Duration of the move at the double command, s: under a current the speed needs time."""
        return self.move if self.takes_current else self.move / 2

    @property
    def starting_torque(self) -> float:
        """Torque of a motor at rest that gets the test command, N m."""
        return self.torque_constant * self.value / (1.0 if self.takes_current else self.resistance)

    def ideal_speed(self, joint: str) -> float:
        """Speed of a motor without losses at the end of a move, at the shaft of ``joint``, rad/s."""
        motor = (
            self.starting_torque * self.move / self.inertia if self.takes_current else self.value / self.torque_constant
        )
        return motor * (1.0 if joint == self.motor_joint else self.gear_ratio)

    def ideal_travel(self, joint: str) -> float:
        """Travel of a motor without losses during a move, at the shaft of ``joint``, rad."""
        return self.ideal_speed(joint) * self.move * (0.5 if self.takes_current else 1.0)


def described(
    files: Sequence[Path],
    command: str,
    *,
    value: float | None,
    command_timeout: float,
    interface: str | None = None,
    rate: float | None = None,
    motor_joint: str | None = None,
    load_joint: str | None = None,
) -> Expected:
    """Return the drive of parameter files, by default the nominal one; what is not None overrides the files.

    Raises
    ------
    OSError, ValueError
        If a file cannot be read or used.
    """
    axis = read_axis(*files) if files else Axis(NOMINAL_DRIVE)
    drive = axis.drive
    interface = interface or drive.command_interface
    return Expected(
        command=command,
        interface=interface,
        rate=rate or (float(read_parameters(*files).get("rate", RATE)) if files else RATE),
        value=value or TEST_VALUE[interface],
        motor_joint=axis.motor_joint if motor_joint is None else motor_joint,
        load_joint=axis.load_joint if load_joint is None else load_joint,
        gear_ratio=drive.gear.ratio,
        torque_constant=drive.motor.torque_constant,
        resistance=drive.motor.resistance,
        inertia=drive.motor.inertia + drive.gear.ratio**2 * drive.load.inertia,
        command_timeout=command_timeout,
    )


@dataclass(frozen=True)
class Motion:
    """One joint during one stretch: s, rad, rad/s and N m, nan if not measured."""

    time: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    effort: NDArray[np.float64]

    @property
    def travel(self) -> float:
        """From the first sample to the last, rad."""
        return float(self.position[-1] - self.position[0])

    def end_speed(self, duration: float = 0.1, before: float = 0.0) -> float:
        """Mean speed over the ``duration`` that ends ``before`` the last sample, from the positions, rad/s."""
        last = max(1, int(np.searchsorted(self.time, self.time[-1] - before)))
        first = min(int(np.searchsorted(self.time, self.time[last] - duration)), last - 1)
        return float((self.position[last] - self.position[first]) / (self.time[last] - self.time[first]))

    def top_speed(self, duration: float = 0.05) -> float:
        """Largest magnitude of the mean speed over ``duration``, from the positions, rad/s."""
        first = np.arange(int(np.searchsorted(self.time, self.time[-1] - duration, side="right")))
        last = np.searchsorted(self.time, self.time[first] + duration)
        return float(
            np.max(np.abs((self.position[last] - self.position[first]) / (self.time[last] - self.time[first])))
        )


@dataclass(frozen=True)
class Recording:
    """Every received sample, and the stretch to which it belongs."""

    messages: list[JointState]
    received: list[int]
    stretches: dict[str, slice]
    reliable: bool

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Header stamps, ns."""
        return np.array([stamp_ns(m.header.stamp) for m in self.messages], dtype=np.int64)

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of each sample, s; by its stamp, or by its arrival if the stamps are wrong, which has its own check."""
        stamps = self.stamps if np.all(np.diff(self.stamps) > 0) else np.array(self.received, dtype=np.int64)
        return np.asarray((stamps - stamps[0]) * 1e-9)

    def motion(self, joint: str, *stretches: str) -> Motion:
        """Return the motion of ``joint`` from the first of the stretches to the last."""
        what = " to ".join(dict.fromkeys((stretches[0], stretches[-1])))
        within = range(self.stretches[stretches[0]].start, self.stretches[stretches[-1]].stop)
        time = self.time
        rows = []
        for k in within:
            message = self.messages[k]
            place = list(message.name).index(joint) if joint in message.name else len(message.position)
            if place < len(message.position):
                fields = (message.position, message.velocity, message.effort)
                rows.append([time[k], *(field[place] if place < len(field) else np.nan for field in fields)])
        if len(rows) < FEWEST:
            pytest.fail(
                f"{len(rows)} positions of joint {joint!r} in {len(within)} samples of stretch {what!r},"
                f" {FEWEST} are needed; the last sample of all names {list(self.messages[-1].name)}"
            )
        return Motion(*np.array(rows).T)


class Bench:
    """A drive in its own process group, and the node that commands and records it."""

    def __init__(self, expected: Expected) -> None:
        self._expected = expected
        self._join()
        self._process = subprocess.Popen(
            shlex.split(expected.command),
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._command: Sequence[float] | None = None
        self._stamped = False
        self._origin = self._reach = math.inf
        self._moved = 0.0
        self.runaway = 0.0
        self.recording = Recording([], [], {}, reliable=True)

    def _join(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("drive_contract", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publisher = self._node.create_publisher(Float64MultiArray, "command", QoSProfile(depth=10))

    def _leave(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _spin_until(self, condition: Callable[[], object], seconds: float) -> bool:
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def _wait(self, what: str, condition: Callable[[], object]) -> None:
        met = self._spin_until(lambda: condition() or self.exit_code is not None, START_LIMIT)
        if self.exit_code is not None:
            pytest.fail(f"the drive ended with code {self.exit_code} while the kit waited for {what}")
        if not met:
            pytest.fail(f"no {what} within {START_LIMIT:g} s of the start of the drive")

    def connect(self) -> None:
        """Wait until the drive publishes and subscribes."""
        topic = self._node.resolve_topic_name("joint_states")

        def heard() -> bool:
            # A new participant announces itself at once, later only every 3 s.
            if not self._spin_until(lambda: self._node.count_publishers(topic), 1.0):
                self._leave()
                self._join()
            return bool(self._node.count_publishers(topic))

        self._wait(f"publisher on {topic}", heard)
        offered = [info.qos_profile.reliability for info in self._node.get_publishers_info_by_topic(topic)]
        reliable = all(policy == ReliabilityPolicy.RELIABLE for policy in offered)
        # A best-effort drive fails its own check, but is received anyway.
        wanted = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        self.recording = Recording([], [], {}, reliable=reliable)
        self._node.create_subscription(
            JointState, "joint_states", self._on_joint_states, QoSProfile(depth=1000, reliability=wanted)
        )
        self._wait(f"sensor_msgs/JointState on {topic}", lambda: self.recording.messages)
        self._wait(
            f"subscription for std_msgs/Float64MultiArray on {self._publisher.topic_name}",
            self._publisher.get_subscription_count,
        )

    def _on_joint_states(self, message: JointState) -> None:
        self.recording.messages.append(message)
        self.recording.received.append(self._node.get_clock().now().nanoseconds)
        travel = abs(self._position() - self._origin)
        if travel > self._reach:
            self.runaway, self._reach, self._command = travel, math.inf, [0.0]
        self._send(message)

    def _send(self, answered: JointState) -> None:
        """Command once, as the controller does on each sample."""
        if self._command is None:
            return
        message = Float64MultiArray(data=self._command)
        if self._stamped:
            label = stamp_label(answered.header.stamp)
            message.layout = MultiArrayLayout(dim=[MultiArrayDimension(label=label, size=len(self._command), stride=1)])
        self._publisher.publish(message)

    def _position(self, back: int = 0) -> float:
        """Position of the first joint ``back`` samples ago, rad; nan if not measured."""
        message = self.recording.messages[-1 - back]
        return float(dict(zip(message.name, message.position, strict=False)).get(self._expected.joints[0], math.nan))

    def hold(
        self,
        stretch: str,
        command: Sequence[float] | None,
        seconds: float,
        *,
        stamped: bool = False,
        set_off: bool = False,
        reach: float = math.inf,
    ) -> None:
        """Answer each sample with ``command`` for a time (None: with silence), and note the stretch.

        ``stamped``: with the sample's stamp in the layout. ``set_off``: the time counts from the first motion, since a
        drive that has just started may not yet receive commands. ``reach``: travel at which the bench gives up and
        commands 0, rad.
        """
        start = len(self.recording.messages)
        self.runaway = 0.0
        self._origin, self._reach = self._position(), reach
        self._command, self._stamped = command, stamped
        if set_off and math.isfinite(self._origin):
            enough = 0.02 * self._expected.ideal_travel(self._expected.joints[0])
            self._spin_until(lambda: abs(self._position() - self._origin) > enough, 5.0)
        self._spin_until(lambda: False, seconds)
        self.recording.stretches[stretch] = slice(start, len(self.recording.messages))

    def move(self, stretch: str, command: Sequence[float], seconds: float, *, stamped: bool = False) -> None:
        """Hold a command; repeat it after a rest if samples were missing: the watchdog may have stopped the motor.

        A motor that accelerates under a current is stopped if it goes too far.
        """
        expected = self._expected
        self._moved = command[0]
        reach = math.inf
        if expected.takes_current:
            size = abs(command[0]) / expected.value
            reach = REACH[expected.interface] * size * expected.ideal_travel(expected.joints[0])
        for _ in range(ATTEMPTS):
            self.hold(stretch, command, seconds, stamped=stamped, set_off=True, reach=reach)
            if not self.stalled(stretch):
                return
            self.rest("rest before another attempt")

    def turn(self, stretch: str) -> None:
        """Turn each joint by more than a turn, at about the speed of a move; give up after four times what it takes."""
        expected = self._expected
        start = done = len(self.recording.messages)
        ways = dict.fromkeys(expected.joints, 0.0)
        slowest = min(expected.ideal_speed(joint) for joint in ways)
        samples = max(1, round(0.05 * expected.rate))

        def far() -> bool:
            nonlocal done
            messages = self.recording.messages
            for before, after in pairwise(messages[max(done - 1, 0) :]):
                for joint in ways:
                    then, now = (
                        dict(zip(m.name, m.position, strict=False)).get(joint, math.nan) for m in (before, after)
                    )
                    if abs(now - then) < math.pi:
                        ways[joint] += now - then
            done = len(messages)
            speed = (self._position() - self._position(min(samples, done - 1))) * expected.rate / samples
            self._command = [expected.value if abs(speed) < expected.ideal_speed(expected.joints[0]) else 0.0]
            return all(abs(way) > _MORE_THAN_A_TURN for way in ways.values())

        self._stamped, self._reach, self._moved = False, math.inf, expected.value
        self._spin_until(far, 2.0 + 4.0 * _MORE_THAN_A_TURN / slowest)
        self.recording.stretches[stretch] = slice(start, len(self.recording.messages))

    def stalled(self, stretch: str) -> bool:
        """Whether samples were missing, from just before the stretch on, for so long that commands may be missing."""
        within = self.recording.stretches[stretch]
        arrivals = self.recording.received[max(0, within.start - 1) : within.stop]
        return len(arrivals) > 2 and bool(np.max(np.diff(arrivals)) * 1e-9 >= 0.5 * self._expected.command_timeout)

    def rest(self, stretch: str) -> None:
        """Command 0 after a move, then remove the remaining motion."""
        self.hold(stretch, [0.0], REST)
        self.brake()

    def brake(self) -> None:
        """Drive a motor that coasts at 0 A against its motion until it reverses, at most for two moves."""
        samples = max(1, round(0.02 * self._expected.rate))
        if not self._expected.takes_current or len(self.recording.messages) <= samples:
            return
        way = self._position() - self._position(samples)
        if way:
            self._command = [-self._moved]
            self._stamped, self._reach = False, math.inf
            self._spin_until(lambda: (self._position() - self._position(samples)) * way <= 0, 2 * self._expected.move)
        self._command = [0.0]

    @property
    def exit_code(self) -> int | None:
        """Exit code of the drive's process, None while it runs."""
        return self._process.poll()

    def end(self, number: signal.Signals) -> bool:
        """Send a signal to the drive's process group; return whether it ended in time."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)
        return self._spin_until(lambda: self.exit_code is not None, END_LIMIT)

    def close(self) -> None:
        """Command 0 and end the drive in any case."""
        self._command, self._reach = [0.0], math.inf
        self._publisher.publish(Float64MultiArray(data=self._command))
        if self.exit_code is None:
            self._spin_until(lambda: False, 0.05)
            self.end(signal.SIGINT)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._leave()


@contextlib.contextmanager
def running(expected: Expected) -> Iterator[Bench]:
    """Start the drive on a bench, and end it afterwards: the next one may need the same machine."""
    with isolated():
        bench = Bench(expected)
        try:
            bench.connect()
            yield bench
        finally:
            bench.close()
