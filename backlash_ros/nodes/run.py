"""How every node of this package runs: started from arguments, spun, and stopped in order on SIGINT or SIGTERM."""

import argparse
import gc
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

from backlash_ros.nodes.managed import ManagedNode
from backlash_ros.nodes.timer import Timer, call_due, now


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


class Stop:
    """Becomes true on SIGINT or SIGTERM."""

    def __init__(self) -> None:
        self._asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self._asked = True

    def __bool__(self) -> bool:
        return self._asked

    @staticmethod
    def done() -> None:
        """Leave the signals alone: a second Ctrl-C must not kill the interpreter while it ends."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _axes(args: Sequence[str] | None) -> list[str]:
    """Return the namespaces that ``--axes`` gives, one node each; without it one, that of the process."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--axes", nargs="+", default=[""], metavar="NAMESPACE")
    words = remove_ros_args(sys.argv[1:] if args is None else list(args))
    axes = list(parser.parse_known_args(words)[0].axes)
    if len({axis.strip("/") for axis in axes}) < len(axes):
        raise ValueError(f"--axes must be different from each other, got {axes}")
    return axes


def _turn(executor: EventsExecutor, nodes: Sequence[ManagedNode | StoppableNode]) -> None:
    """Call the timers that are due, then work off one event, which may come until the next timer is due.

    When the timers are late it is one event more than timers were called: what has piled up goes down, and neither
    starves the other.
    """
    called, wait = call_due([timer for node in nodes for timer in node.own_timers])
    for _ in range(1 if wait > 0 else called + 1):
        executor.spin_once(timeout_sec=min(max(wait, 0.0), 0.1))


def run(make: Callable[[str], ManagedNode | StoppableNode], args: Sequence[str] | None) -> int:
    """Run the nodes that ``make`` builds, one per axis, until told to stop; return the exit code.

    rclpy's own handlers would end the context before a last command could leave, so signals are taken here.
    A parameter out of bounds ends it at once with code 2 and a line that says which.
    """
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    stop = Stop()
    nodes: list[ManagedNode | StoppableNode] = []
    # The fastest executor there is; its spin() ignores signals, so it is spun event by event.
    executor = EventsExecutor()
    code = 0
    try:
        try:
            for axis in _axes(args):
                nodes.append(make(axis))
                if axis and nodes[-1].get_namespace().strip("/") != axis.strip("/"):
                    raise ValueError("with --axes the namespaces are the axes: --axes arm/elbow, not __ns:=arm")
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
            nodes[0].get_logger().fatal(f"{type(error).__name__}: {error}")
            nodes[0].get_logger().debug(traceback.format_exc())
            code = 1
        finally:
            for node in nodes:
                node.stop()
        return code
    finally:
        for node in nodes:
            executor.remove_node(node)
            node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
        stop.done()
