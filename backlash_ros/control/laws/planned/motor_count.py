"""The count of the motor's encoder, and the observer's gain for it.

A coarse reading says little, and less of a speed than of an angle: with the gain for a fine one the observer would take
each count for a torque.
"""

import math

from backlash_ros.control.laws.planned.constants import FINEST_ERROR, GAINS
from backlash_ros.control.laws.planned.memory import Count, Motor
from backlash_ros.foundation.compiled import compiled

_NO_CHANGE = 1e-9
"""Rad, up to which two readings are the same."""
_SAME = 0.02
"""Share of a count by which a change may be off a multiple of it: readings are rounded."""
_AGREE = 8.0
"""Changes in a row that must agree on a count: by chance each is a multiple of twice the count, one in two."""
_FINE = 0.25
"""Share of `FINEST_ERROR` below which it does not matter how fine a count is."""


@compiled
def find_count(count: Count, reading: float) -> None:
    """Take a believed reading, rad: the count is the greatest common divisor of all changes (Euclid)."""
    change, count.reading = abs(reading - count.reading), reading
    if change <= _NO_CHANGE or 0.0 < count.width < _FINE * FINEST_ERROR:
        return
    if count.width == 0.0:
        count.width = change
        return
    width, rest = count.width, abs(change - count.width * round(change / count.width))
    count.agreeing = count.agreeing + 1.0 if rest <= _SAME * width else 0.0
    while rest > _SAME * width and width >= _FINE * FINEST_ERROR:
        width, rest = rest, abs(width - rest * round(width / rest))
    count.width = width


@compiled
def choose_gain(motor: Motor, reading: float, counts: float) -> None:
    """Choose the observer's gain by a believed reading of the motor's angle at the output, rad.

    It may be off by so many ``counts``.
    """
    find_count(motor.count, reading)
    error = counts * motor.count.width if motor.count.agreeing >= _AGREE else 0.0
    doublings = math.log(max(error / FINEST_ERROR, 1.0)) / math.log(2.0)
    motor.gain = min(round(doublings), GAINS - 1.0)
