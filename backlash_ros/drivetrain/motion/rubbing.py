"""Both shafts after a linearly implicit step, with dry friction that brakes what turns and holds what it stops."""

import math
from typing import NamedTuple

from backlash_ros.foundation.compiled import compiled


class Solved(NamedTuple):
    """Both speeds after a step, rad/s; the inverse of their matrix, and the direction of each shaft's dry friction.

    The inverse is symmetric, [11, 12, 22], and zero for a shaft that is held.
    """

    motor_speed: float
    load_speed: float
    inverse: tuple[float, float, float]
    motor_side: float
    load_side: float


@compiled
def with_friction(
    matrix: tuple[float, float, float],
    right: tuple[float, float],
    speeds: tuple[float, float],
    coulomb: tuple[float, float],
) -> Solved:
    """Solve for both speeds with dry friction, which brakes moving shafts and holds a shaft that it stops.

    Parameters
    ----------
    matrix : of the speeds, symmetric: [11, 12, 22]
    right, speeds, coulomb : right sides, speeds before the step, and dry friction, of motor and load
    """
    m11, m12, m22 = matrix
    rhs_w, rhs_v = right
    w, v = speeds
    c_m, c_l = coulomb
    per_det = 1.0 / (m11 * m22 - m12 * m12)
    s11, s12, s22 = per_det * m22, -per_det * m12, per_det * m11
    side_m = math.copysign(1.0, w if w != 0.0 else s11 * rhs_w + s12 * rhs_v)
    side_l = math.copysign(1.0, v if v != 0.0 else s12 * rhs_w + s22 * rhs_v)
    rhs_w -= side_m * c_m
    rhs_v -= side_l * c_l
    # The load turns back, if friction from the other side lets it; otherwise it stops.
    if (s12 * rhs_w + s22 * rhs_v) * side_l < 0.0:
        back = rhs_v + 2.0 * side_l * c_l
        if (s12 * rhs_w + s22 * back) * side_l < 0.0:
            rhs_v, side_l = back, -side_l
        else:
            s11, s12, s22 = 1.0 / m11, 0.0, 0.0
    # So does the motor, beside a load that may stand by now.
    if (s11 * rhs_w + s12 * rhs_v) * side_m < 0.0:
        back = rhs_w + 2.0 * side_m * c_m
        if (s11 * back + s12 * rhs_v) * side_m < 0.0:
            rhs_w, side_m = back, -side_m
        else:
            s11, s12, s22 = 0.0, 0.0, 1.0 / m22 if s22 > 0.0 else 0.0
    return Solved(s11 * rhs_w + s12 * rhs_v, s12 * rhs_w + s22 * rhs_v, (s11, s12, s22), side_m, side_l)
