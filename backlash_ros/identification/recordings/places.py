"""The gap around the output's turn from one recording: finds in the motion the places at which it was measured.

At a place both shafts rest, then the teeth move to and fro across the gap, and the motor comes back before it moves on.
The experiment `gap_map` does this, and so may a user who moves an axis from place to place by hand. The gaps and the
eccentricity come from the experiment's own code: see `identification.gap_map`.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.gap_map import FEWEST_PLACES, GapMap, Mapped, map_gaps
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.stretch import HOLE, LONGEST

_TURN = 2.0 * math.pi
_REST = 0.15
"""Time for which both shafts rest, s; tuned."""
_STILL = 0.05
"""Share of their relative travel within which they rest; tuned."""
_COUNTS = 3.0
"""Counts within which they rest, where these are coarser; tuned."""
_KEPT = 0.25
"""Rest that is kept ahead of the motion, s."""
_SIDE = 0.25
"""Distance from the middle beyond which a flank counts as met, as a share of that travel: half of the way to it."""
_CROSSINGS = 4
"""Smallest number of crossings; tuned."""
_ROUND = 1.5
"""Distance, in mean distances of neighbours, up to which the last place is also a neighbour of the first."""


def _rests(recording: Recording, near: float) -> list[tuple[int, int]]:
    """Return the first and the last row of each rest, in which neither shaft moves by more than ``near``, rad."""
    read = np.flatnonzero(np.isfinite(recording.motor + recording.load))
    size = round(_REST / float(np.median(np.diff(recording.time)))) + 1
    if read.size < size:
        return []
    at_rest = np.ones(read.size - size + 1, dtype=bool)
    for angle in (recording.motor[read], recording.load[read]):
        spread = maximum_filter1d(angle, size, mode="nearest") - minimum_filter1d(angle, size, mode="nearest")
        at_rest &= spread[size // 2 :][: at_rest.size] < near
    edges = np.flatnonzero(np.diff(at_rest.astype(int), prepend=0, append=0))
    return [(int(read[a]), int(read[b + size - 2])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _crossings(between: Array, way: float) -> int:
    """Return how often the angle between the shafts crosses its middle."""
    off = between - 0.5 * (np.max(between) + np.min(between))
    sides = np.sign(off[np.abs(off) > _SIDE * way])
    return int(np.count_nonzero(np.diff(sides)))


def visits(recording: Recording) -> list[Recording]:
    """Return the parts in which the gap was measured, each from a rest on and at another place, in the order of places.

    A part with a hole does not count: what happened there is unknown.
    """
    time, motor, load = recording.time, recording.motor, recording.load
    if time.size < 2 or not recording.travel.size:
        return []
    way, period = float(np.ptp(recording.travel)), float(np.median(np.diff(time)))
    near = max(_STILL * way, _COUNTS * max(count_of(motor), count_of(load)))
    found: list[Recording] = []
    rests = _rests(recording, near)
    ends = [first for first, _ in rests[1:]] + [time.size - 1]
    for (_, rest), end in zip(rests, ends, strict=False):
        if end <= rest:
            continue
        back = np.flatnonzero(np.abs(motor[rest : end + 1] - motor[rest]) <= way)
        first = int(np.searchsorted(time, time[rest] - _KEPT))
        first += int(np.argmax(np.isfinite(motor[first:] + load[first:])))
        last = min(rest + int(back[-1]), int(np.searchsorted(time, time[first] + LONGEST)))
        part = recording.part(slice(first, last + 1))
        known = any(abs(part.load[0] - other.load[0]) <= way for other in found)
        whole = np.max(np.diff(part.time), initial=0.0) < HOLE * period
        if whole and not known and _crossings(part.travel, way) >= _CROSSINGS:
            found.append(part)
    return sorted(found, key=lambda part: float(part.load[0]))


def liveliest(recording: Recording, parts: Sequence[Recording]) -> tuple[Recording, str]:
    """Return the one of a recording's `visits` in which the shafts move most, with its place in words."""
    best = max(parts, key=lambda part: float(np.sum(np.abs(np.diff(part.travel)))))
    start, end, length = (float(time - recording.time[0]) for time in (*best.time[[0, -1]], recording.time[-1]))
    return best, f"{start:.2f} to {end:.2f} s of {length:.2f} s, at one of {len(parts)} places around the turn"


def gap_around(drive: Drive, parts: Sequence[Recording]) -> Mapped:
    """Return the gap around the output's turn, or why a recording does not show it.

    Parameters
    ----------
    drive : for its motor and gear ratio, which are taken as they are, and its contact law, which is tried first
    parts : its `visits`
    """
    if len(parts) < FEWEST_PLACES:
        seen = "no place" if not parts else f"{len(parts)} place{'s' if len(parts) > 1 else ''}"
        return Mapped(
            None,
            f"the teeth went to and fro across the gap, after a rest, at {seen} around the turn, and there must be "
            f"{FEWEST_PLACES}",
        )
    spread = float(parts[-1].load[0] - parts[0].load[0])
    if spread > _TURN:
        return Mapped(None, f"the places are spread over {spread:.3g} rad, more than a turn")
    closed = _TURN - spread <= _ROUND * spread / (len(parts) - 1)
    return map_gaps(drive, parts, drive.standstill_torque(), len(parts), closed=closed)


def map_findings(found: GapMap) -> tuple[Finding, ...]:
    """Return smallest, mean and largest gap, and the eccentricity.

    The mean is as uncertain as its places are on average, since most of the uncertainty is common to all of them.
    """
    low, high = found.smallest, found.largest
    rows = [
        Finding("", symbol, what, "rad", gap, uncertainty)
        for symbol, what, gap, uncertainty in (
            ("b min", f"smallest gap, at {found.places[low]:.3g} rad", found.gaps[low], found.uncertainties[low]),
            ("b mean", "mean gap around the turn", found.mean, math.fsum(found.uncertainties) / len(found.places)),
            ("b max", f"largest gap, at {found.places[high]:.3g} rad", found.gaps[high], found.uncertainties[high]),
        )
    ]
    unsure = found.eccentricity_uncertainty
    what = "once-per-turn error of the load's encoder"
    if found.eccentric:
        return (*rows, Finding("", "e", what, "rad", found.eccentricity, unsure))
    return (*rows, Finding("", "e", what, "rad", why=found.eccentricity_in_words()))
