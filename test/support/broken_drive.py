"""A simulated drive that breaks the contract in one way, ``--defect NAME``, or in none.

It imports nothing of the package, whose compiled plant takes longer to load than the kit looks at most of these.
"""

import argparse
import contextlib
import math
import os
import signal
import sys
import time

import rclpy
from builtin_interfaces.msg import Time as Stamp
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

RATE = 100.0
COMMAND_TIMEOUT = 0.1
TORQUE_CONSTANT, RESISTANCE = 0.05, 2.0
INERTIA, FRICTION = 2.5e-5, 7e-5  # of motor and load, at the motor's shaft
RATIO, BACKLASH = 0.1, 0.02
VALUE = {"voltage": 1.0, "current": 0.05}
FULL = {"voltage": 24.0, "current": 12.0}
DEFECTS = {
    "none": "keeps the contract",
    "best_effort": "offers joint_states best effort only",
    "wrong_names": "calls the joints by other names",
    "motor_twice": "names the motor's joint twice",
    "missing_positions": "names two joints and gives one position",
    "missing_velocities": "names two joints and gives one velocity",
    "missing_efforts": "names two joints and gives one effort",
    "nan_in_states": "publishes NaN for a velocity now and then",
    "half_rate": "publishes every other sample",
    "drops_samples": "leaves out every fifth sample",
    "bursts": "publishes at twice the rate, half of the time",
    "extra_samples": "puts a sample between every second and third",
    "double_publishing": "publishes every sample twice",
    "frozen_stamps": "stamps every sample with its start",
    "stamps_backward": "stamps some samples earlier than the one before",
    "stamps_since_start": "stamps with the time since its start instead of the ROS clock",
    "stamps_ahead": "stamps with a time to come",
    "creeps": "turns at 0",
    "sign_flipped": "turns back on a positive command",
    "load_sign_flipped": "counts the load's angle the other way",
    "load_before_gear": "measures the load at the motor's shaft",
    "degrees": "gives positions and velocities in degrees",
    "revolutions": "gives positions and velocities in revolutions",
    "load_wraps": "gives the load's position between -pi and pi",
    "velocity_in_rpm": "gives velocities in revolutions per minute",
    "effort_in_amperes": "gives the motor's current as effort",
    "effort_sign_flipped": "gives the torque on the motor's housing",
    "bang_bang": "takes the sign of the command for a fixed one",
    "holds_at_zero": "keeps the last command that is not 0",
    "strict_length": "ignores commands of more than one element",
    "no_watchdog": "keeps the command when commands stop",
    "keeps_voltage_on_nan": "keeps the command at one that is not finite",
    "spreads_nan": "publishes NaN velocities after a command that is not finite",
    "full_voltage_on_inf": "clips an infinite command to the largest",
    "dies_on_empty_command": "ends at a command without elements",
    "ignores_sigterm": "goes on at SIGTERM",
    "leaves_child": "ends at SIGTERM, its child goes on",
}
MISSING = {"missing_positions": "position", "missing_velocities": "velocity", "missing_efforts": "effort"}
LOAD = {"load_sign_flipped": -1.0, "load_before_gear": 1.0 / RATIO}
RADIAN = {"degrees": 180 / math.pi, "revolutions": 0.5 / math.pi}


class Servo:
    """About the nominal drive: a motor with the load's inertia and friction on its shaft, the load with play."""

    def __init__(self, interface: str) -> None:
        self._takes_current = interface == "current"
        self.motor_angle = self.motor_speed = self.motor_torque = self.load_angle = self.load_speed = 0.0

    def advance(self, command: float, duration: float) -> None:
        """Solve J w' = K i - B w, where i is the command or (command - K w)/R."""
        gain = TORQUE_CONSTANT if self._takes_current else TORQUE_CONSTANT / RESISTANCE
        back_emf = 0.0 if self._takes_current else TORQUE_CONSTANT * gain
        time_constant = INERTIA / (FRICTION + back_emf)
        final_speed = gain * command / (FRICTION + back_emf)
        share = -math.expm1(-duration / time_constant)
        above = self.motor_speed - final_speed
        self.motor_angle += final_speed * duration + above * time_constant * share
        self.motor_speed -= above * share
        self.motor_torque = gain * command - back_emf * self.motor_speed
        low, high = RATIO * self.motor_angle - BACKLASH / 2, RATIO * self.motor_angle + BACKLASH / 2
        before, self.load_angle = self.load_angle, min(max(self.load_angle, low), high)
        self.load_speed = (self.load_angle - before) / duration


class BrokenDrive(Node):
    """The servo behind the topics of a drive; the load's effort is not measured."""

    def __init__(self, defect: str, interface: str) -> None:
        super().__init__("broken_drive")
        self._defect = defect
        self._servo = Servo(interface)
        self._one, self._full = VALUE[interface], FULL[interface]
        self._creep = 0.3 * self._one if defect == "creeps" else 0.0
        self._command = self._creep
        self._last_command = time.monotonic()
        self._start = self._now = self.get_clock().now()
        self._periods = 0
        self._rate = 2 * RATE if defect in ("bursts", "extra_samples") else RATE
        self._spreads_nan = False
        send = QoSProfile(depth=10)
        if defect == "best_effort":
            send.reliability = ReliabilityPolicy.BEST_EFFORT
        self._publisher = self.create_publisher(JointState, "joint_states", send)
        receive = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Float64MultiArray, "command", self._on_command, receive)
        self.create_timer(1 / self._rate, self._step)

    def _on_command(self, message: Float64MultiArray) -> None:
        defect = self._defect
        if not message.data and defect == "dies_on_empty_command":
            sys.exit(1)
        if len(message.data) > 1 and defect == "strict_length":
            return
        self._last_command = time.monotonic()
        value = message.data[0] if message.data else 0.0
        if not math.isfinite(value):
            self._spreads_nan = defect == "spreads_nan"
            if defect == "keeps_voltage_on_nan":
                return
            value = math.copysign(self._full, value) if math.isinf(value) and defect == "full_voltage_on_inf" else 0.0
        if defect == "sign_flipped":
            value = -value
        if defect == "bang_bang" and value:
            value = math.copysign(self._one, value)
        if defect == "holds_at_zero" and not value:
            return
        self._command = value or self._creep

    def _step(self) -> None:
        if self._defect != "no_watchdog" and time.monotonic() - self._last_command > COMMAND_TIMEOUT:
            self._command = 0.0
        # The servo goes by the stamps, however late the timer is; late periods bring no extra samples.
        before, self._now = self._now, self.get_clock().now()
        self._servo.advance(self._command, max(1, (self._now - before).nanoseconds) * 1e-9)
        due = max(1, round((self._now - self._start).nanoseconds * 1e-9 * self._rate) - self._periods)
        self._periods += due
        if self._defect == "half_rate" and self._periods % 2:
            return
        if self._defect == "drops_samples" and self._periods % 5 == 0:
            return
        if self._defect == "bursts" and self._periods % 6 >= 3:
            return
        if self._defect == "extra_samples" and self._periods % 5 in (1, 3):
            return
        message = self._sample()
        self._publisher.publish(message)
        if self._defect == "double_publishing":
            self._publisher.publish(message)

    def _stamp(self) -> Stamp:
        defect, now = self._defect, self._now
        if defect == "frozen_stamps":
            now = self._start
        elif defect == "stamps_backward" and self._periods % 25 == 0:
            now -= Duration(seconds=0.02)
        elif defect == "stamps_since_start":
            now = Time(nanoseconds=(now - self._start).nanoseconds)
        elif defect == "stamps_ahead":
            now += Duration(seconds=1.0)
        return now.to_msg()

    def _sample(self) -> JointState:
        servo, defect = self._servo, self._defect
        message = JointState(name=["motor", "load"])
        message.header.stamp = self._stamp()
        message.position = [servo.motor_angle, servo.load_angle]
        message.velocity = [servo.motor_speed, servo.load_speed]
        message.effort = [servo.motor_torque, math.nan]
        if defect == "wrong_names":
            message.name = ["joint1", "joint2"]
        elif defect == "motor_twice":
            for values in (message.name, message.position, message.velocity, message.effort):
                values.append(values[0])
        elif defect in MISSING:
            setattr(message, MISSING[defect], getattr(message, MISSING[defect])[:1])
        elif defect == "nan_in_states" and self._periods % 50 == 0:
            message.velocity[0] = math.nan
        elif defect in LOAD:
            message.position[1], message.velocity[1] = LOAD[defect] * servo.load_angle, LOAD[defect] * servo.load_speed
        elif defect in RADIAN:
            message.position = [angle * RADIAN[defect] for angle in message.position]
            message.velocity = [speed * RADIAN[defect] for speed in message.velocity]
        elif defect == "load_wraps":
            message.position[1] = (servo.load_angle + math.pi) % (2 * math.pi) - math.pi
        elif defect == "velocity_in_rpm":
            message.velocity = [speed * 30 / math.pi for speed in message.velocity]
        elif defect == "effort_in_amperes":
            message.effort[0] /= TORQUE_CONSTANT
        elif defect == "effort_sign_flipped":
            message.effort[0] *= -1
        elif self._spreads_nan:
            message.velocity[0] = math.nan
        return message


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--defect", choices=DEFECTS, default="none")
    parser.add_argument("--command-interface", choices=VALUE, default="voltage")
    arguments = parser.parse_args()
    defect = arguments.defect
    if defect == "leaves_child" and os.fork():
        signal.pause()
    rclpy.init()
    if defect in ("ignores_sigterm", "leaves_child"):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(BrokenDrive(defect, arguments.command_interface))


if __name__ == "__main__":
    main()
