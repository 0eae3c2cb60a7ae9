"""Hold: the load is kept at its target, by what keeps it where it is.

The law leaves the load alone while it is near enough: with the motor in the middle of the gap, or on the flank where
the load torque holds it. If the load is not near enough:

    held by a load torque     it is moved with the motor on the flank: led in, or by a shift; from far away it is thrown
    stuck by dry friction     it is pressed to its target
    free                      it is led in by the flank behind or before it, no faster than it can stop by itself
    not held, and far away    it is thrown
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.command import Wanted
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load_torque import set_load_torque
from backlash_ros.control.laws.planned.memory import NO_MOVE, TO_FLY, TO_PRESS, TO_SHIFT, Hold, Memory
from backlash_ros.control.laws.planned.motor import attribute_to_teeth, friction_sticks, loop_slowdown
from backlash_ros.control.laws.planned.moves import coasting_distance
from backlash_ros.control.laws.planned.parking import (
    DWELL,
    LARGEST_LEAD,
    LONG,
    end_parking,
    go_to_the_middle,
    has_watched,
    inner_band,
    outer_band,
    shortened,
)
from backlash_ros.control.laws.planned.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled

_SHIFT_SPEED = 0.5
"""Speed of the load, rad/s, below which it can be shifted. Tuned on the populations."""
_HELD_RATE = 15.0
"""Rate, 1/s, with which a held load is led in. Tuned on the populations."""
FREE_RATE = 12.0
"""Rate, 1/s, with which a free load is led in at most. Tuned on the populations."""
_OWN_RATE_SHARE = 0.65
"""Share of its own rate B/J with which a free load is led in: it must slow down faster than the flank to stay on it."""
MEET_RATE = 20.0
"""Rate, 1/s, with which a free load is met. Tuned on the populations."""
TOUCHED = 0.06
"""Share of the gap within which a free load is touched. Tuned on the populations."""
AHEAD = 0.3
"""Share of the gap by which the motor's target is ahead of the motor at most, and of the error by which a free load
must come to rest beyond its target for the other flank to lead. Tuned on the populations."""
_AHEAD_TIME = 0.3
"""Time, s, in which a held load that is parked moves by less than twice the inner band. Tuned on the populations."""
_LEAD_MARGIN = 2e-3
"""Rad, beyond half a gap, by which a held load's motor may be off its target. Tuned on the populations."""


@compiled
def _move_held_load(constants: Constants, memory: Memory, error: float) -> float:
    """Lead a load that a torque holds in, or choose a shift or a flight: return the motor's speed, rad/s."""
    hold, load = memory.hold, memory.load
    has_friction = friction_sticks(constants, constants.load_dry_friction + constants.motor_dry_friction)
    if not has_friction and abs(error) <= constants.gap:
        # The target must not run ahead of the motor.
        if abs(memory.motor_target - memory.motor.predicted.angle) >= 0.5 * constants.gap + _LEAD_MARGIN:
            return 0.0
        speed = clamp(_HELD_RATE / loop_slowdown(constants, memory) * error, -LARGEST_LEAD, LARGEST_LEAD)
        memory.motor_target += constants.period * speed
        return speed
    if not has_watched(hold) or abs(load.speed) >= _SHIFT_SPEED:
        return 0.0
    hold.attempts += 1.0
    # A heavy load would swing on its flank.
    if loop_slowdown(constants, memory) > 1.0 and abs(error) > constants.gap:
        memory.next_move = TO_FLY
    else:
        memory.next_move, memory.next_target = TO_SHIFT, load.angle + shortened(hold, error)
    return 0.0


@compiled
def hold_held_load(constants: Constants, memory: Memory, error: float) -> Wanted:
    """Hold a load that a torque holds on a flank."""
    hold, load, inner = memory.hold, memory.load, inner_band(constants, memory.load)
    torque, speed = -memory.load_torque.estimated, 0.0
    memory.flank = -math.copysign(1.0, memory.load_torque.estimated)
    if hold.parking_time >= 0.0:
        if abs(error) > outer_band(constants, load):
            end_parking(hold)
    elif abs(error) < inner and abs(load.speed) * _AHEAD_TIME < 2.0 * inner:
        hold.parking_time = 0.0
    if hold.parking_time < 0.0:
        speed = _move_held_load(constants, memory, error)
    return Wanted(memory.motor_target, speed, torque, torque, memory.motor.predicted.speed)


@compiled
def choose_flank(constants: Constants, hold: Hold, error: float, resting_error: float, inner: float) -> None:
    """Choose the flank that leads a free load in, and keep it for a while."""
    hold.leading_time += constants.period
    turned = hold.leading_flank * resting_error < -max(2.0 * inner, AHEAD * abs(error))
    if hold.leading_time > DWELL and (hold.leading_flank == 0.0 or turned):
        hold.leading_flank, hold.leading_time = math.copysign(1.0, resting_error), 0.0


@compiled
def _lead_free_load(constants: Constants, memory: Memory, error: float, load_angle: float) -> Wanted:
    """Lead a free load in by the flank that was chosen."""
    flank, motor = memory.hold.leading_flank, memory.motor.predicted
    left = flank * contact_distance(constants, 0.0) - (motor.angle - load_angle - memory.middle)
    if flank * left > TOUCHED * constants.gap:
        speed = clamp(memory.load.speed + MEET_RATE * left, -LARGEST_LEAD, LARGEST_LEAD)
    else:
        speed = min(_OWN_RATE_SHARE * constants.load_friction / constants.load_inertia, FREE_RATE) * error
    memory.flank = flank
    wanted = Wanted(memory.motor_target, speed, 0.0, 0.0, motor.speed)
    angle, ahead = memory.motor_target + constants.period * speed, AHEAD * constants.gap
    memory.motor_target = clamp(angle, motor.angle - ahead, motor.angle + ahead)
    return wanted


@compiled
def _end_parking_of_unheld_load(constants: Constants, memory: Memory, error: float, load_angle: float) -> None:
    """No longer leave a load alone that nothing holds, though it was at rest."""
    end_parking(memory.hold)
    memory.hold.waiting_time = 0.0
    # It slid without a command: more pulls than was thought.
    if friction_sticks(constants, constants.load_dry_friction):
        pulls = constants.load_dry_friction + 2.0 * constants.holding_excess
        torque = max(abs(memory.load_torque.estimated), pulls)
        set_load_torque(memory.load_torque, -math.copysign(torque, error), load_angle)


@compiled
def _hold_unheld_load(constants: Constants, memory: Memory, error: float, load_angle: float) -> Wanted:
    """Hold a load that no torque holds."""
    hold, load, motor = memory.hold, memory.load, memory.motor.predicted
    inner, outer = inner_band(constants, load), outer_band(constants, load)
    coasts = coasting_distance(constants, load.speed)
    resting_error = error - coasts
    memory.flank = 0.0
    if hold.parking_time >= 0.0:
        if abs(error) > outer and hold.waiting_time > DWELL:
            _end_parking_of_unheld_load(constants, memory, error, load_angle)
    elif abs(resting_error) < inner and abs(error) < outer and abs(coasts) < outer:
        hold.parking_time, hold.parked_from = 0.0, motor.angle
        memory.motor_target = load_angle + coasts + memory.middle
    elif abs(error) > LONG * constants.gap and has_watched(hold):
        hold.attempts += 1.0
        memory.next_move = TO_FLY
    elif not friction_sticks(constants, constants.load_dry_friction):
        choose_flank(constants, hold, error, resting_error, inner)
        return _lead_free_load(constants, memory, error, load_angle)
    elif has_watched(hold):
        hold.attempts += 1.0
        memory.next_move, memory.next_target = TO_PRESS, load_angle + coasts + shortened(hold, resting_error)
    if hold.parking_time >= 0.0:
        return go_to_the_middle(constants, memory)
    return Wanted(memory.motor_target, 0.0, 0.0, 0.0, motor.speed)


@compiled
def hold_load(constants: Constants, memory: Memory, target: float) -> Wanted:
    """Hold the load at its target, rad, or choose a move there."""
    hold, load, held = memory.hold, memory.load, memory.held != 0.0
    hold.waiting_time += constants.period
    hold.time_since_landing += constants.period
    angle = load.angle + constants.delay * load.speed
    if held:
        wanted = hold_held_load(constants, memory, target - angle)
    else:
        wanted = _hold_unheld_load(constants, memory, target - angle, angle)
    if memory.next_move == NO_MOVE:
        attribute_to_teeth(memory.motor, memory.sent, wanted.teeth_torque)
    return wanted
