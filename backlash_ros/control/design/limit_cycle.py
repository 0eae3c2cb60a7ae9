"""Pure computation, no clock: finds whether a record is a limit cycle, and its amplitude and period.

Samples are joined by the cubic Hermite curve through position and speed, so that eight samples a cycle give the
amplitude that lies between them.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from backlash_ros.foundation.record import Array

_POINTS = 16
_CROSSING_BAND = 0.2


@dataclass(frozen=True)
class LimitCycle:
    """A repeating oscillation: means over its cycles, and the spread between cycles.

    ``amplitude`` is peak to peak in the unit of the record, ``period`` in s; the spreads are
    (largest - smallest)/mean over the cycles.
    """

    amplitude: float
    amplitude_spread: float
    period: float
    period_spread: float
    cycles: int


def refine(position: Array, speed: Array, period: float) -> Array:
    """Return the Hermite curve through samples every ``period`` s, 16 points a sample: shape (16 (N - 1) + 1,)."""
    t = (np.arange(_POINTS) / _POINTS)[None, :]
    here, there = position[:-1, None], position[1:, None]
    slope_here, slope_there = period * speed[:-1, None], period * speed[1:, None]
    curve = (1 + 2 * t) * (1 - t) ** 2 * here + t * (1 - t) ** 2 * slope_here
    curve += t**2 * (3 - 2 * t) * there + t**2 * (t - 1) * slope_there
    return np.append(curve.ravel(), position[-1])


def cycle_starts(curve: Array) -> NDArray[np.intp]:
    """Return where ``curve`` rises through its middle, once per cycle; noise within a band is ignored."""
    low, high = float(np.min(curve)), float(np.max(curve))
    middle, band = 0.5 * (low + high), _CROSSING_BAND * (high - low)
    side = np.where(curve > middle + band, 1, np.where(curve < middle - band, -1, 0))
    decided = np.flatnonzero(side)
    rising = (side[decided[:-1]] < 0) & (side[decided[1:]] > 0)
    starts = [
        int(below + np.flatnonzero(curve[below:above] <= middle)[-1])
        for below, above in zip(decided[:-1][rising], decided[1:][rising], strict=True)
    ]
    return np.array(starts, dtype=np.intp)


def find_limit_cycle(position: Array, speed: Array, period: float, travel: Array | None = None) -> LimitCycle | None:
    """Return the limit cycle of a record, or None if it has fewer than two whole cycles.

    Parameters
    ----------
    position, speed : shape (N,), the oscillating signal and its rate, sampled every ``period`` s
    travel : a second curve from `refine`; its peak-to-peak amplitude over the same cycles replaces the position's
    """
    if position.size < 8 or float(np.ptp(position)) == 0.0:
        return None
    curve = refine(position, speed, period)
    starts = cycle_starts(curve)
    if starts.size < 3:
        return None
    seen = curve if travel is None else travel
    amplitudes = np.array([np.ptp(seen[a : b + 1]) for a, b in pairwise(starts)])
    periods = np.diff(starts) * (period / _POINTS)
    return LimitCycle(
        amplitude=float(np.mean(amplitudes)),
        amplitude_spread=float(np.ptp(amplitudes) / np.mean(amplitudes)) if np.any(amplitudes) else math.inf,
        period=float(np.mean(periods)),
        period_spread=float(np.ptp(periods) / np.mean(periods)),
        cycles=int(periods.size),
    )
