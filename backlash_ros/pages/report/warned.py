"""Warnings and errors of diagnostics, on the clock of the axis that they are about, and the step they came in."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backlash_ros.pages.report.steps import Step
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.recordings.axes.contents import Contents

_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True)
class Warned:
    """A repeated message of diagnostics.

    Attributes
    ----------
    first, last : times, s, on the clock of ``axis``, or from the start by the recorder's clock if that is empty
    step : number of the step in which it first came; 0 if in none
    name, level, text, times : sender, 1 for warnings and 2 for errors, the first text, and how often it came
    axis : name of the axis that it is about; empty if unknown
    """

    first: float
    last: float
    step: int
    name: str
    level: int
    text: str
    times: int
    axis: str


def _of(name: str, axes: Sequence[tuple[Axis, Sequence[Step]]]) -> tuple[Axis, Sequence[Step]] | None:
    """Return the axis and its steps that a sender's name belongs to."""
    if len(axes) == 1:
        return axes[0]
    own = [both for both in axes if name.startswith(f"{both[0].name.rstrip('/')}/")]
    return max(own, key=lambda both: len(both[0].name), default=None)


def warnings_of(contents: Contents, axes: Sequence[tuple[Axis, Sequence[Step]]]) -> list[Warned]:
    """Return the warnings and errors of diagnostics; texts that differ only in their numbers count as one.

    ``axes``: each with its steps.
    """
    found: dict[tuple[str, int, str], Warned] = {}
    for said in contents.told:
        if said.level == 0:
            continue
        at, name, step, both = said.received - contents.start, "", 0, _of(said.name, axes)
        if both is not None:
            (axis, steps), name = both, both[0].name
            if axis.clock and axis.time.size:
                at = float(np.interp(said.received, axis.received, axis.time))
            step = next((k for k, each in enumerate(steps, 1) if each.start <= at < each.end), 0)
        key = said.name, said.level, _NUMBER.sub("#", said.text)
        before = found.get(key, Warned(at, at, step, said.name, said.level, said.text, 0, name))
        found[key] = replace(before, last=at, times=before.times + 1)
    return list(found.values())
