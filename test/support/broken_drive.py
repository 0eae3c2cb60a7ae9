"""A simulated drive that breaks the contract in one way, ``--defect NAME``, or in none.

It imports nothing of the package, whose compiled plant takes longer to load than the kit looks at most of these.
"""

import argparse
import contextlib
import math
import signal
import sys
import time

import rclpy
import rclpy.duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
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
    "missing_positions": "names two joints and gives one position",
    "nan_in_states": "publishes NaN for a velocity now and then",
    "half_rate": "publishes every other sample",
    "drops_samples": "leaves out every fifth sample",
    "double_publishing": "publishes every sample twice",
    "frozen_stamps": "stamps every sample with its start",
    "stamps_backward": "stamps some samples earlier than the one before",
    "stamps_since_start": "stamps with the time since its start instead of the ROS clock",
    "creeps": "turns at 0",
    "sign_flipped": "turns back on a positive command",
    "load_sign_flipped": "counts the load's angle the other way",
    "load_before_gear": "measures the load at the motor's shaft",
    "degrees": "gives positions and velocities in degrees",
    "velocity_in_rpm": "gives velocities in revolutions per minute",
    "effort_in_amperes": "gives the motor's current as effort",
    "effort_sign_flipped": "gives the torque on the motor's housing",
    "bang_bang": "takes the sign of the command for a fixed one",
    "holds_at_zero": "keeps the last command that is not 0",
    "strict_length": "ignores commands of more than one element",
    "no_watchdog": "keeps the command when commands stop",
    "keeps_voltage_on_nan": "keeps the command at one that is not finite",
    "full_voltage_on_inf": "clips an infinite command to the largest",
    "dies_on_empty_command": "ends at a command without elements",
    "ignores_sigterm": "goes on at SIGTERM",
}


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
        self._start = self.get_clock().now()
        self._beats = 0
        send = QoSProfile(depth=10)
        if defect == "best_effort":
            send.reliability = ReliabilityPolicy.BEST_EFFORT
        self._publisher = self.create_publisher(JointState, "joint_states", send)
        receive = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Float64MultiArray, "command", self._on_command, receive)
        self.create_timer(1 / RATE, self._beat)

    def _on_command(self, message: Float64MultiArray) -> None:
        defect = self._defect
        if not message.data and defect == "dies_on_empty_command":
            sys.exit(1)
        if len(message.data) > 1 and defect == "strict_length":
            return
        self._last_command = time.monotonic()
        value = message.data[0] if message.data else 0.0
        if not math.isfinite(value):
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

    def _beat(self) -> None:
        if self._defect != "no_watchdog" and time.monotonic() - self._last_command > COMMAND_TIMEOUT:
            self._command = 0.0
        # Late beats are made good in the servo, not by extra samples.
        now = self.get_clock().now()
        due = max(1, round((now - self._start).nanoseconds * 1e-9 * RATE) - self._beats)
        self._beats += due
        self._servo.advance(self._command, due / RATE)
        if self._defect == "half_rate" and self._beats % 2:
            return
        if self._defect == "drops_samples" and self._beats % 5 == 0:
            return
        message = self._sample()
        self._publisher.publish(message)
        if self._defect == "double_publishing":
            self._publisher.publish(message)

    def _sample(self) -> JointState:
        servo, defect = self._servo, self._defect
        message = JointState(name=["motor", "load"])
        now = self.get_clock().now()
        message.header.stamp = now.to_msg()
        message.position = [servo.motor_angle, servo.load_angle]
        message.velocity = [servo.motor_speed, servo.load_speed]
        message.effort = [servo.motor_torque, math.nan]
        if defect == "wrong_names":
            message.name = ["joint1", "joint2"]
        elif defect == "missing_positions":
            message.position = message.position[:1]
        elif defect == "nan_in_states" and self._beats % 50 == 0:
            message.velocity[0] = math.nan
        elif defect == "frozen_stamps":
            message.header.stamp = self._start.to_msg()
        elif defect == "stamps_backward" and self._beats % 25 == 0:
            message.header.stamp = (now - rclpy.duration.Duration(seconds=0.02)).to_msg()
        elif defect == "stamps_since_start":
            since = (now - self._start).nanoseconds
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(since, 10**9)
        elif defect == "load_sign_flipped":
            message.position[1], message.velocity[1] = -servo.load_angle, -servo.load_speed
        elif defect == "load_before_gear":
            message.position[1], message.velocity[1] = servo.load_angle / RATIO, servo.load_speed / RATIO
        elif defect == "degrees":
            message.position = [math.degrees(angle) for angle in message.position]
            message.velocity = [math.degrees(speed) for speed in message.velocity]
        elif defect == "velocity_in_rpm":
            message.velocity = [speed * 30 / math.pi for speed in message.velocity]
        elif defect == "effort_in_amperes":
            message.effort[0] /= TORQUE_CONSTANT
        elif defect == "effort_sign_flipped":
            message.effort[0] *= -1
        return message


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--defect", choices=DEFECTS, default="none")
    parser.add_argument("--command-interface", choices=VALUE, default="voltage")
    arguments = parser.parse_args()
    defect = arguments.defect
    rclpy.init()
    if defect == "ignores_sigterm":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(BrokenDrive(defect, arguments.command_interface))


if __name__ == "__main__":
    main()
