"""Motion while the contact force is linear in the gap and its rate: in the gap, and with a linear spring in contact.

The equations of a plain drive (`dynamics.is_plain`) are linear then, and the power series of their solution is as good
as exact. Its coefficients also tell for how long the force stays linear: see `Contact.linear`.
"""

import math
from collections.abc import Callable
from functools import cache

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact, LinearFunction, LinearPiece, one_piece
from backlash_ros.foundation.compiled import fused, specialize, unbound
from backlash_ros.foundation.record import Array, Record, cells, size_of, view_of
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M

_ORDER = 20
_ROW = _ORDER + 1
"""Coefficients of a series."""


class Series(Record):
    """The coefficients of the states, and of the gap."""

    theta_m: Array = cells(_ROW)  # rad
    omega_m: Array = cells(_ROW)  # rad/s
    theta_l: Array = cells(_ROW)  # rad
    omega_l: Array = cells(_ROW)  # rad/s
    current: Array = cells(_ROW)  # A
    gap: Array = cells(_ROW)  # m


ROOM = size_of(Series)
"""Numbers to work with."""
series_at = view_of(Series)

_REACH = 2.0
"""Longest step in the gap times the fastest rate: at 2 what the series leaves out is 4e-14."""
_REACH_IN_CONTACT = 1.0
"""Longest step in contact times the fastest rate."""
_FASTEST = 2e4
"""Rate, 1/s, above which steps that short are not worth it: the other methods know how to deal with stiff motion."""
_BEYOND = 1e-10
"""Share of half the gap by which a step goes across a bound that it meets, so that the next one starts behind it."""
_TRIES = 12
_WORTH_IT = 0.1
"""Share of the longest step that one which ends before a bound without a kink has to reach."""

_KINKS = True
"""Whether the force has kinks at the bounds: `series_with` binds it."""


@fused
def _value(coefficients: Array, t: float) -> float:
    """Return a series after ``t`` seconds."""
    value: float = coefficients[_ORDER]
    for k in range(_ORDER - 1, -1, -1):
        value = value * t + coefficients[k]
    return value


@fused
def _gap_at(gap: Array, t: float) -> tuple[float, float, float]:
    """Return the gap after ``t`` seconds (m), its rate (m/s) and half its acceleration (m/s^2)."""
    value = rate = half = 0.0
    for k in range(_ORDER, -1, -1):
        half = half * t + rate
        rate = rate * t + value
        value = value * t + gap[k]
    return value, rate, half


@fused
def _clear_of(piece: LinearPiece, gap: Array, t: float) -> tuple[float, float, bool]:
    """Return how far from its bounds the piece is certain to keep for ``t`` seconds, m: below 0 where it is not.

    Also how that changes with t, and whether the first bound is the nearer one. Of the gap's series less its straight
    line, and of the rate's, magnitudes count: so it is concave in t, and what it is at the end it is on the way, too.
    """
    _, _, _, a0, a1, a2, b0, b1, b2 = piece
    p = slope = bend = 0.0
    for k in range(_ORDER, 1, -1):
        bend = bend * t + slope
        slope = slope * t + p
        p = p * t + abs(gap[k])
    off, off_rate = p * t * t, (2.0 * p + slope * t) * t
    off_slope = 2.0 * p + (4.0 * slope + 2.0 * bend * t) * t
    place, rate, twice = gap[0] + gap[1] * t, gap[1], 2.0 * gap[2]
    off_rate_alone, off_slope_alone = off_rate - abs(twice) * t, off_slope - abs(twice)
    first = a0 + a1 * place + a2 * (rate + twice * t) - abs(a1) * off - abs(a2) * off_rate_alone
    second = b0 + b1 * place + b2 * (rate + twice * t) - abs(b1) * off - abs(b2) * off_rate_alone
    first_slope = a1 * rate + a2 * twice - abs(a1) * off_rate - abs(a2) * off_slope_alone
    second_slope = b1 * rate + b2 * twice - abs(b1) * off_rate - abs(b2) * off_slope_alone
    if first < second or (first == second and first_slope <= second_slope):
        return first, first_slope, True
    return second, second_slope, False


@fused
def _met(bound: float, change: float, longest: float) -> float:
    """Return when a straight line from ``bound`` down, by ``change`` a second, comes to 0, at most ``longest``, s."""
    return -bound / change if bound + change * longest < 0.0 else longest


@fused
def _certain(piece: LinearPiece, gap: Array, longest: float, beyond: float) -> tuple[float, float, bool]:
    """Return until when the piece is certain to hold (s), a time near which it may end (s), and by which bound."""
    _, _, _, a0, a1, a2, b0, b1, b2 = piece
    place, rate, twice = gap[0], gap[1], 2.0 * gap[2]
    t = _met(a0 + a1 * place + a2 * rate, a1 * rate + a2 * twice, longest)
    t = _met(b0 + b1 * place + b2 * rate, b1 * rate + b2 * twice, t)
    for _ in range(_TRIES):  # Newton's method comes down a concave curve from the right
        clear, slope, first = _clear_of(piece, gap, t)
        if clear > -beyond:
            return t, t, first
        t -= (clear + 0.5 * beyond) / slope
        if t <= 0.0:
            break
    return 0.0, max(t, 0.0), first


@fused
def _behind(bound: float, by_gap: float, by_rate: float, gap: Array, t: float, beyond: float) -> float:
    """Return when, near ``t``, a bound is behind by less than ``beyond`` (m); -1 where it is not met there."""
    for _ in range(_TRIES):
        place, rate, half = _gap_at(gap, t)
        slope, over = by_gap * rate + 2.0 * by_rate * half, bound + by_gap * place + by_rate * rate + 0.5 * beyond
        if abs(over) < 0.4 * beyond:
            return t
        if not slope < 0.0:
            break
        t -= over / slope
    return -1.0


def _until(piece: LinearPiece, gap: Array, longest: float, beyond: float) -> float:
    """Return until when the piece is certain to hold, at most ``longest``, s.

    Where a bound is met soon after that and the force has a kink there, it is the time just behind it, by less than
    ``beyond`` (m).
    """
    certain, t, first = _certain(piece, gap, longest, beyond)
    if certain == longest:
        return longest
    if not _KINKS:  # what is short is left to the other methods, or it would come nearer and nearer
        return certain if certain > _WORTH_IT * longest else 0.0
    _, _, _, a0, a1, a2, b0, b1, b2 = piece
    bound, by_gap, by_rate = (a0, a1, a2) if first else (b0, b1, b2)
    met = _behind(bound, by_gap, by_rate, gap, t, beyond)
    return met if certain <= met <= longest else certain


@fused
def _force_at(piece: LinearPiece, gap: Array, t: float) -> float:
    """Return the contact force after ``t`` seconds, N."""
    place, rate, _ = _gap_at(gap, t)
    return piece[0] + piece[1] * place + piece[2] * rate


@fused
def _largest_force(piece: LinearPiece, gap: Array, h: float) -> float:
    """Return the largest contact force within ``h`` seconds, N."""
    # A parabola through three places has the peak.
    first, middle, last = _force_at(piece, gap, 0.0), _force_at(piece, gap, 0.5 * h), _force_at(piece, gap, h)
    force = max(abs(first), abs(middle), abs(last))
    tilt, bend = 0.5 * (last - first), 0.5 * (first + last) - middle
    if abs(tilt) < 2.0 * abs(bend):
        force = max(force, abs(middle - 0.25 * tilt * tilt / bend))
    return force


_linear: LinearFunction = unbound


def _step(
    plant: PlantConstants, state: Array, longest: float, command: float, load_torque: float, work: Array
) -> tuple[float, float]:
    """Move ``state``, shape (7,), on in place for as long as the force is certain to stay linear.

    Parameters
    ----------
    longest : of the step, s
    work : shape (ROOM,)

    Returns
    -------
    (time, force) : by how much it moved on, s, 0 where the force is not linear or the motion stiff; the largest force
        on the way, N
    """
    theta_m, omega_m, theta_l, omega_l = state[THETA_M], state[OMEGA_M], state[THETA_L], state[OMEGA_L]
    current, volts, torque = state[CURRENT], command, load_torque
    gap, rate = plant.R1 * theta_m - plant.R2 * theta_l, plant.R1 * omega_m - plant.R2 * omega_l
    piece = _linear(plant.contact, plant.half_gap, gap, rate)
    offset, stiffness, damping, a0, a1, a2, b0, b1, b2 = piece
    if a0 + a1 * gap + a2 * rate < 0.0 or b0 + b1 * gap + b2 * rate < 0.0:
        return 0.0, 0.0
    touches = stiffness != 0.0 or damping != 0.0
    fastest, h = plant.rate, _REACH / plant.rate
    if touches:
        per_mass = plant.R1 * plant.R1 * plant.per_inertia_m + plant.R2 * plant.R2 * plant.per_inertia_l
        fastest = max(fastest, math.sqrt(stiffness * per_mass), damping * per_mass)
        h = _REACH_IN_CONTACT / fastest
    if fastest > _FASTEST:
        return 0.0, 0.0
    series = series_at(work)
    series.theta_m[0], series.omega_m[0], series.theta_l[0], series.omega_l[0] = theta_m, omega_m, theta_l, omega_l
    series.current[0], series.gap[0] = current, gap
    for k in range(1, _ROW):
        share = 1.0 / k
        on_motor, on_load = plant.K_m * current - plant.B_m * omega_m, torque - plant.B_l * omega_l
        if touches:
            force = offset + stiffness * gap + damping * rate
            on_motor -= plant.R1 * force
            on_load += plant.R2 * force
        series.theta_m[k], series.theta_l[k] = omega_m * share, omega_l * share
        series.gap[k] = gap = rate * share
        current = (volts - plant.R * current - plant.K_m * omega_m) * (plant.per_inductance * share)
        omega_m, omega_l = on_motor * (plant.per_inertia_m * share), on_load * (plant.per_inertia_l * share)
        series.omega_m[k], series.omega_l[k], series.current[k] = omega_m, omega_l, current
        rate = plant.R1 * omega_m - plant.R2 * omega_l
        volts = torque = offset = 0.0
    h = _until(piece, series.gap, min(longest, h), _BEYOND * plant.half_gap)
    state[THETA_M], state[OMEGA_M] = _value(series.theta_m, h), _value(series.omega_m, h)
    state[THETA_L], state[OMEGA_L] = _value(series.theta_l, h), _value(series.omega_l, h)
    state[CURRENT] = _value(series.current, h)
    if not touches:
        return h, 0.0
    return h, _largest_force(piece, series.gap, h)


SeriesStep = Callable[[PlantConstants, Array, float, float, float, Array], tuple[float, float]]


@cache
def series_with(law: type[Contact]) -> SeriesStep:
    """Return `_step` compiled for a contact law."""
    until = specialize(_until, fused=True, _KINKS=law.piece is not one_piece)
    return specialize(_step, fused=True, inlined=True, _linear=law.linear, _until=until)
