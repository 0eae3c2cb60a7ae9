"""One step of the explicit method, for motion that is not stiff: nearly all of it.

DOP853, the explicit Runge-Kutta pair of Dormand and Prince of order 8, with its two embedded solutions of orders 5 and
3 (Hairer, Norsett & Wanner, Solving ODEs I, sect. II.5); scipy has the coefficients. Twelve evaluations of the
equations of motion, on tuples: the compiler keeps their numbers in registers, where arrays would go through memory.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from scipy.integrate import DOP853

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.motion.dynamics import Acting, Motion, equations_with, powers
from backlash_ros.foundation.compiled import fused, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOST, OMEGA_L, OMEGA_M, SUPPLIED, THETA_L, THETA_M

_A = tuple(tuple(float(weight) for weight in row if weight != 0.0) for row in DOP853.A)
"""Weights of the slopes that a stage uses."""
_USED = (0, 5, 6, 7, 8, 9, 10, 11)
"""Stages used by the solutions."""
_B, _E3, _E5 = (tuple(float(weights[j]) for j in _USED) for weights in (DOP853.B, DOP853.E3, DOP853.E5))
"""Their weights: of the solution of order 8, and of how far those of orders 3 and 5 are from it."""


class Change(NamedTuple):
    """How far or how fast gap and state change."""

    gap: float  # m
    theta_m: float  # rad
    omega_m: float  # rad/s
    theta_l: float  # rad
    omega_l: float  # rad/s
    current: float  # A


class Stage(NamedTuple):
    """A stage: how fast the state changes there; the current, A; force of the teeth and its elastic part, N."""

    slope: Change
    current: float
    force: float
    elastic: float


@fused
def judged(h: float, fifth: float, third: float, tolerance: float) -> float:
    """Return the error of a step over ``tolerance`` from its squared differences to the solutions of orders 5 and 3."""
    both = fifth + 0.01 * third
    if both == 0.0:
        return 0.0
    return h * fifth / (math.sqrt(both) * tolerance) if both < math.inf else math.inf


@fused
def _sum(w: tuple[float, ...], k: tuple[Change, ...]) -> Change:
    """Return the weighted sum of slopes."""
    gap, theta_m, omega_m = w[0] * k[0].gap, w[0] * k[0].theta_m, w[0] * k[0].omega_m
    theta_l, omega_l, current = w[0] * k[0].theta_l, w[0] * k[0].omega_l, w[0] * k[0].current
    for j in range(1, len(k)):
        gap += w[j] * k[j].gap
        theta_m += w[j] * k[j].theta_m
        omega_m += w[j] * k[j].omega_m
        theta_l += w[j] * k[j].theta_l
        omega_l += w[j] * k[j].omega_l
        current += w[j] * k[j].current
    return Change(gap, theta_m, omega_m, theta_l, omega_l, current)


@fused
def _size(plant: PlantConstants, error: Change) -> float:
    """Return the squared size of an error."""
    size = (plant.per_angle_m * error.theta_m) ** 2
    size += (plant.per_speed_m * error.omega_m) ** 2
    size += (plant.per_angle_l * error.theta_l) ** 2
    size += (plant.per_speed_l * error.omega_l) ** 2
    return size + (plant.per_current * error.current) ** 2


@fused
def _energy(w: tuple[float, ...], powers_at: tuple[float, ...]) -> float:
    """Return the weighted sum of a power at the stages of `_USED`."""
    total = 0.0
    for j in range(len(w)):
        total += w[j] * powers_at[j]
    return total


@fused
def _energy_error(h: float, powers_at: tuple[float, ...], per: float, tolerance: float) -> float:
    """Return the error of an energy as `judged`; ``per``: over what it is judged by, 1/J."""
    return judged(h, (per * _energy(_E5, powers_at)) ** 2, (per * _energy(_E3, powers_at)) ** 2, tolerance)


_motion: Callable[..., Motion] = unbound
_stage: Callable[..., Stage] = unbound


def stage(
    plant: PlantConstants,
    start: Change,
    h: float,
    weights: tuple[float, ...],
    slopes: tuple[Change, ...],
    acting: Acting,
) -> Stage:
    """Return the stage that is ``h`` times the weighted sum of slopes after the ``start``."""
    way = _sum(weights, slopes)
    gap, theta_l = start.gap + h * way.gap, start.theta_l + h * way.theta_l
    omega_m, omega_l = start.omega_m + h * way.omega_m, start.omega_l + h * way.omega_l
    current, gap_rate = start.current + h * way.current, plant.R1 * omega_m - plant.R2 * omega_l
    a, b, d, force, elastic = _motion(plant, gap, gap_rate, theta_l, omega_m, omega_l, current, acting)
    return Stage(Change(gap_rate, omega_m, a, omega_l, b, d), current, force, elastic)


@fused
def _powers(plant: PlantConstants, at: Stage, acting: Acting) -> tuple[float, float]:
    return powers(plant, at.slope.theta_m, at.slope.theta_l, at.current, at.force, at.elastic, acting)


def _step(
    plant: PlantConstants,
    state: Array,
    h: float,
    acting: Acting,
    tolerance: float,
    account: bool,
    out: Array,
) -> tuple[float, float]:
    """Take a step of ``h`` seconds from ``state`` to ``out``, both of shape (7,), with the energies if ``account``.

    Returns
    -------
    (error, force) : the error over what ``tolerance`` allows, and the largest contact force on the way, N
    """
    theta_m, omega_m, theta_l, omega_l = state[THETA_M], state[OMEGA_M], state[THETA_L], state[OMEGA_L]
    gap = plant.R1 * theta_m - plant.R2 * theta_l
    start = Change(gap, theta_m, omega_m, theta_l, omega_l, state[CURRENT])
    s0 = _stage(plant, start, 0.0, (0.0,), (start,), acting)
    k0 = s0.slope
    k1 = _stage(plant, start, h, _A[1], (k0,), acting).slope
    k2 = _stage(plant, start, h, _A[2], (k0, k1), acting).slope
    k3 = _stage(plant, start, h, _A[3], (k0, k2), acting).slope
    k4 = _stage(plant, start, h, _A[4], (k0, k2, k3), acting).slope
    s5 = _stage(plant, start, h, _A[5], (k0, k3, k4), acting)
    s6 = _stage(plant, start, h, _A[6], (k0, k3, k4, s5.slope), acting)
    s7 = _stage(plant, start, h, _A[7], (k0, k3, k4, s5.slope, s6.slope), acting)
    s8 = _stage(plant, start, h, _A[8], (k0, k3, k4, s5.slope, s6.slope, s7.slope), acting)
    k = (k0, k3, k4, s5.slope, s6.slope, s7.slope, s8.slope)
    s9 = _stage(plant, start, h, _A[9], k, acting)
    s10 = _stage(plant, start, h, _A[10], (*k, s9.slope), acting)
    s11 = _stage(plant, start, h, _A[11], (*k, s9.slope, s10.slope), acting)
    used = (k0, s5.slope, s6.slope, s7.slope, s8.slope, s9.slope, s10.slope, s11.slope)
    total = _sum(_B, used)
    out[THETA_M], out[OMEGA_M] = theta_m + h * total.theta_m, omega_m + h * total.omega_m
    out[THETA_L], out[OMEGA_L] = theta_l + h * total.theta_l, omega_l + h * total.omega_l
    out[CURRENT] = state[CURRENT] + h * total.current
    fifth, third = _size(plant, _sum(_E5, used)), _size(plant, _sum(_E3, used))
    error = judged(h, 0.2 * fifth, 0.2 * third, tolerance)
    if account:  # the energies follow from the motion and do not act back on it
        p0, p5 = _powers(plant, s0, acting), _powers(plant, s5, acting)
        p6, p7 = _powers(plant, s6, acting), _powers(plant, s7, acting)
        p8, p9 = _powers(plant, s8, acting), _powers(plant, s9, acting)
        p10, p11 = _powers(plant, s10, acting), _powers(plant, s11, acting)
        supplied = (p0[0], p5[0], p6[0], p7[0], p8[0], p9[0], p10[0], p11[0])
        lost = (p0[1], p5[1], p6[1], p7[1], p8[1], p9[1], p10[1], p11[1])
        out[SUPPLIED], out[LOST] = state[SUPPLIED] + h * _energy(_B, supplied), state[LOST] + h * _energy(_B, lost)
        per_supplied = 1.0 / (plant.energy_scale + abs(out[SUPPLIED]))
        per_lost = 1.0 / (plant.energy_scale + abs(out[LOST]))
        error = max(error, _energy_error(h, supplied, per_supplied, tolerance))
        error = max(error, _energy_error(h, lost, per_lost, tolerance))
    # The force is often largest between the ends of a step; late stages are close to the solution there.
    return error, max(abs(s0.force), abs(s7.force), abs(s8.force), abs(s10.force))


Step = Callable[[PlantConstants, Array, float, Acting, float, bool, Array], tuple[float, float]]


@cache
def explicit_with(law: type[Contact], plain: bool = False) -> Step:
    """Return `_step` compiled for a contact law and for drives that are ``plain``: see `dynamics.is_plain`."""
    motion = equations_with(law, plain).motion  # type: ignore[arg-type]
    one = specialize(stage, fused=True, inlined=True, _motion=motion)
    return specialize(_step, fused=True, inlined=True, _stage=one)
