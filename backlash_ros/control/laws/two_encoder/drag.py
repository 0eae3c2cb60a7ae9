"""Drag: what motion costs beyond the model, as a load torque does in both directions or as friction against each.

A Kalman filter of the momentum of both shafts. A load torque may change, with the load's angle or with time; friction
stays. So what is learned of either holds beyond a reversal.
"""

import math

from backlash_ros.control.laws.two_encoder.constants import Constants
from backlash_ros.control.laws.two_encoder.load_torque import load_torque_at
from backlash_ros.control.laws.two_encoder.memory import DRAG_STATES, Memory
from backlash_ros.control.laws.two_encoder.motor import dry_friction
from backlash_ros.control.laws.two_encoder.reference import Reference, reference_at
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

_MOMENTUM, _LOAD, _FRICTION = range(DRAG_STATES)
"""Rows of the covariance."""
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
def _restart(constants: Constants, memory: Memory, state: int, deviation: float) -> None:
    """Forget what is known of a state of the filter but its standard deviation."""
    spread = memory.follow.drag.spread
    for other in range(DRAG_STATES):
        spread[state, other] = spread[other, state] = 0.0
    spread[state, state] = deviation * deviation


@compiled
def begin_to_learn_drag(constants: Constants, memory: Memory) -> None:
    """Forget the drag."""
    drag, least = memory.follow.drag, _LEAST_DRAG * constants.stall_torque
    drag.load = drag.friction = drag.runs = 0.0
    _restart(constants, memory, _LOAD, least)
    _restart(constants, memory, _FRICTION, least + _FRICTION_ERROR * constants.load_dry_friction)


@compiled
def _sample_error(constants: Constants, effort: float) -> float:
    """Return the standard deviation of a sample of the momentum while an acceleration takes a torque, N m s."""
    return math.hypot(_MOMENTUM_NOISE * constants.stall_torque, _MOMENTUM_LAG * effort)


@compiled
def _predict(constants: Constants, memory: Memory, direction: float, effort: float) -> None:
    """Let the uncertainty grow over a period."""
    spread, period, stall = memory.follow.drag.spread, constants.period, constants.stall_torque
    for i in range(DRAG_STATES):
        spread[_MOMENTUM, i] -= period * (spread[_LOAD, i] + direction * spread[_FRICTION, i])
    for i in range(DRAG_STATES):
        spread[i, _MOMENTUM] -= period * (spread[i, _LOAD] + direction * spread[i, _FRICTION])
    unexplained = constants.unexplained_motor_torque + constants.unexplained_load_torque
    noise = (_TORQUE_NOISE * stall) ** 2 + _UNEXPLAINED_TIME * unexplained**2
    noise += _INERTIA_TIME * (_INERTIA_ERROR * effort) ** 2
    spread[_MOMENTUM, _MOMENTUM] += period * noise
    spread[_LOAD, _LOAD] += period * (_WALK * stall) ** 2


@compiled
def _correct(constants: Constants, memory: Memory, effort: float, error: float) -> None:
    """Correct the states by the error of the expected momentum, N m s."""
    drag = memory.follow.drag
    spread, gain = drag.spread, drag.gain
    expected = spread[_MOMENTUM, _MOMENTUM] + _sample_error(constants, effort) ** 2
    for i in range(DRAG_STATES):
        gain[i] = spread[i, _MOMENTUM] / expected
    for i in range(DRAG_STATES):
        for j in range(DRAG_STATES):
            spread[i, j] -= gain[i] * gain[j] * expected
    drag.momentum += gain[_MOMENTUM] * error
    drag.load += gain[_LOAD] * error
    drag.friction += gain[_FRICTION] * error


@compiled
def _given(constants: Constants, memory: Memory, reference: Reference) -> float:
    """Return the torque on both shafts together as far as it is known, N m, without the drag."""
    motor, load = memory.motor.estimated, memory.load
    given = motor.current_torque - constants.motor_friction * motor.speed - constants.load_friction * load.speed
    given -= dry_friction(constants, motor.speed) + math.copysign(constants.load_dry_friction, reference.speed)
    return given + load_torque_at(memory.load_torque, load.angle)


@compiled
def learn_drag(constants: Constants, memory: Memory, path: Array) -> None:
    """Learn what even motion costs beyond the model from the momentum of both shafts."""
    drag, load = memory.follow.drag, memory.load
    reference = reference_at(constants, path, 0.0)
    momentum = constants.motor_inertia * memory.motor.estimated.speed + constants.load_inertia * load.speed
    effort = abs(reference.acceleration) * (constants.load_inertia + constants.motor_inertia)
    moves = abs(reference.speed) > _LEAST_SPEED and abs(load.speed) > _LOAD_SPEED
    if not moves or effort >= _STEADY * constants.stall_torque:
        drag.runs = 0.0
    elif drag.runs == 0.0:
        drag.runs, drag.momentum = 1.0, momentum
        _restart(constants, memory, _MOMENTUM, _sample_error(constants, effort))
    else:
        direction = math.copysign(1.0, reference.speed)
        cost = drag.load + direction * drag.friction
        drag.momentum += constants.period * (_given(constants, memory, reference) - cost)
        _predict(constants, memory, direction, effort)
        _correct(constants, memory, effort, momentum - drag.momentum)
