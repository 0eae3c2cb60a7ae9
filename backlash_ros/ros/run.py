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

from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.output import Backlog, never_wait
from backlash_ros.ros.overrides import COMMAND_LINE, parameter_rules
from backlash_ros.ros.timer import Timer, call_due, now
from backlash_ros.ros.transport import avoid_shared_memory


class StoppableNode(Node):
    """A node with something to do before it goes, such as putting 0 V out.

    ``linger``: how long it goes on after it was told to stop, s, to work off what has already arrived.
    """

    linger = 0.0
    own_timers: Sequence[Timer] = ()
    finished = broken = False

    def __init__(self, name: str) -> None:
        super().__init__(name, cli_args=list(COMMAND_LINE.get()))

    def prepare(self) -> None:
        """Do what takes its time; the executor knows the node by now."""

    def start(self) -> None:
        """Begin."""

    def stop(self) -> None:
        """Leave things safe and whole; the context is still alive."""


Runnable = ManagedNode | StoppableNode

_FAREWELL = 0.5
"""How long nodes that were shut down on request go on, s: the answer has to leave."""

_LEAVING = 10.0
"""How long the process may take to leave the graph, s. Fast DDS may lock itself up there, beside others that leave."""


class Stop:
    """Becomes true on SIGINT, SIGTERM or, unless nohup had it ignored, SIGHUP: the terminal was closed."""

    def __init__(self) -> None:
        self._asked = False
        ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        self._numbers = [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]
        for number in self._numbers:
            signal.signal(number, self._ask)

    def ignore_more(self) -> None:
        """Let no further signal end the process before it ends well: `ros2 launch` passes on what the terminal sent."""
        for number in self._numbers:
            signal.signal(number, signal.SIG_IGN)

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self._asked = True

    def __bool__(self) -> bool:
        return self._asked


class _RosLog(logging.Handler):
    """Hands what the library says to the ROS log."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            get_logger(self._name).warning(record.getMessage())
        else:
            get_logger(self._name).info(record.getMessage())


def help_of(name: str, about: str) -> argparse.ArgumentParser:
    """Return the parser of what stands before ``--ros-args``; its help says what the node is, in ``about``, and how."""
    return argparse.ArgumentParser(
        prog=name,
        description=about,
        epilog="Parameters and remaps stand behind --ros-args: -p NAME:=VALUE, --params-file FILE, -r FROM:=TO.\n"
        "docs/parameters.md has all parameters, with units and bounds; so has a running node: ros2 param describe.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _axes(name: str, about: str, words: Sequence[str]) -> list[str]:
    """Return the namespaces that ``--axes`` gives, one node each; without it one, that of the process.

    Help, and words that nobody knows, end it: a parameter file without ``--ros-args`` before it must not be overlooked.
    """
    parser = help_of(name, about)
    parser.add_argument("--axes", nargs="+", default=[""], metavar="NAMESPACE", help="one node in each")
    axes: list[str] = parser.parse_args(remove_ros_args(list(words))).axes
    return axes


def _made(make: Callable[[str], Runnable], axis: str) -> Runnable:
    node = make(axis)
    if axis and node.get_namespace().strip("/") != axis.strip("/"):
        raise ValueError("with --axes the namespaces are the axes: --axes arm/elbow, not __ns:=arm")
    return node


def _refuse(name: str, error: Exception) -> int:
    """Say in one line, without places in the source of rcl, why nothing starts; return the exit code."""
    reason = " ".join(re.sub(r",? at \S+:\d+", "", str(error)).split())
    get_logger(name).fatal(f"cannot start: {reason}")
    return 2


def _report(node: Node, error: Exception) -> None:
    node.get_logger().fatal(f"{type(error).__name__}: {error}")
    node.get_logger().debug(traceback.format_exc())


def _stopped(node: Runnable) -> bool:
    """Stop a node and return whether that went well; what went wrong with one must not keep the others from it."""
    try:
        node.stop()
    except Exception as error:
        _report(node, error)
        return False
    return True


def _watch_output(node: Node) -> Timer:
    """Return a timer that tells when lines are taken again that were not, which nobody saw."""
    backlog = Backlog()

    def look() -> None:
        if held := backlog.ended():
            where = get_logging_directory()
            node.get_logger().warning(f"no output was taken for {held:.0f} s: lines may be missing, {where} has them")

    return Timer(1.0, look)


def _turn(executor: EventsExecutor, nodes: Sequence[Runnable], watch: Timer) -> None:
    """Call a timer that is due and work off one event, which may come until the next timer is due.

    Neither starves the other: timers that are overdue leave beats out.
    """
    wait = call_due([watch, *(timer for node in nodes for timer in node.own_timers)])
    executor.spin_once(timeout_sec=min(max(wait, 0.0), 0.1))


def run(name: str, about: str, make: Callable[[str], Runnable], args: Sequence[str] | None) -> int:
    """Run the nodes that ``make`` builds, one per axis, until told to stop or shut down; return the exit code.

    rclpy's own handlers would end the context before a last command could leave, so signals are taken here.
    A parameter out of bounds, or one that nobody knows, ends it at once with code 2 and a line that says which. Where
    the middleware does not let go of a node that has been stopped, the process ends with code 1 and says where it was.

    ``name`` stands in the log until there is a node; ``about`` is what the help says of it.
    """
    avoid_shared_memory()
    words = sys.argv[1:] if args is None else list(args)
    never_wait()
    try:
        axes = _axes(name, about, words)
        rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # arguments or a parameter file that cannot be read
        return _refuse(name, error)
    COMMAND_LINE.set(parameter_rules(words))
    logging.getLogger("backlash_ros").addHandler(_RosLog(name))
    logging.getLogger("backlash_ros").setLevel(logging.INFO)
    stop = Stop()
    nodes: list[Runnable] = []
    # The fastest executor there is; its spin() ignores signals, so it is spun event by event.
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
            for node in nodes:
                executor.add_node(node)
                node.prepare()
            # What is there by now stays: a look for garbage among it would stop the loop for many periods.
            gc.collect()
            gc.freeze()
            for node in nodes:
                node.start()
            watch = _watch_output(nodes[0])
            while not (stop or all(node.finished for node in nodes)):
                _turn(executor, nodes, watch)
            end = now() + (max(node.linger for node in nodes) if stop else _FAREWELL)
            while now() < end:
                executor.spin_once(timeout_sec=0.01)
        except Exception as error:  # whatever it is, the drive is left safe and the reason is in the log
            _report(nodes[0], error)
            code = 1
        finally:
            if [node for node in nodes if not _stopped(node) or node.broken]:
                code = 1
        return code
    finally:
        stop.ignore_more()
        # It ends the process even where a call into the middleware that never returns holds Python's lock.
        faulthandler.dump_traceback_later(_LEAVING, exit=True, file=2)
        for node in nodes:
            executor.remove_node(node)
            node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()
