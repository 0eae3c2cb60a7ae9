"""One axis for the page: the messages of its controller and its drive, and requests to them."""

import asyncio
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterEvent
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from backlash_ros.control import Gains, Margins, stability_margins
from backlash_ros.control.design.start import emulated
from backlash_ros.dashboard.rows import JOINT_COLUMNS, STATE_COLUMNS, JointReader, Table, state_rows
from backlash_ros.drivetrain.parameters import drive_of
from backlash_ros.ros.aside import give_way
from backlash_ros.ros.topics import HISTORY, SEND

ANSWER = 5.0
"""Time limit for the answer of a service without an experiment, s."""
EXPERIMENT = 900.0
"""Time limit for the answer of a service with an experiment, s."""
SILENCE = 1.0
"""Time without joint states after which the drive counts as gone, s."""
_GOES_ON = 0.1
"""Time for which time goes on without a sample, s: they are taken together, every 0.05 s."""

_ALL = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=500)
"""Enough for 0.25 s at 2 kHz; best effort, so that a page that hangs does not hold up the sender."""

_SPOKEN = {"reference": Float64, "load_torque": Float64, "setpoint": JointTrajectory}
"""What is sent to the controller or the simulator, by its field of `Names`."""
_SERVICES = ("learn", "identify", "cancel", "apply_estimate", "reset_fault", "hold")


class Polled(CallbackGroup):
    """For subscriptions without an executor: their messages wait until they are taken, many at once."""

    def can_execute(self, _entity: Any) -> bool:
        """Return False, so that executors ignore them."""
        return False

    def beginning_execution(self, _entity: Any) -> bool:
        """Return False, as above."""
        return False

    def ending_execution(self, _entity: Any) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class Diagnosis:
    """One status of ``/diagnostics``: level, message, values by name, and time of receipt (monotonic, s)."""

    level: int
    message: str
    values: Mapping[str, str]
    at: float
    stamp: float = math.nan
    """Time of the node that sent it, s."""


@dataclass(frozen=True)
class Names:
    """The names of an axis: its controller, its topics, and the simulator of its drive, empty without one."""

    controller: str
    joint_states: str
    reference: str
    command: str
    load_torque: str
    setpoint: str
    simulator: str = ""


@dataclass(frozen=True)
class Answer:
    """The answer of a service, or why there is none."""

    success: bool
    text: str


@dataclass(frozen=True)
class Told:
    """Parameters in use of a node, with their version."""

    version: int = 0
    values: dict[str, Any] = field(default_factory=dict)


class Axis:
    """One axis: its messages and requests to it.

    The constructor and the ROS callbacks run in the thread of the executor, everything else in the event loop ``loop``
    of the page.
    """

    def __init__(self, node: Node, names: Names, loop: asyncio.AbstractEventLoop) -> None:
        self._node, self._loop = node, loop
        self.names = names
        self.title = names.controller.rpartition("/")[0] or "/"
        self.present = True
        self.told, self.told_by_simulator = Told(), Told()
        self.diagnoses: dict[str, Diagnosis] = {}
        self.last_state: dict[str, float] = {}
        self.sample_at = -math.inf
        self._reader = JointReader()
        self._newest = self._used = math.nan
        self._ahead = 0.0  # by which the controller's clock is ahead of the samples', s
        self.aimed = -math.inf
        """Time when the last setpoint was sent, s."""
        self.margins: dict[str, Margins] = {}
        self.answer = ""
        self._group = Polled()
        self._joints = self._hear(JointState, names.joint_states)
        self._states = self._hear(DiagnosticArray, f"{names.controller}/state")
        node.create_subscription(ParameterEvent, f"{names.controller}/parameters_in_use", self._on_told, HISTORY)
        self._spoken = {name: node.create_publisher(_SPOKEN[name], getattr(names, name), SEND) for name in _SPOKEN}
        self._services = {name: node.create_client(Trigger, f"{names.controller}/{name}") for name in _SERVICES}
        self._transition = node.create_client(ChangeState, f"{names.controller}/change_state")
        self._parameters = AsyncParameterClient(node, names.controller)
        self._simulator: Simulator | None = None

    # What is heard, in the executor's thread.

    def _hear(self, kind: type, topic: str) -> Subscription:
        # Its callback is never called.
        raw = kind is JointState
        return self._node.create_subscription(kind, topic, lambda _: None, _ALL, callback_group=self._group, raw=raw)

    def found(self, names: Names) -> None:
        """Update the topics of the controller and the simulator of the drive."""
        self.present = True
        before, self.names = self.names, names
        if names.joint_states != before.joint_states:
            old, self._joints = self._joints, self._hear(JointState, names.joint_states)
            self._node.destroy_subscription(old)
        for name, kind in _SPOKEN.items():
            if (topic := getattr(names, name)) != getattr(before, name):
                old, self._spoken[name] = self._spoken[name], self._node.create_publisher(kind, topic, SEND)
                self._node.destroy_publisher(old)
        if names.simulator and (self._simulator is None or self._simulator.name != names.simulator):
            self._simulator = Simulator(self._node, names.simulator, self._on_told_by_simulator)

    def _on_told(self, message: ParameterEvent) -> None:
        told = read_told(message)
        values = told.values
        try:
            period, delay = 1.0 / values["rate"], values["loop_delay"]
            drive = emulated(drive_of(values), period, delay)
            self.margins = {
                region: stability_margins(drive, Gains(*values[f"gains.{region}.k"]), period, delay)
                for region in ("fast", "overdamped")
            }
        except (KeyError, ValueError, TypeError):  # another version's controller
            self.margins = {}
        self.told = told

    def _on_told_by_simulator(self, message: ParameterEvent) -> None:
        self.told_by_simulator = read_told(message)

    def on_diagnostics(self, name: str, diagnosis: Diagnosis) -> None:
        """Keep a status that concerns this axis; ``name`` as in ``/controller: timing``."""
        node, _, part = name.partition(": ")
        if node == self.names.controller:
            ahead, patience = diagnosis.stamp - self.time, float(self.told.values.get("state_timeout", math.inf))
            self._ahead = ahead if abs(ahead) >= patience else 0.0  # as the controller itself decides
        if node in {self.names.controller, self.names.simulator}:
            self.diagnoses[f"{'simulator' if node == self.names.simulator else 'controller'}: {part}"] = diagnosis

    # What is taken, by the page.

    def take(self) -> tuple[Table, Table]:
        """Return the rows of joint states and of ``~/state`` since the last call."""
        values = self.told.values
        motor, load = values.get("motor_joint", "motor"), values.get("load_joint", "load")
        reduction = float(values.get("gear.reduction", math.nan))  # until the controller has told it
        samples = self._reader.rows(taken(self._joints), motor, load, reduction)
        samples[:, [JOINT_COLUMNS.index(shaft) for shaft in ("motor", "load")]] -= float(values.get("zero", 0.0))
        # In lockstep a sample is sent again where its answer is missing.
        samples = samples[np.diff(samples[:, 0], prepend=self._newest) != 0]
        states = state_rows(taken(self._states))
        if len(samples):
            self.sample_at, self._newest = time.monotonic(), samples[-1, 0]
        if len(states):
            self.last_state = dict(zip(STATE_COLUMNS, states[-1].tolist(), strict=True))
            self._used = states[-1, 0]
        return samples, states

    @property
    def simulated(self) -> bool:
        """Whether a simulator of this package emulates the drive."""
        return bool(self.names.simulator)

    @property
    def silent(self) -> float:
        """Time without joint states, s."""
        return time.monotonic() - self.sample_at

    @property
    def unused(self) -> float:
        """Time of the samples since the controller told of one that it used, s; nan before the first one.

        It tells of every few that it uses, with their stamps.
        """
        return self._newest - self._used

    @property
    def time(self) -> float:
        """The time of the samples, s, which stands still where none come; nan before the first one."""
        return self._newest + min(self.silent, _GOES_ON)

    @property
    def lifecycle(self) -> str:
        """The last known state of the controller, or that it is missing."""
        said = self.diagnoses.get("controller: servo")
        if not self.present:
            return "not there"
        return said.values.get("state", "unknown") if said else "unknown"

    @property
    def b(self) -> float:
        """The backlash in use, rad at the output; 0 if unknown."""
        return float(self.told.values.get("backlash_angle", 0.0))

    # What is asked.

    def move(self, angle: float) -> None:
        """Send a reference, rad."""
        self._spoken["reference"].publish(Float64(data=angle))

    def aim(self, when: float, setpoint: Sequence[float]) -> None:
        """Send where the load is to be at a time of the samples, s: rad, rad/s and rad/s^2."""
        position, velocity, acceleration = setpoint
        point = JointTrajectoryPoint(positions=[position], velocities=[velocity], accelerations=[acceleration])
        message = JointTrajectory(joint_names=[self.told.values.get("load_joint", "load")], points=[point])
        seconds, message.header.stamp.sec = math.modf(when + self._ahead)[0], int(when + self._ahead)
        message.header.stamp.nanosec = int(1e9 * seconds)
        self._spoken["setpoint"].publish(message)
        self.aimed = self.time

    def load(self, torque: float) -> None:
        """Put a load torque on the simulated drive, N m."""
        self._spoken["load_torque"].publish(Float64(data=torque))

    async def call(self, service: str, seconds: float = ANSWER) -> Answer:
        """Call a service of the controller and return its answer."""
        return await trigger(self._loop, self._services[service], seconds)

    async def reset(self) -> Answer:
        """Reset a latched fault, first that of a simulated drive."""
        if self._simulator is not None and self.simulated:
            await trigger(self._loop, self._simulator.reset_fault, ANSWER)
        return await self.call("reset_fault")

    async def change(self, transition: int) -> Answer:
        """Ask the controller for a transition of its lifecycle."""
        if not self._transition.service_is_ready():
            return Answer(False, f"{self.names.controller} is not available")
        request = ChangeState.Request()
        request.transition.id = transition
        try:
            response = await answered(self._loop, self._transition.call_async(request), ANSWER)
        except TimeoutError:
            return Answer(False, f"{self.names.controller} did not answer within {ANSWER:g} s")
        return Answer(response.success, "" if response.success else "the controller refused; its log has the reason")

    async def set(self, values: Mapping[str, Any], *, simulator: bool = False) -> Answer:
        """Set parameters of the controller, or of the simulator, all or none; return the reason if they are refused."""
        client, name = self._parameters, self.names.controller
        if simulator and self._simulator is not None:
            client, name = self._simulator.parameters, self._simulator.name
        if not client.services_are_ready():
            return Answer(False, f"{name} is not available")
        request = [Parameter(key, value=value) for key, value in values.items()]
        try:
            response = await answered(self._loop, client.set_parameters_atomically(request), ANSWER)
        except TimeoutError:
            return Answer(False, f"{name} did not answer within {ANSWER:g} s")
        return Answer(response.result.successful, response.result.reason)


class Simulator:
    """The services of a simulated drive, and its parameters in use."""

    def __init__(self, node: Node, name: str, on_told: Callable[[ParameterEvent], None]) -> None:
        self.name = name
        self.reset_fault = node.create_client(Trigger, f"{name}/reset_fault")
        self.parameters = AsyncParameterClient(node, name)
        node.create_subscription(ParameterEvent, f"{name}/parameters_in_use", on_told, HISTORY)


def read_told(message: ParameterEvent) -> Told:
    """Return the content of a message of ``~/parameters_in_use``."""
    values = {each.name: parameter_value_to_python(each.value) for each in message.new_parameters}
    return Told(values.pop("version", 0), values)


def taken(subscription: Subscription) -> list[Any]:
    """Return the messages that wait, oldest first."""
    messages = []
    with subscription.handle:
        while (got := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            messages.append(got[0])
            if len(messages) % 8 == 0:
                give_way()
    return messages


async def answered(loop: asyncio.AbstractEventLoop, future: Future, seconds: float) -> Any:
    """Return the result of a future of rclpy, which another thread sets; TimeoutError if it does not come."""
    done: asyncio.Future[Any] = loop.create_future()

    def pass_on(result: Any) -> None:
        if not done.done():
            done.set_result(result)

    future.add_done_callback(lambda known: loop.call_soon_threadsafe(pass_on, known.result()))
    try:
        return await asyncio.wait_for(done, seconds)
    except asyncio.TimeoutError as error:
        raise TimeoutError from error


async def trigger(loop: asyncio.AbstractEventLoop, client: Any, seconds: float) -> Answer:
    """Call a service of type Trigger."""
    if not client.service_is_ready():
        return Answer(False, f"{client.srv_name} is not available")
    try:
        response = await answered(loop, client.call_async(Trigger.Request()), seconds)
    except TimeoutError:
        return Answer(False, f"{client.srv_name} did not answer within {seconds:g} s")
    return Answer(response.success, response.message)
