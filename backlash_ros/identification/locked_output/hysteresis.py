"""Gap, lost motion and stiffness from the angle between the shafts while a slow torque acts on an output at rest.

With x = n theta_m - theta_l, the motor's torque T and the teeth's torque tau, both N m at the output:

    x = x0 +- (h + wind-up(abs(tau)))                          on either flank, by a contact law
    T - C - mu abs(tau) <= tau <= T + C + mu abs(tau)          the motor moves at either end only, else it sticks

Half the gap h, its middle x0, the Coulomb friction C, the teeth's loss mu and, of a spring, its compliance are found by
least squares of x. The branches up and down are 2 (C + mu abs(tau)) apart, which separates friction from wind-up.
Samples at speed, in the gap and just after it, do not count. Slopes and angles at a torque are found without a law.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.contact import Contact, gap_at_rest, law_name
from backlash_ros.drivetrain.contacts.elastic import SpringContact
from backlash_ros.foundation.record import Array
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.fitting.candidates import contacts_of
from backlash_ros.identification.fitting.problem import motor_side
from backlash_ros.identification.locked_output.lost_motion import Curve, LostMotion
from backlash_ros.identification.locked_output.ramps import Ramps, ramps_of
from backlash_ros.identification.newey_west import newey_west

_BLOCK = 0.008
"""Averaging time of the samples, s; tuned."""
_SETTLED = 0.06
"""Time for which the motor must have been slow before samples count, s; tuned."""
_FAST = 0.5
"""Share of the speed through the gap above which the motor is not slow."""
_RATE_OVER = 0.02
"""Time to either side over which the motor's speed is taken, s; tuned."""
_WARM_UP = 2
"""Branches of the torque, at first, that do not count; tuned."""
_END = 2
"""Branches of the torque, at last, that do not count; tuned."""
_FAINT = 0.01
"""Share of the torque below which the teeth's place says little."""
_MOST_LOSS = 0.4
"""Largest share of the torque that friction may take."""
_BETTER = 0.8
"""Share of the own law's residual below which another law is taken; tuned."""
_AS_GOOD = 1.1
"""Largest multiple of the best residual with which a law is as good, so that its gap counts."""
_LOSS = 0.05
"""Prior standard deviation of the teeth's loss, a share; tuned."""
_WEIGHT = 4.0
"""Weight of that prior, in single counts; tuned."""
_FITS = 0.03
"""Largest residual, a share of the gap."""
_FITS_COUNTS = 1.0
"""Largest residual, in counts, where these are coarser."""
_REPEATS = 0.05
"""Largest spread from cycle to cycle, a share of the gap."""
_SURE = 0.05
"""Largest standard uncertainty, a share of the gap."""
_HALF_COUNT = 0.5
"""Largest standard uncertainty, in counts, where these are coarser."""
_NOISE = 1.25
"""Component of the uncertainty: a factor on the residuals' standard deviation; tuned."""
_MODEL = 0.006
"""Component of the uncertainty: a share of the gap; tuned."""
_COUNT = 0.12
"""Component of the uncertainty: a share of a count; tuned."""
_GIVE_MODEL = 0.01
"""Component of a stiffness's uncertainty: a share of it; tuned."""
_GIVE_COUNT = 0.3
"""Component of a stiffness's uncertainty: a share of a count divided by the travel that it comes from; tuned."""
_FEWEST_POINTS = 50
"""Fewest points that count for a fit."""
_FEWEST_ON_FLANK = 20
"""Fewest of them on either flank."""
_SHOWN = 600
"""About how many points of the curve are kept to be drawn."""


class _Values(NamedTuple):
    """What is fitted."""

    middle: float  # of the gap, motor angle less load angle, rad
    half_gap: float  # rad
    friction: float  # C, N m
    loss: float  # mu, a share
    give: float = 0.0  # of a linear spring, rad/(N m)


class _Points(NamedTuple):
    """Means over a few samples: angle, torque, side of the middle, branch; and which of them count for the fit."""

    x: Array
    torque: Array
    side: Array
    branch: Array
    counts: NDArray[np.bool_]


class _Found(NamedTuple):
    """A fit with one law: ``rms`` of its residuals, rad, and torque of the ``teeth`` at each point, N m."""

    contact: Contact
    vector: Array
    covariance: Array
    rms: float
    teeth: Array

    @property
    def values(self) -> _Values:
        """What was fitted, by name."""
        return _values(self.vector)

    @property
    def deviations(self) -> _Values:
        """Its standard deviations."""
        return _Values(*(math.sqrt(max(float(variance), 0.0)) for variance in np.diag(self.covariance)))


def _values(vector: Array) -> _Values:
    return _Values(*(float(value) for value in vector))


def _points(curve: Curve, drive: Drive, speed: float) -> _Points:
    """Return the points for the fit from a recording in which the motor crosses the gap at ``speed``, rad/s."""
    period = float(curve.time[-1] / (curve.time.size - 1))
    size = max(1, round(_BLOCK / period))
    n = curve.time.size // size * size

    def mean(values: Array) -> Array:
        return np.asarray(values[:n].reshape(-1, size).mean(axis=1))

    x, torque, time = mean(curve.motor - curve.load), mean(curve.torque), mean(curve.time)
    near = max(1, round(_RATE_OVER / (size * period)))
    rate = np.zeros_like(x)
    rate[near:-near] = (x[2 * near :] - x[: -2 * near]) / (time[2 * near :] - time[: -2 * near])
    torque = torque - motor_side(drive).viscous * rate
    fast = np.abs(rate) > _FAST * speed
    after = np.ones(max(1, round(_SETTLED / (size * period))))
    lately = np.convolve(fast, after)[: fast.size] > 0.5
    branch = curve.branch[:n:size]
    middle = 0.5 * (np.max(x) + np.min(x))
    counts = (branch >= _WARM_UP) & (branch <= branch[-1] - _END) & ~lately & ~fast
    return _Points(x, torque, np.sign(x - middle), branch, counts)


def _teeth_torque(torque: Array, friction: float, loss: float) -> Array:
    """Return the teeth's torque, N m, under a slowly changing motor torque: the motor sticks, then slips."""
    up, down = torque - friction, torque + friction
    least = np.where(up > 0.0, up / (1.0 + loss), up / (1.0 - loss)).tolist()
    most = np.where(down > 0.0, down / (1.0 - loss), down / (1.0 + loss)).tolist()
    teeth, held = [], 0.0
    for low, high in zip(least, most, strict=True):
        held = min(max(held, low), high)
        teeth.append(held)
    return np.array(teeth)


def static_place(drive: Drive, contact: Contact, half_gap: float, torque: float) -> float:
    """Return where, from the middle of the gap, the teeth rest under a torque (N m, > 0), rad at the output."""
    radius = drive.gear.load_radius
    constants = contact.constants(radius, drive.contact_mass)
    return gap_at_rest(contact, constants, radius * half_gap, torque / radius) / radius


def _places(drive: Drive, contact: Contact, values: _Values, teeth: Array) -> Array:
    """Return the distances from the middle of the gap for torques of the teeth (N m, >= 0), rad."""
    half_gap = values.half_gap
    if isinstance(contact, SpringContact):
        return np.asarray(half_gap + values.give * teeth)
    top = float(np.max(teeth)) + 1e-9
    grid = np.geomspace(0.2 * _FAINT * top, 1.001 * top, 24)
    placed = [static_place(drive, contact, half_gap, float(each)) for each in grid]
    return np.asarray(np.interp(np.log(np.maximum(teeth, grid[0])), np.log(grid), placed))


def _covariance(jacobian: Array, residual: Array, together: int) -> Array:
    """Return that of the parameters, with residuals that resemble each other over fewer than so many samples."""
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    return np.asarray(inverse @ newey_west(jacobian * residual[:, None], together) @ inverse)


def _fit(drive: Drive, contact: Contact, points: _Points, count: float) -> _Found:
    """Return the parameters under which ``contact`` explains the points best; a ``count`` is in rad."""
    spring = isinstance(contact, SpringContact)
    top = float(np.max(np.abs(points.torque)))

    def residual(vector: Array) -> Array:
        values = _values(vector)
        teeth = _teeth_torque(points.torque, values.friction, values.loss)
        pressed = np.maximum(points.side * teeth, 0.0)
        weight = np.clip(pressed / (_FAINT * top) - 1.0, 0.0, 1.0) * points.counts
        off = points.x - values.middle - points.side * _places(drive, contact, values, pressed)
        return np.append(weight * off, _WEIGHT * count / math.sqrt(12.0) * values.loss / _LOSS)

    x = points.x[points.counts]
    reach = 0.5 * float(np.ptp(x))
    start = [0.5 * float(np.max(x) + np.min(x)), 0.9 * reach, 0.02 * top, 0.01]
    scale = [0.1 * reach, 0.1 * reach, 0.02 * top, 0.02]
    low, high = [-np.inf, 1e-9, 0.0, 0.0], [np.inf, np.inf, 0.5 * top, 0.5]
    if spring:
        start, scale = [*start, 0.1 * reach / top], [*scale, 0.1 * reach / top]
        low, high = [*low, 0.0], [*high, np.inf]
    found = least_squares(residual, start, bounds=(low, high), x_scale=scale, method="trf", max_nfev=60)
    off, jacobian = found.fun[:-1], found.jac[:-1]
    rms = math.sqrt(float(np.sum(off**2)) / max(1, int(np.count_nonzero(off))))
    together = max(2, int(np.sum(points.counts)) // 24)
    values = _values(found.x)
    teeth = _teeth_torque(points.torque, values.friction, values.loss)
    return _Found(contact, found.x, _covariance(jacobian, off, together), rms, teeth)


def _slope(points: _Points, teeth: Array, side: float, count: float) -> tuple[float, float]:
    """Return the stiffness of a flank from half its torque on, N m/rad, and its standard uncertainty."""
    pressed = side * teeth
    chosen = points.counts & (points.side == side) & (pressed > 0.5 * np.max(pressed))
    design = np.column_stack((np.ones(np.sum(chosen)), pressed[chosen]))
    angle = side * points.x[chosen]
    best = np.linalg.lstsq(design, angle, rcond=None)[0]
    deviation = math.sqrt(_covariance(design, angle - design @ best, max(2, angle.size // 12))[1, 1])
    give = max(float(best[1]), 1e-12)
    share = math.hypot(_NOISE * deviation / give, _GIVE_MODEL, _GIVE_COUNT * count / (give * np.ptp(pressed[chosen])))
    return 1.0 / give, share / give


def _cycle_travels(points: _Points, teeth: Array) -> Array:
    """Return for each cycle the distance between both flanks at about half the torque, rad."""
    share = np.abs(teeth) / np.max(np.abs(teeth))
    there = points.counts & (share > 0.4) & (share < 0.6)
    travels = []
    cycles = (points.branch - _WARM_UP) // 2
    for cycle in np.unique(cycles[points.counts]):
        flanks = [points.x[there & (cycles == cycle) & (points.side == side)] for side in (1.0, -1.0)]
        if min(map(np.size, flanks)) > 0:
            travels.append(float(np.mean(flanks[0]) - np.mean(flanks[1])))
    return np.array(travels)


def _ramps(points: _Points, at: float) -> Ramps | None:
    """Return what the curve shows without a model, from the first peak that counts on; None if it shows nothing."""
    rows = points.branch > _WARM_UP
    found = max(ramps_of(points.torque[rows], points.x[rows], at), key=lambda each: each.number)
    return found if found.valid else None


def _refused(reason: str) -> LostMotion:
    return LostMotion(valid=False, reason=reason)


def measure_lost_motion(
    drive: Drive, curve: Curve, speed: float, at: float, contacts: Sequence[Contact] = ()
) -> LostMotion:
    """Return gap, lost motion and stiffness from a recording.

    Parameters
    ----------
    drive : for its motor, viscous friction and gear ratio, which are taken as given, and its contact law
    speed : of the motor through the gap, rad/s at the output
    at : the lost motion is measured between plus and minus this torque, N m
    contacts : the laws to try, the drive's own first; see `contacts_of`
    """
    points = _points(curve, drive, speed)
    counts = count_of(curve.motor), count_of(curve.load) if np.ptp(curve.load) > 0.0 else 0.0
    if reason := _too_little(points, counts[0]):
        return _refused(reason)
    count = math.hypot(*counts)
    tried = [_fit(drive, contact, points, count) for contact in contacts or contacts_of(drive)]
    best = min(tried, key=lambda each: each.rms)
    if tried[0].rms * _BETTER <= best.rms:
        best = tried[0]
    gap, spread = _gap(points, best, tried, counts)
    found = _lost(drive, points, best, gap, spread.error, at, count)
    if why := _doubt(points, best, found, gap, spread, count):
        return replace(found, valid=False, reason=why)
    told = f"{spread.cycles} cycles of torque on an output that stood; {found.in_words()}"
    return replace(found, valid=True, reason=told)


class _Gap(NamedTuple):
    """A gap, rad, with its ``deviation`` by what was seen, and the ``floor`` of its uncertainty by model and counts."""

    width: float
    deviation: float
    floor: float

    @property
    def uncertainty(self) -> float:
        """The standard uncertainty, rad."""
        return math.hypot(self.deviation, self.floor)


class _Spread(NamedTuple):
    """How many ``cycles`` there were, by how much they differ, rad, and the standard error of their mean, rad."""

    cycles: int
    range: float
    error: float


def _too_little(points: _Points, count: float) -> str:
    """Return why there is nothing to fit; ``count`` of the motor's encoder, rad."""
    least = min(np.sum(points.counts & (points.side == side)) for side in (-1.0, 1.0))
    if np.sum(points.counts) < _FEWEST_POINTS or least < _FEWEST_ON_FLANK:
        return "the motor hardly moved, or did not come to rest on both flanks: check its encoder and command"
    if np.ptp(points.x[points.counts]) < 3.0 * max(count, 1e-7):
        return "the motor hardly moved under the torque: its encoder stands still, or there is no gap"
    return ""


def _gap(points: _Points, best: _Found, tried: Sequence[_Found], counts: tuple[float, float]) -> tuple[_Gap, _Spread]:
    """Return the gap, and how it repeats; ``counts`` of both encoders, rad."""
    gap, travels = 2.0 * best.values.half_gap, _cycle_travels(points, best.teeth)
    spread = _Spread(0, math.inf, math.inf)._replace(cycles=travels.size)
    if travels.size > 1:
        error = float(np.std(travels, ddof=1)) / math.sqrt(travels.size)
        spread = _Spread(travels.size, float(np.ptp(travels)), error)
    # Other laws that explain the curve as well may have another gap.
    others = [2.0 * each.values.half_gap for each in tried if each.rms <= _AS_GOOD * best.rms]
    unsure = 0.5 * (max([gap, *others]) - min([gap, *others]))
    deviation = math.hypot(_NOISE * 2.0 * best.deviations.half_gap, spread.error, unsure)
    return _Gap(gap, deviation, math.hypot(_MODEL * gap, _COUNT * counts[0], _COUNT * counts[1])), spread


def _lost(drive: Drive, points: _Points, best: _Found, gap: _Gap, error: float, at: float, count: float) -> LostMotion:
    """Return what was found, not judged yet; ``error`` is the standard error of the cycles, rad."""
    lost, lost_deviation = _lost_motion(drive, best, at)
    flanks = [_slope(points, best.teeth, side, count) for side in (-1.0, 1.0)]
    every = max(1, points.x.size // _SHOWN)
    pressed = np.maximum(points.side * best.teeth, 0.0)
    modelled = points.side * _places(drive, best.contact, best.values, pressed)
    modelled[pressed < _FAINT * np.max(pressed)] = math.nan
    return LostMotion(
        valid=True,
        reason="",
        gap=gap.width,
        gap_uncertainty=gap.uncertainty,
        lost_motion=lost,
        lost_motion_uncertainty=math.hypot(_NOISE * lost_deviation, error, gap.floor),
        at=at,
        stiffness=(flanks[0][0], flanks[1][0]),
        stiffness_uncertainty=(flanks[0][1], flanks[1][1]),
        friction=best.values.friction,
        friction_uncertainty=_NOISE * best.deviations.friction,
        loss=best.values.loss,
        torque=min(float(np.max(best.teeth)), -float(np.min(best.teeth))),
        contact=law_name(best.contact),
        gap_torque=0.0 if isinstance(best.contact, SpringContact) else _edge_torque(drive, best),
        torques=points.torque[::every],
        angles=points.x[::every] - best.values.middle,
        modelled=modelled[::every],
        ramps=_ramps(points, at),
    )


def _doubt(points: _Points, best: _Found, found: LostMotion, gap: _Gap, spread: _Spread, count: float) -> str:
    """Return why what was found cannot be used; nothing if it can."""
    if not best.rms <= max(_FITS * gap.width, _FITS_COUNTS * count):
        return (
            f"no model of teeth and friction explains the curve: its angles are {best.rms:.2g} rad off (rms); check "
            "the couplings, that nothing else moves the load, and that encoders count without gaps"
        )
    if found.friction + found.loss * found.torque > _MOST_LOSS * float(np.max(points.torque)):
        return "friction takes about half of the torque: the motor does not feel the tooth load of a self-locking gear"
    limit = max(_REPEATS * gap.width, 2.0 * count)
    if not spread.range <= limit:
        return (
            f"the cycles differ by {spread.range:.2g} rad; the limit is {limit:.2g} rad: "
            "something slips, gives way or warms up; hold the output better, or go more slowly"
        )
    enough = max(_SURE * gap.width, _HALF_COUNT * count)
    if not gap.deviation <= enough or not gap.uncertainty < 0.5 * gap.width:
        return (
            f"the gap is {gap.width:.3g} rad with a standard uncertainty of {gap.uncertainty:.2g} rad, "
            "too large to be used"
        )
    return ""


def _edge_torque(drive: Drive, found: _Found) -> float:
    """Return what the teeth bear at the edge of the gap, N m."""
    radius, half_gap = drive.gear.load_radius, drive.gear.load_radius * found.values.half_gap
    constants = found.contact.constants(radius, drive.contact_mass)
    return radius * found.contact.force(constants, half_gap, half_gap, 0.0)[3]


def _lost_motion(drive: Drive, found: _Found, at: float) -> tuple[float, float]:
    """Return the angle between plus and minus ``at`` (N m), rad, and its standard deviation."""

    def of(vector: Array) -> float:
        values = _values(vector)
        if isinstance(found.contact, SpringContact):
            return 2.0 * (values.half_gap + values.give * at)
        return 2.0 * static_place(drive, found.contact, values.half_gap, at)

    here, slopes = of(found.vector), np.zeros(found.vector.size)
    for k in range(slopes.size):
        step = np.zeros(slopes.size)
        step[k] = 1e-4 * max(abs(float(found.vector[k])), 1e-9)
        slopes[k] = (of(found.vector + step) - here) / step[k]
    return here, math.sqrt(max(float(slopes @ found.covariance @ slopes), 0.0))
