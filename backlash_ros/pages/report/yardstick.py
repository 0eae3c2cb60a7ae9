"""What the motion of an axis is measured by: backlash, middle of the gap, a count of its encoder; what swings count.

Pure computation.
"""

import math
from typing import NamedTuple

import numpy as np

from backlash_ros.foundation.record import Array
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.studies.judging import QUIET

_FEWEST_CYCLES, _EVEN, _MOST = 3, 0.25, 0.75
"""Least number of periods of a limit cycle; largest relative deviation of a period from their median; and least share
of periods within that, since a late answer makes one longer."""
_ONE_COUNT = 1.5
"""Swing up to which a position moved by one count, in counts: between one and two, which rounding does not reach."""
_ROUNDING = 1e-9
"""Difference of positions that is rounding, rad."""


class Yardstick(NamedTuple):
    """Angles at the output, rad: backlash ``b``, 0 if unknown; ``centre`` of the gap, see `gap_centre`; one count."""

    b: float
    centre: float
    resolution: float

    def least_swing(self, unknown: float) -> float:
        """Return the swing, rad, that a limit cycle exceeds; of the backlash, or ``unknown`` where that is."""
        return max(QUIET * self.b if self.b > 0.0 else unknown, _ONE_COUNT * self.resolution)


def yardstick_of(axis: Axis, b: float) -> Yardstick:
    """Return what an axis is measured by; ``b``: its backlash, rad, or 0."""
    return Yardstick(b, gap_centre(axis.twist, b), resolution_of(axis.position))


def resolution_of(position: Array) -> float:
    """Return the smallest difference between positions that were recorded; 0 for less than two.

    Near zero where the encoder is exact.
    """
    steps = np.diff(np.unique(position[np.isfinite(position)]))
    return float(np.min(steps[steps > _ROUNDING], initial=math.inf)) if np.any(steps > _ROUNDING) else 0.0


def gap_centre(twist: Array, b: float) -> float:
    """Return the middle between both flanks, rad at the output; nan if the teeth were not seen on both."""
    known = twist[np.isfinite(twist)]
    if not known.size or not b > 0.0:
        return math.nan
    low, high = float(np.min(known)), float(np.max(known))
    return 0.5 * (low + high) if high - low >= 0.8 * b else math.nan


def limit_cycle(time: Array, position: Array, least: float) -> tuple[float, float]:
    """Return swing, peak to peak, and frequency (Hz) of an oscillation above ``least``; nan if there is none.

    Counted between upward passages of the middle, each after the signal was a quarter of its swing below it. An uneven
    oscillation has no frequency: nan.
    """
    low, high = float(np.min(position)), float(np.max(position))
    swing, middle = high - low, 0.5 * (high + low)
    if not swing > least:
        return math.nan, math.nan
    passages, armed = [], False
    for k in range(1, position.size):
        armed = armed or position[k - 1] < middle - 0.25 * swing
        if armed and position[k - 1] < middle <= position[k]:
            share = (middle - position[k - 1]) / (position[k] - position[k - 1])
            passages.append(float(time[k - 1] + share * (time[k] - time[k - 1])))
            armed = False
    periods = np.diff(passages)
    even = periods[np.abs(periods - np.median(periods)) <= _EVEN * np.median(periods)] if periods.size else periods
    if periods.size < _FEWEST_CYCLES:
        return math.nan, math.nan
    if even.size < max(_FEWEST_CYCLES, _MOST * periods.size):
        return swing, math.nan
    return swing, float(1.0 / np.mean(even))
