"""The running system of the demo: its processes, and a user's topics, services and parameters."""

import math
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.recordings.bag import seconds_of
from backlash_ros.ros.client import Client, ClientError, start_node, stop_node
from backlash_ros.ros.topics import RECEIVE
from backlash_ros.studies.session import Interval

LOAD_STEP = 0.1
"""Load torque that is applied, N m."""
HOLD, _LOADED = 4.0, 2.5
"""Times for which a step is held and a load torque acts, s."""
ALL = QoSProfile(depth=10_000)
"""Reliable and deep: lockstep does not wait for listeners."""


class Session(Client):
    """A user of the running system: topics, services and parameters.

    All times are stamps of samples, s: in lockstep they are independent of this machine's clock.
    """

    def __init__(self, node: Node, children: dict[str, subprocess.Popen[bytes]]) -> None:
        super().__init__(node, children)
        self.stamp = self.angle = self.speed = self.felt = math.nan
        self.sent = self.answered = 0
        self._reference = node.create_publisher(Float64, "reference", ALL)
        self._load_torque = node.create_publisher(Float64, "load_torque", ALL)
        self._holds, self._since = math.nan, math.nan
        self._lifecycle = node.create_client(ChangeState, "controller/change_state")
        node.create_subscription(JointState, "joint_states", self._on_joint_states, RECEIVE)
        node.create_subscription(DiagnosticArray, "controller/state", self._on_state, ALL)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, ALL)

    def _on_joint_states(self, message: JointState) -> None:
        k = message.name.index("load")
        self.stamp, self.angle, self.speed = seconds_of(message.header.stamp), message.position[k], message.velocity[k]

    def _on_state(self, message: DiagnosticArray) -> None:
        told = {entry.key: entry.value for entry in message.status[0].values}
        reference, self.felt = float(told["reference"]), float(told["load_torque"])
        if reference != self._holds:
            self._holds, self._since = reference, seconds_of(message.header.stamp)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/plant_simulator: timing":
                counts = {entry.key: entry.value for entry in status.values}
                self.sent, self.answered = int(counts["samples"]), int(counts["answered_in_period"])

    def bring(self, what: str, transition: int) -> None:
        """Send the controller through a transition of its lifecycle."""
        self.wait("the controller's lifecycle", self._lifecycle.service_is_ready)
        request = ChangeState.Request(transition=Transition(id=transition))
        answer = self._lifecycle.call_async(request)
        self.wait(f"the controller to {what}", answer.done)
        if not answer.result().success:
            raise ClientError(f"the controller did not {what}")

    def ready(self) -> None:
        """Wait until drive and controller receive each other's messages."""
        self.wait("the drive's joint states", lambda: not math.isnan(self.angle))
        self.wait("the controller to answer them", lambda: not math.isnan(self._holds))
        self.wait("the drive to hear the answers", lambda: self.answered > 0)
        self.wait_for_controller()

    def run(self, seconds: float) -> None:
        """Let some time of the drive pass."""
        end = self.stamp + seconds
        self.wait("time to pass", lambda: self.stamp >= end)

    def _send(self, publisher: Publisher, value: float, what: str, taken: Callable[[], bool]) -> None:
        """Publish ``value`` until it is taken, once a second: the nodes' subscriptions are best effort."""
        sent = -math.inf

        def done() -> bool:
            nonlocal sent
            if not taken() and time.monotonic() - sent > 1.0:
                publisher.publish(Float64(data=value))
                sent = time.monotonic()
            return taken()

        self.wait(what, done)

    def move(self, target: float) -> float:
        """Send another reference and return the first sample on which it acts."""
        self._send(self._reference, target, "the controller to take the reference", lambda: self._holds == target)
        return self._since

    def load(self, torque: float) -> None:
        """Apply a load torque, N m, and wait until the controller estimates it."""
        self._send(
            self._load_torque,
            torque,
            f"the controller to feel {torque:g} N m",
            lambda: abs(self.felt - torque) < 0.5 * LOAD_STEP,
        )

    def settle_at(self, target: float) -> None:
        """Go to ``target`` with the two-region law and wait for rest."""
        self.must_set({"law": "two_region", "gain_set": "nominal"})
        self.move(target)
        b = NOMINAL_DRIVE.gear.backlash_angle
        self.wait("rest", lambda: abs(self.angle - target) < 0.5 * b and abs(self.speed) < 0.01)
        self.run(0.5)

    def step(self, law: str, target: float = 1.0) -> Interval:
        """Step from 0 to ``target`` with ``law`` and hold."""
        self.settle_at(0.0)
        self.must_set({"law": law})
        start = self.move(target)
        self.run(HOLD)
        return Interval(start, start + HOLD, target)

    def swap(self) -> tuple[bool, Interval]:
        """Swap the gain set while the load moves; return whether that was accepted, and when it was."""
        self.settle_at(0.0)
        self.must_set({"law": "overdamped"})
        start = self.move(1.0)
        self.wait("the load to move", lambda: self.angle > 0.3)
        accepted, _ = self.set({"gain_set": "brisk"})
        self.run(1.0)
        return accepted, Interval(start, self.stamp, 1.0)

    def load_step(self) -> Interval:
        """Apply a load torque while the load is held, and remove it."""
        before, target = self.stamp, self._holds
        self.load(LOAD_STEP)
        self.run(_LOADED)
        loaded = Interval(before, self.stamp, target)
        self.load(0.0)
        return loaded

    def ask(self, service: str, say: Callable[[str], None]) -> str:
        """Call ``service`` and return its answer; ClientError if it has no result."""
        done, answer = self.call(service)
        say(f"  {answer}")
        if not done:
            raise ClientError(f"{service}: {answer}")
        return answer


@contextmanager
def running(folder: Path, nodes: Mapping[str, Sequence[str]]) -> Iterator[Session]:
    """Run nodes with their parameters, as processes with logs in ``folder``; the last one ends first.

    The controller begins once a recorder, if there is one, hears both nodes: in lockstep no time passes before. What
    the controller says once it is configured comes over the last of its publishers to be found.
    """
    with ExitStack() as stack:
        children: dict[str, subprocess.Popen[bytes]] = {}
        for name, parameters in nodes.items():
            words = [word for parameter in parameters for word in ("-p", parameter)]
            children[name] = start_node(name, folder / f"{name}.log", *words)
            stack.callback(stop_node, children[name])
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(context.try_shutdown)
        node = Node("demo", context=context)
        stack.callback(node.destroy_node)
        session = Session(node, children)
        session.bring("configure", Transition.TRANSITION_CONFIGURE)
        if "recorder" in nodes:
            for topic in ("/joint_states", "/controller/parameters_in_use"):
                session.wait_for_recorder(folder / "recorder.log", topic)
        session.bring("activate", Transition.TRANSITION_ACTIVATE)
        session.ready()
        yield session
        for name, child in reversed(children.items()):  # controller first: 0 V goes out while everybody listens
            if (code := stop_node(child)) != 0:
                raise ClientError(f"{name} ended with code {code}")
