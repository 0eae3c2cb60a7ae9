"""A linear output-feedback compensator for the elastic two-mass drive: a reconstruction of Mohan's (SSST 2007).

Of that controller the abstract and a step response are known: it is linear, made for a position control system with
elasticity, removes the limit cycle of the backlash, and overshoots somewhat. This one has those properties and is not
claimed to be the original: LQG on motor and load joined by a spring, from the load's angle alone, with a lead on the
reference that makes up for the slow pole, and more. The spring is the teeth's secant stiffness at the edge of the gap.
"""

from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are

from backlash_ros.control.command import within
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, Array, ControlLaw, NamedLaw
from backlash_ros.control.observer import THETA_L
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive, sampled
from backlash_ros.drivetrain.compiled import compiled_as

_STATES = 5
_A, _B, _L, _K, _RATIO, _LEAD, _FORGET = 0, 25, 30, 35, 40, 41, 42
_STARTED, _SLOW_REFERENCE = 1 + _STATES, 2 + _STATES

POSITION_WEIGHT = 25.0
"""LQR weight on the load's angle: low enough for the nominal drive to come to rest."""
TORQUE_NOISE, ANGLE_NOISE = 1e-3, 1e-3
"""What the Kalman filter expects: noise on the motor torque in N m and on the angle in rad."""
LEAD, LAG_TIME = 1.1, 0.03
"""Zero of the reference's lead over the slowest pole's time constant, and its lag, s."""


@compiled_as(LAW_SIGNATURE)
def elastic_lqg_step(law: Array, memory: Array, estimate: Array, reference: float, low: float, high: float) -> float:
    """Kalman predictor in ``memory[1:6]``: theta_m, omega_m, theta_l, omega_l, i; V = -K (state - target)."""
    state = memory[1 : 1 + _STATES]
    if memory[_STARTED] == 0.0:
        state[0], state[2] = estimate[THETA_L] / law[_RATIO], estimate[THETA_L]
        memory[_SLOW_REFERENCE] = estimate[THETA_L]
        memory[_STARTED] = 1.0
    target = reference + law[_LEAD] * (reference - memory[_SLOW_REFERENCE])
    memory[_SLOW_REFERENCE] += law[_FORGET] * (reference - memory[_SLOW_REFERENCE])
    wanted = law[_K] * (target / law[_RATIO] - state[0]) + law[_K + 2] * (target - state[2])
    wanted -= law[_K + 1] * state[1] + law[_K + 3] * state[3] + law[_K + 4] * state[4]
    voltage = within(wanted, low, high)
    innovation = estimate[THETA_L] - state[2]
    following = np.empty(_STATES)
    for i in range(_STATES):
        following[i] = law[_B + i] * voltage + law[_L + i] * innovation
        for j in range(_STATES):
            following[i] += law[_A + _STATES * i + j] * state[j]
    state[:] = following
    return voltage


def optimal_gain(a: Array, b: Array, weight: Array, effort: Array) -> Array:
    """Return K of the discrete LQR problem, u = -K x; ValueError where it is too ill-conditioned."""
    try:
        riccati = solve_discrete_are(a, b, weight, effort)
    except ValueError as error:
        raise ValueError(f"law = 'elastic_lqg' cannot be designed for this drive: {error}") from error
    gain: Array = np.linalg.solve(effort + b.T @ riccati @ b, b.T @ riccati @ a)
    return gain


def elastic_lqg(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Design the compensator for ``drive`` at the sample period."""
    motor, gear, load = drive.motor, drive.gear, drive.load
    spring = gear.edge_stiffness
    r1, r2 = gear.motor_radius, gear.load_radius
    a = np.zeros((_STATES, _STATES))
    a[0, 1] = a[2, 3] = 1.0
    a[1] = [-spring * r1 * r1, -motor.viscous_friction, spring * r1 * r2, 0.0, motor.torque_constant]
    a[1] /= motor.inertia
    a[3] = [spring * r1 * r2, 0.0, -spring * r2 * r2, -load.viscous_friction, 0.0]
    a[3] /= load.inertia
    a[4] = [0.0, -motor.torque_constant, 0.0, 0.0, -motor.resistance]
    a[4] /= motor.inductance
    b = np.array([[0.0], [0.0], [0.0], [0.0], [1.0 / motor.inductance]])
    c = np.array([[0.0, 0.0, 1.0, 0.0, 0.0]])
    a_held, b_held = sampled(drive, a, b, settings.period)
    k = optimal_gain(a_held, b_held, np.diag([0.0, 0.0, POSITION_WEIGHT, 0.0, 0.0]), np.eye(1))
    poles = np.linalg.eigvals(a_held - b_held @ k)
    slowest = -settings.period / np.log(np.max(np.abs(poles)))
    torque = np.array([[0.0], [settings.period / motor.inertia], [0.0], [0.0], [0.0]])
    # The Kalman predictor is the dual problem.
    predictor = optimal_gain(a_held.T, c.T, TORQUE_NOISE**2 * torque @ torque.T, np.eye(1) * ANGLE_NOISE**2).T
    reference = [LEAD * slowest / LAG_TIME - 1.0, -np.expm1(-settings.period / LAG_TIME)]
    parts: list[Any] = [a_held, b_held, predictor, k, [gear.ratio], reference]
    constants = np.concatenate([np.ravel(part) for part in parts])
    return ControlLaw(elastic_lqg_step, constants, np.array([float(FAST_REGION), *np.zeros(_STATES + 2)]))


LAWS = {"elastic_lqg": NamedLaw("linear compensator (after Mohan)", elastic_lqg)}
