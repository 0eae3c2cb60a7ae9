"""Calls at a fixed rate, made by the loop of `run` between two events.

Not by timers of rclpy: its events executor passes each through a thread and a queue, where one that is overdue while
others are added is queued again and again, and then called too early and too often (rclpy 7.1.6).
"""

import math
import time
from collections.abc import Callable, Sequence

now = time.monotonic
"""The steady clock, s: it neither jumps nor stops with ROS time. All beats and watchdogs go by it."""


class Timer:
    """Calls back every ``period`` s from now on; calls that were missed are left out, the phase is kept."""

    def __init__(self, period: float, callback: Callable[[], None]) -> None:
        self._period = period
        self._callback = callback
        self.due = now() + period

    def call(self) -> None:
        """Call back, and be due again."""
        self.due += self._period * max(1, math.ceil((now() - self.due) / self._period))
        self._callback()


def call_due(timers: Sequence[Timer]) -> tuple[int, float]:
    """Call each timer that is due; return how many were, and in how many seconds the next one will be."""
    at = now()
    due = [timer for timer in timers if timer.due <= at]
    for timer in due:
        timer.call()
    return len(due), min(timer.due for timer in timers) - now()
