"""Pure computation: figures of a step response or of a path, the same for every page and study that judges one."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CONTACT = 0.9
"""Teeth touch if abs(gap) >= 0.9 d/2: the paper's law is soft, and few samples show the peak of a contact."""
SETTLED = 0.25
"""Band of a settled load, in b."""
_STANDS = 1e-9
"""Way of a setpoint from sample to sample below which it stands, rad: its polynomials are no more exact."""
_ROUNDS, _LONGEST_LAG = 8, 1.0
"""Rounds in which a lag is found, and the longest, s."""
TAIL = 1.0
"""The end of a record in which swing and error are taken, and for which a settled load must stay in its band, s."""


@dataclass(frozen=True)
class StepFigures:
    """A step response in figures: times in s, angles in rad.

    ``rise`` 10 to 90 %, nan if 90 % is never reached. ``settling``: when it entered the band for good, inf if never.
    ``overshoot`` beyond the target, negative if it stays short of it. In the last second ``swing``, peak to peak, and
    ``error``, of the mean.
    """

    rise: float
    settling: float
    overshoot: float
    swing: float
    error: float


@dataclass(frozen=True)
class StepResponse:
    """A step response in figures, in units of the backlash.

    ``rise_time`` 10 to 90 %, s. ``overshoot`` beyond the target and ``residual`` peak to peak at the end, in b.
    ``impacts``: flank contacts after the loop first came within the backlash of the target. ``settling_time``: when it
    was within b/4 for good, s, inf if never.
    """

    rise_time: float
    overshoot: float
    residual: float
    impacts: int
    settling_time: float


@dataclass(frozen=True)
class PathFigures:
    """How a load followed a path: angles in rad, times in s.

    ``rms`` error until the path ends, ``largest`` error also after that, ``final`` error, with its sign, at the end of
    the record. ``lag``: the time by which the path, shifted, fits the load best; nan where it does not move.
    ``reversals`` of the path, at each of which the teeth may change sides.
    """

    rms: float
    largest: float
    final: float
    lag: float
    reversals: int


def path_figures(time: Array, position: Array, setpoint: Array, end: float) -> PathFigures:
    """Judge how a load, ``position``, follows a ``setpoint``, both in rad and of shape (N,); ``end`` of the path, s."""
    error = position - setpoint
    during = time <= end
    ways = np.diff(setpoint)
    ways = ways[np.abs(ways) > _STANDS]
    return PathFigures(
        rms=float(np.sqrt(np.mean(error[during] ** 2))),
        largest=float(np.max(np.abs(error))),
        final=float(error[-1]),
        lag=_lag(time, position, setpoint),
        reversals=int(np.count_nonzero(np.diff(np.sign(ways)))),
    )


def _lag(time: Array, position: Array, setpoint: Array) -> float:
    """Return the shift of ``setpoint`` that fits ``position`` best, s, by Gauss and Newton; nan if it stands."""
    speed, lag = np.gradient(setpoint, time), 0.0
    for _ in range(_ROUNDS):
        shifted, slope = (np.interp(time - lag, time, values) for values in (setpoint, speed))
        if (power := float(slope @ slope)) == 0.0:
            return math.nan
        lag -= float(slope @ (position - shifted)) / power
        lag = min(max(lag, -_LONGEST_LAG), _LONGEST_LAG)
    return lag


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


def count_crossings(gap: Array, backlash: float) -> int:
    """Count passages through the gap, from one flank, abs(gap) >= 0.9 d/2, to the other; both in m."""
    touching = gap[np.abs(gap) >= CONTACT * 0.5 * backlash]
    return int(np.count_nonzero(np.diff(np.sign(touching))))


def settling_time(time: Array, position: Array, target: float, band: float, last: float = 0.0) -> float:
    """Return when abs(position - target) was last above ``band``, s.

    Inf if it still is at the end, or was in the ``last`` seconds: a swinging load has not settled.
    """
    outside = np.flatnonzero(np.abs(position - target) > band)
    if outside.size == 0:
        settled = 0.0
    else:
        settled = math.inf if outside[-1] == position.size - 1 else float(time[outside[-1] + 1])
    return settled if settled <= time[-1] - last else math.inf


def step_figures(
    time: Array,
    position: Array,
    target: float,
    band: float,
    *,
    origin: float | None = None,
    end: float | None = None,
    tail: float = TAIL,
) -> StepFigures:
    """Judge a step response.

    Parameters
    ----------
    time, position : shape (N,), from the step on: s and rad
    target, band : of the settled load, rad
    origin : of the reference, rad, which tells the direction; by default position[0]
    end, tail : the end of the part in which swing and error are taken, by default that of the record, and its length, s
    """
    start, end = float(position[0]), float(time[-1]) if end is None else end
    direction = math.copysign(1.0, target - (start if origin is None else origin))
    rest = position[(time >= end - tail) & (time <= end)]
    return StepFigures(
        rise=rise_time(time, position, start, target),
        settling=settling_time(time, position, target, band, tail),
        overshoot=float(np.max(direction * (position - target))),
        swing=float(np.ptp(rest)),
        error=float(np.mean(rest)) - target,
    )


def step_response(
    time: Array, position: Array, gap: Array, *, target: float, backlash: float, backlash_angle: float
) -> StepResponse:
    """Judge one step response.

    Parameters
    ----------
    time, position, gap : shape (N,), from the step on: s, load angle in rad, R1 theta_m - R2 theta_l in m
    target : rad; the step starts at position[0]
    backlash, backlash_angle : d in m and b in rad, the units of the result
    """
    found = step_figures(time, position, target, SETTLED * backlash_angle)
    within = np.flatnonzero(np.abs(position - target) < backlash_angle)
    arrived = int(within[0]) if within.size else position.size
    return StepResponse(
        rise_time=found.rise,
        overshoot=found.overshoot / backlash_angle,
        residual=found.swing / backlash_angle,
        impacts=count_impacts(gap[arrived:], backlash),
        settling_time=found.settling,
    )
