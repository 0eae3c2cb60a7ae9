"""What to do about a limit cycle or a rattle: the first thing to try, by the law that acted and what it knew."""

from collections.abc import Iterable

import numpy as np

from backlash_ros.control.laws import BEST
from backlash_ros.pages.report.outcome import trouble
from backlash_ros.pages.report.steps import Step
from backlash_ros.recordings.axes.axis import Axis

_LEARN = "learn the backlash"
_AUTO = "choose law auto"
_BY_LAW = {
    "fast": [_AUTO],
    "overdamped": ["identify the load, or lower the weights gains.overdamped.q"],
    "two_region": ["identify the drive", _AUTO],
    BEST: ["learn and identify again: gap or load may have changed"],
}


def cure(axis: Axis, step: Step, others: Iterable[Step] = ()) -> str:
    """Return what to do about the limit cycle or the rattle of a step; empty where the recording does not tell.

    ``others``: the steps of the same recording. Law `auto` is no cure where the law that it would choose did worse.
    """
    gap = axis.state.get("backlash_angle")
    known = gap.between(step.start, step.end).values[-1:] if gap is not None else np.empty(0)
    acts = _BY_LAW.get(step.law, [])
    if known.size and not known[0] > 0.0:
        acts = [_LEARN, *(act for act in acts if act == _AUTO and step.law == "fast")]
    if any(other.law == BEST and trouble(other) > trouble(step) for other in others):
        acts = [act for act in acts if act != _AUTO]
    return ", and ".join(acts)
