"""Hold with one encoder alone: as with two, but the motor never looks for the middle of the gap.

With the load's encoder the motor's place is known by touching; so it backs off from a free load by just as much as the
teeth let go, and stays. With the motor's encoder the place of a free load is not known. The motor blocks: it stands
where the load cannot pass the target, until a load that coasts has come to rest. Then it wipes: it goes on through the
gap, slower than the load slows down by itself. Whatever lies in its way is pushed to the target, and stays there.
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.alone.constants import AloneConstants
from backlash_ros.control.laws.planned.alone.memory import AloneMemory, gap_variance
from backlash_ros.control.laws.planned.command import Wanted
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.hold import (
    AHEAD,
    FREE_RATE,
    MEET_RATE,
    TOUCHED,
    choose_flank,
    hold_held_load,
)
from backlash_ros.control.laws.planned.memory import TO_FLY, TO_PRESS, Memory
from backlash_ros.control.laws.planned.motor import friction_sticks
from backlash_ros.control.laws.planned.moves import coasting_distance
from backlash_ros.control.laws.planned.parking import (
    DWELL,
    LARGEST_LEAD,
    LONG,
    end_parking,
    has_watched,
    inner_band,
    outer_band,
    shortened,
)
from backlash_ros.control.laws.planned.teeth import contact_distance, light_contact_distance
from backlash_ros.foundation.compiled import compiled

_BACKS_OFF = 0.8
"""Share of the way to a flank within which the motor stays beside a free load that rests."""
_RATE_SHARE = 0.5
"""Share of its own rate B/J with which a free load is led in: it must slow down faster than the flank to stay on it."""
_SURELY_TOUCHED = 0.02
"""Share of the gap within which it is pushed."""
_MAY_BE_TOUCHED = 0.4
"""Share of the gap within which a free load that is not measured may be touched."""
_PUSHED = 0.1
"""Share of the gap by which a motor beside a free load must be pushed to say that the load has gone."""
_WIPE_TORQUE = 0.05
"""Torque of the teeth, as acceleration of the motor, rad/s^2, that wipes a free load to its target."""
_BLOCK = 2.5
"""Time for which the motor blocks, in times J/B in which the load slows down."""
_LONGEST_BLOCK = 1.5
"""The same at most, s."""


@compiled
def _go(constants: Constants, memory: Memory, flank: float, speed: float) -> Wanted:
    """Let the motor lead a free load with a speed, rad/s, on a flank."""
    motor, ahead = memory.motor.predicted, AHEAD * constants.gap
    memory.flank = flank
    angle = memory.motor_target + constants.period * speed
    memory.motor_target = clamp(angle, motor.angle - ahead, motor.angle + ahead)
    return Wanted(memory.motor_target, speed, 0.0, 0.0, motor.speed)


@compiled
def _own_rate(constants: Constants) -> float:
    """Return the rate with which a free load is led in, 1/s."""
    return min(_RATE_SHARE * constants.load_friction / constants.load_inertia, FREE_RATE)


@compiled
def _lead_measured_load(constants: AloneConstants, memory: AloneMemory, error: float, resting_error: float) -> Wanted:
    """Lead a free load in that is measured: no faster than it can stop by itself."""
    plans, hold, known = memory.plans, memory.plans.hold, constants.plans
    choose_flank(known, hold, error, resting_error, inner_band(known, plans.load))
    flank, speed, way = hold.leading_flank, memory.ahead.load_speed, _own_rate(known) * error
    left = flank * contact_distance(known, 0.0) - (memory.ahead.angle - memory.ahead.load_angle)
    near = max(TOUCHED * known.gap, math.sqrt(gap_variance(memory.covariance[:])))
    if flank * left > near:
        # A blow must not let it coast farther than the error.
        return _go(
            known, plans, flank, clamp(speed + MEET_RATE * (left - flank * near) + way, -LARGEST_LEAD, LARGEST_LEAD)
        )
    if flank * left > _SURELY_TOUCHED * known.gap:
        return _go(known, plans, flank, speed + way)
    return _go(known, plans, flank, way)


@compiled
def _block_then_wipe(constants: AloneConstants, memory: AloneMemory, target: float) -> Wanted:
    """Bring a free load to its target that is not measured."""
    plans, hold, known = memory.plans, memory.plans.hold, constants.plans
    if hold.leading_flank == 0.0:
        # That of the last move; before the first one either is right.
        hold.leading_flank = plans.plan.move.direction if plans.plan.move.direction != 0.0 else 1.0
    flank, motor = hold.leading_flank, plans.motor.predicted
    touch = light_contact_distance(known, _WIPE_TORQUE * known.motor_inertia)
    stops = _BLOCK * known.load_inertia / max(known.load_friction, 1e-12)
    if hold.waiting_time < min(stops, _LONGEST_BLOCK):
        plans.flank, plans.motor_target = -flank, target - flank * touch
        return Wanted(plans.motor_target, 0.0, 0.0, 0.0, motor.speed)
    way = target + flank * touch - plans.motor_target
    if abs(way) < inner_band(known, plans.load):
        hold.parking_time = 0.0
        return Wanted(plans.motor_target, 0.0, 0.0, 0.0, motor.speed)
    left = flank * contact_distance(known, 0.0) - (memory.ahead.angle - memory.ahead.load_angle)
    near, speed = _MAY_BE_TOUCHED * known.gap, _own_rate(known) * way
    if flank * left > near:
        speed = clamp(memory.ahead.load_speed + MEET_RATE * (left - flank * near) + speed, -LARGEST_LEAD, LARGEST_LEAD)
    return _go(known, plans, flank, speed)


@compiled
def _has_gone(constants: AloneConstants, memory: AloneMemory, error: float) -> bool:
    """Return whether a free load that was parked is no longer where it was."""
    plans, known = memory.plans, constants.plans
    if constants.sees_load != 0.0 or friction_sticks(known, known.load_dry_friction):
        return abs(error) > outer_band(known, plans.load)
    return abs(plans.motor.predicted.angle - plans.motor_target) > _PUSHED * known.gap


@compiled
def _hold_unheld_load(constants: AloneConstants, memory: AloneMemory, target: float) -> Wanted:
    """Hold a load that no torque holds."""
    plans, hold, known, ahead = memory.plans, memory.plans.hold, constants.plans, memory.ahead
    inner, outer = inner_band(known, plans.load), outer_band(known, plans.load)
    error, coasts = target - ahead.load_angle, coasting_distance(known, ahead.load_speed)
    resting_error, sticks = error - coasts, friction_sticks(known, known.load_dry_friction)
    shown = sticks or constants.sees_load != 0.0
    plans.flank = 0.0
    if hold.parking_time >= 0.0:
        if _has_gone(constants, memory, error) and hold.waiting_time > DWELL:
            end_parking(hold)
            hold.waiting_time = hold.leading_flank = 0.0
    elif shown and abs(resting_error) < inner and abs(error) < outer and abs(coasts) < outer:
        hold.parking_time, edge = 0.0, _BACKS_OFF * contact_distance(known, 0.0)
        plans.motor_target = ahead.load_angle + coasts + clamp(ahead.angle - ahead.load_angle, -edge, edge)
    elif abs(error) > LONG * known.gap and has_watched(hold):
        hold.attempts += 1.0
        plans.next_move = TO_FLY
    elif not sticks:
        if constants.sees_load != 0.0:
            return _lead_measured_load(constants, memory, error, resting_error)
        return _block_then_wipe(constants, memory, target)
    elif has_watched(hold):
        hold.attempts += 1.0
        plans.next_move, plans.next_target = TO_PRESS, ahead.load_angle + coasts + shortened(hold, resting_error)
    return Wanted(plans.motor_target, 0.0, 0.0, 0.0, plans.motor.predicted.speed)


@compiled
def hold_alone(constants: AloneConstants, memory: AloneMemory, target: float) -> Wanted:
    """Hold the load at its target, rad, or choose a move there."""
    plans, hold, known = memory.plans, memory.plans.hold, constants.plans
    hold.waiting_time += known.period
    hold.time_since_landing += known.period
    if plans.held != 0.0:
        wanted = hold_held_load(known, plans, target - memory.ahead.load_angle)
    else:
        wanted = _hold_unheld_load(constants, memory, target)
    return wanted
