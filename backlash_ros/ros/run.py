"""How every node of this package runs: started from arguments, spun, and stopped in order by a signal."""

import argparse
import faulthandler
import gc
import logging
import re
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, NameValidationException, ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.logging import get_logger, get_logging_directory
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from backlash_ros.foundation.reading.yaml_text import RepeatedKeyError
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.output import Backlog, never_wait
from backlash_ros.ros.overrides import COMMAND_LINE, parameter_rules, refuse_repeated_keys
from backlash_ros.ros.timer import Timer, call_due, now
from backlash_ros.ros.transport import avoid_shared_memory


class StoppableNode(Node):
    """A node with something to do before it ends, such as a last command of 0 V.

    ``linger``: how long it goes on after it was told to stop, s, to process what has already arrived.
    """

    linger = 0.0
    own_timers: Sequence[Timer] = ()
    finished = broken = False

    def __init__(self, name: str) -> None:
        super().__init__(name, cli_args=list(COMMAND_LINE.get()))

    def prepare(self) -> None:
        """Do what takes long; the executor already knows the node."""

    def start(self) -> None:
        """Begin."""

    def stop(self) -> None:
        """Leave everything safe and complete; the context is still alive."""


Runnable = ManagedNode | StoppableNode

_FAREWELL = 0.5
"""Time that nodes go on after a shutdown request, s, so that the answer is sent."""

_LAST_WORDS = 0.1
"""Time that managed nodes go on after they were stopped by a signal, s, so that clients hear how their goals ended."""

_LEAVING = 10.0
"""Longest time for leaving the graph, s. Fast DDS may deadlock there while other participants leave."""


class Stop:
    """Becomes true on SIGINT, SIGTERM or, unless nohup ignores it, SIGHUP (the terminal was closed)."""

    def __init__(self) -> None:
        self._asked = False
        ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        self._numbers = [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]
        for number in self._numbers:
            signal.signal(number, self._ask)

    def ignore_more(self) -> None:
        """Ignore further signals until the process has ended properly: `ros2 launch` repeats the terminal's signal."""
        for number in self._numbers:
            signal.signal(number, signal.SIG_IGN)

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self._asked = True

    def __bool__(self) -> bool:
        return self._asked


class _RosLog(logging.Handler):
    """Passes the library's log records to the ROS log."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            get_logger(self._name).warning(record.getMessage())
        else:
            get_logger(self._name).info(record.getMessage())


def help_of(name: str, about: str) -> argparse.ArgumentParser:
    """Return the parser for the arguments before ``--ros-args``; its help shows ``about``."""
    return argparse.ArgumentParser(
        prog=name,
        description=about,
        epilog="Parameters and remaps follow --ros-args: -p NAME:=VALUE, --params-file FILE, -r FROM:=TO.\n"
        "docs/parameters.md lists all parameters with units and bounds; on a running node: ros2 param describe.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _axes(name: str, about: str, words: Sequence[str]) -> list[str]:
    """Return the namespaces of ``--axes``, one node each; without it only that of the process.

    Help and unknown words end the process: a parameter file without ``--ros-args`` before it must not be ignored.
    """
    parser = help_of(name, about)
    parser.add_argument("--axes", nargs="+", default=[""], metavar="NAMESPACE", help="one node in each")
    axes: list[str] = parser.parse_args(remove_ros_args(list(words))).axes
    return axes


def _made(make: Callable[[str], Runnable], axis: str) -> Runnable:
    node = make(axis)
    if axis and node.get_namespace().strip("/") != axis.strip("/"):
        raise ValueError("--axes gives the namespaces: use --axes arm/elbow without __ns:=arm")
    return node


def _refuse(name: str, error: Exception) -> int:
    """Log in one line, without rcl's source positions, why nothing starts; return the exit code."""
    reason = " ".join(re.sub(r",? at \S+:\d+", "", str(error)).split())
    get_logger(name).fatal(f"cannot start: {reason}")
    return 2


def _report(node: Node, error: Exception) -> None:
    node.get_logger().fatal(f"{type(error).__name__}: {error}")
    node.get_logger().debug(traceback.format_exc())


def _stopped(node: Runnable) -> bool:
    """Stop a node and return whether that went well; an error must not keep the other nodes from stopping."""
    try:
        node.stop()
    except Exception as error:
        _report(node, error)
        return False
    return True


def _watch_output(node: Node) -> Timer:
    """Return a timer that warns, once the output takes lines again, that some were lost."""
    backlog = Backlog()

    def look() -> None:
        if held := backlog.ended():
            where = get_logging_directory()
            node.get_logger().warning(
                f"nothing read the output for {held:.0f} s: lines may be missing here, {where} has all of them"
            )

    return Timer(1.0, look)


def _turn(executor: EventsExecutor, nodes: Sequence[Runnable], watch: Timer) -> None:
    """Call a timer that is due and process one event, waiting for it until the next timer is due.

    Neither starves the other: overdue timers skip beats.
    """
    wait = call_due([watch, *(timer for node in nodes for timer in node.own_timers)])
    executor.spin_once(timeout_sec=min(max(wait, 0.0), 0.1))


def _spin(executor: EventsExecutor, nodes: Sequence[Runnable], stop: Stop) -> None:
    """Start the nodes and process events until they are told to stop or have finished, and a while longer."""
    for node in nodes:
        executor.add_node(node)
        node.prepare()
    # These objects stay: a garbage collection over them would stop the loop for many periods.
    gc.collect()
    gc.freeze()
    for node in nodes:
        node.start()
    watch = _watch_output(nodes[0])
    while not (stop or all(node.finished for node in nodes)):
        _turn(executor, nodes, watch)
    _go_on(executor, max(node.linger for node in nodes) if stop else _FAREWELL)


def _go_on(executor: EventsExecutor, seconds: float) -> None:
    """Process events for a while."""
    end = now() + seconds
    while now() < end:
        executor.spin_once(timeout_sec=0.01)


def run(name: str, about: str, make: Callable[[str], Runnable], args: Sequence[str] | None) -> int:
    """Run the nodes that ``make`` builds, one per axis, until told to stop or shut down; return the exit code.

    rclpy's own handlers would end the context before a last command is sent, so signals are handled here. A parameter
    out of bounds or a misspelled one ends the process at once with code 2 and a line that names it. If the middleware
    does not release a stopped node, the process ends with code 1 and a traceback.

    ``name`` is used in the log until there is a node; ``about`` is the description in the help.
    """
    avoid_shared_memory()
    words = sys.argv[1:] if args is None else list(args)
    never_wait()
    try:
        axes = _axes(name, about, words)
        refuse_repeated_keys(words)
        rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, RepeatedKeyError) as error:  # unreadable arguments or parameter file
        return _refuse(name, error)
    COMMAND_LINE.set(parameter_rules(words))
    logging.getLogger("backlash_ros").addHandler(_RosLog(name))
    logging.getLogger("backlash_ros").setLevel(logging.INFO)
    stop = Stop()
    nodes: list[Runnable] = []
    # The fastest executor; its spin() ignores signals, so it is spun event by event.
    executor = EventsExecutor()
    code = 0
    try:
        try:
            if len({axis.strip("/") for axis in axes}) < len(axes):
                raise ValueError(f"--axes must be different from each other, got {axes}")
            nodes.extend(_made(make, axis) for axis in axes)
        except (ValueError, NameValidationException, ParameterException, InvalidParameterTypeException) as error:
            return _refuse(name, error)
        try:
            _spin(executor, nodes, stop)
        except Exception as error:  # in any case the drive is left safe and the reason is logged
            _report(nodes[0], error)
            code = 1
        finally:
            if [node for node in nodes if not _stopped(node) or node.broken]:
                code = 1
        if code == 0 and all(isinstance(node, ManagedNode) for node in nodes):
            try:
                _go_on(executor, _LAST_WORDS)
            except Exception as error:  # the drive has its last command already
                _report(nodes[0], error)
                code = 1
        return code
    finally:
        stop.ignore_more()
        # It ends the process even if a middleware call that never returns holds Python's lock.
        faulthandler.dump_traceback_later(_LEAVING, exit=True, file=2)
        for node in nodes:
            executor.remove_node(node)
            node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()
