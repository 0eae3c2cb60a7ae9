"""Error-controlled integration of the drive: stiff in contact, smooth in the gap, any validated drive.

RODAS4P, a linearly implicit (Rosenbrock) method of order 4 with an embedded third-order solution, stiffly
accurate and L-stable (Steinebach, 1995; in Hairer & Wanner, Solving ODEs II, sect. IV.7). Each step costs six
evaluations of the equations of motion and no iteration. The stage equations have the drive's structure, so
they are solved by eliminating down to one unknown, the contact force.

Dry friction makes the equations change where a shaft comes to rest, reverses or breaks away. No step goes across such
an event: `friction` tells where in the step it is, and the step is taken again, to there. A shaft that sticks has a
speed of exactly 0.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np

from backlash_ros.drivetrain.compiled import compiled, specialize
from backlash_ros.drivetrain.constants import PLANT_TYPE, PlantConstants
from backlash_ros.drivetrain.contact import Contact, ToothForce
from backlash_ros.drivetrain.dynamics import SLIDES, Slopes, equations_with, load_rubs, motor_rubs
from backlash_ros.drivetrain.integration.friction import friction_with
from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.drivetrain.signals import (
    CURRENT,
    LOST,
    OMEGA_L,
    OMEGA_M,
    STATE_NAMES,
    SUPPLIED,
    THETA_L,
    THETA_M,
    Array,
    PlantState,
)

_types: Any = numba.types

DEFAULT_TOLERANCE = 1e-9
"""Error allowed per step: in units of the backlash for angles, relative for speeds and current."""

DONE, STEP_TOO_SMALL, TOO_MANY_STEPS = range(3)

STEP_SIZE, PEAK_FORCE = range(2)
"""What `advance` keeps from call to call."""

Advance = Callable[[PlantConstants, PlantState, Array, float, float, float, float], tuple[int, float]]
ADVANCE_SIGNATURE: Any = _types.Tuple((_types.int64, _types.float64))(
    PLANT_TYPE, *[_types.float64[::1]] * 2, *[_types.float64] * 4
)
"""numba's signature of `Advance`."""

_STEPS_AT_MOST = 200_000
_SHORTEST = 1e-13
"""Step, as a share of the duration, below which time does not pass."""
_TRIES = 20
"""Steps towards one event before the shaft is taken to be there."""
_NEAR = 1e-6
"""Share of a step within which an event is not looked for any more: it was none, or the next step meets it."""
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

    def __init__(self, reason: str, time: float, state: Array) -> None:
        listed = ", ".join(f"{name} = {value:.9g}" for name, value in zip(STATE_NAMES, state[:5], strict=True))
        super().__init__(f"integration stopped at t = {time:.9g} s: {reason} ({listed})")
        self.time = time
        self.state = state.copy()


def integration_memory() -> Array:
    """Return what `Advance` keeps from call to call, as it is at the start: STEP_SIZE (s) and PEAK_FORCE (N)."""
    return np.zeros(2)


@compiled
def _solve_stage(
    plant: PlantConstants,
    s: Slopes,
    g: float,
    current: float,
    command: float,
    load_torque: float,
    residual: Array,
    out: Array,
) -> None:
    """Solve (g I - J) out = residual, with J the Jacobian that ``s`` makes, g = 1/(h gamma)."""
    theta_m, theta_l = residual[THETA_M], residual[THETA_L]
    inverse_i = 1.0 / (g + plant.R / plant.L)
    inverse_m = 1.0 / (g + s.drag_m + s.per_current * plant.K_m * inverse_i / plant.L)
    inverse_l = 1.0 / (g + s.drag_l - s.per_torque * s.torque_l / g)
    # Speeds without the change of the contact force, and what one newton of it takes away or adds.
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
    electrical = plant.K_m * current * out[OMEGA_M] if math.isinf(plant.L) else command * out[CURRENT]
    out[SUPPLIED] = (residual[SUPPLIED] + electrical + load_torque * out[OMEGA_L]) / g
    out[LOST] = (residual[LOST] + lost) / g


@compiled
def _error(plant: PlantConstants, before: Array, after: Array, difference: Array, tolerance: float) -> float:
    """Largest error over its allowance; angles are judged against the backlash wherever the shaft stands."""
    angle = 2.0 * plant.half_gap * (1.0 - plant.variation)
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
def _growth(error: float, rejected: bool) -> float:
    """Return next step over this one, for its error over the allowance and whether the one before was rejected."""
    if error <= 1.0:
        growth = min(5.0, 0.9 * float(max(error, 1e-9) ** -0.25))
        return min(growth, 1.0) if rejected else growth
    return max(0.2, 0.9 * float(error**-0.25)) if math.isfinite(error) else 0.1


def _derivative(
    plant: PlantConstants,
    state: Array,
    command: float,
    load_torque: float,
    slip_m: float,
    slip_l: float,
    out: Array,
) -> None:
    """Stand for `dynamics.derivative` of a contact law, which `integrator_with` binds."""
    raise NotImplementedError


def _linearize(plant: PlantConstants, state: Array, slip_m: float, slip_l: float) -> Slopes:
    """Stand for `dynamics.linearize` of a contact law, which `integrator_with` binds."""
    raise NotImplementedError


def _contact_of(plant: PlantConstants, state: Array) -> ToothForce:
    """Stand for `dynamics.contact_of` of a contact law, which `integrator_with` binds."""
    raise NotImplementedError


def _slips(plant: PlantConstants, state: Array, load_torque: float, tolerance: float) -> tuple[float, float]:
    """Stand for `friction.slips` of a contact law, which `integrator_with` binds."""
    raise NotImplementedError


def _first_event(
    plant: PlantConstants,
    before: Array,
    after: Array,
    slope_before: Array,
    slope_after: Array,
    load_torque: float,
    slip_m: float,
    slip_l: float,
    used: float,
    tolerance: float,
) -> tuple[float, bool, bool]:
    """Stand for `friction.first_event` of a contact law, which `integrator_with` binds."""
    raise NotImplementedError


def _switch(
    plant: PlantConstants,
    state: Array,
    load_torque: float,
    slip_m: float,
    slip_l: float,
    come_m: bool,
    come_l: bool,
    tolerance: float,
) -> tuple[float, float]:
    """Stand for `friction.switch` of a contact law, which `integrator_with` binds."""
    raise NotImplementedError


def _advance(
    plant: PlantConstants,
    state: PlantState,
    step: Array,
    command: float,
    load_torque: float,
    duration: float,
    tolerance: float,
) -> tuple[int, float]:
    """Advance ``state`` in place by ``duration`` seconds under a constant command and load torque (N m).

    Parameters
    ----------
    plant : PlantConstants
    state : shape (7,); on failure the last good one
    step : of `integration_memory`, shape (2,): the step size to try first, s, updated, so that the next call starts
        well; and the largest magnitude of the contact force since the caller last set it to 0, N
    command : voltage, V, or where the inductance is infinite the current, A, which it then is from the start
    tolerance : see `DEFAULT_TOLERANCE`

    Returns
    -------
    (status, time) : DONE, STEP_TOO_SMALL or TOO_MANY_STEPS, and how far the state got, s
    """
    stages = np.empty((6, 7))
    trial = np.empty(7)
    residual = np.empty(7)
    slope = np.empty(7)
    if math.isinf(plant.L):
        state[CURRENT] = command
    rubs = motor_rubs(plant) or load_rubs(plant)
    slip_m = slip_l = SLIDES
    if rubs:
        slip_m, slip_l = _slips(plant, state, load_torque, tolerance)
    time = 0.0
    h = step[STEP_SIZE]
    if not 0.0 < h <= duration:
        h = duration
    rejected = False
    # Steps towards the next event, the step to go on with behind it, and the time within which it comes.
    tries, size, ahead = 0, 0.0, 0.0
    for _ in range(_STEPS_AT_MOST):
        remaining = duration - time
        if remaining <= 1e-12 * duration:
            return DONE, duration
        last = h >= remaining * (1.0 - 1e-9)
        used = remaining if last else h
        if used <= _SHORTEST * duration:
            return STEP_TOO_SMALL, time
        g = 1.0 / (used * _GAMMA)
        slopes = _linearize(plant, state, slip_m, slip_l)
        for j in range(6):
            for k in range(7):
                value = state[k]
                for m in range(j):
                    value += _A[j, m] * stages[m, k]
                trial[k] = value
            _derivative(plant, trial, command, load_torque, slip_m, slip_l, residual)
            if j == 0:
                slope[:] = residual
            for k in range(7):
                for m in range(j):
                    residual[k] += _C[j, m] / used * stages[m, k]
            _solve_stage(plant, slopes, g, state[CURRENT], command, load_torque, residual, stages[j])
        for k in range(7):
            trial[k] += stages[5, k]
        error = _error(plant, state, trial, stages[5], tolerance)
        if not error <= 1.0:  # nan too
            h = used * _growth(error, rejected)
            rejected = True
            continue
        come_m = come_l = False
        if rubs:
            _derivative(plant, trial, command, load_torque, slip_m, slip_l, residual)
            share, come_m, come_l = _first_event(
                plant, state, trial, slope, residual, load_torque, slip_m, slip_l, used, tolerance
            )
            if share < 1.0 - 1e-9 and tries < _TRIES:
                tries += 1
                if tries > 4:  # the curve is no cubic: close in from both sides
                    share = min(max(share, 0.1), 0.9)
                size, ahead = max(size, used), used
                h = used * share
                if h <= 2.0 * _SHORTEST * duration:
                    h, tries = 2.0 * _SHORTEST * duration, _TRIES
                continue
        state[:] = trial
        time = duration if last else time + used
        growth = _growth(error, rejected)
        # A last step that was cut short to end on time says little about the size that would do.
        h = used * growth if growth < 1.0 or not last else max(h, used * growth)
        if size > 0.0:  # this step was cut short for an event
            ahead -= used
            if come_m or come_l or ahead <= _NEAR * size:
                h, size, tries = max(h, size), 0.0, 0
            else:  # too short: teeth that meet push all at once
                h = max(0.5 * ahead, 2.0 * _SHORTEST * duration)
        if come_m or come_l:
            slip_m, slip_l = _switch(plant, state, load_torque, slip_m, slip_l, come_m, come_l, tolerance)
        step[STEP_SIZE] = h
        step[PEAK_FORCE] = max(step[PEAK_FORCE], abs(_contact_of(plant, state)[0]))
        rejected = False
    return TOO_MANY_STEPS, time


def integrator_for(drive: Drive) -> Advance:
    """Return `_advance` compiled for the contact law of ``drive``: a value that a compiled loop can take."""
    return integrator_with(type(drive.gear.contact))  # type: ignore[arg-type]


@cache
def integrator_with(law: type[Contact]) -> Advance:
    """Return `_advance` compiled for a contact law."""
    equations = equations_with(law)  # type: ignore[arg-type]
    friction = friction_with(law)  # type: ignore[arg-type]
    return specialize(
        _advance,
        ADVANCE_SIGNATURE,
        _derivative=equations.derivative,
        _linearize=equations.linearize,
        _contact_of=equations.contact_of,
        _slips=friction.slips,
        _first_event=friction.first_event,
        _switch=friction.switch,
    )
