"""Load torques: how far each pushed the load off its target, and how soon it was back. Pure computation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from backlash_ros.pages.report.events import Events, held
from backlash_ros.pages.report.yardstick import Yardstick
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.studies.metrics import SETTLED, settling_time


@dataclass(frozen=True)
class LoadTorque:
    """A load torque of the topic ``load_torque``; times in s, angles in rad at the output, nan if unknown.

    Attributes
    ----------
    start, end, torque : of the torque, N m; ``end`` is infinite where it lasts to the end
    largest : largest distance of the load from its target, until torque or reference changes, or an experiment begins;
        nan where the load was not at its target before
    back : after which the load is within b/4 of the target for good; inf if it never is, nan where b is unknown
    """

    start: float
    end: float
    torque: float
    largest: float
    back: float


def torques_of(axis: Axis, events: Events, yard: Yardstick) -> Sequence[LoadTorque]:
    """Return the changes of the load torque, the one to none as well."""
    return [
        LoadTorque(start, end, torque, *_effect(axis, events, yard, start, end))
        for (start, torque), (end, _) in pairwise([*events.torques, (math.inf, 0.0)])
    ]


def _effect(axis: Axis, events: Events, yard: Yardstick, start: float, end: float) -> tuple[float, float]:
    """Return how far off its target the load was from a change of the torque on, rad, and when it was back, s."""
    if any(first < end and start < last for first, last in events.followed):
        return math.nan, math.nan
    begun = (*(move.start for move in events.moves), *(other for other, _ in events.apart))
    others = [other for other in begun if other > start]
    chosen = (axis.time >= start) & (axis.time < min([end, *others])) & np.isfinite(axis.position)
    if axis.reference is None or not np.any(chosen):
        return math.nan, math.nan
    time = axis.time[chosen] - start
    error = axis.position[chosen] - held(axis.reference, axis.time[chosen])
    if not np.all(np.isfinite(error)):
        return math.nan, math.nan
    back = settling_time(time, error, 0.0, SETTLED * yard.b) if yard.b > 0.0 else math.nan
    there = not abs(error[0]) > (yard.b or math.inf)
    return float(np.max(np.abs(error))) if there else math.nan, back
