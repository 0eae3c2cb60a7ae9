"""A recording of a drive in motion: the readings of both encoders, and the commands that acted."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backlash_ros.foundation.record import Array


class Recording(NamedTuple):
    """Samples of both angles and the commands that answered them, shapes (N,): s, rad, V or A.

    ``motor`` is the motor's angle as seen at the output, n theta_m. Times need not be even; an angle, but for the
    first, is nan where there is no reading. ``doubt``: how far off the command may be, 0 where it is known.
    """

    time: Array
    motor: Array
    load: Array
    command: Array
    doubt: Array

    @classmethod
    def of(cls, time: Array, motor: Array, load: Array, command: Array) -> "Recording":
        """Return a recording whose unknown commands (nan) are replaced by those around them."""
        return cls(time, motor, load, *_guessed(command))

    @property
    def travel(self) -> Array:
        """The motor's angle less the load's where both were read, rad."""
        both = self.motor - self.load
        return np.asarray(both[np.isfinite(both)])

    def part(self, rows: "slice | NDArray[np.bool_]") -> "Recording":
        """Return some of its rows."""
        return Recording(*(values[rows] for values in self))


def _guessed(command: Array) -> tuple[Array, Array]:
    """Return commands with nan replaced by those around, and a doubt from the difference between them."""
    result, doubt = command.copy(), np.zeros(command.size)
    told = np.flatnonzero(np.isfinite(command))
    for row in np.flatnonzero(~np.isfinite(command)) if told.size else ():
        k = int(np.searchsorted(told, row))
        before, after = told[max(k - 1, 0)], told[min(k, told.size - 1)]
        near = [command[j] for j in (before - 1, before, after, after + 1) if 0 <= j < command.size]
        steps = np.abs(np.diff([value for value in near if math.isfinite(value)]))
        result[row], doubt[row] = 0.5 * (command[before] + command[after]), float(np.max(steps, initial=0.0))
    return result, doubt


def with_late_answers(time: Array, motor: Array, load: Array, command: Array, late: Array, period: float) -> Recording:
    """Return a recording of samples of which some answers came late.

    A drive takes a command at once or with its next period. So between the whole periods before and after it, it is
    unknown whether a late command acts: the mean of both commands is assumed, with half their difference as doubt.

    Parameters
    ----------
    time : of the samples, whole periods, s
    late : how much later than usual each sample was answered, s
    period : of the samples, s
    """
    slot = np.round((time - time[0]) / period).astype(int)
    slots = np.arange(slot[-1] + 1)

    def newest(waits: Array) -> Array:
        """Return the newest answer in each slot if answers act after this many periods."""
        acts = np.full(slots.size, 0)
        begin = slot + waits.astype(int)
        inside = begin < slots.size
        np.maximum.at(acts, begin[inside], np.flatnonzero(inside))
        return np.maximum.accumulate(acts)

    least, most = newest(np.ceil(late / period)), newest(np.floor(late / period))
    low, high = (np.array([pick(command[a : b + 1]) for a, b in zip(least, most, strict=True)]) for pick in (min, max))
    changes = (np.diff(least, prepend=-1) != 0) | (np.diff(most, prepend=-1) != 0)
    changes[slot] = True
    rows = np.flatnonzero(changes)
    times = time[0] + period * rows
    angles = np.full((2, slots.size), math.nan)
    angles[:, slot] = np.stack((motor, load))
    times[np.searchsorted(rows, slot)] = time
    seen = angles[:, rows]
    return Recording(times, seen[0], seen[1], 0.5 * (low + high)[rows], 0.5 * (high - low)[rows])
