"""Simulator and controller as live processes, and the test's hands on them: what the motor gets, faults, resets."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from graph import Peer, Process
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.messages import answered_sample

TIMEOUT = 1.0
"""Of both watchdogs in these tests, s: a loaded machine may stall for longer than the default."""
LOAD_TORQUE = 0.3
DEEP = QoSProfile(depth=5000)
STATUS = {"controller": "servo", "plant_simulator": "drive"}


def stamp_of(message: JointState | DiagnosticArray) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def voltage_of(message: JointState) -> float:
    """Voltage on the motor by eq 7, up to the inductance: R i + K_m omega_m."""
    motor = NOMINAL_DRIVE.motor
    current = message.effort[0] / motor.torque_constant
    return motor.resistance * current + motor.torque_constant * message.velocity[0]


class Pair:
    """Both nodes, holding the load against a torque, so that the motor is under voltage when the fault comes."""

    def __init__(self, start: Callable[..., Process], peer: Peer) -> None:
        self.peer, self._start = peer, start
        self.states: list[JointState] = []
        self.commands: list[tuple[float, list[float], int | None]] = []
        self._values: dict[str, dict[str, str]] = {}
        self._levels: dict[str, tuple[bytes, str]] = {}
        node = peer.node
        node.create_subscription(JointState, "joint_states", self._on_state, DEEP)
        node.create_subscription(Float64MultiArray, "command", self._on_command, DEEP)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, DEEP)
        self._torque = node.create_publisher(Float64, "load_torque", 10)
        self.reference = node.create_publisher(Float64, "reference", 10)
        self.controller = self._start("controller", state_timeout=TIMEOUT)
        self.start_simulator()

    def start_simulator(self) -> None:
        self._values.clear()
        self._answered = 0
        self.simulator = self._start("plant_simulator", command_timeout=TIMEOUT)

    def restart_controller(self) -> None:
        """Start a controller where the old one has ended, with the load at rest, so that it may take its time."""

        def at_rest() -> bool:
            self._torque.publish(Float64(data=0.0))
            return abs(self.states[-1].velocity[1]) < 0.01

        self.peer.wait("the load to stand still", at_rest)
        self._values.clear()
        self.peer.wait("diagnostics", self.answered)
        self._answered = self.answered()
        self.controller = self._start("controller", state_timeout=TIMEOUT)

    def _on_state(self, message: JointState) -> None:
        self.states.append(message)

    def _on_command(self, message: Float64MultiArray) -> None:
        self.commands.append((self.now(), list(message.data), answered_sample(message)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._values[status.name] = {entry.key: entry.value for entry in status.values}
            self._levels[status.name] = status.level, status.message

    def now(self) -> float:
        """ROS time, s: that of the stamps."""
        return self.peer.node.get_clock().now().nanoseconds * 1e-9

    def value(self, node: str, key: str) -> str:
        """What the newest diagnostics say, empty before there are any."""
        return self._values.get(f"/{node}: {STATUS[node]}", {}).get(key, "")

    def answered(self) -> int:
        """How many of its samples the simulator has had an answer to within the period, by its newest diagnostics."""
        return int(self._values.get("/plant_simulator: timing", {}).get("answered_in_period", 0))

    def level(self, status: str) -> tuple[bytes, str]:
        return self._levels.get(status, (b"", ""))

    def faulty(self, node: str, reason: str) -> None:
        """Wait until the diagnostics have a latched fault for ``reason``."""
        self.peer.wait(f"the fault of {node}: {reason}", lambda: reason in self.value(node, "fault"))
        assert self.level(f"/{node}: {STATUS[node]}")[0] == b"\x02"

    def reset(self, node: str) -> str:
        response = self.peer.call(Trigger, f"{node}/reset_fault", Trigger.Request())
        assert response.success
        self.peer.wait("diagnostics without a fault", lambda: not self.value(node, "fault"))
        return response.message

    def loaded(self) -> "Pair":
        """Wait until the load is held against a torque and the voltage that this takes is on the motor.

        The torque comes when both hear each other: a load that falls, whatever is commanded, is a fault.
        """
        self.peer.wait("the simulator", lambda: self._torque.get_subscription_count() > 0)
        self.peer.wait("the controller", lambda: self.reference.get_subscription_count() > 0)
        self.peer.wait(
            lambda: f"answers; {self.log()}", lambda: self.states and self.commands and self.answered() > self._answered
        )
        needed = -LOAD_TORQUE * NOMINAL_DRIVE.gear.ratio * NOMINAL_DRIVE.motor.resistance
        needed /= NOMINAL_DRIVE.motor.torque_constant

        def held() -> bool:
            self._torque.publish(Float64(data=LOAD_TORQUE))
            last = self.states[-1]
            return abs(voltage_of(last) - needed) < 0.1 and abs(last.velocity[1]) < 0.01

        self.peer.wait(lambda: f"the load to be held; {self.log()}", held)
        return self

    def log(self) -> str:
        """What both processes say, for a test that failed."""
        return f"controller:\n{self.controller.output()}\nsimulator:\n{self.simulator.output()}"

    def unpowered(self, since: float) -> float:
        """Wait until the motor has 0 V, and return how long after ``since`` it had, by the sample's stamp."""

        def first() -> float | None:
            for message in self.states:
                if stamp_of(message) > since and abs(voltage_of(message)) < 0.1:
                    return stamp_of(message) - since
            return None

        return self.peer.wait("the motor to be without voltage", first)

    def told_zero(self, since: float) -> float:
        """Wait until the controller has commanded 0 V, and return how long after ``since``."""

        def first() -> float | None:
            return next((at - since for at, data, _ in self.commands if at > since and data == [0.0]), None)

        return self.peer.wait("0 V to be commanded", first)

    def answered_twice(self) -> float | None:
        """When a sample had its second answer, None while none had."""
        seen: set[int] = set()
        for at, _, sample in self.commands:
            if sample in seen:
                return at
            if sample is not None:
                seen.add(sample)
        return None

    def works(self) -> None:
        """Wait until the load is held again: new samples, new answers, the voltage that it takes."""
        self.states.clear()
        self.commands.clear()
        self.loaded()
