"""Pure computation: figures of a step response."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CONTACT = 0.9
"""Teeth touch if abs(gap) >= 0.9 d/2: the paper's law is soft, and few samples show the peak of a contact."""


@dataclass(frozen=True)
class StepResponse:
    """A step response in figures.

    ``rise_time`` 10 to 90 %, s. ``overshoot`` beyond the target and ``residual`` peak to peak at the end, in units of
    the backlash. ``impacts``: flank contacts after the loop first came within the backlash of the target.
    """

    rise_time: float
    overshoot: float
    residual: float
    impacts: int


def rise_time(time: Array, position: Array, start: float, target: float) -> float:
    """Return the 10 to 90 % rise time between interpolated crossings, s; nan if 90 % is never reached."""
    progress = (position - start) / (target - start)
    crossings = []
    for level in (0.1, 0.9):
        beyond = np.flatnonzero(progress >= level)
        if beyond.size == 0:
            return float("nan")
        k = int(beyond[0])
        if k == 0:
            crossings.append(float(time[0]))
        else:
            part = (level - progress[k - 1]) / (progress[k] - progress[k - 1])
            crossings.append(float(time[k - 1] + part * (time[k] - time[k - 1])))
    return crossings[1] - crossings[0]


def count_impacts(gap: Array, backlash: float) -> int:
    """Count entries into contact, abs(gap) >= 0.9 d/2; both in m. Contact at the start does not count."""
    touching = np.abs(gap) >= CONTACT * 0.5 * backlash
    return int(np.count_nonzero(touching[1:] & ~touching[:-1]))


def settling_time(time: Array, position: Array, target: float, band: float) -> float:
    """Return when abs(position - target) was last above ``band``; inf if it still is at the end."""
    outside = np.flatnonzero(np.abs(position - target) > band)
    if outside.size == 0:
        return 0.0
    return float("inf") if outside[-1] == position.size - 1 else float(time[outside[-1] + 1])


def step_response(
    time: Array,
    position: Array,
    gap: Array,
    *,
    target: float,
    backlash: float,
    backlash_angle: float,
    tail: float = 1.0,
) -> StepResponse:
    """Judge one step response.

    Parameters
    ----------
    time, position, gap : shape (N,), from the step on: s, load angle in rad, R1 theta_m - R2 theta_l in m
    target : rad; the step starts at position[0]
    backlash, backlash_angle : d in m and b in rad, the units of the result
    tail : length of the end in which the residual is taken, s
    """
    start = float(position[0])
    direction = 1.0 if target > start else -1.0
    end = position[time >= time[-1] - tail]
    within = np.flatnonzero(np.abs(position - target) < backlash_angle)
    arrived = int(within[0]) if within.size else position.size
    return StepResponse(
        rise_time=rise_time(time, position, start, target),
        overshoot=float(np.max(direction * (position - target))) / backlash_angle,
        residual=float(np.ptp(end)) / backlash_angle,
        impacts=count_impacts(gap[arrived:], backlash),
    )
