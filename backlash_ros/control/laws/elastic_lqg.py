"""A linear output-feedback compensator for the elastic two-mass drive: a reconstruction of Mohan's (SSST 2007).

Only the abstract and a step response of that controller are known: it is linear, made for a position control system
with elasticity, removes the limit cycle of the backlash, and overshoots somewhat. This law has those properties but
need not be the original: LQG on motor and load joined by a spring, from the load's angle alone, with a lead on the
reference that more than compensates the slow pole. The spring is the teeth's secant stiffness at the edge of the gap.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.linalg import solve_discrete_are

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import LAW_SIGNATURE, ControlLaw, LawState, NamedLaw
from backlash_ros.drivetrain import Drive, discretize
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array, Record, cells, row_of, view_of
from backlash_ros.foundation.signals import (
    CURRENT,
    OMEGA_L,
    OMEGA_M,
    POSITION,
    THETA_L,
    THETA_M,
    Estimate,
    Setpoint,
)

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_STATES = 5
"""Motor angle and speed, load angle and speed, and current, as in an `Estimate`."""


class ElasticLqgConstants(Record):
    """The compensator as the compiled step reads it."""

    transition: Array = cells(_STATES, _STATES)  # A of the discrete model
    input: Array = cells(_STATES)  # B, per volt
    correction: Array = cells(_STATES)  # of the predictor, per rad of innovation
    gains: Array = cells(_STATES)  # V per unit of each state
    ratio: float = 1.0  # of the gear, n
    lead: float = 0.0  # lead time over lag time, less 1
    forgetting: float = 1.0  # share of a step that the lag follows within a period
    held: Array = cells(_STATES)  # the predictor's steady state per volt with the load at rest


class ElasticLqgState(LawState):
    """The predictor and the lag of the reference."""

    predicted: Array = cells(_STATES)  # the states at the next sample
    following: Array = cells(_STATES)  # those after them, while they are computed
    started: float = 0.0  # 1 once a sample has been seen
    slow_reference: float = 0.0  # rad, behind the lag


elastic_lqg_constants_at, elastic_lqg_state_at = view_of(ElasticLqgConstants), view_of(ElasticLqgState)


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
def elastic_lqg_step(law: Array, state: Array, estimate: Estimate, path: Array, low: float, high: float) -> float:
    """V = gains (target - predicted), with a Kalman predictor of the states and a lead on the reference."""
    constants, memory = elastic_lqg_constants_at(law), elastic_lqg_state_at(state)
    predicted, gains, ratio, lead = memory.predicted, constants.gains, constants.ratio, constants.lead
    reference = path[0, POSITION]
    if memory.started == 0.0:
        predicted[THETA_M], predicted[THETA_L] = estimate[THETA_L] / ratio, estimate[THETA_L]
        memory.slow_reference = estimate[THETA_L]
        memory.started = 1.0
    target = reference + lead * (reference - memory.slow_reference)
    per_target = gains[THETA_M] / ratio + gains[THETA_L]
    wanted = gains[THETA_M] * (target / ratio - predicted[THETA_M]) + gains[THETA_L] * (target - predicted[THETA_L])
    wanted -= (
        gains[OMEGA_M] * predicted[OMEGA_M] + gains[OMEGA_L] * predicted[OMEGA_L] + gains[CURRENT] * predicted[CURRENT]
    )
    voltage = clamp(wanted, low, high)
    # The lead follows the reference that the range lets through, not one that was never acted on (Hanus, Kinnaert &
    # Henrotte, Automatica 23, 1987).
    acted_on = reference + (voltage - wanted) / (per_target * (1.0 + lead))
    memory.slow_reference += constants.forgetting * (acted_on - memory.slow_reference)
    innovation = estimate[THETA_L] - predicted[THETA_L]
    following = memory.following
    for i in range(_STATES):
        following[i] = constants.input[i] * voltage + constants.correction[i] * innovation
        for j in range(_STATES):
            following[i] += constants.transition[i, j] * predicted[j]
    predicted[:] = following
    return voltage


def _take_over(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, holding: float) -> None:
    """Start the predictor at its steady state for the held load, and the lead so that it asks for the holding voltage.

    So the voltage does not step; how far the load then moves under a load torque depends on the law.
    """
    constants, memory = elastic_lqg_constants_at(law), elastic_lqg_state_at(state)
    ratio, gains, lead = constants.ratio, constants.gains, constants.lead
    angle, speed = estimate[THETA_L], estimate[OMEGA_L]
    predicted = np.array([angle / ratio, speed / ratio, angle, speed, 0.0]) + holding * constants.held
    reference = setpoint[POSITION]
    target = (holding + gains @ predicted) / (gains[THETA_M] / ratio + gains[THETA_L])
    memory.predicted[:] = predicted
    memory.slow_reference = reference - (target - reference) / lead if lead else reference
    memory.started = 1.0


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
    constants = row_of(
        ElasticLqgConstants,
        transition=a,
        input=b[:, 0],
        correction=predictor[:, 0],
        gains=k[0],
        ratio=drive.gear.ratio,
        lead=parameters.lead * slowest / parameters.lag_time - 1.0,
        forgetting=-np.expm1(-settings.period / parameters.lag_time),
        held=held[:, 0],
    )
    return ControlLaw(elastic_lqg_step, constants, row_of(ElasticLqgState), _take_over)


LAWS = {"elastic_lqg": NamedLaw("linear compensator (after Mohan)", elastic_lqg, ElasticLqgParameters())}
