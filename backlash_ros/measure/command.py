"""Measures the drive of a running controller: starts an experiment, records, identifies and reports."""

import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_namespace import validate_namespace
from rich.console import Console
from rich.progress import Progress, TaskID

from backlash_ros.commands.command import NOTHING, STOPPED
from backlash_ros.commands.identification import Request, identify_recording
from backlash_ros.foundation.reading.parameter_files import in_sections
from backlash_ros.foundation.staging import staging
from backlash_ros.measure import CERTIFICATE
from backlash_ros.recordings.bag import Series, read_bag
from backlash_ros.recordings.bag_topics import Topics, read_topics
from backlash_ros.recordings.samples import Columns, Reading
from backlash_ros.ros.client import PATIENCE, Client, ClientError, start_node, stop_node
from backlash_ros.ros.topics import RECEIVE

TOLD, BAG, IDENTIFIED, FIGURES = "told.yaml", "bag", "identified.yaml", "figures.json"
"""The files of a measurement beside its `CERTIFICATE`."""
_FIND = 10.0
_LONGEST = 900.0
"""Time limits for finding the controller and for its answer, s."""
_START, _HEAR = 120.0, 60.0
"""Time limits for the start of the recorder and for hearing each topic, s: a simulation as fast as possible leaves it
little of the processor."""
_BEFORE, _AFTER = 0.5, 0.2
"""Time that is recorded before and after, s."""
_TOPICS = "joint_states", "command", "controller/state", "controller/parameters_in_use"
"""The recorded topics: all would be too much for the recorder beside a simulation as fast as possible."""
_DRIVE = ("motor.", "gear.", "load.", "contact.", "limits.position_")
_AXIS = ("command_interface", "motor_joint", "load_joint")
"""Parameters that describe the drive."""


@dataclass(frozen=True)
class Measurement:
    """What to measure and where to write it.

    ``out``: a new folder; ``namespace`` of the controller, whose name is ``controller``; ``experiment``: empty for that
    of the controller; ``rated_torque`` in N m, 0 for half of the motor's at standstill.
    """

    out: Path
    namespace: str = "/"
    experiment: str = ""
    rated_torque: float = 0.0

    def __post_init__(self) -> None:
        try:
            validate_namespace(self.namespace)
        except NameValidationException as error:
            reason = str(error).splitlines()[0]
            raise ValueError(
                f"argument --namespace: must be a namespace of ROS such as /axis_1, got {self.namespace!r}: {reason}"
            ) from error
        if self.out.exists():
            raise ValueError(f"argument --out: must be a new folder, got '{self.out}', which exists")


def told_parameters(values: dict[str, Any]) -> str:
    """Return the text of a parameter file that describes the drive as the controller knows it.

    Parameters
    ----------
    values : the controller's parameters by name
    """
    own = {name: value for name, value in sorted(values.items()) if name in _AXIS or name.startswith(_DRIVE)}
    return yaml.safe_dump({"/**": {"ros__parameters": in_sections(own)}}, sort_keys=False)


class _Operator(Client):
    """Lets the controller learn, shows the progress, and cancels an unfinished experiment.

    ``interrupted``: the received signals; they end the measurement even if Python drops their exception, as it does in
    a destructor.
    """

    def __init__(self, node: Node, children: dict[str, subprocess.Popen[bytes]], interrupted: list[int]) -> None:
        super().__init__(node, children)
        self._interrupted, self._answered = interrupted, 0
        self._bar: tuple[Progress, TaskID] | None = None
        node.create_subscription(DiagnosticArray, "controller/state", self._on_state, RECEIVE)

    def _on_state(self, message: DiagnosticArray) -> None:
        if self._bar is not None:
            values = {entry.key: entry.value for entry in message.status[0].values}
            bar, task = self._bar
            bar.update(task, completed=float(values["progress"]))

    def wait(self, what: str, condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
        """Wait as any client does; KeyboardInterrupt if a signal came that has had no effect yet."""

        def goes_on() -> bool:
            if len(self._interrupted) > self._answered:
                raise KeyboardInterrupt
            return condition()

        super().wait(what, goes_on, seconds)

    def learn(self, console: Console) -> tuple[bool, str]:
        """Let it learn; if that is interrupted, cancel it."""
        with Progress(console=console, transient=True) as bar:
            self._bar = bar, bar.add_task("measuring", total=1.0)
            try:
                return self.call("learn", _LONGEST)
            except BaseException:
                self._answered = len(self._interrupted)
                self.children.clear()  # Ctrl-C ends them, too, and they are not needed any more
                with suppress(ClientError):
                    self.call("cancel", 5.0)
                raise
            finally:
                self._bar = None

    @contextmanager
    def using(self, experiment: str) -> Iterator[None]:
        """Let the controller use another experiment for a while."""
        if not experiment:
            yield
            return
        before = self.get("learning.experiment")
        try:
            self.must_set({"learning.experiment": experiment})
            yield
        finally:
            self._answered = len(self._interrupted)
            self.must_set(before)


def _record(request: Measurement, folder: Path, console: Console, interrupted: list[int]) -> str:
    """Let the controller learn while a bag is written to ``folder``; return why nothing was learned, if so."""
    namespace = f"__ns:={request.namespace}"
    with ExitStack() as stack:
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(context.try_shutdown)
        node = Node("measure", context=context, namespace=request.namespace)
        stack.callback(node.destroy_node)
        children: dict[str, subprocess.Popen[bytes]] = {}
        operator = _Operator(node, children, interrupted)
        try:
            operator.wait_for_controller(_FIND)
        except ClientError as error:
            where = node.resolve_service_name("controller/learn")
            raise ClientError(f"no controller found at {where}: {error}; start one, or set --namespace") from error
        (folder / TOLD).write_text(told_parameters(operator.get()))
        chosen = "-p", f"topics:=[{', '.join(_TOPICS)}]", "-p", f"output:={folder / BAG}"
        log = folder / "recorder.log"
        recorder = start_node("recorder", log, "-r", namespace, *chosen)
        children["recorder"] = recorder
        stack.callback(stop_node, recorder)
        operator.wait("the recorder to start", lambda: "recording" in log.read_text(), _START)
        for topic in map(node.resolve_topic_name, _TOPICS):
            operator.wait_for_recorder(log, topic, _HEAR)
        operator.pause(_BEFORE)
        with operator.using(request.experiment):
            valid, answer = operator.learn(console)
        console.print(answer, markup=False, highlight=False, soft_wrap=True)
        operator.pause(_AFTER)
        if (code := stop_node(recorder)) != 0:
            raise ClientError(f"the recorder ended with code {code}: {log.read_text()[-500:]}")
    log.unlink()
    return "" if valid else answer


def _part(columns: Columns, experiment: Series) -> Reading:
    """Return how to read a bag: only while the experiment acts, since the law may rattle before and after.

    Parameters
    ----------
    experiment : not 0 while it acts, by the stamps of the samples
    """
    acted = experiment.time[experiment.values != 0.0] - columns.epoch
    if not acted.size:
        return Reading()
    start, end = float(acted[0]), float(acted[-1])
    if start == end:
        raise ClientError("the recording does not show the experiment: see its answer, and measure again")
    if not 0.0 < start < end:
        raise ClientError(
            "the recording misses a part of the experiment because the recorder started late: measure again"
        )
    return Reading(start=start, end=end)


def measure(request: Measurement, command: str, console: Console) -> int:
    """Measure, print and write; return the exit code: 0 if something was found, else 1.

    The folder appears with the recording, once the controller has answered; the results are added later.

    Parameters
    ----------
    command : the command line

    Raises
    ------
    ClientError
        If there is no controller, it does not answer, or nothing could be recorded.
    OSError
        If the folder cannot be written.
    """
    out = request.out
    interrupted: list[int] = []

    def interrupt(number: int, _frame: object) -> None:
        interrupted.append(number)
        raise KeyboardInterrupt

    before = [signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        with staging(out) as folder:
            refusal = _record(request, folder, console, interrupted)
            folder.rename(out)
    except (KeyboardInterrupt, RuntimeError):  # amid a message rclpy makes another error of the interruption
        if not interrupted:
            raise
        console.print("stopped: the experiment was cancelled, and nothing was written")
        return STOPPED
    finally:
        for number, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(number, handler)
    values = yaml.safe_load((out / TOLD).read_text())["/**"]["ros__parameters"]
    prefix = request.namespace.rstrip("/")
    topics = Topics(f"{prefix}/joint_states", f"{prefix}/command", values["motor_joint"], values["load_joint"])
    experiment = read_bag(out / BAG).scalars[f"{prefix}/controller/state/experiment"]
    found = identify_recording(
        Request(
            out / BAG,
            _part(read_topics(out / BAG, topics), experiment),
            topics=topics,
            drive=out / TOLD,
            json=out / FIGURES,
            drive_file=out / IDENTIFIED,
            certificate=out / CERTIFICATE,
            rated_torque=request.rated_torque,
            command=command,
        ),
        console,
    )
    return NOTHING if refusal else found


def folder_of_now() -> Path:
    """Return the default folder of a measurement."""
    return Path(time.strftime("measured_%Y_%m_%d-%H_%M_%S"))
