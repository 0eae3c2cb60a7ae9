"""Calls at a fixed rate, made by the loop of `run` between two events.

Not by timers of rclpy: its events executor passes each through a thread and a queue, where one that is overdue while
others are added is queued again and again, and then called too early and too often (rclpy 7.1.6).
"""

import math
import time
from collections.abc import Callable, Sequence
from operator import attrgetter

now = time.monotonic
"""The steady clock, s: it neither jumps nor stops with ROS time. All periods and watchdogs go by it."""

now_ns = time.monotonic_ns
"""The same clock in ns, as the gates take it."""


def in_ns(seconds: float) -> int:
    """Return a time in ns, from s."""
    return round(1e9 * seconds)


class Timer:
    """Calls back every ``period`` s from now on; calls that were missed are left out, the phase is kept.

    ``phase``: the times are this much, s, after whole periods of the steady clock; without it they count from now.
    ``due``: the next time; whoever sets it moves the beat, as a watchdog is put off.
    """

    def __init__(self, period: float, callback: Callable[[], None], phase: float | None = None) -> None:
        self._period = period
        self._callback = callback
        self.due = now() if phase is None else phase
        self._move_on()

    def _move_on(self) -> None:
        self.due += self._period * (math.floor((now() - self.due) / self._period) + 1)

    @property
    def overdue(self) -> float:
        """For how long the next call has been due, s; negative until then."""
        return now() - self.due

    def restart(self, phase: float) -> None:
        """Be due from now on ``phase`` s after whole periods of the steady clock."""
        self.due = phase
        self._move_on()

    def call(self) -> None:
        """Call back, and be due again."""
        self._move_on()
        self._callback()


def call_due(timers: Sequence[Timer]) -> float:
    """Call the timer that is the most overdue, if one is; return in how many seconds the first was, or is, due."""
    first = min(timers, key=attrgetter("due"))
    wait = first.due - now()
    if wait <= 0:
        first.call()
    return wait
