"""How every node of this package runs: started from arguments, spun, and stopped in order on SIGINT or SIGTERM."""

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


class StoppableNode(Node):
    """A node with something to do before it goes, such as putting 0 V out.

    ``linger``: how long it goes on after it was told to stop, s, to work off what has already arrived.
    """

    linger = 0.0

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


def _report(node: Node, error: Exception) -> None:
    node.get_logger().fatal(f"{type(error).__name__}: {error}")
    node.get_logger().debug(traceback.format_exc())


def run(make: Callable[[], StoppableNode], args: Sequence[str] | None) -> int:
    """Run the node that ``make`` builds until it is told to stop; return the exit code.

    rclpy's own handlers would end the context before a last command could leave, so signals are taken here.
    A parameter out of bounds ends it at once with code 2 and a line that says which.
    """
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    stop = Stop()
    try:
        try:
            node = make()
        except (ValueError, ParameterException, InvalidParameterTypeException) as error:
            print(f"cannot start: {error}", file=sys.stderr)
            return 2
        # The fastest executor there is; its spin() ignores signals, so it is spun event by event.
        executor = EventsExecutor()
        executor.add_node(node)
        code = 0
        try:
            while not stop:
                executor.spin_once(timeout_sec=0.1)
            end = time.monotonic() + node.linger
            while time.monotonic() < end:
                executor.spin_once(timeout_sec=0.01)
        except Exception as error:  # whatever it is, the drive is left safe and the reason is in the log
            _report(node, error)
            code = 1
        finally:
            try:
                node.stop()
            except Exception as error:
                _report(node, error)
                code = 1
            executor.remove_node(node)
            executor.shutdown()
            node.destroy_node()
        return code
    finally:
        rclpy.try_shutdown()
