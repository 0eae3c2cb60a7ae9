"""The events of an axis: moves of its reference, learning runs, changes of parameters, load torques and faults."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from backlash_ros.foundation.record import Array
from backlash_ros.gates.faults import FAULTS, Fault
from backlash_ros.pages.report.changes import Change, changes_of
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.recordings.axes.contents import Told
from backlash_ros.recordings.bag import Series

PATH_STEP = 0.1
"""Largest time between two changes of the reference that belong to one path, s."""
_PAUSE = 0.5
"""Longest time for which the setpoint of one path stands still on its way, s."""
_SMALLEST = 1e-6
"""Change of the reference that is ignored, rad."""


class Move(NamedTuple):
    """A change of the reference: from where to where, rad, and when, s; a ``path`` consists of many small changes."""

    start: float
    end: float
    origin: float
    target: float
    path: bool


class LearningRun(NamedTuple):
    """An experiment: start and end, s, and the backlash in use after it, rad, if that changed."""

    start: float
    end: float
    learned: float
    ended: bool


class FaultSeen(NamedTuple):
    """A latched fault: start and end, s (infinite if the bag ends before), name and meaning."""

    start: float
    end: float
    name: str
    text: str


@dataclass(frozen=True)
class Events:
    """All events in the order of time.

    ``followed``: where ``~/state`` shows a setpoint that moves, from and to, s. ``holds``: where the reference stands
    still, but after no step; see `_holds`.
    """

    moves: Sequence[Move]
    followed: Sequence[tuple[float, float]]
    runs: Sequence[LearningRun]
    changes: Sequence[Change]
    faults: Sequence[FaultSeen]
    torques: Sequence[tuple[float, float]]
    holds: Sequence[Move]

    @property
    def apart(self) -> list[tuple[float, float]]:
        """Learning runs and faults, from and to, s, in which nothing is held."""
        return [*((run.start, run.end) for run in self.runs), *((fault.start, fault.end) for fault in self.faults)]

    def in_the_way(self, start: float, end: float) -> list[tuple[float, str]]:
        """Return when the rest after a move that starts at ``start`` ended, s, and by what, in words."""
        found = [(run.start, f"learning run {k}") for k, run in enumerate(self.runs, 1)]
        found += [(time, f"a load torque of {torque:g} N m") for time, torque in self.torques]
        found += [(fault.start, f"the fault {fault.name}") for fault in self.faults]
        return sorted(event for event in found if start < event[0] < end)


def _runs_of(series: Series | None) -> list[tuple[float, float, bool]]:
    """Return when a flag is set, from and to, and whether the end was seen."""
    if series is None or not series.time.size:
        return []
    on = np.concatenate([[0], (series.values > 0.0).astype(int), [0]])
    starts, ends = np.flatnonzero(np.diff(on) > 0), np.flatnonzero(np.diff(on) < 0)
    times = [*map(float, series.time), float(series.time[-1])]
    return [(times[a], times[b], b < series.time.size) for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]


def _learning_runs(axis: Axis) -> list[LearningRun]:
    """Return the experiments; a result may come a while after the end, since it has to be computed."""
    found, in_use = _runs_of(axis.state.get("experiment")), axis.state.get("backlash_angle")
    runs = []
    for k, (start, end, ended) in enumerate(found):
        until, learned = found[k + 1][0] if k + 1 < len(found) else math.inf, math.nan
        if axis.estimates is not None and (said := axis.estimates.between(end, until).values).size:
            learned = float(said[-1])
        elif in_use is not None and (used := in_use.between(start, until).values).size and used[-1] != used[0]:
            learned = float(used[-1])
        runs.append(LearningRun(start, end, learned, ended))
    return runs


def _followed(axis: Axis, runs: Sequence[LearningRun]) -> list[tuple[float, float]]:
    """Return where the setpoint moves along a path: not at once, nor by an experiment."""
    speed, acceleration = (axis.state.get(f"setpoint_{name}") for name in ("velocity", "acceleration"))
    if speed is None or acceleration is None or not axis.state.keys() >= {"setpoint", "error"}:
        return []
    moves = (speed.values != 0.0) | (acceleration.values != 0.0)  # nan moves, too, and is not judged
    for run in runs:
        moves &= (speed.time < run.start) | (speed.time > run.end)
    found: list[tuple[float, float]] = []
    for time in speed.time[moves].tolist():
        if found and time - found[-1][1] < _PAUSE:
            found[-1] = found[-1][0], time
        else:
            found.append((time, time))
    return [(start, end) for start, end in found if end > start]


def _moves(axis: Axis, followed: Sequence[tuple[float, float]]) -> list[Move]:
    if axis.reference is None:
        return []
    time, values = axis.reference.time, axis.reference.values
    known = np.flatnonzero(np.isfinite(values))
    changes: list[tuple[float, float, float]] = []
    for before, k in pairwise(known):
        held = k == before + 1  # else nothing was held in between: it begins anew where the load is
        if held and abs(values[k] - values[before]) > _SMALLEST:
            changes.append((float(time[k]), float(values[before]), float(values[k])))
    groups: list[list[tuple[float, float, float]]] = []
    for change in changes:
        if groups and change[0] - groups[-1][-1][0] < PATH_STEP:
            groups[-1].append(change)
        else:
            groups.append([change])
    ends = [*(group[0][0] for group in groups), _end_of(axis)][1:]
    moves = []
    for group, end in zip(groups, ends, strict=True):
        path = len(group) >= 3 or any(abs(start - group[-1][0]) < PATH_STEP for start, _ in followed)
        moves.append(Move(group[0 if path else -1][0], end, group[0][1], group[-1][2], path))
    return moves


def _end_of(axis: Axis) -> float:
    return float(axis.time[-1]) if axis.time.size else math.inf


def _first_start(axis: Axis) -> list[Move]:
    """Return the move to the first reference of a topic, which starts from the position of the load."""
    series = axis.reference
    if series is None or axis.reference_source == "~/state" or not series.time.size or not axis.time.size:
        return []
    start, target = float(series.time[0]), float(series.values[0])
    k = int(np.searchsorted(axis.time, start)) - 1
    origin = float(axis.position[k]) if k >= 0 else math.nan
    if not abs(target - origin) > _SMALLEST:
        return []
    later = series.time[1:][np.abs(np.diff(series.values)) > _SMALLEST]
    end = float(later[0]) if later.size else _end_of(axis)
    return [Move(start, end, origin, target, False)] if end - start >= PATH_STEP else []


def _holds(axis: Axis, moves: Sequence[Move], apart: Sequence[tuple[float, float]]) -> list[Move]:
    """Return where the reference stands still from the start on, or after a path, a learning run or a fault.

    ``apart``: see `Events`.
    """
    series = axis.reference
    if series is None or not axis.time.size:
        return []
    same = np.abs(np.diff(series.values, prepend=math.nan)) <= _SMALLEST
    breaks = np.append(series.time[~same], math.inf)
    steps, found = {move.start for move in moves if not move.path}, []
    for k in np.flatnonzero(np.isfinite(series.values) & ~same).tolist():
        time, target = float(series.time[k]), float(series.values[k])
        start = max(time, float(axis.time[0]))
        end = min(float(breaks[np.searchsorted(breaks, time, side="right")]), _end_of(axis))
        edges = sorted({edge for both in apart for edge in both if start < edge < end})
        for a, b in pairwise([start, *edges, end] if start < end else []):
            led_to = a == start and time in steps
            if not led_to and not any(begin <= a < over for begin, over in apart):
                found.append(Move(a, b, target, target, False))
    return found


def _faults(axis: Axis, told: Sequence[Told]) -> list[FaultSeen]:
    series = axis.state.get("fault")
    if series is None:
        return []
    result = []
    for start, end, ended in _runs_of(series):
        k = int(np.searchsorted(series.time, start))
        number = int(series.values[k])
        fault = Fault(number) if number in {f.value for f in Fault} else None
        name = fault.name if fault else f"fault {number}"
        text = next((t.text for t in told if fault and fault.name in t.text), "")
        meaning = FAULTS[fault].meaning if fault in FAULTS else ""
        result.append(FaultSeen(start, end if ended else math.inf, name, text or meaning))
    return result


def _torques(axis: Axis) -> list[tuple[float, float]]:
    """Return the changes of the load torque: when, s, and to what, N m; at first there is none."""
    found, before = [], 0.0
    if axis.load_torque is not None:
        for time, torque in zip(axis.load_torque.time.tolist(), axis.load_torque.values.tolist(), strict=True):
            if torque != before:
                found.append((time, torque))
            before = torque
    return found


def held(series: Series, time: Array) -> Array:
    """Return the values of a series of changes at other times, nan before the first."""
    at = np.searchsorted(series.time, time + 1e-9, side="right") - 1
    return np.where(at >= 0, series.values[np.maximum(at, 0)], math.nan) if series.time.size else time * math.nan


def events_of(axis: Axis, told: Sequence[Told]) -> Events:
    """Return the events of an axis; ``told``: what diagnostics said in the bag."""
    runs, faults = _learning_runs(axis), _faults(axis, told)
    followed = _followed(axis, runs)
    moves = [*_first_start(axis), *_moves(axis, followed)]
    events = Events(moves, followed, runs, changes_of(axis), faults, _torques(axis), [])
    return replace(events, holds=_holds(axis, moves, events.apart))
