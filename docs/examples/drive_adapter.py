"""A drive of your own as a ROS 2 node: joint states out, commands in through the gate, which has watchdog and refusals.

Put your board's calls in `Board`; here a simulated drive stands in its place. Then judge it: docs/contract.md.
"""

import time

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.drivetrain import NOMINAL_DRIVE, Plant
from backlash_ros.foundation.messages import answered_sample, stamp_ns
from backlash_ros.gates import CommandGate
from backlash_ros.ros.topics import RECEIVE, SEND

PERIOD = 0.004  # s
TIMEOUT = 100_000_000  # ns


class Board:
    """What talks to the amplifier and the encoders."""

    def __init__(self) -> None:
        self._plant = Plant(NOMINAL_DRIVE)

    def exchange(self, voltage: float) -> tuple[float, float]:
        """Put a voltage (V) on the motor and return the angles of motor and load, rad."""
        self._plant.advance(voltage, 0.0, PERIOD)
        return self._plant.motor_angle, self._plant.load_angle


class Drive(Node):
    """Publishes what the board measures and gives it what the gate lets through."""

    def __init__(self, board: Board) -> None:
        super().__init__("drive")
        self._board, self._gate = board, CommandGate(TIMEOUT)
        self._states = self.create_publisher(JointState, "joint_states", SEND)
        self.create_subscription(Float64MultiArray, "command", self._on_command, RECEIVE)
        self.create_service(Trigger, "~/reset_fault", self._on_reset)
        self.create_timer(PERIOD, self._exchange, clock=Clock(clock_type=ClockType.STEADY_TIME))
        # A process's first line takes rclpy 0.1 s, in which it looks through all modules: not while the motor turns.
        self.get_logger().info(f"a sample each {1e3 * PERIOD:g} ms")

    def _exchange(self) -> None:
        angles = self._board.exchange(self._gate.output(time.monotonic_ns()))
        message = JointState(name=["motor", "load"], position=angles)
        message.header.stamp = self.get_clock().now().to_msg()
        self._gate.sent(stamp_ns(message.header.stamp), time.monotonic_ns())
        self._states.publish(message)

    def _on_command(self, message: Float64MultiArray) -> None:
        if why := self._gate.command(message.data, answered_sample(message), time.monotonic_ns()):
            self.get_logger().warning(why, throttle_duration_sec=1.0)
        if self._gate.fault:
            self.get_logger().error(f"{self._gate.fault.name}: {self._gate.why}", throttle_duration_sec=1.0)

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, f"reset {self._gate.fault.name}"
        self._gate.reset()
        return response


def main() -> None:
    """Run until told to stop; the motor then has nothing."""
    board = Board()
    rclpy.init()
    try:
        rclpy.spin(Drive(board))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        board.exchange(0.0)
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
