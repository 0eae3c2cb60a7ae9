"""Calls at a fixed rate, made by the loop of `run` between two events.

rclpy's timers are not used: its events executor passes each through a thread and a queue, where an overdue timer is
queued again and again while others are added, and then called too early and too often (rclpy 7.1.6).
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
    """Calls back every ``period`` s from now on; missed calls are skipped, the phase is kept.

    ``phase``: the calls are this much, s, after whole periods of the steady clock; without it they count from now.
    ``due``: time of the next call; setting it shifts the beat, as for a watchdog.
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
        """Time since the next call became due, s; negative before."""
        return now() - self.due

    def restart(self, phase: float) -> None:
        """Be due, from now on, ``phase`` s after whole periods of the steady clock."""
        self.due = phase
        self._move_on()

    def call(self) -> None:
        """Call back, and schedule the next call."""
        self._move_on()
        self._callback()


def call_due(timers: Sequence[Timer]) -> float:
    """Call the most overdue timer, if any; return the time until the first timer is (or was) due, s."""
    first = min(timers, key=attrgetter("due"))
    wait = first.due - now()
    if wait <= 0:
        first.call()
    return wait
