"""Drag: what motion costs beyond the model, as a load torque does in both directions or as friction against each.

A Kalman filter of the momentum of both shafts. A load torque may change, with the load's angle or with time; friction
stays. So what is learned of either holds beyond a reversal.
"""

import math

from backlash_ros.control.laws.two_encoder.constants import Constants
from backlash_ros.control.laws.two_encoder.load_torque import load_torque_at
from backlash_ros.control.laws.two_encoder.memory import Drag, DragSpread, Memory
from backlash_ros.control.laws.two_encoder.motor import dry_friction, known_torque, momentum_at
from backlash_ros.control.laws.two_encoder.reference import Reference, reference_at
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
_INERTIA_TIME = 0.1
"""Time, s, for which that keeps its sign."""
_STEADY = 0.02
"""Share of the stall torque up to which acceleration asks for it, so that wrong inertias do not look like a drag."""
_WALK = 1e-3
"""Share of the stall torque by which a load torque may change in a second. Tuned on random drives."""
_LEAST_DRAG = 1e-3
"""Share of the stall torque by which load torque and friction may be off at first. Tuned on random drives."""
_FRICTION_ERROR = 0.1
"""Share of the dry friction that is added to this, since the friction is not known better."""
_LEAST_SPEED = 0.02
"""Speed of the reference, rad/s, above which its drag is learned: below, friction may stick. Tuned on random drives."""
_LOAD_SPEED = 0.01
"""Speed of the load, rad/s, above which its friction is that of motion. Tuned on random drives."""


@compiled
def begin_to_learn_drag(constants: Constants, memory: Memory) -> None:
    """Forget the drag."""
    drag, spread, least = memory.follow.drag, memory.follow.drag.spread, _LEAST_DRAG * constants.stall_torque
    drag.load = drag.friction = drag.runs = spread.load_friction = 0.0
    spread.load, spread.friction = least**2, (least + _FRICTION_ERROR * constants.load_dry_friction) ** 2


@compiled
def _sample_variance(constants: Constants, effort: float) -> float:
    """Return the variance of a sample of the momentum while an acceleration takes a torque, (N m s)^2."""
    return (_MOMENTUM_NOISE * constants.stall_torque) ** 2 + (_MOMENTUM_LAG * effort) ** 2


@compiled
def _start(constants: Constants, drag: Drag, momentum: float, effort: float) -> None:
    """Start from a sample of the momentum, with what is known of the drag."""
    spread = drag.spread
    drag.runs, drag.momentum, spread.momentum = 1.0, momentum, _sample_variance(constants, effort)
    spread.momentum_load = spread.momentum_friction = 0.0


@compiled
def _predict(constants: Constants, spread: DragSpread, direction: float, effort: float) -> None:
    """Let the uncertainty grow over a period."""
    period, stall = constants.period, constants.stall_torque
    unexplained = constants.unexplained_motor_torque + constants.unexplained_load_torque
    noise = (_TORQUE_NOISE * stall) ** 2 + _UNEXPLAINED_TIME * unexplained**2
    noise += _INERTIA_TIME * (_INERTIA_ERROR * effort) ** 2
    cost = spread.load + 2.0 * direction * spread.load_friction + spread.friction
    spread.momentum += period * (noise + period * cost)
    spread.momentum -= 2.0 * period * (spread.momentum_load + direction * spread.momentum_friction)
    spread.momentum_load -= period * (spread.load + direction * spread.load_friction)
    spread.momentum_friction -= period * (spread.load_friction + direction * spread.friction)
    spread.load += period * (_WALK * stall) ** 2


@compiled
def _correct(constants: Constants, drag: Drag, effort: float, error: float) -> None:
    """Correct the drag by the error of the expected momentum, N m s."""
    spread = drag.spread
    expected = spread.momentum + _sample_variance(constants, effort)
    momentum, load = spread.momentum / expected, spread.momentum_load / expected
    friction, left = spread.momentum_friction / expected, 1.0 - momentum
    drag.momentum += momentum * error
    drag.load += load * error
    drag.friction += friction * error
    spread.load -= load * spread.momentum_load
    spread.load_friction -= load * spread.momentum_friction
    spread.friction -= friction * spread.momentum_friction
    spread.momentum *= left
    spread.momentum_load *= left
    spread.momentum_friction *= left


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
    moves = abs(reference.speed) > _LEAST_SPEED and abs(load.speed) > _LOAD_SPEED
    if not moves or effort >= _STEADY * constants.stall_torque:
        drag.runs = 0.0
    elif drag.runs == 0.0:
        _start(constants, drag, momentum, effort)
    else:
        direction = math.copysign(1.0, reference.speed)
        cost = drag.load + direction * drag.friction
        drag.momentum += constants.period * (_given(constants, memory, reference) - cost)
        _predict(constants, drag.spread, direction, effort)
        _correct(constants, drag, effort, momentum - drag.momentum)
