"""What to do about a limit cycle: the first thing to try, by the law that acted and what it knew."""

import numpy as np

from backlash_ros.pages.report.steps import Step
from backlash_ros.recordings.axes.axis import Axis

_LEARN = "learn the backlash"
_BY_LAW = {
    "fast": "choose law auto",
    "overdamped": "identify the load, or lower the weights gains.overdamped.q",
    "two_region": "identify the drive, and choose law auto",
    "two_encoder": "learn and identify again: gap or load may have changed",
}


def cure(axis: Axis, step: Step) -> str:
    """Return what to do about the limit cycle in which a step ended; empty where the recording does not tell."""
    gap = axis.state.get("backlash_angle")
    known = gap.between(step.start, step.end).values[-1:] if gap is not None else np.empty(0)
    if known.size and not known[0] > 0.0:
        return f"{_LEARN}, and {_BY_LAW['fast']}" if step.law == "fast" else _LEARN
    return _BY_LAW.get(step.law, "")
