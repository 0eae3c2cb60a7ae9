"""Lost motion of a locked output as the curve of angle over torque shows it, while the torque goes up and down.

A ramp takes the torque to one side and to the other. On its way back from either end, friction keeps the teeth on their
flank until the torque has changed its sign; `back+` and `back-` are the angles on these two branches:

    at zero torque               back+(0) - back-(0)
    between +-T                  back+(T) - back-(-T)
    the same without friction    back+(T - C) - back-(C - T),   C: half of breakaway+ less breakaway-; where the torque
                                 is too coarse for that, the first less what C winds up by the flanks' stiffness
    width                        largest distance between the branches
    breakaway-, breakaway+       torque at which a quarter of the first is passed on the way to the other flank
    stiffness                    slope of torque over angle from half of the torque on, and on the way back from there

Only the order of the samples counts, not their times, and no law of the teeth is assumed. Each figure comes from each
ramp; the mean leaves the first ramp out, which starts from an unknown place.
"""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from backlash_ros.foundation.record import Array

_SMOOTH = 0.002
"""Noise of the torque that averaging leaves while ramps are sought, a share of its range; tuned."""
_SMOOTH_RAMP = 0.02
"""Noise of the torque that averaging leaves in a ramp, a share of the ramp's torque; tuned."""
_MOST_ROWS = 200
"""The average over the recording covers at most one in so many parts of it; tuned."""
_MOST_OF_RAMP = 40
"""The average in a branch covers at most one in so many parts of it; tuned."""
_BAND = 0.005
"""Torque beyond which it is on a side, a share of the range; tuned."""
_BAND_NOISE = 6.0
"""Torque beyond which it is on a side, in standard deviations of its noise; tuned."""
_SLIGHT = 0.2
"""Peak that is no turn, as a share of both of its neighbours; tuned."""
_ALIKE = 0.7
"""Least ratio of successive peaks of one set of ramps; tuned."""
_FEW = 5
"""Least samples of a branch."""
_STEPS = 40
"""Torques of a branch up to which it goes in steps."""
_NEAR = 0.01
"""Share of the torque by which a branch may end before a torque that counts as reached."""
_FINE = 3.0
"""Least multiple of the torque's noise or steps that the flank's end must be away; tuned."""
_LEAST = 1e-9
"""Least range of a torque, N m."""
_BEYOND = 1.1
"""Multiple of the torque of the ramps up to which the curve of the last one is kept."""
_QUARTER = 0.25
"""Share of the way to the other flank at which the motor has broken away."""
_JUMP = 0.1
"""Share of a branch's way between two rows that is no wind-up."""
_REACH = 0.95
"""Largest torque between which a lost motion is taken, as a share of the ramps' torque; tuned."""
_WIDE = 0.8
"""Largest torque at which both sides are compared, as a share of the ramps' torque; tuned."""
_LOADING = (0.5, 0.97)
"""Shares of the torque between which a flank's slope is taken on the way out."""
_CLEAR = 1.1
"""Multiple of the breakaway torque where that begins at least."""
_UNLOADING = (0.1, 0.5)
"""Shares of the torque between which a flank's slope is taken on the way back."""
_ON = 0.25
"""Share of the lost motion by which the angle may go on while the torque falls; tuned."""
_DRIFT = 0.3
"""Share of the distance of both ends of the angle by which they may move from ramp to ramp; tuned."""


@dataclass(frozen=True)
class Figure:
    """A quantity of all ramps: mean, standard uncertainty, and the value of each ramp, nan where it has none.

    ``spread`` is the largest difference between the ramps of the mean; ``first`` that of the first ramp to the mean,
    nan if it is part of it.
    """

    mean: float = math.nan
    uncertainty: float = math.nan
    spread: float = math.nan
    first: float = math.nan
    values: tuple[float, ...] = ()

    @property
    def found(self) -> bool:
        """Whether there is a value, with an uncertainty."""
        return math.isfinite(self.mean) and math.isfinite(self.uncertainty)


@dataclass(frozen=True)
class Ramps:
    """Figures of a set of ramps to about the same ``torque``, N m; angles in rad, stiffness in N m/rad.

    ``breakaway`` is that of both directions, negative first; ``stiffness`` of the negative and the positive flank on
    the way out, then on the way back. A figure without a value has nan; ``reason`` says why nothing holds.
    ``torques`` and ``angles`` are the curve, N m and rad, ``begins`` the rows where its ramps begin, ``flanks`` the
    mean angles at zero torque, rad.
    """

    valid: bool
    reason: str
    torque: float = 0.0
    number: int = 0
    at: float = 0.0
    at_zero: Figure = Figure()
    at_torque: Figure = Figure()
    without_friction: Figure = Figure()
    width: Figure = Figure()
    breakaway: tuple[Figure, Figure] = (Figure(), Figure())
    stiffness: tuple[Figure, ...] = (Figure(),) * 4
    torques: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    angles: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    begins: tuple[int, ...] = ()
    flanks: tuple[float, float] = (math.nan, math.nan)

    def in_words(self) -> str:
        """Return the lost motion at zero torque and how well it repeats, deg at the output."""
        zero, degree = self.at_zero, math.pi / 180.0
        apart = math.isfinite(zero.first)
        first = f"; the first ramp, which does not count, is {zero.first / degree:+.2g} deg off" if apart else ""
        return (
            f"{self.number} ramps to +-{self.torque:.3g} N m: {zero.mean / degree:.4g} +- "
            f"{zero.uncertainty / degree:.2g} deg are lost at zero torque; repeatability "
            f"{zero.spread / degree:.2g} deg between the ramps{first}"
        )

    @property
    def friction(self) -> float:
        """Half of what is between both breakaway torques, N m; nan without one of them."""
        low, high = self.breakaway
        return 0.5 * (high.mean - low.mean)


class _Branch(NamedTuple):
    """The way from a peak of the torque to the next one: rows, and the torque towards the other side, falling."""

    side: float
    start: int
    end: int
    torque: Array
    angle: Array

    def at(self, torque: float) -> float:
        """Return the angle where the torque first comes to a value, rad; nan if it does not come near."""
        least = float(self.torque[-1])
        if not self.side * torque > least - _NEAR * float(self.torque[0]):
            return math.nan
        level = max(self.side * torque, least)
        k = int(np.searchsorted(-self.torque, -level, side="right"))
        if 0 < k < self.torque.size and self.torque[k] < 0.0 and self._jumps(k):
            return float(self.angle[k - 1])  # the motor broke away between both rows
        return float(np.interp(-level, -self.torque, self.angle, left=math.nan))

    def _jumps(self, k: int) -> bool:
        return abs(float(self.angle[k] - self.angle[k - 1])) > _JUMP * float(np.ptp(self.angle))


def smoothed(values: Array, size: int) -> Array:
    """Return moving averages over ``size`` values, as many as there are values."""
    padded = np.pad(values, (size // 2, size - 1 - size // 2), mode="edge")
    return np.asarray(np.convolve(padded, np.full(size, 1.0 / size), mode="valid"))


def _noise(torque: Array) -> float:
    """Return the standard deviation of the torque's noise from its second differences."""
    return 1.4826 * float(np.median(np.abs(np.diff(torque, 2)))) / math.sqrt(6.0)


def _peaks(torque: Array, band: float) -> list[int]:
    """Return the rows of the largest torque on either side in turn."""
    rows = np.flatnonzero(np.abs(torque) > band)
    if not rows.size:
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(np.sign(torque[rows]))) + 1)
    peaks = [int(part[0]) + int(np.argmax(np.abs(torque[part[0] : part[-1] + 1]))) for part in parts]
    k = 1
    while k < len(peaks) - 1:  # a peak that is slight against both neighbours joins them
        before, here, after = (abs(float(torque[peak])) for peak in peaks[k - 1 : k + 2])
        if here < _SLIGHT * min(before, after):
            peaks[k - 1 : k + 2] = [peaks[k - 1] if before >= after else peaks[k + 1]]
            k = max(k - 1, 1)
        else:
            k += 1
    return peaks


def _branch(torque: Array, angle: Array, side: float, start: int, end: int) -> _Branch:
    falling = np.minimum.accumulate(side * torque[start:end])
    levels = np.flatnonzero(np.diff(falling, prepend=math.inf))
    # In a ramp a torque counts where it comes; of a few long steps, the angle that has settled counts.
    rows = levels if levels.size > _STEPS else np.append(levels[1:], falling.size) - 1
    return _Branch(side, start, end, falling[levels], angle[start:end][rows])


def _figure(values: list[float], count: float = 0.0) -> Figure:
    """Return the figure of one value a ramp; ``count`` is its resolution."""
    every = np.array(values)
    first, rest = (every[0], every[1:]) if np.sum(np.isfinite(every[1:])) > 1 else (math.nan, every)
    used = rest[np.isfinite(rest)]
    if not used.size:
        return Figure(values=tuple(values))
    mean, n = float(np.mean(used)), used.size
    # The factor makes two of these uncertainties an interval of 95 % for few ramps, too.
    few = 0.5 * float(stdtrit(n - 1, 0.975)) if n > 1 else math.inf
    scatter = few * float(np.std(used, ddof=1)) / math.sqrt(n) if n > 1 else math.inf
    return Figure(mean, math.hypot(scatter, count), _range(used), float(first) - mean, tuple(values))


def _less(figure: Figure, change: float) -> Figure:
    """Return a figure less a value, which is half unsure."""
    if not math.isfinite(change):
        return Figure()
    values = tuple(value - change for value in figure.values)
    return Figure(
        figure.mean - change, math.hypot(figure.uncertainty, 0.5 * change), figure.spread, figure.first, values
    )


def _slope(torque: Array, angle: Array, low: float, high: float) -> float:
    """Return what the angle changes by for each N m between two torques; nan with few samples."""
    inside = (torque >= low) & (torque <= high)
    if np.sum(inside) < _FEW or not np.ptp(torque[inside]) > 0.5 * (high - low) > 0.0:
        return math.nan
    share = torque[inside] / high
    share -= np.mean(share)
    return float(share @ angle[inside] / (share @ share) / high)


def _stiffness(give: Figure) -> Figure:
    """Return the stiffness to a compliance, N m/rad; nan without any travel."""
    values = tuple(1.0 / each if each > 0.0 else math.nan for each in give.values)
    if not give.mean > 0.0:
        return Figure(values=values)
    stiffness = 1.0 / give.mean
    used = np.array(values[1:] if math.isfinite(give.first) else values)
    first = values[0] - stiffness if math.isfinite(give.first) else math.nan
    return Figure(stiffness, give.uncertainty * stiffness * stiffness, _range(used), first, values)


def _range(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else math.nan


def _sets(torque: Array, angle: Array, peaks: list[int]) -> list[list[_Branch]]:
    """Return the branches, in sets of successive peaks that are about alike."""
    ends = [*peaks[1:], torque.size]
    sets: list[list[_Branch]] = []
    for start, end in zip(peaks, ends, strict=True):
        here = abs(float(torque[start]))
        before = abs(float(torque[sets[-1][-1].start])) if sets else math.inf
        if min(here, before) < _ALIKE * max(here, before):
            sets.append([])
        sets[-1].append(_branch(torque, angle, math.copysign(1.0, float(torque[start])), start, end))
    return sets


def ramps_of(torque: Array, angle: Array, at: float = 0.0, share: float = 0.0) -> list[Ramps]:
    """Return the figures of each set of ramps that a recording has, in order; never empty.

    Parameters
    ----------
    torque, angle : shapes (N,), finite: N m, and of the motor through the gear less that of the load, rad; of one
        side alone, the other being locked
    at : the lost motion is taken between plus and minus this torque, N m; 0: a ``share`` of the ramps' torque

    Returns
    -------
    list of Ramps
        One that is not valid, with the reason, if there is no ramp, or it says nothing.
    """
    if torque.size < 4 * _FEW:
        return [_refused(f"there are {torque.size} samples, and must be at least {4 * _FEW}")]
    whole, noise = float(np.ptp(torque)), _noise(torque)
    if not whole > _LEAST:
        return [_refused(f"the torque stays at {torque[0]:.3g} N m")]
    size = max(1, min(math.ceil((noise / (_SMOOTH * whole)) ** 2), torque.size // _MOST_ROWS))
    rough = smoothed(torque, size)
    peaks = _peaks(rough, max(_BAND_NOISE * noise / math.sqrt(size), _BAND * whole))
    sets = [each for each in _sets(rough, angle, peaks) if len(each) > 3] if len(peaks) > 3 else []
    if not sets:
        return [
            _refused(
                f"the torque goes from {np.min(torque):.3g} to {np.max(torque):.3g} N m and must go to both sides of "
                f"zero at least twice, to about the same torque; it has {len(peaks)} turns beyond zero"
            )
        ]
    return [_measured(torque, angle, branches, at, share, noise) for branches in sets]


def _measured(torque: Array, angle: Array, branches: list[_Branch], at: float, share: float, noise: float) -> Ramps:
    """Return the figures of one set of ramps."""
    level = float(np.median([abs(branch.torque[0]) for branch in branches]))
    shortest = min(branch.end - branch.start for branch in branches)
    size = max(1, min(math.ceil((noise / (_SMOOTH_RAMP * level)) ** 2), shortest // _MOST_OF_RAMP))
    smooth = smoothed(torque, size)
    branches = [_branch(smooth, angle, *branch[:3]) for branch in branches[: len(branches) // 2 * 2]]
    plus = [branch for branch in branches if branch.side > 0.0]
    minus = [branch for branch in branches if branch.side < 0.0]
    at = at or share * level
    count = 0.41 * _resolution(angle)

    def between(torque: float) -> Figure:
        pairs = zip(plus, minus, strict=True)
        return _figure([up.at(torque) - down.at(-torque) for up, down in pairs], count)

    zero = between(0.0)
    low, high = (_figure([_breakaway(b, zero.mean) for b in each]) for each in (plus, minus))
    friction, stiffness = 0.5 * (high.mean - low.mean), _flanks(smooth, angle, branches, level, (low.mean, high.mean))
    within = at <= _REACH * level
    steps = np.concatenate([-np.diff(branch.torque) for branch in branches])
    step = float(np.median(steps)) if steps.size else level
    fine = at > _FINE * max(noise / math.sqrt(size), step)
    free = between(at - friction) if within and fine and math.isfinite(friction) else Figure()
    if within and not fine:
        give = sum(1.0 / flank.mean for flank in stiffness[:2])
        free = _less(zero, (min(friction, level - friction) - at) * give)
    low_flank, high_flank = (_figure([branch.at(0.0) for branch in each]).mean for each in (minus, plus))
    last = branches[-1]  # it may go on to larger ramps
    beyond = last.side * smooth[last.start : last.end] < -_BEYOND * level
    begins = [*(branch.start for branch in branches), last.start + int(np.argmax(np.append(beyond, True)))]
    rows = slice(begins[0], begins[-1])
    found = Ramps(
        valid=True,
        reason="",
        torque=level,
        number=int(np.sum(np.isfinite(zero.values))),
        at=at,
        at_zero=zero,
        at_torque=between(at) if within else Figure(),
        without_friction=free,
        width=_figure([_width(*pair, level) for pair in zip(plus, minus, strict=True)], count),
        breakaway=(low, high),
        stiffness=stiffness,
        torques=smooth[rows],
        angles=angle[rows],
        begins=tuple(begin - begins[0] for begin in begins[:-1:2]),
        flanks=(low_flank, high_flank),
    )
    why = _unusable(found, plus, minus)
    return replace(found, valid=not why, reason=why)


def _breakaway(branch: _Branch, way: float) -> float:
    """Return the torque at which the angle leaves the flank by a quarter of the ``way``, N m."""
    gone = branch.side * (branch.at(0.0) - branch.angle) >= _QUARTER * way
    gone &= branch.torque < 0.0
    return branch.side * float(branch.torque[np.argmax(gone)]) if np.any(gone) else math.nan


def _width(plus: _Branch, minus: _Branch, level: float) -> float:
    """Return the largest distance of two branches, rad; nan where one of them ends early."""
    apart = [plus.at(each) - minus.at(each) for each in np.linspace(-_WIDE, _WIDE, 81) * level]
    return max(apart) if np.all(np.isfinite(apart)) else math.nan


def _flanks(
    torque: Array, angle: Array, branches: list[_Branch], level: float, breakaway: tuple[float, float]
) -> tuple[Figure, ...]:
    """Return the stiffness of both flanks on the way out, then on the way back."""
    out: dict[float, list[float]] = {-1.0: [], 1.0: []}
    back: dict[float, list[float]] = {-1.0: [], 1.0: []}
    for k, branch in enumerate(branches):
        side, low = branch.side, max(_LOADING[0] * level, _CLEAR * abs(breakaway[branch.side > 0.0]))
        come = slice(branches[k - 1].start if k else 0, branch.start + 1)
        there = slice(branch.start, branch.end)
        out[side].append(_slope(side * torque[come], side * angle[come], low, _LOADING[1] * level) if k else math.nan)
        until = branch.start + int(np.argmax(np.append(side * torque[there] < 0.0, True)))
        there = slice(branch.start, until)
        back[side].append(_slope(side * torque[there], side * angle[there], *(s * level for s in _UNLOADING)))
    return tuple(_stiffness(_figure(each[side])) for each in (out, back) for side in (-1.0, 1.0))


def _resolution(angle: Array) -> float:
    """Return the least step of an angle, rad."""
    steps = np.diff(np.unique(angle))
    return float(np.median(steps[steps <= 1.5 * np.min(steps)])) if steps.size else 0.0


def _unusable(found: Ramps, plus: list[_Branch], minus: list[_Branch]) -> str:
    """Return why a curve is none of a locked output; empty if it may be one."""
    if found.number < 2:
        return f"{found.number} ramp passes zero torque both ways, and at least 2 must, to tell how well they repeat"
    lost, resolution = found.at_zero.mean, _resolution(found.angles)
    ends = [np.array([branch.angle[0] for branch in each]) for each in (plus, minus)]
    swing = float(np.mean(ends[0]) - np.mean(ends[1]))
    if not float(np.ptp(found.angles)) > 0.0:
        return "the angle stands still under the torque: its encoder does, or the torque is too small"
    why = _loose(swing, lost, ends, plus, minus)
    if why or not swing > 0.0:
        return why or "the angle falls while the torque rises: one of them has the wrong sign"
    if not lost > 0.5 * resolution:
        return f"the branches meet at zero torque: nothing is lost that the angle's steps of {resolution:.2g} rad show"
    return ""


def _loose(swing: float, lost: float, ends: list[Array], plus: list[_Branch], minus: list[_Branch]) -> str:
    """Return why the output is not locked; empty if it may be."""
    drift = max(float(np.median(np.abs(np.diff(each[len(each) > 2 :])))) for each in ends)
    if drift > _DRIFT * abs(swing):
        return (
            f"the ends of the angle move by {drift:.3g} rad from ramp to ramp, and are {abs(swing):.3g} rad apart: the "
            "output is not locked, or something slips"
        )
    if not swing > 0.0:
        return ""
    on = [float(np.nanmedian([b.side * (b.at(0.0) - b.angle[0]) for b in each])) for each in (plus, minus)]
    if min(on) > _ON * lost:
        return (
            f"the angle goes on by {min(on):.3g} rad while the torque falls to zero, on both sides: the output is not "
            "locked, or the torque changes too fast"
        )
    return ""


def _refused(reason: str) -> Ramps:
    return Ramps(valid=False, reason=reason)
