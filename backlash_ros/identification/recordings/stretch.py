"""The most informative part of a recording: without a hole, and with the largest relative motion of the shafts."""

import numpy as np

from backlash_ros.identification.recording import Recording

LONGEST = 12.0
"""Longest part that is fitted, s."""
HOLE = 10
"""Periods without a sample that end a stretch: what happened in between is unknown."""
_STEP = 0.5
"""Step between the stretches that are tried, s; tuned."""
_STILL = 0.3
"""Rest that is kept before the motion, s; tuned."""


def _starts(recording: Recording, first: int) -> int:
    """Return the first row, from ``first`` on, with both angles; the end if there is none."""
    read = np.flatnonzero(np.isfinite(recording.motor[first:] + recording.load[first:]))
    return first + int(read[0]) if read.size else recording.time.size


def _still(recording: Recording) -> int:
    """Return the number of superfluous rows at rest before the motion."""
    time, motor, load, command, _ = recording
    moved = np.zeros(time.size, dtype=bool)
    for values in (motor, load, command):
        moved |= np.abs(values - values[0]) > 0.02 * (np.nanmax(values) - np.nanmin(values))
    return max(0, int(np.searchsorted(time, time[int(np.argmax(moved))] - _STILL)))


def informative(recording: Recording, longest: float = LONGEST) -> tuple[Recording, str]:
    """Return the stretch to fit, with its place in words unless it is the whole recording.

    A hole of more than `HOLE` periods ends a stretch. If it is longer than ``longest`` s, the part in which the angle
    between the shafts travels most is used. Rest before the motion is left out.
    """
    period = float(np.median(np.diff(recording.time)))
    holes = np.flatnonzero(np.diff(recording.time) > HOLE * period) + 1
    best, most = recording, -1.0
    for first, last in zip((0, *holes), (*holes, recording.time.size), strict=True):
        whole = recording.part(slice(min(_starts(recording, first), last), last))
        if whole.time.size < 2:
            continue
        between = whole.motor - whole.load
        steps = np.abs(np.diff(between, prepend=between[0]))
        way = np.concatenate(([0.0], np.cumsum(np.where(np.isfinite(steps), steps, 0.0))))
        time = whole.time
        for start in np.arange(time[0], max(time[-1] - longest, time[0]) + _STEP, _STEP):
            begin, end = np.searchsorted(time, (start, start + longest))
            if end - begin > 1 and way[end] - way[begin] > 1.001 * most:
                most = float(way[end] - way[begin])
                best = whole.part(slice(_starts(whole, int(begin)), int(end)))
    best = best.part(slice(_starts(best, _still(best)), None))
    start, end = (float(best.time[k] - recording.time[0]) for k in (0, -1))
    length = float(recording.time[-1] - recording.time[0])
    whole_of_it = end - start > 0.98 * length
    told = "" if whole_of_it else f"{start:.2f} to {end:.2f} s of {length:.2f} s, where the shafts move most"
    return best, told
