"""Pure computation: judges a record of the load. Lengths are in units of the mean backlash b."""

import math
from dataclasses import dataclass

from backlash_ros.studies.metrics import SETTLED, TAIL, Array, settling_time, step_figures

QUIET, PRECISE, OVERSHOOT = 0.05, 0.1, 0.25
"""Largest swing in the last second, final error and overshoot, in b."""


@dataclass(frozen=True)
class Move:
    """A step response in figures.

    In b: ``swing`` peak to peak and ``error`` of the mean, both in the last second, and ``overshoot``. In s:
    ``settle``, after which the load stays within the band, and ``rise`` from 10 to 90 %; if never, the length of the
    record.
    """

    swing: float = math.nan
    error: float = math.nan
    overshoot: float = math.nan
    settle: float = math.nan
    rise: float = math.nan


def threshold(share: float, b: float, count: float) -> float:
    """Return a threshold in b: ``share``, or a count of the load's encoder (rad) if that is larger."""
    return max(share, count / b)


def judge_move(time: Array, position: Array, target: float, b: float, count: float) -> Move:
    """Judge a step response.

    Parameters
    ----------
    time : s, shape (N,), from 0 at the step
    position : rad, shape (N,): what a perfect encoder would read
    target : rad; the step starts from position[0]
    b, count : mean backlash and count of the load's encoder, rad
    """
    found, end = step_figures(time, position, target, b * threshold(SETTLED, b, count)), float(time[-1])
    return Move(
        swing=found.swing / b,
        error=abs(found.error) / b,
        overshoot=max(0.0, found.overshoot) / b,
        settle=min(found.settling, end),
        rise=end if math.isnan(found.rise) else found.rise,
    )


def recovery(time: Array, position: Array, target: float, b: float, count: float, share: float = SETTLED) -> float:
    """Return when the load stays within b/4 of its target, s, or the length of the record if it never does.

    ``share`` replaces 1/4. The load must stay there for at least the last second, so that a swinging load does not
    count as settled.
    """
    return min(settling_time(time, position, target, b * threshold(share, b, count), TAIL), float(time[-1]))
