"""A drive made by the test, in lockstep: it sends a sample, waits for the answer, and only then goes on."""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from graph import Peer
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive, Plant
from backlash_ros.foundation.messages import answered_sample, stamp_ns
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.simulation import SimulatedDrive

_CLOCK_START = 1_000_000_000
_LONGEST, _PATIENCE = 50_000, 600.0
"""Periods and time, s, after which nothing is waited for any more: an experiment, and the processes that compute it."""


class LockstepDrive:
    """A simulated plant behind the topics of a drive, stepped by the controller's answers.

    Time stamps are the simulation's, so that nothing depends on how fast the machine is. A ``simulated`` drive, with
    sensors and delay, takes the place of the plant that shows all of its state at once; it may not measure the current.
    """

    def __init__(
        self, peer: Peer, rate: float = 250.0, drive: Drive = NOMINAL_DRIVE, simulated: SimulatedDrive | None = None
    ) -> None:
        self.peer = peer
        self.simulated = simulated
        self.period = 1.0 / rate
        self.plant = Plant(drive)
        self.load_torque = 0.0
        self.tick = 0
        self.commands: list[float] = []
        node = peer.node
        self._states = node.create_publisher(JointState, "joint_states", QoSProfile(depth=10))
        self._reference = node.create_publisher(Float64, "reference", QoSProfile(depth=10))
        node.create_subscription(Float64MultiArray, "command", self._on_command, QoSProfile(depth=100))
        self.answers: dict[int | None, float] = {}

    def _on_command(self, message: Float64MultiArray) -> None:
        self.commands.append(message.data[0])
        self.answers[answered_sample(message)] = message.data[0]

    def matched(self) -> "LockstepDrive":
        """Send the sample at rest, which changes nothing, until the controller answers."""
        self.peer.wait("the controller", lambda: self._states.get_subscription_count() > 0)
        self.peer.wait("the controller", lambda: self._reference.get_subscription_count() > 0)
        self.commands.clear()

        def answered() -> bool:
            self._states.publish(self.sample())
            self.tick += 1
            self.peer.spin(0.05)
            return bool(self.commands)

        publishers = partial(self.peer.node.count_publishers, "command")
        self.peer.wait(lambda: f"the controller to answer; publishers of command found: {publishers()}", answered)
        self.peer.wait("late answers", self._quiet)
        return self

    def _quiet(self) -> bool:
        """Whether nothing has come for a while."""
        before = len(self.commands)
        self.peer.spin(0.2)
        return len(self.commands) == before

    def sample(self, **changes: Any) -> JointState:
        """Return the present joint states, with fields replaced by ``changes``."""
        plant, message = self.plant, JointState()
        stamp = _CLOCK_START + round(self.tick * self.period * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        message.name = ["motor", "load"]
        message.position = [plant.motor_angle, plant.load_angle]
        message.velocity = [plant.motor_speed, plant.load_speed]
        message.effort = [plant.motor_torque, plant.gear_torque]
        if self.simulated is not None:
            motor, motor_speed, load, load_speed, current = self.simulated.sample().tolist()
            assert math.isnan(current)
            joints = ("motor", motor, motor_speed), ("load", load, load_speed)
            present = [joint for joint in joints if not math.isnan(joint[1])]
            message.name, message.position, message.velocity = (list(each) for each in zip(*present, strict=True))
            message.effort = []
        for field, value in changes.items():
            setattr(message, field, value)
        return message

    def exchange(self, message: JointState) -> float:
        """Send one sample, again while it may have been lost, and return the command that answers it."""
        self.commands.clear()
        self.tick += 1
        sample, due = stamp_ns(message.header.stamp), 0.0
        self.answers.pop(sample, None)

        def answered() -> bool:
            nonlocal due
            if time.monotonic() >= due:
                self._states.publish(message)
                due = time.monotonic() + 2.0
            return sample in self.answers

        self.peer.wait("a command", answered)
        return self.answers[sample]

    def stand_at(self, motor_angle: float, load_angle: float) -> "LockstepDrive":
        """Put the shafts at angles (rad), each its own, where they stand."""
        self.plant = Plant(self.plant.drive, [motor_angle, 0.0, load_angle, 0.0, 0.0])
        return self

    def set_reference(self, target: float, *, move: bool = True) -> None:
        """Send a reference while at rest, wait until it is answered, and make that period where it may ``move``."""
        at_rest = self.exchange(self.sample())
        self._reference.publish(Float64(data=target))
        voltage = self.peer.wait("the reference to arrive", lambda: self._changed(at_rest))
        if move:
            self._advance(voltage)

    def _advance(self, command: float) -> None:
        if self.simulated is None:
            self.plant.advance(command, self.load_torque, self.period)
        else:
            self.simulated.advance(command, self.load_torque)

    @property
    def load_angle(self) -> float:
        """Where the load is, whatever is measured, rad."""
        return self.plant.load_angle if self.simulated is None else float(self.simulated.state[THETA_L])

    def _changed(self, before: float) -> float | None:
        voltage = self.exchange(self.sample())
        return voltage if voltage != before else None

    def step(self) -> float:
        """One whole period: sample, answer, motion."""
        voltage = self.exchange(self.sample())
        self._advance(voltage)
        return voltage

    def until(self, condition: Callable[[], bool]) -> None:
        """Make periods until ``condition`` holds, such as that of a request which is answered.

        Slowly where it rests for long: there is a fit to be waited for, which needs the core.
        """
        last, end = self.tick + _LONGEST, time.monotonic() + _PATIENCE
        command, rests = math.nan, 0.0
        while not condition():
            late = self.tick > last and time.monotonic() > end
            assert not late, f"waited {_LONGEST} periods and {_PATIENCE:g} s"
            before, command = command, self.step()
            rests = rests + self.period if abs(command - before) < 1e-3 else 0.0
            if rests > 1.0:
                time.sleep(5.0 * self.period)

    def call(self, service: str) -> Trigger.Response:
        """Ask for a service of the controller, and make periods until there is an answer."""
        asked = self.peer.request(service)
        self.until(asked.done)
        return asked.result()

    def run(self, count: int) -> np.ndarray:
        """Make ``count`` periods; return the load angle after each, shape (count,)."""
        angles = np.full(count, math.nan)
        for k in range(count):
            self.step()
            angles[k] = self.load_angle
        return angles

    def follows(self, target: float) -> bool:
        """Send a reference and make periods until the load is there; return whether it comes there."""
        self._reference.publish(Float64(data=target))
        return any(abs(self.run(1)[0] - target) < 0.02 for _ in range(3000))
