"""One step of the explicit method for a drive with effects: DOP853, as in `motion.explicit`, on arrays."""

from functools import cache

import numpy as np
from scipy.integrate import DOP853

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.effects.equations import Derivative, real_equations
from backlash_ros.drivetrain.effects.state import WHOLE, whole_at
from backlash_ros.drivetrain.motion.dynamics import Acting
from backlash_ros.drivetrain.motion.explicit import Step, judged
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOST, OMEGA_L, OMEGA_M, SUPPLIED, THETA_L, THETA_M

_STAGES = 12
_A = np.ascontiguousarray(DOP853.A[:_STAGES, :_STAGES])
_B, _E3, _E5 = (np.ascontiguousarray(weights[:_STAGES]) for weights in (DOP853.B, DOP853.E3, DOP853.E5))


@compiled
def weights_of(plant: PlantConstants, state: Array, account: bool, out: Array) -> None:
    """Write the reciprocals of what errors are judged by into ``out``, shape (WHOLE,): of `integrator`."""
    out[:] = 0.0
    out[THETA_M], out[OMEGA_M] = plant.per_angle_m, plant.per_speed_m
    out[THETA_L], out[OMEGA_L] = plant.per_angle_l, plant.per_speed_l
    whole = whole_at(out)
    whole.wheel_angle, whole.wheel_speed = plant.per_angle_l, plant.per_speed_l
    whole.outer_angle, whole.outer_speed = plant.per_angle_l, plant.per_speed_l
    out[CURRENT] = plant.per_current
    if account:
        out[SUPPLIED] = 1.0 / (plant.energy_scale + abs(state[SUPPLIED]))
        out[LOST] = 1.0 / (plant.energy_scale + abs(state[LOST]))


_derivative: Derivative = unbound


def _step(
    plant: PlantConstants,
    state: Array,
    h: float,
    acting: Acting,
    tolerance: float,
    account: bool,
    out: Array,
) -> tuple[float, float]:
    """Take a step of ``h`` seconds from ``state`` to ``out``, both of shape (WHOLE,).

    Returns
    -------
    (error, force) : the error over what ``tolerance`` allows, and the largest force of the teeth on the way, N
    """
    slopes, weights = np.empty((_STAGES, WHOLE)), np.empty(WHOLE)
    weights_of(plant, state, account, weights)
    force = 0.0
    for j in range(_STAGES):
        for k in range(WHOLE):
            change = 0.0
            for m in range(j):
                change += _A[j, m] * slopes[m, k]
            out[k] = state[k] + h * change
        pushed = _derivative(plant, out, acting, slopes[j])
        if j == 0 or j >= 7:  # the others are not close to the solution
            force = max(force, pushed)
    fifth = third = 0.0
    for k in range(WHOLE):
        change = by_fifth = by_third = 0.0
        for m in range(_STAGES):
            change += _B[m] * slopes[m, k]
            by_fifth += _E5[m] * slopes[m, k]
            by_third += _E3[m] * slopes[m, k]
        out[k] = state[k] + h * change
        fifth += (weights[k] * by_fifth) ** 2
        third += (weights[k] * by_third) ** 2
    return judged(h, 0.2 * fifth, 0.2 * third, tolerance), force  # of the five states of every drive, as there


@cache
def real_explicit(law: type[Contact]) -> Step:
    """Return `_step` compiled for a contact law."""
    return specialize(_step, fused=True, _derivative=real_equations(law).derivative)  # type: ignore[arg-type]
