"""Changes of the parameters in use."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

from backlash_ros.recordings.axes.axis import Axis

_GAINS = (
    "law",
    "laws.",
    "gain_set",
    "gains.",
    "backlash_angle",
    "identified",
    "gear.",
    "load.",
    "motor.",
    "loop_delay",
)
"""Beginnings of the names of parameters that change the motion of the loop."""
_FEW = 3
"""Largest number of parameters that are named in a sentence."""


class Change(NamedTuple):
    """Parameters that came into use at a time, s: old and new value by name."""

    time: float
    values: dict[str, tuple[Any, Any]]

    @property
    def named(self) -> str:
        """The change in a few words: a gain set stands for its gains."""
        if self.identified:
            return "the drive was identified"
        names = [name for name in self.values if "gain_set" not in self.values or not name.startswith("gains.")]
        more = f" and {len(names) - _FEW} more" if len(names) > _FEW else ""
        return f"a change of {', '.join(names[:_FEW])}{more}"

    @property
    def identified(self) -> bool:
        """Whether the drive was identified."""
        return bool(self.values.get("identified", (None, False))[1])

    @property
    def moves(self) -> bool:
        """Whether any of them changes the motion of the loop."""
        return any(name.startswith(_GAINS) for name in self.values)


def changes_of(axis: Axis) -> list[Change]:
    """Return the changes of the parameters in use."""
    found = []
    for (_, _, before), (time, _, after) in pairwise(axis.versions):
        values = {
            name: (before.get(name), after.get(name))
            for name in dict.fromkeys([*after, *before])
            if before.get(name) != after.get(name)
        }
        if values:
            found.append(Change(time, values))
    return found


def in_use_at(axis: Axis, time: float) -> Mapping[str, Any]:
    """Return the parameters in use at a time; empty if the bag does not say."""
    known = [values for at, _, values in axis.versions if at <= time + 1e-6]
    return known[-1] if known else {}
