"""One step of the implicit method, for stiff motion: teeth that press hard.

RODAS4P, a linearly implicit (Rosenbrock) method of order 4 with an embedded third-order solution, stiffly
accurate and L-stable (Steinebach, 1995; in Hairer & Wanner, Solving ODEs II, sect. IV.7). Each step costs six
evaluations of the equations of motion and no iteration. The stage equations have the drive's structure, so
they are solved by eliminating down to one unknown, the contact force.
"""

import math
from functools import cache

import numpy as np

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.motion.dynamics import Acting, ContactOf, Derivative, Linearize, Slopes, equations_with
from backlash_ros.drivetrain.motion.explicit import Step
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOST, OMEGA_L, OMEGA_M, SUPPLIED, THETA_L, THETA_M

GAMMA = 0.25
STAGES = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0, 0.0, 0.0, 0.0, 0.0],
        [1.831036793486759, 0.4955183967433795, 0.0, 0.0, 0.0],
        [2.304376582692669, -0.05249275245743001, -1.176798761832782, 0.0, 0.0],
        [-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401, 0.0],
        [-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401, 1.0],
    ]
)
COUPLINGS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [-12.0, 0.0, 0.0, 0.0, 0.0],
        [-8.791795173947035, -2.207865586973518, 0.0, 0.0, 0.0],
        [10.81793056857153, 6.780270611428266, 19.53485944642410, 0.0, 0.0],
        [34.19095006749676, 15.49671153725963, 54.74760875964130, 14.16005392148534, 0.0],
        [34.62605830930532, 15.30084976114473, 56.99955578662667, 18.40807009793095, -5.714285714285717],
    ]
)


@compiled
def _solve_stage(
    plant: PlantConstants,
    s: Slopes,
    g: float,
    current: float,
    acting: Acting,
    residual: Array,
    out: Array,
) -> None:
    """Solve (g I - J) out = residual, with J the Jacobian that ``s`` makes, g = 1/(h gamma)."""
    theta_m, theta_l = residual[THETA_M], residual[THETA_L]
    inverse_i = 1.0 / (g + plant.R / plant.L)
    inverse_m = 1.0 / (g + s.drag_m + s.per_current * plant.K_m * inverse_i / plant.L)
    inverse_l = 1.0 / (g + s.drag_l - s.per_torque * s.torque_l / g)
    # Speeds without the change of the contact force, and their change per newton of it.
    free_m = (residual[OMEGA_M] + s.per_current * inverse_i * residual[CURRENT]) * inverse_m
    push_m = s.per_force_m * inverse_m
    pull = s.per_torque * s.torque_m / g
    free_l = (residual[OMEGA_L] + pull * (theta_m + free_m) + s.per_torque * s.torque_l / g * theta_l) * inverse_l
    push_l = (s.per_force_l - pull * push_m) * inverse_l
    coupling_m, coupling_l = s.force_m / g + s.force_rate * plant.R1, s.force_l / g - s.force_rate * plant.R2
    force = coupling_m * free_m + coupling_l * free_l + (s.force_m * theta_m + s.force_l * theta_l) / g
    force /= 1.0 + coupling_m * push_m - coupling_l * push_l
    out[OMEGA_M] = free_m - push_m * force
    out[OMEGA_L] = free_l + push_l * force
    out[THETA_M] = (theta_m + out[OMEGA_M]) / g
    out[THETA_L] = (theta_l + out[OMEGA_L]) / g
    out[CURRENT] = (residual[CURRENT] - plant.K_m / plant.L * out[OMEGA_M]) * inverse_i
    # The energy account follows from the motion and does not act back on it.
    rate = plant.R1 * out[OMEGA_M] - plant.R2 * out[OMEGA_L]
    elastic = s.elastic_m * out[THETA_M] + s.elastic_l * out[THETA_L]
    force = s.force_m * out[THETA_M] + s.force_l * out[THETA_L] + s.force_rate * rate
    lost = s.lost_m * out[OMEGA_M] + s.lost_l * out[OMEGA_L] + s.lost_current * out[CURRENT]
    lost += s.lost_force * force + s.gap_rate * (force - elastic) + s.lost_rate * rate
    electrical = plant.K_m * current * out[OMEGA_M] if math.isinf(plant.L) else acting.command * out[CURRENT]
    out[SUPPLIED] = (residual[SUPPLIED] + electrical + acting.load_torque * out[OMEGA_L]) / g
    out[LOST] = (residual[LOST] + lost) / g


@compiled
def _error(plant: PlantConstants, after: Array, difference: Array, account: bool) -> float:
    """Largest error relative to its scale: see `integrator.DEFAULT_TOLERANCE`."""
    error = max(abs(difference[THETA_M]) * plant.per_angle_m, abs(difference[THETA_L]) * plant.per_angle_l)
    error = max(error, abs(difference[OMEGA_M]) * plant.per_speed_m, abs(difference[OMEGA_L]) * plant.per_speed_l)
    error = max(error, abs(difference[CURRENT]) * plant.per_current)
    if account:
        for k in (SUPPLIED, LOST):
            error = max(error, abs(difference[k]) / (plant.energy_scale + abs(after[k])))
    for k in range(7):
        if not math.isfinite(after[k]):
            return math.inf
    return float(error)


_derivative: Derivative = unbound
_linearize: Linearize = unbound
_contact_of: ContactOf = unbound


def _step(
    plant: PlantConstants,
    state: Array,
    h: float,
    acting: Acting,
    tolerance: float,
    account: bool,
    out: Array,
) -> tuple[float, float]:
    """Take a step of ``h`` seconds from ``state`` to ``out``, both of shape (7,).

    Returns
    -------
    (error, force) : the error over what ``tolerance`` allows, that of the energies included if ``account``; and the
        contact force at ``state``, N, without its sign
    """
    stages = np.empty((6, 7))
    residual = np.empty(7)
    g = 1.0 / (h * GAMMA)
    slopes = _linearize(plant, state, acting.slip_m, acting.slip_l)
    for j in range(6):
        for k in range(7):
            value = state[k]
            for m in range(j):
                value += STAGES[j, m] * stages[m, k]
            out[k] = value
        _derivative(plant, out, acting, residual)
        for k in range(7):
            for m in range(j):
                residual[k] += COUPLINGS[j, m] / h * stages[m, k]
        _solve_stage(plant, slopes, g, state[CURRENT], acting, residual, stages[j])
    for k in range(7):
        out[k] += stages[5, k]
    return _error(plant, out, stages[5], account) / tolerance, abs(_contact_of(plant, state)[0])


@cache
def implicit_with(law: type[Contact]) -> Step:
    """Return `_step` compiled for a contact law."""
    equations = equations_with(law)  # type: ignore[arg-type]
    return specialize(
        _step,
        _derivative=equations.derivative,
        _linearize=equations.linearize,
        _contact_of=equations.contact_of,
    )
