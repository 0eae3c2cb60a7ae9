"""Converts an encoder's column to an angle in rad: units, counts, and readings that wrap around."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from backlash_ros.foundation.record import Array

UNITS = {"rad": 2.0 * math.pi, "deg": 360.0, "turns": 1.0, "counts": math.nan}
"""Units of an angle, and their number per turn."""
_JUMP = 0.6
"""Share of a turn between two readings that no shaft can travel, so that the reading has wrapped around."""
_AMBIGUOUS = 0.4
"""Share of the range by which a reading may differ from its extrapolation at constant speed."""
_WHOLE = 0.1
"""Counts by which readings may differ from whole ones because they were rounded."""


@dataclass(frozen=True)
class Encoder:
    """Format of an angle: its ``unit``, ``counts`` of the encoder per turn (0: unknown), and its range.

    ``wraps``: units after which readings wrap around; 0: detected, if that is one turn.
    """

    unit: str = "rad"
    counts: float = 0.0
    wraps: float = 0.0

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise ValueError(f"the unit of an angle must be one of {list(UNITS)}, got {self.unit!r}")
        for name, value in (("counts", self.counts), ("wraps", self.wraps)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and >= 0, got {value!r}")
        if self.unit == "counts" and self.counts == 0.0:
            raise ValueError("counts for each turn must be given where the unit is counts")

    @property
    def turn(self) -> float:
        """Units per turn."""
        return self.counts if self.unit == "counts" else UNITS[self.unit]

    def radians(self, time: Array, values: Array, name: str, place: Callable[[int], str]) -> tuple[Array, str]:
        """Return readings as angles of the encoder's shaft, rad, and how they were converted, in words.

        Parameters
        ----------
        time : of the readings, s, rising
        values : nan for missing readings
        name, place : of the column and of one of its rows, for errors

        Raises
        ------
        ValueError
            If the travel between readings that wrap around is ambiguous.
        """
        read = np.flatnonzero(np.isfinite(values))
        steps = np.abs(np.diff(values[read]))
        turns_once = np.ptp(values[read]) <= self.turn * (1.0 + 1e-9) and np.any(steps > _JUMP * self.turn)
        wraps = self.wraps or (self.turn if turns_once else 0.0)
        result, note = values.copy(), ""
        if wraps:
            result[read] = _unwrapped(time[read], values[read], wraps, name, lambda k: place(int(read[k])))
            note = f"{name} begins again after {wraps:g} {self.unit}, and was continued"
        angle = result * (2.0 * math.pi / self.turn)
        if self.counts:
            counted = angle * (self.counts / (2.0 * math.pi))
            whole = np.round(counted)
            if np.nanmax(np.abs(counted - whole)) <= _WHOLE:
                angle = whole * (2.0 * math.pi / self.counts)
        return angle, note


def _unwrapped(time: Array, values: Array, wraps: float, name: str, place: Callable[[int], str]) -> Array:
    result, speed = values.copy(), 0.0
    if np.ptp(values) > wraps * (1.0 + 1e-9):
        raise ValueError(
            f"{name} begins again after {wraps:g}, but its readings go from {np.min(values):g} to {np.max(values):g}"
        )
    longest = 10.0 * float(np.median(np.diff(time)))
    for k in range(1, values.size):
        passed = time[k] - time[k - 1]
        expected = result[k - 1] + speed * passed
        result[k] = values[k] + wraps * round((expected - values[k]) / wraps)
        off = abs(result[k] - expected) / wraps
        if off > _AMBIGUOUS and passed < longest:
            raise ValueError(
                f"{name} goes from {values[k - 1]:g} to {values[k]:g} {place(k)}, and begins again after {wraps:g}: "
                "the shaft turned so fast that nobody can tell which way it went"
            )
        speed = (result[k] - result[k - 1]) / passed
    return result
