"""The likeliest fit of a recording of one encoder.

The gear is known and the motor nearly, so the time in which it crosses the gap under a known torque shows the width,
whichever shaft is seen: the motor moves as if it had no load, and the load coasts. The filter also predicts the shaft
without encoder; each impact shows its position.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.candidates import Candidate, contacts_of, told_teeth
from backlash_ros.identification.fitting.fit import Fit
from backlash_ros.identification.fitting.parameters import PARAMETERS
from backlash_ros.identification.one_encoder.search import PUNCTUAL, Minimum, Search, cost_of, ln_half_gap
from backlash_ros.identification.recording import Recording

_EARLY_OR_LATE = 0.06
"""Standard deviation of the times of the samples, in periods, where they are even within a tenth to either side."""
_TIMINGS = (PUNCTUAL, 0.02, _EARLY_OR_LATE, 0.12)
"""Standard deviations of those times of which the likeliest is taken at the end."""
_GENTLE = 0.3
"""Share of the recording, which is gentle: there the load bounces in the gap, and the least error grows; tuned."""
_APART = 0.15
"""By how much, as ln, a gap differs to be another one, which has to be worse."""
_OTHERS = 20.0
"""Cost by which another end of the search must be worse to count by 1/e in the uncertainties; tuned."""
_ROUNDS = 4
"""Largest number of times that other widths, laws and losses are tried around the best end; tuned."""
_GAINS = 3.0
"""Least gain in cost for which another round is worth it; tuned."""


class OneSided(NamedTuple):
    """The likeliest fit; cost by which another gap is ``worse``; how far off the ends ``near`` by are.

    That is a row of `Parameters`, each of the farthest end; an end counts the less the worse it is. ``stage`` of the
    noise: in the first ones it takes so much that the model is not the drive's. ``both``: whether both flanks bore a
    torque.
    """

    fit: Fit
    worse: float
    near: Array
    stage: int
    both: bool


def _brisk(recording: Recording) -> Recording:
    """Return the brisk part of a recording of the motor's angle."""
    late = np.arange(recording.time.size) >= _GENTLE * recording.time.size
    first = int(np.argmax(late & np.isfinite(recording.motor)))
    return recording.part(slice(first, None))


def _first_ends(
    drive: Drive, recording: Recording, torque: float, laws: Sequence[Candidate]
) -> tuple[Search, list[Minimum]]:
    """Return a search and its ends, the best first: of one that leaves nothing to be explained, or the likeliest.

    Tried in turn: samples on time; with the motor's encoder, without the gentle part; samples early or late.
    """
    search = Search(drive, recording, torque)
    ends = search.ends(laws)
    if ends[0].explained:
        return search, ends
    if search.by_motor:
        brisk = Search(drive, _brisk(recording), torque)
        found = brisk.in_play(laws)
        if found[0].explained:
            return brisk, found
    jittery = Search(drive, recording, torque, _EARLY_OR_LATE)
    found = jittery.ends(laws)
    return (jittery, found) if cost_of(found[0]) < cost_of(ends[0]) else (search, ends)


def _timed(search: Search, found: Minimum) -> tuple[Search, Minimum]:
    """Return the likeliest of an end and those beside it with other timings, and the search that it is of."""
    others = [search.timed(timing) for timing in _TIMINGS]
    ends = [(search, found), *((other, other.near(found)) for other in others)]
    return min(ends, key=lambda each: cost_of(each[1]))


def fit_one_sided(drive: Drive, recording: Recording, torque: float, contacts: Sequence[Contact] = ()) -> OneSided:
    """Return the likeliest fit of a recording of one angle.

    Parameters
    ----------
    drive : for its gear, which is taken as given, and its motor, which may be off by as much as data sheets are
    recording : one angle is all nan; the other one is used
    torque : of the motor at standstill, N m at the output
    contacts : the laws to try, see `contacts_of`
    """
    laws = [told_teeth(drive, contact) for contact in contacts or contacts_of(drive)]
    search, ends = _first_ends(drive, recording, torque, laws)
    if not ends[0].explained:
        ends = sorted([*ends, *search.anew(ends[0])], key=cost_of)
    for _ in range(_ROUNDS):
        best = ends[0]
        more = [*search.widths(best), *search.places(best), *search.other_laws(best, laws), search.with_losses(best)]
        if not best.problem.teeth.free:
            more += [search.freed(best), *search.steel(best)]
        ends = sorted([*ends, *more], key=cost_of)
        if not cost_of(ends[0]) < cost_of(best) - _GAINS:
            break
    best = ends[0]
    here = ln_half_gap(best.x)
    others = [
        (abs(ln_half_gap(end.x) - here), cost_of(end) - cost_of(best), np.abs(end.x - best.x))
        for end in ends
        if math.isfinite(end.cost)
    ]
    near = [math.exp(-cost / _OTHERS) * off for apart, cost, off in others if apart <= _APART]
    search, best = _timed(search, best)
    end = search.finish(best)
    return OneSided(
        fit=search.fit(end),
        worse=min((cost for apart, cost, _ in others if apart > _APART), default=math.inf),
        near=np.max(near, axis=0) if near else np.full(PARAMETERS, math.inf),
        stage=end.stage,
        both=end.both,
    )
