"""Figures of paths: how far off the load was while its setpoint moved. Pure computation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backlash_ros.foundation.record import Array
from backlash_ros.pages.report.events import Events
from backlash_ros.pages.report.steps import law_of
from backlash_ros.pages.report.yardstick import Yardstick
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.studies.metrics import PathFigures, count_impacts, path_figures

_AFTER = 0.5
"""Time after the end of a path for which the load is watched, s, unless another one begins."""
_SHORTEST = 5
"""Least number of messages of the state within a path that is judged."""


@dataclass(frozen=True)
class FollowedPath:
    """A path of the setpoint, or of a reference that changes quickly; angles in rad at the output, times in s.

    Attributes
    ----------
    start, end, origin, target : of the path
    law, gain_set : in use at the start, as of a step
    figures : None where the recording does not tell the setpoint
    impacts : of the teeth, until the end; -1 if unknown
    """

    start: float
    end: float
    origin: float
    target: float
    law: str
    gain_set: str
    figures: PathFigures | None = None
    impacts: int = -1


def paths_of(axis: Axis, events: Events, yard: Yardstick) -> Sequence[FollowedPath]:
    """Return the paths of an axis: judged by ``~/state``, or as its reference shows them."""
    if not events.followed:
        moves = [move for move in events.moves if move.path]
        return [
            FollowedPath(move.start, move.end, move.origin, move.target, *law_of(axis, move.start, move.end))
            for move in moves
        ]
    starts = [*(start for start, _ in events.followed[1:]), math.inf]
    return [_judged(axis, *both, until, yard) for both, until in zip(events.followed, starts, strict=True)]


def error_of(axis: Axis, start: float, end: float) -> tuple[Array, Array, Array]:
    """Return times, s, setpoint and load less setpoint, rad, as ``~/state`` tells them."""
    told = axis.state["setpoint"].between(start, end), axis.state["error"].between(start, end)
    return told[0].time, told[0].values, -told[1].values


def _judged(axis: Axis, start: float, end: float, until: float, yard: Yardstick) -> FollowedPath:
    time, setpoint, error = error_of(axis, start, min(end + _AFTER, until))
    seen = np.isfinite(setpoint) & np.isfinite(error)
    time, setpoint, error = time[seen], setpoint[seen], error[seen]
    if time.size < _SHORTEST:
        return FollowedPath(start, end, math.nan, math.nan, *law_of(axis, start, end))
    figures = path_figures(time, setpoint + error, setpoint, end)
    impacts = -1
    if math.isfinite(yard.centre):
        twist = axis.twist[(axis.time >= start) & (axis.time <= end)]
        impacts = count_impacts(twist[np.isfinite(twist)] - yard.centre, yard.b)
    whole = axis.state["setpoint"]
    before = float(whole.values[max(int(np.searchsorted(whole.time, start)) - 1, 0)])
    ends = before if math.isfinite(before) else float(setpoint[0]), float(setpoint[-1])
    return FollowedPath(start, end, *ends, *law_of(axis, start, end), figures, impacts)
