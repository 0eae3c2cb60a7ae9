"""Figures of a step: speed, overshoot, rest, effort. Pure computation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backlash_ros.control import AUTO
from backlash_ros.control.laws import BEST, UNTIL_THEN
from backlash_ros.foundation.record import Array
from backlash_ros.pages.report.changes import in_use_at
from backlash_ros.pages.report.events import Events, Move
from backlash_ros.pages.report.timing import SETTLING, last_quiet, late_answers
from backlash_ros.pages.report.yardstick import Yardstick, limit_cycle
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.studies.metrics import SETTLED, TAIL, count_crossings, count_impacts, step_figures

_BY_REGIONS = "fast", "overdamped", "two_region", AUTO
"""Laws with gains of a gain set."""

Mask = NDArray[np.bool_]

NEAR = 0.02
"""Band of a settled step if the backlash is unknown, as a share of the step."""
_LEAST_CYCLE = 1e-3
"""Smallest limit cycle if the backlash is unknown, as a share of the step."""
_CYCLE_TIME = 5.0
"""Longest part at the end of a step from which the frequency is taken, s."""
_LEAST_SWING = 1e-3
"""Smallest limit cycle of a hold if the backlash is unknown, rad."""
_HOLD_TIME = 20.0
"""Longest part at the end of a hold from which its limit cycle is taken, s."""
_HOLE = 0.5
"""Time without a sample that ends a step, s."""
_SHORTEST = 5
"""Least number of samples of a step that is judged."""


@dataclass(frozen=True)
class Step:
    """A step response; angles in rad at the output, times in s, nan if the recording does not show them.

    Attributes
    ----------
    start, end, origin, target : of the reference, and of its rest
    ended_by : what ended the rest, in words; empty for the next change of the reference or the end of the bag
    law, gain_set : in use at the start, the law that acted where it was chosen by itself; empty if unknown, and the
        gain set also where the law uses none
    rise : 10 to 90 %
    settling : after which it stays within ``band`` of the target, for at least the last second; inf if never
    overshoot : beyond the target, at least 0
    residual, error : peak to peak, and of the mean, in the last second
    amplitude, frequency : of the limit cycle in the rest, peak to peak and in Hz; nan where there is none; the
        frequency alone is nan where the load swings unevenly
    impacts, crossings : of the teeth, and of the gap from flank to flank, after the load first came within the
        backlash of the target; -1 if unknown
    peak_torque, peak_speed : largest of the motor, N m before the gear, and of the load, rad/s, as recorded
    late_rising, late_rest : whether samples or answers were late during the rise, and all through the rest
    remarks : further notes that are needed to read the figures
    """

    start: float
    end: float
    origin: float
    target: float
    ended_by: str = ""
    law: str = ""
    gain_set: str = ""
    band: float = math.nan
    rise: float = math.nan
    settling: float = math.nan
    overshoot: float = math.nan
    residual: float = math.nan
    error: float = math.nan
    amplitude: float = math.nan
    frequency: float = math.nan
    impacts: int = -1
    crossings: int = -1
    peak_torque: float = math.nan
    peak_speed: float = math.nan
    late_rising: int = 0
    late_rest: bool = False
    remarks: tuple[str, ...] = field(default=())


def _end_of_rest(time: Array, move: Move, events: Events, arrived: float) -> tuple[float, str]:
    """Return when the rest after a move ended, and by what, in words; ``time``: of its samples."""
    found = events.in_the_way(move.start, move.end)
    holes = np.flatnonzero(np.diff(time) > _HOLE)[:1].tolist()
    found += [(float(time[k]), f"samples missing for {time[k + 1] - time[k]:.2f} s") for k in holes]
    found += [
        (change.time, change.named) for change in events.changes if change.moves and arrived < change.time < move.end
    ]
    return min(found, default=(move.end, ""))


def judge(axis: Axis, events: Events, move: Move, yard: Yardstick) -> Step:
    """Return the figures of one step."""
    height = abs(move.target - move.origin)
    near = yard.b if yard.b > 0.0 else 0.1 * height
    first = max(int(np.searchsorted(axis.time, move.start)) - 1, 0)  # where the load was before
    inside = (axis.time >= axis.time[first]) & (axis.time < move.end)
    within = np.flatnonzero(inside & (np.abs(axis.position - move.target) < near))
    end, why = _end_of_rest(axis.time[inside], move, events, float(axis.time[within[0]]) if within.size else math.inf)
    step = _begun(axis, move, end, why, band=SETTLED * yard.b if yard.b > 0.0 else NEAR * height)
    chosen = inside & (axis.time < end) & np.isfinite(axis.position)
    time, position = axis.time[chosen] - move.start, axis.position[chosen]
    if time.size < _SHORTEST:
        return replace(step, remarks=("too few samples to judge it",))
    return _judged(axis, events, step, chosen, time, position, yard)


def _begun(axis: Axis, move: Move, end: float, why: str, **figures: Any) -> Step:
    """Return a step with what was in use at its start; it ended, or its rest, because of ``why``."""
    return Step(move.start, end, move.origin, move.target, why, *law_of(axis, move.start, end), **figures)


def law_of(axis: Axis, start: float, end: float) -> tuple[str, str]:
    """Return the law that acted and its gain set, empty if unknown or, the latter, if it uses none."""
    told = in_use_at(axis, start)
    law, gain_set = (str(told.get(name, "")) for name in ("law", "gain_set"))
    phase = axis.state.get("phase")
    if law == AUTO and phase is not None:
        planned = np.any(phase.between(start, end).values > 0.0)
        law = BEST if planned else UNTIL_THEN
    return law, gain_set if law in _BY_REGIONS else ""


def _peak(values: Array) -> float:
    """Return the largest magnitude of values, nan without values."""
    known = np.abs(values[np.isfinite(values)])
    return float(np.max(known)) if known.size else math.nan


def _judged(
    axis: Axis, events: Events, step: Step, chosen: Mask, time: Array, position: Array, yard: Yardstick
) -> Step:
    answers = axis.command.between(step.start, step.end).time - step.start if axis.command is not None else time
    samples, middle = time[time >= 0.0], 0.5 * float(time[-1])
    late = late_answers(samples, answers)
    quiet = last_quiet(samples, answers, middle)
    length = min(TAIL, middle)
    rest_end = quiet if quiet is not None else float(time[-1])
    found = step_figures(time, position, step.target, step.band, origin=step.origin, end=rest_end, tail=length)
    entered = float(time[np.argmin(np.abs(position - step.target) > step.band)])
    rising = float(time[-1]) if math.isnan(found.rise) else entered
    arrived = np.flatnonzero(np.abs(position - step.target) < (yard.b if yard.b > 0.0 else step.band))
    remarks = [
        f"{change.named} {change.time - step.start:.3f} s after the start"
        for change in events.changes
        if change.moves and step.start < change.time < step.end
    ]
    if float(time[-1]) < TAIL + SETTLING:
        remarks.append(f"held for {float(time[-1]):.2f} s only: figures of its rest are of the last {length:.2f} s")
    amplitude = frequency = math.nan
    if arrived.size:
        cycling = (time >= max(float(time[arrived[0]]), rest_end - _CYCLE_TIME, 0.5 * rest_end)) & (time <= rest_end)
        least = yard.least_swing(_LEAST_CYCLE * abs(step.target - step.origin))
        if np.sum(cycling) >= _SHORTEST and found.swing > least:
            swing, frequency = limit_cycle(time[cycling], position[cycling], least)
            amplitude = math.nan if math.isnan(swing) else found.swing
    impacts = crossings = -1
    if math.isfinite(yard.centre):
        twist = axis.twist[chosen][arrived[0] if arrived.size else time.size :]
        gap = twist[np.isfinite(twist)] - yard.centre
        impacts, crossings = count_impacts(gap, yard.b), count_crossings(gap, yard.b)
    return replace(
        step,
        rise=found.rise,
        settling=max(0.0, found.settling),
        overshoot=max(0.0, found.overshoot),
        residual=found.swing,
        error=found.error,
        amplitude=amplitude,
        frequency=frequency,
        impacts=impacts,
        crossings=crossings,
        peak_torque=_peak(axis.torque[chosen]),
        peak_speed=_peak(axis.load_speed[chosen]),
        late_rising=int(np.sum(late <= rising)),
        late_rest=quiet is None and bool(np.any(late > middle)),
        remarks=tuple(remarks),
    )


def holds_of(axis: Axis, events: Events, steps: Sequence[Step], yard: Yardstick) -> Sequence[Step]:
    """Return the figures of the rests that no step led to, as those of steps of no height; short ones are left out.

    Where something ended the rest of one of the ``steps``, or of a hold, a hold begins anew.
    """
    if not np.any(np.isfinite(axis.position)):
        return []
    moves = [move for move in events.moves if not move.path]
    rests = [_after(axis, events, step.end, step.ended_by, move) for step, move in zip(steps, moves, strict=True)]
    waiting = [(hold, "") for hold in events.holds] + [rest for rest in rests if rest]
    found = []
    while waiting:
        hold, why = waiting.pop()
        judged, end, ended_by = _judge_hold(axis, events, hold, yard)
        if judged is not None:
            found.append(replace(judged, remarks=(f"after {why}",) if why else ()))
        rest = _after(axis, events, end, ended_by, hold)
        waiting += [rest] if rest else []
    return sorted(found, key=lambda held: held.start)


def _after(axis: Axis, events: Events, end: float, why: str, move: Move) -> tuple[Move, str] | None:
    """Return what is left to hold after a rest ended because of ``why``; None after learning runs and faults."""
    later = axis.time[(axis.time > end) & (axis.time < move.end)]
    if not why or not later.size or any(start <= end < over for start, over in events.apart):
        return None
    return Move(float(later[0]), move.end, move.target, move.target, False), why


def _judge_hold(axis: Axis, events: Events, hold: Move, yard: Yardstick) -> tuple[Step | None, float, str]:
    """Return the figures of a hold, None if it is too short, and when and by what it ended."""
    inside = (axis.time >= hold.start) & (axis.time < hold.end)
    end, why = _end_of_rest(axis.time[inside], hold, events, hold.start)
    chosen = inside & (axis.time < end) & np.isfinite(axis.position)
    time, position = axis.time[chosen] - hold.start, axis.position[chosen]
    if time.size < _SHORTEST or time[-1] - time[0] < TAIL + SETTLING:
        return None, end, why
    answers = axis.command.between(hold.start, end).time - hold.start if axis.command is not None else time
    middle = 0.5 * float(time[0] + time[-1])
    quiet = last_quiet(time, answers, middle)
    rest_end = quiet if quiet is not None else float(time[-1])
    tail = (time >= rest_end - TAIL) & (time <= rest_end)
    cycling = (time >= max(rest_end - _HOLD_TIME, middle)) & (time <= rest_end)
    swings = limit_cycle(time[cycling], position[cycling], yard.least_swing(_LEAST_SWING))
    held = _begun(
        axis,
        hold,
        end,
        why,
        residual=float(np.ptp(position[tail])),
        error=float(np.mean(position[tail])) - hold.target,
        amplitude=swings[0],
        frequency=swings[1],
        late_rest=quiet is None and bool(np.any(late_answers(time, answers) > middle)),
    )
    return held, end, why


def steps_of(axis: Axis, events: Events, yard: Yardstick) -> Sequence[Step]:
    """Return the figures of all steps of an axis that has samples."""
    if not axis.time.size or not np.any(np.isfinite(axis.position)):
        return []
    return [judge(axis, events, move, yard) for move in events.moves if not move.path]
