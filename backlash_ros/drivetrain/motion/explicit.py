"""One step of the explicit method, for motion that is not stiff: nearly all of it.

DOP853, the explicit Runge-Kutta pair of Dormand and Prince of order 8, with its two embedded solutions of orders 5 and
3 (Hairer, Norsett & Wanner, Solving ODEs I, sect. II.5); scipy has the coefficients. Twelve evaluations of the
equations of motion, written out on numbers of their own, so that none of them goes through memory.
"""

import math
from collections.abc import Callable
from functools import cache

from scipy.integrate import DOP853

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.motion.dynamics import Acting, Motion, equations_with, powers
from backlash_ros.foundation.compiled import fused, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOST, OMEGA_L, OMEGA_M, SUPPLIED, THETA_L, THETA_M

_A = tuple(tuple(float(weight) for weight in row) for row in DOP853.A)
_USED = (0, 5, 6, 7, 8, 9, 10, 11)
"""Stages used by the solutions."""
_B, _E5 = (tuple(float(weights[j]) for j in _USED) for weights in (DOP853.B, DOP853.E5))
_B3 = tuple(float(DOP853.B[j] - DOP853.E3[j]) for j in (0, 8, 11))
"""The solution of order 3, from three stages."""


@fused
def _sum(
    w: tuple[float, ...],
    x0: float,
    x5: float,
    x6: float,
    x7: float,
    x8: float,
    x9: float,
    x10: float,
    x11: float,
) -> float:
    """Return the weighted sum of a slope at the stages of `_USED`."""
    first = w[0] * x0 + w[1] * x5 + w[2] * x6 + w[3] * x7
    return first + (w[4] * x8 + w[5] * x9 + w[6] * x10 + w[7] * x11)


@fused
def _third(x0: float, x8: float, x11: float) -> float:
    """Return the weighted sum of a slope for the solution of order 3."""
    return _B3[0] * x0 + _B3[1] * x8 + _B3[2] * x11


@fused
def judged(h: float, fifth: float, third: float, tolerance: float) -> float:
    """Return the error of a step over ``tolerance`` from its squared differences to the solutions of orders 5 and 3."""
    both = fifth + 0.01 * third
    if both == 0.0:
        return 0.0
    return h * fifth / (math.sqrt(both) * tolerance) if both < math.inf else math.inf


_motion: Callable[..., Motion] = unbound


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
    current = state[CURRENT]
    # At stage j: speeds m, l, v of the gap and current i; rates a, b, d of m, l, i; force f and its elastic part e.
    m0, l0, i0 = omega_m, omega_l, current
    gap, v0 = plant.R1 * theta_m - plant.R2 * theta_l, plant.R1 * m0 - plant.R2 * l0
    a0, b0, d0, f0, e0 = _motion(plant, gap, v0, theta_l, m0, l0, i0, acting)

    w = _A[1]
    m1 = omega_m + h * (w[0] * a0)
    l1 = omega_l + h * (w[0] * b0)
    i1 = current + h * (w[0] * d0)
    x = gap + h * (w[0] * v0)
    q = theta_l + h * (w[0] * l0)
    v1 = plant.R1 * m1 - plant.R2 * l1
    a1, b1, d1, _, _ = _motion(plant, x, v1, q, m1, l1, i1, acting)
    w = _A[2]
    m2 = omega_m + h * (w[0] * a0 + w[1] * a1)
    l2 = omega_l + h * (w[0] * b0 + w[1] * b1)
    i2 = current + h * (w[0] * d0 + w[1] * d1)
    x = gap + h * (w[0] * v0 + w[1] * v1)
    q = theta_l + h * (w[0] * l0 + w[1] * l1)
    v2 = plant.R1 * m2 - plant.R2 * l2
    a2, b2, d2, _, _ = _motion(plant, x, v2, q, m2, l2, i2, acting)
    w = _A[3]
    m3 = omega_m + h * (w[0] * a0 + w[2] * a2)
    l3 = omega_l + h * (w[0] * b0 + w[2] * b2)
    i3 = current + h * (w[0] * d0 + w[2] * d2)
    x = gap + h * (w[0] * v0 + w[2] * v2)
    q = theta_l + h * (w[0] * l0 + w[2] * l2)
    v3 = plant.R1 * m3 - plant.R2 * l3
    a3, b3, d3, _, _ = _motion(plant, x, v3, q, m3, l3, i3, acting)
    w = _A[4]
    m4 = omega_m + h * (w[0] * a0 + w[2] * a2 + w[3] * a3)
    l4 = omega_l + h * (w[0] * b0 + w[2] * b2 + w[3] * b3)
    i4 = current + h * (w[0] * d0 + w[2] * d2 + w[3] * d3)
    x = gap + h * (w[0] * v0 + w[2] * v2 + w[3] * v3)
    q = theta_l + h * (w[0] * l0 + w[2] * l2 + w[3] * l3)
    v4 = plant.R1 * m4 - plant.R2 * l4
    a4, b4, d4, _, _ = _motion(plant, x, v4, q, m4, l4, i4, acting)
    w = _A[5]
    m5 = omega_m + h * (w[0] * a0 + w[3] * a3 + w[4] * a4)
    l5 = omega_l + h * (w[0] * b0 + w[3] * b3 + w[4] * b4)
    i5 = current + h * (w[0] * d0 + w[3] * d3 + w[4] * d4)
    x = gap + h * (w[0] * v0 + w[3] * v3 + w[4] * v4)
    q = theta_l + h * (w[0] * l0 + w[3] * l3 + w[4] * l4)
    v5 = plant.R1 * m5 - plant.R2 * l5
    a5, b5, d5, f5, e5 = _motion(plant, x, v5, q, m5, l5, i5, acting)
    w = _A[6]
    m6 = omega_m + h * (w[0] * a0 + w[3] * a3 + w[4] * a4 + w[5] * a5)
    l6 = omega_l + h * (w[0] * b0 + w[3] * b3 + w[4] * b4 + w[5] * b5)
    i6 = current + h * (w[0] * d0 + w[3] * d3 + w[4] * d4 + w[5] * d5)
    x = gap + h * (w[0] * v0 + w[3] * v3 + w[4] * v4 + w[5] * v5)
    q = theta_l + h * (w[0] * l0 + w[3] * l3 + w[4] * l4 + w[5] * l5)
    v6 = plant.R1 * m6 - plant.R2 * l6
    a6, b6, d6, f6, e6 = _motion(plant, x, v6, q, m6, l6, i6, acting)
    w = _A[7]
    m7 = omega_m + h * (w[0] * a0 + w[3] * a3 + w[4] * a4 + w[5] * a5 + w[6] * a6)
    l7 = omega_l + h * (w[0] * b0 + w[3] * b3 + w[4] * b4 + w[5] * b5 + w[6] * b6)
    i7 = current + h * (w[0] * d0 + w[3] * d3 + w[4] * d4 + w[5] * d5 + w[6] * d6)
    x = gap + h * (w[0] * v0 + w[3] * v3 + w[4] * v4 + w[5] * v5 + w[6] * v6)
    q = theta_l + h * (w[0] * l0 + w[3] * l3 + w[4] * l4 + w[5] * l5 + w[6] * l6)
    v7 = plant.R1 * m7 - plant.R2 * l7
    a7, b7, d7, f7, e7 = _motion(plant, x, v7, q, m7, l7, i7, acting)
    w = _A[8]
    m8 = omega_m + h * (w[0] * a0 + w[3] * a3 + w[4] * a4 + w[5] * a5 + w[6] * a6 + w[7] * a7)
    l8 = omega_l + h * (w[0] * b0 + w[3] * b3 + w[4] * b4 + w[5] * b5 + w[6] * b6 + w[7] * b7)
    i8 = current + h * (w[0] * d0 + w[3] * d3 + w[4] * d4 + w[5] * d5 + w[6] * d6 + w[7] * d7)
    x = gap + h * (w[0] * v0 + w[3] * v3 + w[4] * v4 + w[5] * v5 + w[6] * v6 + w[7] * v7)
    q = theta_l + h * (w[0] * l0 + w[3] * l3 + w[4] * l4 + w[5] * l5 + w[6] * l6 + w[7] * l7)
    v8 = plant.R1 * m8 - plant.R2 * l8
    a8, b8, d8, f8, e8 = _motion(plant, x, v8, q, m8, l8, i8, acting)
    w = _A[9]
    m9 = omega_m + h * (w[0] * a0 + w[3] * a3 + w[4] * a4 + w[5] * a5 + w[6] * a6 + w[7] * a7 + w[8] * a8)
    l9 = omega_l + h * (w[0] * b0 + w[3] * b3 + w[4] * b4 + w[5] * b5 + w[6] * b6 + w[7] * b7 + w[8] * b8)
    i9 = current + h * (w[0] * d0 + w[3] * d3 + w[4] * d4 + w[5] * d5 + w[6] * d6 + w[7] * d7 + w[8] * d8)
    x = gap + h * (w[0] * v0 + w[3] * v3 + w[4] * v4 + w[5] * v5 + w[6] * v6 + w[7] * v7 + w[8] * v8)
    q = theta_l + h * (w[0] * l0 + w[3] * l3 + w[4] * l4 + w[5] * l5 + w[6] * l6 + w[7] * l7 + w[8] * l8)
    v9 = plant.R1 * m9 - plant.R2 * l9
    a9, b9, d9, f9, e9 = _motion(plant, x, v9, q, m9, l9, i9, acting)
    w = _A[10]
    m10 = omega_m + h * (w[0] * a0 + w[3] * a3 + w[4] * a4 + w[5] * a5 + w[6] * a6 + w[7] * a7 + w[8] * a8 + w[9] * a9)
    l10 = omega_l + h * (w[0] * b0 + w[3] * b3 + w[4] * b4 + w[5] * b5 + w[6] * b6 + w[7] * b7 + w[8] * b8 + w[9] * b9)
    i10 = current + h * (w[0] * d0 + w[3] * d3 + w[4] * d4 + w[5] * d5 + w[6] * d6 + w[7] * d7 + w[8] * d8 + w[9] * d9)
    x = gap + h * (w[0] * v0 + w[3] * v3 + w[4] * v4 + w[5] * v5 + w[6] * v6 + w[7] * v7 + w[8] * v8 + w[9] * v9)
    q = theta_l + h * (w[0] * l0 + w[3] * l3 + w[4] * l4 + w[5] * l5 + w[6] * l6 + w[7] * l7 + w[8] * l8 + w[9] * l9)
    v10 = plant.R1 * m10 - plant.R2 * l10
    a10, b10, d10, f10, e10 = _motion(plant, x, v10, q, m10, l10, i10, acting)
    w = _A[11]
    m11 = omega_m + h * (
        w[0] * a0 + w[3] * a3 + w[4] * a4 + w[5] * a5 + w[6] * a6 + w[7] * a7 + w[8] * a8 + w[9] * a9 + w[10] * a10
    )
    l11 = omega_l + h * (
        w[0] * b0 + w[3] * b3 + w[4] * b4 + w[5] * b5 + w[6] * b6 + w[7] * b7 + w[8] * b8 + w[9] * b9 + w[10] * b10
    )
    i11 = current + h * (
        w[0] * d0 + w[3] * d3 + w[4] * d4 + w[5] * d5 + w[6] * d6 + w[7] * d7 + w[8] * d8 + w[9] * d9 + w[10] * d10
    )
    x = gap + h * (
        w[0] * v0 + w[3] * v3 + w[4] * v4 + w[5] * v5 + w[6] * v6 + w[7] * v7 + w[8] * v8 + w[9] * v9 + w[10] * v10
    )
    q = theta_l + h * (
        w[0] * l0 + w[3] * l3 + w[4] * l4 + w[5] * l5 + w[6] * l6 + w[7] * l7 + w[8] * l8 + w[9] * l9 + w[10] * l10
    )
    v11 = plant.R1 * m11 - plant.R2 * l11
    a11, b11, d11, f11, e11 = _motion(plant, x, v11, q, m11, l11, i11, acting)
    sum_m = _sum(_B, m0, m5, m6, m7, m8, m9, m10, m11)
    sum_a = _sum(_B, a0, a5, a6, a7, a8, a9, a10, a11)
    sum_l = _sum(_B, l0, l5, l6, l7, l8, l9, l10, l11)
    sum_b = _sum(_B, b0, b5, b6, b7, b8, b9, b10, b11)
    sum_d = _sum(_B, d0, d5, d6, d7, d8, d9, d10, d11)
    out[THETA_M], out[OMEGA_M] = theta_m + h * sum_m, omega_m + h * sum_a
    out[THETA_L], out[OMEGA_L] = theta_l + h * sum_l, omega_l + h * sum_b
    out[CURRENT] = current + h * sum_d
    fifth = (plant.per_angle_m * _sum(_E5, m0, m5, m6, m7, m8, m9, m10, m11)) ** 2
    fifth += (plant.per_speed_m * _sum(_E5, a0, a5, a6, a7, a8, a9, a10, a11)) ** 2
    fifth += (plant.per_angle_l * _sum(_E5, l0, l5, l6, l7, l8, l9, l10, l11)) ** 2
    fifth += (plant.per_speed_l * _sum(_E5, b0, b5, b6, b7, b8, b9, b10, b11)) ** 2
    fifth += (plant.per_current * _sum(_E5, d0, d5, d6, d7, d8, d9, d10, d11)) ** 2
    third = (plant.per_angle_m * (sum_m - _third(m0, m8, m11))) ** 2
    third += (plant.per_speed_m * (sum_a - _third(a0, a8, a11))) ** 2
    third += (plant.per_angle_l * (sum_l - _third(l0, l8, l11))) ** 2
    third += (plant.per_speed_l * (sum_b - _third(b0, b8, b11))) ** 2
    third += (plant.per_current * (sum_d - _third(d0, d8, d11))) ** 2
    if account:  # the energies follow from the motion and do not act back on it
        s0, t0 = powers(plant, m0, l0, i0, f0, e0, acting)
        s5, t5 = powers(plant, m5, l5, i5, f5, e5, acting)
        s6, t6 = powers(plant, m6, l6, i6, f6, e6, acting)
        s7, t7 = powers(plant, m7, l7, i7, f7, e7, acting)
        s8, t8 = powers(plant, m8, l8, i8, f8, e8, acting)
        s9, t9 = powers(plant, m9, l9, i9, f9, e9, acting)
        s10, t10 = powers(plant, m10, l10, i10, f10, e10, acting)
        s11, t11 = powers(plant, m11, l11, i11, f11, e11, acting)
        sum_s = _sum(_B, s0, s5, s6, s7, s8, s9, s10, s11)
        sum_t = _sum(_B, t0, t5, t6, t7, t8, t9, t10, t11)
        out[SUPPLIED], out[LOST] = state[SUPPLIED] + h * sum_s, state[LOST] + h * sum_t
    error = judged(h, 0.2 * fifth, 0.2 * third, tolerance)
    if account:
        per_supplied = 1.0 / (plant.energy_scale + abs(out[SUPPLIED]))
        fifth = per_supplied * _sum(_E5, s0, s5, s6, s7, s8, s9, s10, s11)
        third = per_supplied * (sum_s - _third(s0, s8, s11))
        error = max(error, judged(h, fifth**2, third**2, tolerance))
        per_lost = 1.0 / (plant.energy_scale + abs(out[LOST]))
        fifth = per_lost * _sum(_E5, t0, t5, t6, t7, t8, t9, t10, t11)
        third = per_lost * (sum_t - _third(t0, t8, t11))
        error = max(error, judged(h, fifth**2, third**2, tolerance))
    # The force is often largest between the ends of a step; late stages are close to the solution there.
    return error, max(abs(f0), abs(f7), abs(f8), abs(f10))


Step = Callable[[PlantConstants, Array, float, Acting, float, bool, Array], tuple[float, float]]


@cache
def explicit_with(law: type[Contact], plain: bool = False) -> Step:
    """Return `_step` compiled for a contact law and for drives that are ``plain``: see `dynamics.is_plain`."""
    return specialize(_step, fused=True, inlined=True, _motion=equations_with(law, plain).motion)  # type: ignore[arg-type]
