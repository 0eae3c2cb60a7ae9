"""How every node of this package runs: started from arguments, spun, and stopped in order on SIGINT or SIGTERM."""

import argparse
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from backlash_ros.nodes.managed import ManagedNode


class StoppableNode(Node):
    """A node with something to do before it goes, such as putting 0 V out.

    ``linger``: how long it goes on after it was told to stop, s, to work off what has already arrived.
    """

    linger = 0.0

    def start(self) -> None:
        """Begin; the executor knows the node by now."""

    def stop(self) -> None:
        """Leave things safe and whole; the context is still alive."""


class Stop:
    """Becomes true on SIGINT or SIGTERM."""

    _NUMBERS = signal.SIGINT, signal.SIGTERM

    def __init__(self) -> None:
        self._asked = False
        for number in self._NUMBERS:
            signal.signal(number, self._ask)

    def ignore_more(self) -> None:
        """Let no further signal end the process before it ends well: `ros2 launch` passes on what the terminal sent."""
        for number in self._NUMBERS:
            signal.signal(number, signal.SIG_IGN)

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self._asked = True

    def __bool__(self) -> bool:
        return self._asked


def _axes(args: Sequence[str] | None) -> list[str]:
    """Return the namespaces that ``--axes`` gives, one node each; without it one, that of the process."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--axes", nargs="+", default=[""], metavar="NAMESPACE")
    words = remove_ros_args(sys.argv[1:] if args is None else list(args))
    axes = list(parser.parse_known_args(words)[0].axes)
    if len(set(axes)) < len(axes):
        raise ValueError(f"--axes must be different from each other, got {axes}")
    return axes


def _report(node: Node, error: Exception) -> None:
    node.get_logger().fatal(f"{type(error).__name__}: {error}")
    node.get_logger().debug(traceback.format_exc())


def _stopped(node: ManagedNode | StoppableNode) -> bool:
    """Stop a node and return whether that went well; what went wrong with one must not keep the others from it."""
    try:
        node.stop()
    except Exception as error:
        _report(node, error)
        return False
    return True


def run(make: Callable[[str], ManagedNode | StoppableNode], args: Sequence[str] | None) -> int:
    """Run the nodes that ``make`` builds, one per axis, until told to stop; return the exit code.

    rclpy's own handlers would end the context before a last command could leave, so signals are taken here.
    A parameter out of bounds ends it at once with code 2 and a line that says which.
    """
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # arguments or a parameter file that cannot be read
        print(f"cannot start: {error}", file=sys.stderr)
        return 2
    stop = Stop()
    nodes: list[ManagedNode | StoppableNode] = []
    # The fastest executor there is; its spin() ignores signals, so it is spun event by event.
    executor = EventsExecutor()
    code = 0
    try:
        try:
            for axis in _axes(args):
                nodes.append(make(axis))
                if len({node.get_fully_qualified_name() for node in nodes}) < len(nodes):
                    raise ValueError("with --axes the namespaces are the axes: --axes arm/elbow, not __ns:=arm")
        except (ValueError, ParameterException, InvalidParameterTypeException) as error:
            print(f"cannot start: {error}", file=sys.stderr)
            return 2
        try:
            for node in nodes:
                executor.add_node(node)
                node.start()
            while not stop:
                executor.spin_once(timeout_sec=0.1)
            end = time.monotonic() + max(node.linger for node in nodes)
            while time.monotonic() < end:
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
