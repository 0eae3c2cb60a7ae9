"""Drag: what motion costs beyond the model, as a load torque does in both directions or as friction against each.

A Kalman filter of the momentum of both shafts. A load torque may change with time, or like a weight's with the sine and
cosine of the load's angle; friction stays. So what is learned of each holds beyond a reversal, and what a weight takes
is known ahead of the load.
"""

import math

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load_torque import FRICTION_ERROR, load_torque_at
from backlash_ros.control.laws.planned.memory import DRAG_SIZE, Drag, Memory
from backlash_ros.control.laws.planned.motor import dry_friction, known_torque, momentum_at
from backlash_ros.control.laws.planned.reference import Reference, drag_at, reference_at, weight_shares
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

_MOMENTUM_NOISE = 2e-5
"""Error of a sample of the momentum: what the stall torque gives within so many seconds. Tuned on random drives."""
_MOMENTUM_LAG = 5e-3
"""Time, s, by which the estimated speeds may be late: by so much of the effort the momentum may be off."""
_TORQUE_NOISE = 1e-4
"""Share of the stall torque that nothing explains, as the mean over a second. Tuned on random drives."""
_UNEXPLAINED_TIME = 0.02
"""Time, s, for which a torque keeps its sign that identification could not explain, such as cogging."""
_INERTIA_ERROR = 0.03
"""Share of the effort of an acceleration that may be wrong."""
_FADING_TIME = 0.05
"""Time, s, in which the largest effort fades: for as long the momentum shows that speeds are late. Tuned on random
drives."""
_INERTIA_TIME = 0.1
"""Time, s, for which that keeps its sign."""
_STEADY = 0.02
"""Share of the stall torque up to which acceleration asks for it, so that wrong inertias do not look like a drag."""
_WALK = 1e-3
"""Share of the stall torque by which a load torque may change in a second. Tuned on random drives."""
_LEAST_DRAG = 1e-3
"""Share of the stall torque by which load torque and friction may be off at first. Tuned on random drives."""
_LEAST_SPEED = 0.02
"""Speed of the reference, rad/s, above which its drag is learned: below, friction may stick. Tuned on random drives."""
_LOAD_SPEED = 0.01
"""Speed of the load, rad/s, above which its friction is that of motion. Tuned on random drives."""


@compiled
def begin_to_learn_drag(constants: Constants, memory: Memory) -> None:
    """Forget the drag. A weight is thought to be as large as the torque and the slope that are known of it."""
    drag, load_torque, least = memory.follow.drag, memory.load_torque, _LEAST_DRAG * constants.stall_torque
    drag.load = drag.friction = drag.sine = drag.cosine = drag.runs = drag.effort = 0.0
    drag.origin = memory.load.angle
    weight = least + abs(load_torque_at(load_torque, drag.origin)) + math.hypot(load_torque.sine, load_torque.cosine)
    friction = least + FRICTION_ERROR * constants.load_dry_friction
    drag.covariance[:, :] = 0.0
    spreads = (0.0, least, friction, weight, weight)
    for k in range(DRAG_SIZE):
        drag.covariance[k, k] = spreads[k] ** 2


@compiled
def _sample_variance(constants: Constants, drag: Drag) -> float:
    """Return the variance of a sample of the momentum, (N m s)^2."""
    return (_MOMENTUM_NOISE * constants.stall_torque) ** 2 + (_MOMENTUM_LAG * drag.effort) ** 2


@compiled
def _start(constants: Constants, drag: Drag, momentum: float) -> None:
    """Start from a sample of the momentum, with what is known of the drag."""
    drag.runs, drag.momentum = 1.0, momentum
    drag.covariance[0, :] = 0.0
    drag.covariance[:, 0] = 0.0
    drag.covariance[0, 0] = _sample_variance(constants, drag)


@compiled
def _cost_with(covariance: Array, k: int, shares: tuple[float, float, float, float, float]) -> float:
    """Return the covariance of all that motion costs, by the share of each torque in it, with one of them, k."""
    cost = 0.0
    for j in range(1, DRAG_SIZE):
        cost += covariance[k, j] * shares[j]
    return cost


@compiled
def _predict(constants: Constants, drag: Drag, angle: float, direction: float) -> None:
    """Let the uncertainty grow over a period."""
    period, stall, covariance = constants.period, constants.stall_torque, drag.covariance
    unexplained = constants.unexplained_motor_torque + constants.unexplained_load_torque
    noise = (_TORQUE_NOISE * stall) ** 2 + _UNEXPLAINED_TIME * unexplained**2
    noise += _INERTIA_TIME * (_INERTIA_ERROR * drag.effort) ** 2
    sine, cosine = weight_shares(drag, angle)
    shares = (0.0, 1.0, direction, sine, cosine)
    covariance[0, 0] += period * (noise - 2.0 * _cost_with(covariance, 0, shares))
    for k in range(1, DRAG_SIZE):
        cost = _cost_with(covariance, k, shares)
        covariance[0, k] -= period * cost
        covariance[k, 0] = covariance[0, k]
        covariance[0, 0] += period**2 * shares[k] * cost
    covariance[1, 1] += period * (_WALK * stall) ** 2


@compiled
def _correct(constants: Constants, drag: Drag, error: float) -> None:
    """Correct the drag by the error of the expected momentum, N m s."""
    covariance = drag.covariance
    expected = covariance[0, 0] + _sample_variance(constants, drag)
    drag.momentum += covariance[0, 0] / expected * error
    drag.load += covariance[0, 1] / expected * error
    drag.friction += covariance[0, 2] / expected * error
    drag.sine += covariance[0, 3] / expected * error
    drag.cosine += covariance[0, 4] / expected * error
    # The first row changes last, and its first number after the others.
    for k in range(DRAG_SIZE - 1, -1, -1):
        gain = covariance[0, k] / expected
        for j in range(DRAG_SIZE - 1, -1, -1):
            covariance[k, j] -= gain * covariance[0, j]


@compiled
def _given(constants: Constants, memory: Memory, reference: Reference) -> float:
    """Return the torque on both shafts together as far as it is known, N m, without the drag."""
    motor, load = memory.motor.estimated, memory.load
    friction = dry_friction(constants, motor.speed) + math.copysign(constants.load_dry_friction, reference.speed)
    return known_torque(constants, motor, load.speed) - friction + load_torque_at(memory.load_torque, load.angle)


@compiled
def learn_drag(constants: Constants, memory: Memory, path: Array) -> None:
    """Learn what even motion costs beyond the model from the momentum of both shafts."""
    drag, load = memory.follow.drag, memory.load
    reference = reference_at(constants, path, 0.0)
    momentum = momentum_at(constants, memory.motor.estimated.speed, load.speed)
    effort = abs(reference.acceleration) * (constants.load_inertia + constants.motor_inertia)
    drag.effort = max(effort, drag.effort * (1.0 - constants.period / _FADING_TIME))
    moves = abs(reference.speed) > _LEAST_SPEED and abs(load.speed) > _LOAD_SPEED
    if not moves or drag.effort >= _STEADY * constants.stall_torque:
        drag.runs = 0.0
    elif drag.runs == 0.0:
        _start(constants, drag, momentum)
    else:
        direction = math.copysign(1.0, reference.speed)
        cost = drag_at(drag, load.angle, direction)
        drag.momentum += constants.period * (_given(constants, memory, reference) - cost)
        _predict(constants, drag, load.angle, direction)
        _correct(constants, drag, momentum - drag.momentum)
