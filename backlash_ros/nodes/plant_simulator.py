"""The drive, simulated: publishes joint states at a fixed rate and takes the motor's voltage.

Simulated time goes with the steady clock, one period a beat. The voltage that arrives after sample k acts from sample k
on, as if the controller took no time, so that the loop equals the offline one as long as every answer comes within
its period. A beat that comes late is made good by moving the plant on, not by extra samples.
"""

import math
from collections.abc import Sequence

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.drivetrain import Plant
from backlash_ros.nodes.interface import RECEIVE, SEND, STEADY, declare_joints, overridable
from backlash_ros.nodes.parameters import declare_drive, declare_duration, declare_rate
from backlash_ros.nodes.run import StoppableNode, run


class PlantSimulator(StoppableNode):
    """Geared servo with backlash behind the topics of a drive."""

    def __init__(self) -> None:
        super().__init__("plant_simulator")
        self._drive = declare_drive(self)
        self._joints = declare_joints(self)
        self._period = 1.0 / declare_rate(self)
        self._command_timeout = declare_duration(
            self, "command_timeout", 0.1, "silence on command after which the motor gets 0 V"
        )
        self._plant = Plant(self._drive)
        self._plant.advance(0.0, 0.0, self._period)  # compiles, or loads what was compiled before
        self._voltage = 0.0
        self._load_torque = 0.0
        self._last_command: float | None = None
        self._rejected = 0
        self._late = 0
        self._beats = 0
        self._publisher = self.create_publisher(JointState, "joint_states", SEND, qos_overriding_options=overridable())
        self.create_subscription(
            Float64MultiArray, "command", self._on_command, RECEIVE, qos_overriding_options=overridable()
        )
        self.create_subscription(
            Float64, "load_torque", self._on_load_torque, RECEIVE, qos_overriding_options=overridable()
        )
        self._start = self._now()
        self.create_timer(self._period, self._beat, clock=STEADY)
        self.get_logger().info(
            f"simulating at {1 / self._period:g} Hz, backlash {self._drive.gear.backlash_angle:g} rad at the output"
        )

    @staticmethod
    def _now() -> float:
        return STEADY.now().nanoseconds * 1e-9

    def _reject(self, what: str) -> None:
        self._rejected += 1
        self.get_logger().warning(f"{what}; {self._rejected} messages rejected so far", throttle_duration_sec=1.0)

    def _on_command(self, message: Float64MultiArray) -> None:
        if not message.data or not math.isfinite(message.data[0]):
            self._voltage = 0.0
            self._reject(f"command must hold one finite voltage, got {list(message.data)}: motor at 0 V")
            return
        self._voltage = message.data[0]
        self._last_command = self._now()

    def _on_load_torque(self, message: Float64) -> None:
        if not math.isfinite(message.data):
            self._reject(f"load_torque must be finite, in N m, got {message.data}: kept {self._load_torque:g}")
            return
        self._load_torque = message.data

    def _beat(self) -> None:
        now = self._now()
        if self._last_command is not None and now - self._last_command > self._command_timeout:
            self._voltage, self._last_command = 0.0, None
            self.get_logger().warning(f"no command for {self._command_timeout:g} s: motor at 0 V")
        due = max(1, round((now - self._start) / self._period) - self._beats)
        self._late += due - 1
        self._beats += due
        self._plant.advance(self._voltage, self._load_torque, due * self._period)
        self._publish()

    def _publish(self) -> None:
        plant = self._plant
        message = JointState()
        message.header.stamp = self.get_clock().now().to_msg()
        message.name = list(self._joints)
        message.position = [plant.motor_angle, plant.load_angle]
        message.velocity = [plant.motor_speed, plant.load_speed]
        message.effort = [plant.motor_torque, plant.gear_torque]
        self._publisher.publish(message)

    def stop(self) -> None:
        """Say how it went; a simulated motor needs nothing else."""
        self.get_logger().info(f"stopped after {self._beats} beats, {self._late} of them late")


def main(args: Sequence[str] | None = None) -> int:
    """Run the plant simulator."""
    return run(PlantSimulator, args)


if __name__ == "__main__":
    raise SystemExit(main())
