"""The load's encoder alone: an extended Kalman filter of both shafts and the load torque.

In contact the teeth tie both shafts together, so each reading of the load corrects the motor, too. In the gap the
motor's place follows from the commands alone.
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.alone.constants import AloneConstants
from backlash_ros.control.laws.planned.alone.memory import (
    ANGLE,
    CURRENT_TORQUE,
    LOAD_ANGLE,
    LOAD_SPEED,
    SPEED,
    STATES,
    TORQUE,
    AloneMemory,
    gap_variance,
)
from backlash_ros.control.laws.planned.alone.model import Response, advance, command_at
from backlash_ros.control.laws.planned.alone.readings import UNKNOWN_PLACE, believe
from backlash_ros.control.laws.planned.load import UNKNOWN_COUNT, measure_count
from backlash_ros.control.laws.planned.memory import HOLD
from backlash_ros.control.laws.planned.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

_MOTOR_NOISE = 0.1
"""Noise of the motor's speed, rad/s per root s. Small: in the gap its place is dead reckoning."""
_CURRENT_NOISE = 0.01
"""The same for each rad/s^2 that the current's torque gives the motor, root s."""
_LOAD_NOISE = 0.3
"""Noise of the load's speed, rad/s per root s."""
_TORQUE_NOISE = 50.0
"""Noise of the load torque, as acceleration of the motor, rad/s^2 per root s."""
_CALM = 0.1
"""Share of both in which a free load between the teeth is disturbed."""
APART = 0.9
"""Share of the way to a flank up to which the teeth are apart."""
_LARGEST_TORQUE = 500.0
"""Largest standard deviation of the load torque, as acceleration of the motor, rad/s^2; no drive is meant to hold
more than its standstill torque."""
_READING_NOISE = 0.5
"""Standard deviation of a reading, in counts."""
_PARKED_NOISE = 2.0
"""The same of a load that is held at rest, whose readings err for long by the same part of a count."""


@compiled
def _carry_through(constants: AloneConstants, told: Array, given: Array, response: Response) -> None:
    """Write the transposed product of the step's linear map with ``given``, both of shape (6, 6)."""
    h, plans, teeth = constants.step, constants.plans, response.teeth
    brakes = (1.0 - constants.decay) * constants.braking
    for k in range(STATES):
        ties = teeth.stiffness * (given[ANGLE, k] - given[LOAD_ANGLE, k])
        on_motor = plans.motor_inertia / h * given[SPEED, k] + constants.decay * given[CURRENT_TORQUE, k] - ties
        on_load = plans.load_inertia / h * given[LOAD_SPEED, k] + given[TORQUE, k] + ties
        speed = response.motor * on_motor + response.both * on_load
        load_speed = response.both * on_motor + response.load * on_load
        told[k, ANGLE] = given[ANGLE, k] + h * speed
        told[k, SPEED] = speed
        told[k, CURRENT_TORQUE] = constants.decay * given[CURRENT_TORQUE, k] - brakes * speed
        told[k, LOAD_ANGLE] = given[LOAD_ANGLE, k] + h * load_speed
        told[k, LOAD_SPEED] = load_speed
        told[k, TORQUE] = given[TORQUE, k]


@compiled
def _bound(constants: AloneConstants, covariance: Array) -> None:
    """Bound the variance of g: the motor cannot be beyond the gap."""
    most = (UNKNOWN_PLACE * constants.plans.gap) ** 2
    off = gap_variance(covariance)
    if off <= most:
        return
    share = math.sqrt(most / off)
    for k in range(STATES):
        if k != ANGLE:
            own = share * (covariance[ANGLE, k] - covariance[LOAD_ANGLE, k])
            covariance[ANGLE, k] = covariance[k, ANGLE] = covariance[LOAD_ANGLE, k] + own
    covariance[ANGLE, ANGLE] = most + 2.0 * covariance[ANGLE, LOAD_ANGLE] - covariance[LOAD_ANGLE, LOAD_ANGLE]


@compiled
def _is_calm(constants: AloneConstants, memory: AloneMemory) -> bool:
    """Return whether the load is free and nothing touches it."""
    if memory.plans.phase != HOLD or memory.plans.held != 0.0:
        return False
    gap_position = memory.shafts.angle - memory.shafts.load_angle
    return abs(gap_position) < APART * contact_distance(constants.plans, 0.0)


@compiled
def _predict(constants: AloneConstants, memory: AloneMemory) -> None:
    """Advance shafts and covariance by the period up to this sample."""
    shafts, covariance, room, h = memory.shafts, memory.covariance[:], memory.room[:], constants.step
    calm, inertia = _CALM if _is_calm(constants, memory) else 1.0, constants.plans.motor_inertia
    for step in range(int(constants.steps)):
        command = command_at(constants, memory.plans.sent, (step + 0.5) * h)
        response = advance(constants, shafts, command, 0.0)
        # What friction holds goes on in the covariance, so that readings can break it loose.
        _carry_through(constants, room, covariance, response)
        _carry_through(constants, covariance, room, response)
        pushed = _CURRENT_NOISE * shafts.current_torque / constants.plans.motor_inertia
        covariance[SPEED, SPEED] += (_MOTOR_NOISE**2 + pushed * pushed) * h
        covariance[LOAD_SPEED, LOAD_SPEED] += (calm * _LOAD_NOISE) ** 2 * h
        more = covariance[TORQUE, TORQUE] + (calm * _TORQUE_NOISE * inertia) ** 2 * h
        covariance[TORQUE, TORQUE] = min(more, min(_LARGEST_TORQUE * inertia, constants.plans.stall_torque) ** 2)
        _bound(constants, covariance)


@compiled
def _correct(constants: AloneConstants, memory: AloneMemory, error: float, variance: float) -> None:
    """Correct all states by an error of the load's angle, rad, with its variance, rad^2."""
    shafts, covariance, room = memory.shafts, memory.covariance[:], memory.room[:]
    total = covariance[LOAD_ANGLE, LOAD_ANGLE] + variance
    miss = error / total
    shafts.angle += covariance[ANGLE, LOAD_ANGLE] * miss
    shafts.speed += covariance[SPEED, LOAD_ANGLE] * miss
    shafts.current_torque += covariance[CURRENT_TORQUE, LOAD_ANGLE] * miss
    shafts.load_speed += covariance[LOAD_SPEED, LOAD_ANGLE] * miss
    torque, most = shafts.load_torque + covariance[TORQUE, LOAD_ANGLE] * miss, constants.plans.stall_torque
    shafts.load_torque = clamp(torque, -most, most)
    shafts.load_angle += covariance[LOAD_ANGLE, LOAD_ANGLE] * miss
    for k in range(STATES):
        room[0, k] = covariance[LOAD_ANGLE, k]
    for j in range(STATES):
        for k in range(STATES):
            covariance[j, k] -= room[0, j] * room[0, k] / total


@compiled
def observe_by_load(constants: AloneConstants, memory: AloneMemory, reading: float) -> None:
    """Take the load's angle, rad, one period after the previous one."""
    readings, plans = memory.readings, constants.plans
    readings.speed = memory.shafts.load_speed
    if readings.count == 0.0:
        readings.count = UNKNOWN_COUNT * plans.gap
    _predict(constants, memory)
    if not believe(constants, memory, readings, reading, memory.shafts.load_angle):
        return
    measure_count(plans, readings, reading, memory.plans.phase == HOLD)
    if readings.smallest_step > 0.0:
        readings.count = readings.smallest_step
    parked = memory.plans.phase == HOLD and memory.plans.held != 0.0 and memory.plans.hold.parking_time >= 0.0
    off = (_PARKED_NOISE if parked else _READING_NOISE) * readings.count
    _correct(constants, memory, reading - memory.shafts.load_angle, off * off)
