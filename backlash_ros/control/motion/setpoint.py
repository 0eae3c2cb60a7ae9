"""The setpoint of the load's motion, and the sources that plan it.

A source plans when it is chosen, outside the tick, and returns polynomial segments, which the tick evaluates at each
sample: position, velocity and acceleration of the load (rad, rad/s, rad/s^2). The end of the last segment is held.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial.polynomial import polyroots, polyval
from numpy.polynomial.polyutils import trimcoef

from backlash_ros.control.limits import Limits
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY, Setpoint

ORDER = 5
"""Largest power of time in a segment."""

DURATION = ORDER + 1
"""Column of a segment with its duration, s; before it the coefficients, c0 first."""


AHEAD = 64
"""Setpoints that a law sees, a period apart: at 1 kHz more than half a crossing of a wide gap and the longest delay."""


SHORTEST_STOP = 0.03
"""Shortest time to come to rest, s: about the time in which the teeth change sides."""


class Source(Protocol):
    """A planner of setpoints: a reference at rest, a profile, a trajectory."""

    def segments(self, start: Setpoint) -> Array:
        """Return the plan from ``start`` on: shape (segments, 7).

        Each row has the coefficients c0 ... c5 of position = sum c_k t^k, t from the row's own start (rad/s^k), then
        its duration in s. After the last one, its end is held.
        """
        ...


@dataclass(frozen=True)
class AtRest:
    """A reference as a source: one position (rad), at rest, from now on."""

    position: float

    def segments(self, start: Setpoint) -> Array:  # noqa: ARG002  independent of the start
        """Return one segment without an end."""
        return np.array([[self.position, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf]])


def joined(begins: Array, ends: Array, durations: Array) -> Array:
    """Return the polynomials between states that are so many seconds apart, lowest power first.

    Parameters
    ----------
    begins, ends : position and, if given, its derivatives, shape (segments, 1 to 3); the result has twice the columns
    durations : s, shape (segments,)
    """
    order = begins.shape[1]
    powers, derivatives = np.arange(2 * order), np.arange(order)
    # In units of the duration: the value at 1 of each derivative of each power.
    at_end = np.array([[math.perm(int(power), int(k)) for power in powers] for k in derivatives], dtype=np.float64)
    scale = durations[:, None] ** powers
    low = begins * scale[:, :order] / [math.factorial(int(k)) for k in derivatives]
    missing = ends * scale[:, :order] - low @ at_end[:, :order].T
    high = np.linalg.solve(at_end[:, order:], missing.T).T
    return np.hstack([low, high]) / scale


@dataclass(frozen=True, eq=False)
class Stop:
    """A motion that comes to rest along its way, as a source: it decelerates evenly, but for a smooth begin and end.

    Parameters
    ----------
    begin : where it begins, wherever the setpoint is
    deceleration : about, rad/s^2; more where it would pass an end of the travel
    lower, upper : ends of the travel, rad
    """

    begin: Setpoint
    deceleration: float
    lower: float
    upper: float

    def segments(self, start: Setpoint) -> Array:  # noqa: ARG002  it says itself where it starts
        """Return one segment."""
        position, velocity, acceleration = (float(value) for value in self.begin)
        # A quintic decelerates with up to 1.5 times the mean; what accelerates now goes on for a while.
        length = max(1.5 * abs(velocity) / self.deceleration, SHORTEST_STOP)
        end = position + length * (0.5 * velocity + acceleration * length / 12.0)
        end = min(max(end, self.lower), self.upper)
        if velocity != 0.0:
            length = min(length, max(2.0 * abs(end - position) / abs(velocity), SHORTEST_STOP))
        row = joined(self.begin[None], np.array([[end, 0.0, 0.0]]), np.array([length]))
        return np.hstack([row, [[length]]])


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Segments that were planned elsewhere, as `Source.segments` returns them.

    Raises
    ------
    ValueError
        If there is none, a number other than the last duration is not finite, or a duration is not > 0 s.
    """

    rows: Array

    def __post_init__(self) -> None:
        rows = self.rows
        if rows.ndim != 2 or rows.shape[0] == 0 or rows.shape[1] != DURATION + 1:
            raise ValueError(f"segments must have the shape (segments, {DURATION + 1}), got {rows.shape}")
        if not np.all(np.isfinite(rows[:, :DURATION])) or not np.all(np.isfinite(rows[:-1, DURATION])):
            raise ValueError("segments must be finite, in rad/s^k and s; only the last duration may be infinite")
        if not np.all(rows[:, DURATION] > 0):
            raise ValueError(f"segments must last > 0 s each, got {rows[:, DURATION].tolist()}")

    def segments(self, start: Setpoint) -> Array:  # noqa: ARG002  they say themselves where they start
        """Return the rows."""
        return np.ascontiguousarray(self.rows, dtype=np.float64)


_BERNSTEIN = np.array([[math.comb(j, k) / math.comb(ORDER, k) for k in range(DURATION)] for j in range(DURATION)])
"""From a polynomial's coefficients, in units of its duration, to points whose hull contains it."""


def _terms(coefficients: Array, durations: Array) -> Array:
    """Return the terms of polynomials at the end of their durations: their coefficients in units of these.

    Negligible powers, which would overflow, and whose roots would, are left out.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.where(coefficients == 0.0, 0.0, coefficients * durations[:, None] ** np.arange(DURATION))


def _turns(terms: Array) -> list[float]:
    """Return the values of a polynomial where it turns within its duration; infinite ones if they cannot be found."""
    rate = terms[1:] * np.arange(1, DURATION)
    largest = float(np.max(np.abs(rate)))
    if not math.isfinite(largest):
        return [-math.inf, math.inf]
    roots = np.asarray(polyroots(trimcoef(rate, 1e-12 * largest)), dtype=complex)
    inside = (np.abs(roots.imag) < 1e-9) & (roots.real > 0) & (roots.real < 1)
    values: list[float] = polyval(roots.real[inside], terms).tolist()
    return values


def _range(coefficients: Array, durations: Array) -> tuple[float, float, float]:
    """Return the smallest and the largest value of polynomials over their durations, and the last one's at its end.

    Only where the hull says that one might go beyond all ends are its turns sought.
    """
    terms = _terms(coefficients, durations)
    reached = terms.sum(axis=1)
    ends = np.concatenate([coefficients[:, 0], reached])
    least, largest = float(np.min(ends)), float(np.max(ends))
    with np.errstate(over="ignore", invalid="ignore"):
        hulls = terms @ _BERNSTEIN.T  # nan where they overflow
    inside = (np.min(hulls, axis=1) >= least) & (np.max(hulls, axis=1) <= largest)
    for k in np.flatnonzero(~inside):
        values = _turns(terms[k])
        least, largest = min([least, *values]), max([largest, *values])
    return least, largest, float(reached[-1])


def extent(segments: Array) -> tuple[float, float, float, float]:
    """Return the start and the end of a plan, and its smallest and largest position, rad."""
    coefficients, durations = segments[:, :DURATION], segments[:, DURATION].copy()
    start, last = float(segments[0, 0]), segments[-1]
    if math.isinf(durations[-1]):
        durations[-1] = 0.0  # a last segment without an end rests, or goes on without one
    least, largest, end = _range(coefficients, durations)
    if math.isinf(last[DURATION]) and (powers := np.flatnonzero(last[1:DURATION])).size:
        end = math.copysign(math.inf, float(last[1 + powers[-1]]))
    return start, end, min(least, end), max(largest, end)


def top_speed(segments: Array) -> float:
    """Return the largest speed of a plan, rad/s; infinite if it goes on without an end."""
    rates = np.zeros((len(segments), DURATION))
    rates[:, :ORDER] = segments[:, 1:DURATION] * np.arange(1, DURATION)
    durations = segments[:, DURATION].copy()
    if math.isinf(durations[-1]):
        if np.any(rates[-1, 1:]):
            return math.inf
        durations[-1] = 0.0
    least, largest, _ = _range(rates, durations)
    return max(-least, largest)


def plan_rejection(segments: Array, limits: Limits, present: float, reach: tuple[float, float]) -> str:
    """Return why a plan is refused with the setpoint at ``present``, rad; empty if it is accepted.

    It must not leave the travel, nor jump by more than ``limits.step`` at its start or from row to row. ``reach``: its
    smallest and largest position, rad.
    """
    starts = segments[:, 0]
    before = np.append(present, _terms(segments[:-1, :DURATION], segments[:-1, DURATION]).sum(axis=1))
    farthest = int(np.argmax(np.abs(starts - before)))
    checks = [(starts[farthest], before[farthest]), *((end, end) for end in reach)]
    return next(filter(None, (limits.rejection_reason(float(to), float(origin)) for to, origin in checks)), "")


@compiled
def is_reference(segments: Array) -> bool:
    """Return whether a plan is a reference at rest."""
    return segments.shape[0] == 1 and math.isinf(segments[0, DURATION]) and not np.any(segments[0, 1:DURATION])


class Cursor(Record):
    """The row of a plan that is being followed, so that a thousand of them cost what one does."""

    row: float = 0.0
    begins: float = 0.0  # s, since the plan began


class Pace(Record):
    """How fast time goes on along a plan: 1 as planned, 0 not at all."""

    now: float = 1.0
    rate: float = 0.0  # 1/s, by which it may change until the next sample


_QUICKEST_PACE = 10.0
"""Rate at which the pace of a slow plan changes, 1/s: a fast one is bound by what the drive can do."""


@compiled
def _towards(value: float, wanted: float, most: float) -> float:
    return wanted if abs(wanted - value) <= most else value + math.copysign(most, wanted - value)


@compiled
def go_at(pace: Pace, wanted: float, period: float) -> float:
    """Let the pace go on towards ``wanted`` for a period, s; return the time along the plan that passes in it, s."""
    before = pace.now
    pace.now = _towards(before, wanted, pace.rate * period)
    return 0.5 * (before + pace.now) * period


@compiled
def _evaluate_row(row: Array, time: float, out: Array) -> None:
    """Write the setpoint at ``time`` (s from the start of a row) into ``out``; after its end it rests."""
    over = time >= row[DURATION]
    if over:
        time = row[DURATION]
    position = velocity = half_acceleration = 0.0
    for k in range(ORDER, -1, -1):
        half_acceleration = half_acceleration * time + velocity
        velocity = velocity * time + position
        position = position * time + row[k]
    out[POSITION] = position
    out[VELOCITY] = 0.0 if over else velocity
    out[ACCELERATION] = 0.0 if over else 2.0 * half_acceleration


@compiled
def evaluate(segments: Array, time: float, out: Setpoint) -> None:
    """Write the setpoint at ``time`` (s from the start of the plan) into ``out``."""
    row, begins = 0, 0.0
    while row < segments.shape[0] - 1 and time - begins >= segments[row, DURATION]:
        begins += segments[row, DURATION]
        row += 1
    _evaluate_row(segments[row], time - begins, out)


def positions_at(segments: Array, times: Array) -> Array:
    """Return the positions of a plan at times from its start (s), rad."""
    out = Setpoint(np.empty(3))
    positions = np.empty_like(times)
    for k, time in enumerate(times):
        evaluate(segments, time, out)
        positions[k] = out[POSITION]
    return positions


@compiled
def look_ahead(
    segments: Array,
    cursor: Cursor,
    pace: Pace,
    wanted: float,
    acceleration: float,
    time: float,
    period: float,
    path: Array,
) -> None:
    """Write the setpoints from ``time`` on, s from the start of the plan, and a period after each other into ``path``.

    Parameters
    ----------
    pace : at the first of them; its rate is written
    wanted : pace towards which it goes
    acceleration : largest one that a change of the pace causes, rad/s^2
    """
    row, begins, last = int(cursor.row), cursor.begins, segments.shape[0] - 1
    now, behind = pace.now, 0.0
    for k in range(path.shape[0]):
        at = time + k * period - behind
        while row < last and at - begins >= segments[row, DURATION]:
            begins += segments[row, DURATION]
            row += 1
        if k == 0:
            cursor.row, cursor.begins = float(row), begins
        _evaluate_row(segments[row], at - begins, path[k])
        if k == 0:
            speed = abs(path[k, VELOCITY])
            pace.rate = _QUICKEST_PACE if _QUICKEST_PACE * speed <= acceleration else acceleration / speed
        if now == 1.0 and wanted == 1.0:
            continue
        # By the chain rule: the plan's time goes on at the pace, which changes at its rate.
        changes = 0.0 if now == wanted else math.copysign(pace.rate, wanted - now)
        path[k, ACCELERATION] = now * now * path[k, ACCELERATION] + changes * path[k, VELOCITY]
        path[k, VELOCITY] *= now
        after = _towards(now, wanted, pace.rate * period)
        behind += (1.0 - 0.5 * (now + after)) * period
        now = after


@compiled
def go_on(period: float, last: int, path: Array) -> None:
    """Write into ``path``, after row ``last``, what is not known: the setpoint goes on at its speed."""
    for k in range(last + 1, path.shape[0]):
        path[k, POSITION] = path[last, POSITION] + (k - last) * period * path[last, VELOCITY]
        path[k, VELOCITY], path[k, ACCELERATION] = path[last, VELOCITY], 0.0
