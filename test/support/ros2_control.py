"""What stands between a drive and its topics in ros2_control, played by the test from the same configuration file.

A controller manager that reads, updates and writes once a cycle; a joint_state_broadcaster, which publishes every
joint of the robot in alphabetical order with nan for what a joint does not measure; a forward_command_controller,
which keeps the last command for ever and refuses one of another size than its joints. Written after ros2_controllers
of Jazzy.
"""

import math
from pathlib import Path
from typing import Any

import yaml
from graph import Peer
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from backlash_ros.drivetrain import Drive, Plant

_CLOCK_START = 1_800_000_000
_MANAGER = "controller_manager"
_STATES = ("position", "velocity", "effort")


class Ros2Control:
    """One geared drive, and a gripper beside it, behind ros2_control.

    In lockstep with the controller: the cycle after a sample begins when it is answered. As in the real one the answer
    acts from that cycle on.
    """

    def __init__(self, peer: Peer, config: Path, measured: dict[str, tuple[str, ...]], drive: Drive) -> None:
        values = {name: section["ros__parameters"] for name, section in yaml.safe_load(config.read_text()).items()}
        kinds = {name: value["type"].split("/")[1] for name, value in values[_MANAGER].items() if type(value) is dict}
        (broadcaster,) = (name for name, kind in kinds.items() if kind == "JointStateBroadcaster")
        (forward,) = (name for name, kind in kinds.items() if kind == "ForwardCommandController")
        self._joints = values[forward]["joints"]
        self.interface = f"{self._joints[0]}/{values[forward]['interface_name']}"
        self.rate = values[broadcaster]["update_rate"]
        self.period = 1.0 / values[_MANAGER]["update_rate"]
        self._cycles_per_sample = values[_MANAGER]["update_rate"] // self.rate
        self.plant = Plant(drive)
        self.measured = {"gripper": ("position",), **measured}
        self.applied = 0.0
        self.answers = 0
        self.samples = 0
        self._peer = peer
        self._command: Any = None
        prefix = f"{broadcaster}/" if values[broadcaster]["use_local_topics"] else ""
        self._states = peer.node.create_publisher(JointState, f"{prefix}joint_states", QoSProfile(depth=1))
        peer.node.create_subscription(Float64MultiArray, f"{forward}/commands", self._on_command, QoSProfile(depth=1))

    def _on_command(self, message: Float64MultiArray) -> None:
        if all(map(math.isfinite, message.data)):
            self._command = message.data
            self.answers += 1

    def sample(self) -> JointState:
        """What joint_state_broadcaster publishes now."""
        plant = self.plant
        known = {
            "motor": (plant.motor_angle, plant.motor_speed, plant.motor_torque),
            "load": (plant.load_angle, plant.load_speed, plant.gear_torque),
            "gripper": (0.02, 0.0, 0.0),
        }
        message = JointState(name=sorted(self.measured))
        stamp = round((_CLOCK_START + self.samples / self.rate) * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.header.frame_id = "base_link"
        for field, values in zip(_STATES, zip(*(known[name] for name in message.name), strict=True), strict=True):
            there = (field in self.measured[name] for name in message.name)
            setattr(
                message, field, [value if is_there else math.nan for value, is_there in zip(values, there, strict=True)]
            )
        return message

    def step(self) -> None:
        """From one sample to the next."""
        for cycle in range(self._cycles_per_sample):
            if self._command is not None:
                assert len(self._command) == len(self._joints), "command size does not match number of interfaces"
                self.applied = self._command[0]
            answers = self.answers
            if cycle == 0:
                self._states.publish(self.sample())
                self.samples += 1
            self.plant.advance(self.applied, 0.0, self.period)
            if cycle == 0:
                self._peer.wait("an answer", lambda answers=answers: self.answers > answers)

    def matched(self) -> "Ros2Control":
        """Broadcast the drive at rest until the controller answers."""

        def answered() -> bool:
            self._states.publish(self.sample())
            self.samples += 1
            self._peer.spin(0.05)
            return self.answers > 3

        self._peer.wait("the controller", answered)
        for _ in range(3):
            self._peer.spin(0.2)  # late answers
        return self
