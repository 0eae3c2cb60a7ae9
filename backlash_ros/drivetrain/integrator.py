"""Error-controlled integration of the drive: stiff in contact, smooth in the gap, any validated drive.

RODAS4P, a linearly implicit (Rosenbrock) method of order 4 with an embedded third-order solution, stiffly
accurate and L-stable (Steinebach, 1995; in Hairer & Wanner, Solving ODEs II, sect. IV.7). Each step costs six
evaluations of the equations of motion and no iteration. The stage equations have the drive's structure, so
they are solved by eliminating down to one unknown, the contact force.
"""

import math
from typing import Any

import numba
import numpy as np

from backlash_ros.drivetrain.compiled import compiled
from backlash_ros.drivetrain.dynamics import (
    CURRENT,
    LOST,
    OMEGA_L,
    OMEGA_M,
    STATE_NAMES,
    SUPPLIED,
    THETA_L,
    THETA_M,
    State,
    contact_of,
    coulomb,
    derivative,
    gap_of,
)
from backlash_ros.drivetrain.parameters import PlantConstants

DEFAULT_TOLERANCE = 1e-9
"""Error allowed per step: in units of the backlash for angles, relative for speeds and current."""

DONE, STEP_TOO_SMALL, TOO_MANY_STEPS = range(3)

STEP_SIZE, PEAK_FORCE = range(2)
"""What `advance` keeps from call to call."""

_STEPS_AT_MOST = 200_000
_GAMMA = 0.25
_A = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0, 0.0, 0.0, 0.0, 0.0],
        [1.831036793486759, 0.4955183967433795, 0.0, 0.0, 0.0],
        [2.304376582692669, -0.05249275245743001, -1.176798761832782, 0.0, 0.0],
        [-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401, 0.0],
        [-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401, 1.0],
    ]
)
_C = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [-12.0, 0.0, 0.0, 0.0, 0.0],
        [-8.791795173947035, -2.207865586973518, 0.0, 0.0, 0.0],
        [10.81793056857153, 6.780270611428266, 19.53485944642410, 0.0, 0.0],
        [34.19095006749676, 15.49671153725963, 54.74760875964130, 14.16005392148534, 0.0],
        [34.62605830930532, 15.30084976114473, 56.99955578662667, 18.40807009793095, -5.714285714285717],
    ]
)


REASONS = {STEP_TOO_SMALL: "the step size fell below rounding", TOO_MANY_STEPS: "too many steps"}


class IntegrationError(RuntimeError):
    """The equations of motion could not be integrated to the wanted accuracy."""

    def __init__(self, reason: str, time: float, state: State) -> None:
        listed = ", ".join(f"{name} = {value:.9g}" for name, value in zip(STATE_NAMES, state[:5], strict=True))
        super().__init__(f"integration stopped at t = {time:.9g} s: {reason} ({listed})")
        self.time = time
        self.state = state.copy()


@compiled
def _solve_stage(
    plant: PlantConstants,
    at: State,
    g: float,
    command: float,
    load_torque: float,
    residual: State,
    out: State,
) -> None:
    """Solve (g I - J) out = residual, with J the Jacobian of the equations of motion at ``at``, g = 1/(h gamma)."""
    force_now, stiffness, damping, elastic, elastic_stiffness = contact_of(plant, at)
    friction, friction_slope = coulomb(plant, at[OMEGA_L])
    theta_m, omega_m, theta_l = residual[THETA_M], residual[OMEGA_M], residual[THETA_L]
    inverse_i = 1.0 / (g + plant.R / plant.L)
    inverse_m = 1.0 / (g + plant.B_m / plant.J_m + plant.K_m * plant.K_m * inverse_i / (plant.J_m * plant.L))
    inverse_l = 1.0 / (g + (plant.B_l + friction_slope) / plant.J_l)
    # Speeds without the change of the contact force, and what one newton of it takes away or adds.
    free_m = (omega_m + plant.K_m * inverse_i * residual[CURRENT] / plant.J_m) * inverse_m
    free_l = residual[OMEGA_L] * inverse_l
    per_force = plant.R1 * plant.R1 * inverse_m / plant.J_m + plant.R2 * plant.R2 * inverse_l / plant.J_l
    coupling = stiffness / g + damping
    force = coupling * (plant.R1 * free_m - plant.R2 * free_l)
    force += stiffness / g * (plant.R1 * theta_m - plant.R2 * theta_l)
    force /= 1.0 + coupling * per_force
    out[OMEGA_M] = free_m - plant.R1 * inverse_m / plant.J_m * force
    out[OMEGA_L] = free_l + plant.R2 * inverse_l / plant.J_l * force
    out[THETA_M] = (theta_m + out[OMEGA_M]) / g
    out[THETA_L] = (theta_l + out[OMEGA_L]) / g
    out[CURRENT] = (residual[CURRENT] - plant.K_m / plant.L * out[OMEGA_M]) * inverse_i
    # The energy account follows from the motion and does not act back on it.
    _, gap_rate = gap_of(plant, at)
    gap_change = plant.R1 * out[THETA_M] - plant.R2 * out[THETA_L]
    rate_change = plant.R1 * out[OMEGA_M] - plant.R2 * out[OMEGA_L]
    lost = 2.0 * (plant.R * at[CURRENT] * out[CURRENT] + plant.B_m * at[OMEGA_M] * out[OMEGA_M])
    lost += (2.0 * plant.B_l * at[OMEGA_L] + friction + friction_slope * at[OMEGA_L]) * out[OMEGA_L]
    lost += (stiffness - elastic_stiffness) * gap_rate * gap_change
    lost += (damping * gap_rate + force_now - elastic) * rate_change
    electrical = plant.K_m * at[CURRENT] * out[OMEGA_M] if math.isinf(plant.L) else command * out[CURRENT]
    out[SUPPLIED] = (residual[SUPPLIED] + electrical + load_torque * out[OMEGA_L]) / g
    out[LOST] = (residual[LOST] + lost) / g


@compiled
def _error(plant: PlantConstants, before: State, after: State, difference: State, tolerance: float) -> float:
    """Largest error over its allowance; angles are judged against the backlash wherever the shaft stands."""
    angle = 2.0 * plant.half_gap
    motor = abs(difference[THETA_M]) / (angle / plant.R1)
    load = abs(difference[THETA_L]) / (angle / plant.R2)
    error = max(motor, load)
    for k in (OMEGA_M, OMEGA_L, CURRENT):
        small = plant.current_scale
        if k == OMEGA_M:
            small = plant.speed_scale
        elif k == OMEGA_L:
            small = plant.speed_scale * plant.R1 / plant.R2
        error = max(error, abs(difference[k]) / (1e-3 * small + max(abs(before[k]), abs(after[k]))))
    for k in (SUPPLIED, LOST):
        error = max(error, abs(difference[k]) / (plant.energy_scale + max(abs(before[k]), abs(after[k]))))
    for k in range(7):
        if not math.isfinite(after[k]):
            return math.inf
    return float(error / tolerance)


@compiled
def advance(
    plant: PlantConstants,
    state: State,
    step: State,
    command: float,
    load_torque: float,
    duration: float,
    tolerance: float,
) -> tuple[int, float]:
    """Advance ``state`` in place by ``duration`` seconds under a constant command and load torque (N m).

    Parameters
    ----------
    plant : PlantConstants
    command : voltage, V, or where the inductance is infinite the current, A, which it then is from the start
    state : array, shape (7,), in the order of `dynamics`; on failure the last good state
    step : array, shape (2,): the step size to try first, s, updated, so that the next call starts well; and the
        largest magnitude of the contact force since the caller last set it to 0, N
    tolerance : see `DEFAULT_TOLERANCE`

    Returns
    -------
    (status, time) : DONE, STEP_TOO_SMALL or TOO_MANY_STEPS, and how far the state got, s
    """
    stages = np.empty((6, 7))
    trial = np.empty(7)
    residual = np.empty(7)
    if math.isinf(plant.L):
        state[CURRENT] = command
    time = 0.0
    h = step[STEP_SIZE]
    if not 0.0 < h <= duration:
        h = duration
    rejected = False
    for _ in range(_STEPS_AT_MOST):
        remaining = duration - time
        if remaining <= 1e-12 * duration:
            return DONE, duration
        last = h >= remaining * (1.0 - 1e-9)
        used = remaining if last else h
        if used <= 1e-13 * duration:
            return STEP_TOO_SMALL, time
        g = 1.0 / (used * _GAMMA)
        for j in range(6):
            for k in range(7):
                value = state[k]
                for m in range(j):
                    value += _A[j, m] * stages[m, k]
                trial[k] = value
            derivative(plant, trial, command, load_torque, residual)
            for k in range(7):
                for m in range(j):
                    residual[k] += _C[j, m] / used * stages[m, k]
            _solve_stage(plant, state, g, command, load_torque, residual, stages[j])
        for k in range(7):
            trial[k] += stages[5, k]
        error = _error(plant, state, trial, stages[5], tolerance)
        if error <= 1.0:
            state[:] = trial
            time = duration if last else time + used
            growth = min(5.0, 0.9 * max(error, 1e-9) ** -0.25)
            if rejected:
                growth = min(growth, 1.0)
            # A last step that was cut short to end on time says little about the size that would do.
            h = used * growth if growth < 1.0 or not last else max(h, used * growth)
            step[STEP_SIZE] = h
            step[PEAK_FORCE] = max(step[PEAK_FORCE], abs(contact_of(plant, state)[0]))
            rejected = False
        else:
            h = used * (max(0.2, 0.9 * error**-0.25) if math.isfinite(error) else 0.1)
            rejected = True
    return TOO_MANY_STEPS, time


def integration_memory() -> State:
    """Return what `advance` keeps from call to call."""
    return np.zeros(2)


_SIGNATURES: dict[int, Any] = {}


def _signature() -> Any:
    from backlash_ros.drivetrain.constants import plant_constants
    from backlash_ros.drivetrain.parameters import NOMINAL_DRIVE

    types: Any = numba.types
    flat = types.float64[::1]
    return types.Tuple((types.int64, types.float64))(
        numba.typeof(plant_constants(NOMINAL_DRIVE)), flat, flat, *[types.float64] * 4
    )


Advance = Any
ADVANCE_SIGNATURE = _signature()


def integrator_for(drive: Any) -> Any:
    """Return the integrator."""
    if ADVANCE_SIGNATURE.args not in advance.overloads:
        advance.compile(ADVANCE_SIGNATURE)
    return advance
