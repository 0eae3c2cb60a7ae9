"""How every node of this package runs: started from arguments, spun, and stopped in order by a signal."""

import argparse
import gc
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, NameValidationException, ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.timer import Timer, call_due, now


class StoppableNode(Node):
    """A node with something to do before it goes, such as putting 0 V out.

    ``linger``: how long it goes on after it was told to stop, s, to work off what has already arrived.
    """

    linger = 0.0
    own_timers: Sequence[Timer] = ()

    def prepare(self) -> None:
        """Do what takes its time; the executor knows the node by now."""

    def start(self) -> None:
        """Begin."""

    def stop(self) -> None:
        """Leave things safe and whole; the context is still alive."""


Runnable = ManagedNode | StoppableNode


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


def _axes(args: Sequence[str] | None) -> list[str]:
    """Return the namespaces that ``--axes`` gives, one node each; without it one, that of the process.

    Help, and words that nobody knows, end it: a parameter file without ``--ros-args`` before it must not be overlooked.
    """
    parser = argparse.ArgumentParser(epilog="parameters, remaps and the like stand behind --ros-args")
    parser.add_argument("--axes", nargs="+", default=[""], metavar="NAMESPACE", help="one node in each")
    return list(parser.parse_args(remove_ros_args(sys.argv[1:] if args is None else list(args))).axes)


def _made(make: Callable[[str], Runnable], axis: str) -> Runnable:
    node = make(axis)
    if axis and node.get_namespace().strip("/") != axis.strip("/"):
        raise ValueError("with --axes the namespaces are the axes: --axes arm/elbow, not __ns:=arm")
    return node


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


def _turn(executor: EventsExecutor, nodes: Sequence[Runnable]) -> None:
    """Call a timer that is due and work off one event, which may come until the next timer is due.

    Neither starves the other: timers that are overdue leave beats out.
    """
    wait = call_due([timer for node in nodes for timer in node.own_timers])
    executor.spin_once(timeout_sec=min(max(wait, 0.0), 0.1))


def run(make: Callable[[str], Runnable], args: Sequence[str] | None) -> int:
    """Run the nodes that ``make`` builds, one per axis, until told to stop; return the exit code.

    rclpy's own handlers would end the context before a last command could leave, so signals are taken here.
    A parameter out of bounds ends it at once with code 2 and a line that says which.
    """
    # Fast DDS' shared memory lets a listener that is stopped hold up who publishes, for 1 s (docs/faults.md).
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    try:
        axes = _axes(args)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # arguments or a parameter file that cannot be read
        print(f"cannot start: {error}", file=sys.stderr)
        return 2
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
            print(f"cannot start: {error}", file=sys.stderr)
            return 2
        try:
            for node in nodes:
                executor.add_node(node)
                node.prepare()
            # What is there by now stays: a look for garbage among it would stop the loop for many periods.
            gc.collect()
            gc.freeze()
            for node in nodes:
                node.start()
            while not stop:
                _turn(executor, nodes)
            end = now() + max(node.linger for node in nodes)
            while now() < end:
                executor.spin_once(timeout_sec=0.01)
        except Exception as error:  # whatever it is, the drive is left safe and the reason is in the log
            _report(nodes[0], error)
            code = 1
        finally:
            if [node for node in nodes if not _stopped(node)]:
                code = 1
        return code
    finally:
        stop.ignore_more()
        for node in nodes:
            executor.remove_node(node)
            node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
