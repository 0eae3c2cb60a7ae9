"""A linear output-feedback compensator for the elastic two-mass drive: a reconstruction of Mohan's (SSST 2007).

Only the abstract and a step response of that controller are known: it is linear, made for a position control system
with elasticity, removes the limit cycle of the backlash, and overshoots somewhat. This law has those properties but
need not be the original: LQG on motor and load joined by a spring, from the load's angle alone, with a lead on the
reference that more than compensates the slow pole. The spring is the teeth's secant stiffness at the edge of the gap.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.linalg import solve_discrete_are

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, ControlLaw, NamedLaw
from backlash_ros.drivetrain import Drive, discretize
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, POSITION, THETA_L, Estimate, Setpoint

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_STATES = 5
_A, _B, _L, _K, _RATIO, _LEAD, _FORGET, _HELD = 0, 25, 30, 35, 40, 41, 42, 43
_STARTED, _SLOW_REFERENCE = 1 + _STATES, 2 + _STATES


@dataclass(frozen=True)
class ElasticLqgParameters(Validated):
    """Weights and noise of the compensator; with the defaults the nominal drive comes to rest."""

    section: ClassVar[str] = "laws.elastic_lqg"

    position_weight: float = quantity(
        "LQR weight on the load's angle", "V^2/rad^2", above=0, at_most=1e12, default=25.0
    )
    torque_noise: float = quantity("noise on the motor torque", "N m", above=0, at_most=1e3, default=1e-3)
    angle_noise: float = quantity("noise on the load's angle", "rad", above=0, at_most=1, default=1e-3)
    lead: float = quantity(
        "zero of the lead filter on the reference, in units of the slowest time constant",
        "",
        at_least=0,
        at_most=10,
        default=1.1,
    )
    lag_time: float = quantity("lag of the lead filter on the reference", "s", above=0, at_most=10, default=0.03)


@compiled_as(LAW_SIGNATURE)
def elastic_lqg_step(
    law: Array, memory: Array, estimate: Estimate, setpoint: Setpoint, low: float, high: float
) -> float:
    """Kalman predictor in ``memory[1:6]``: theta_m, omega_m, theta_l, omega_l, i; V = K (target - state)."""
    state = memory[1 : 1 + _STATES]
    reference = setpoint[POSITION]
    if memory[_STARTED] == 0.0:
        state[0], state[2] = estimate[THETA_L] / law[_RATIO], estimate[THETA_L]
        memory[_SLOW_REFERENCE] = estimate[THETA_L]
        memory[_STARTED] = 1.0
    target = reference + law[_LEAD] * (reference - memory[_SLOW_REFERENCE])
    per_target = law[_K] / law[_RATIO] + law[_K + 2]
    wanted = law[_K] * (target / law[_RATIO] - state[0]) + law[_K + 2] * (target - state[2])
    wanted -= law[_K + 1] * state[1] + law[_K + 3] * state[3] + law[_K + 4] * state[4]
    voltage = clamp(wanted, low, high)
    # The lead follows the reference that the range lets through, not one that was never acted on (Hanus, Kinnaert &
    # Henrotte, Automatica 23, 1987).
    acted_on = reference + (voltage - wanted) / (per_target * (1.0 + law[_LEAD]))
    memory[_SLOW_REFERENCE] += law[_FORGET] * (acted_on - memory[_SLOW_REFERENCE])
    innovation = estimate[THETA_L] - state[2]
    following = np.empty(_STATES)
    for i in range(_STATES):
        following[i] = law[_B + i] * voltage + law[_L + i] * innovation
        for j in range(_STATES):
            following[i] += law[_A + _STATES * i + j] * state[j]
    state[:] = following
    return voltage


def _take_over(law: Array, memory: Array, estimate: Estimate, setpoint: Setpoint, holding: float) -> None:
    """Start the predictor at its steady state for the held load, and the lead so that it asks for the holding voltage.

    So the voltage does not step; how far the load then moves under a load torque depends on the law.
    """
    angle, speed = estimate[THETA_L], estimate[OMEGA_L]
    moves = np.array([angle / law[_RATIO], speed / law[_RATIO], angle, speed, 0.0])
    memory[1 : 1 + _STATES] = moves + holding * law[_HELD : _HELD + _STATES]
    reference, gains = setpoint[POSITION], law[_K : _K + _STATES]
    target = (holding + gains @ memory[1 : 1 + _STATES]) / (gains[0] / law[_RATIO] + gains[2])
    memory[_SLOW_REFERENCE] = reference - (target - reference) / law[_LEAD] if law[_LEAD] else reference
    memory[_STARTED] = 1.0


def _elastic_model(drive: Drive) -> tuple[Array, Array]:
    """Return (A, B) of motor and load joined by a spring.

    States theta_m (rad), omega_m (rad/s), theta_l, omega_l, i (A); input the voltage, V. Shape (5, 5) and (5, 1).
    """
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
    return a, np.array([[0.0], [0.0], [0.0], [0.0], [1.0 / motor.inductance]])


def _discrete_gain(a: Array, b: Array, q: Array, r: Array) -> Array:
    """Return the gain that minimizes the sum of x'Qx + u'Ru, u = -gain x, by the discrete Riccati equation."""
    cost = solve_discrete_are(a, b, q, r)
    return np.asarray(np.linalg.solve(b.T @ cost @ b + r, b.T @ cost @ a))


def elastic_lqg(drive: Drive, settings: "ServoSettings", parameters: ElasticLqgParameters) -> ControlLaw:
    """Design the compensator for ``drive`` at the sample period: a linear quadratic regulator with a Kalman filter.

    Raises
    ------
    ValueError
        If a Riccati equation is too ill-conditioned for the drive.
    """
    a, b = discretize(drive, *_elastic_model(drive), settings.period)
    angle = np.array([[0.0, 0.0, 1.0, 0.0, 0.0]])
    torque = np.array([[0.0], [settings.period / drive.motor.inertia], [0.0], [0.0], [0.0]])
    weight, noise = np.diag([0.0, 0.0, parameters.position_weight, 0.0, 0.0]), np.eye(1) * parameters.angle_noise**2
    try:
        k = _discrete_gain(a, b, weight, np.eye(1))
        poles = np.linalg.eigvals(a - b @ k)
        predictor = _discrete_gain(a.T, angle.T, parameters.torque_noise**2 * (torque @ torque.T), noise).T
        # Its steady state per volt with the load at rest.
        held = np.linalg.solve(np.eye(_STATES) - a + predictor @ angle, b)
    except ValueError as error:
        raise ValueError(f"law = 'elastic_lqg' cannot be designed for this drive: {error}") from error
    slowest = -settings.period / np.log(np.max(np.abs(poles)))
    reference = [
        parameters.lead * slowest / parameters.lag_time - 1.0,
        -np.expm1(-settings.period / parameters.lag_time),
    ]
    parts: list[Any] = [a, b, predictor, k, [drive.gear.ratio], reference, held]
    constants = np.concatenate([np.ravel(part) for part in parts])
    return ControlLaw(elastic_lqg_step, constants, np.array([float(FAST_REGION), *np.zeros(_STATES + 2)]), _take_over)


LAWS = {"elastic_lqg": NamedLaw("linear compensator (after Mohan)", elastic_lqg, ElasticLqgParameters())}
