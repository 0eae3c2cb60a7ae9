"""Flight: which moves take the load from where it is to rest at its target, in closed form."""

import math

from backlash_ros.control.laws.planned.carry import carry, catch, hold_back
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load_torque import holds_load, load_torque_at
from backlash_ros.control.laws.planned.memory import Memory, Move, Plan
from backlash_ros.control.laws.planned.moves import (
    CARRY_SPEED,
    Shafts,
    approach_time,
    coasting_distance,
    edge_of_gap,
)
from backlash_ros.control.laws.planned.plan import add_crossing, resistance_at
from backlash_ros.control.laws.planned.press import press
from backlash_ros.control.laws.planned.throw import add_throw, land, solve_throw
from backlash_ros.foundation.compiled import compiled

_CROSSING_SHARE = 0.35
"""Share of a move at which the motor crosses, at first: it is computed anew."""
_AT_FIRST = 0.3
"""Share of a load torque that carries the load at first, but not all the way, that a plan uses. Tuned on the
populations."""
_MOTOR_SHORT = 3.0
"""A load with dry friction, which waits where it lands, is to land short: by so many times the distance by which the
motor's unexplained torque deflects its loop. Tuned on the populations."""
_LOAD_SHORT = 0.3
"""And by this share of the distance by which its unexplained torque moves the load in a crossing. Tuned on the
populations."""
_MOST_SHORT = 0.2
"""Share of a move by which it ends short at most. Tuned on the populations."""
_LEAVE_SHARE = 0.5
"""Share of the crossing time in which the motor leaves a load that it has brought to rest. Tuned on the populations."""


@compiled
def _shortfall(constants: Constants, distance: float) -> float:
    """Return by how much a move is to end short of its target, rad, signed like its distance."""
    if constants.load_dry_friction == 0.0:
        return 0.0
    motor = _MOTOR_SHORT * constants.unexplained_motor_torque / constants.stiffness
    crossing, inertia = constants.crossing_time, constants.load_inertia
    load = _LOAD_SHORT * 0.5 * crossing**2 * constants.unexplained_load_torque / inertia
    return math.copysign(min(motor + load, _MOST_SHORT * abs(distance)), distance)


@compiled
def _leave(constants: Constants, plan: Plan) -> None:
    """Let the motor leave a free load, which has come to rest, as far as the teeth would push it back."""
    # Friction hides what may hold the load.
    if plan.rest_torque == 0.0 and constants.load_dry_friction + constants.motor_dry_friction == 0.0:
        length, edge = _LEAVE_SHARE * constants.crossing_time, edge_of_gap(constants)
        add_crossing(plan, -edge, -constants.clear_distance, length, plan.move.target, 0.0)


@compiled
def _describe(constants: Constants, memory: Memory, target: float, shafts: Shafts) -> None:
    """Describe the move to a target, rad, in its own direction."""
    plan, move, load_torque = memory.plan, memory.plan.move, memory.load_torque
    distance, stops = target - shafts.load, coasting_distance(constants, shafts.load_speed)
    torque, last_torque = load_torque_at(load_torque, shafts.load), load_torque_at(load_torque, target)
    held = holds_load(constants, torque)
    # A load that coasts beyond a near target has to be moved back.
    direction = 1.0 if distance - (0.0 if held else stops) >= 0.0 else -1.0
    move.direction, move.target = direction, direction * target
    move.angle, move.speed = direction * shafts.load, direction * shafts.load_speed
    move.gap_position = direction * (shafts.motor - shafts.load)
    move.closing_speed = direction * (shafts.motor_speed - shafts.load_speed)
    move.holding_torque = direction * torque if held else 0.0
    move.first_resistance = constants.load_dry_friction - direction * torque
    move.last_resistance = constants.load_dry_friction - direction * last_torque
    crossing = move.angle + _CROSSING_SHARE * (move.target - move.angle)
    move.crossing_resistance = resistance_at(constants, load_torque, direction, crossing)
    plan.segment_count = 0.0
    plan.rest_torque = -last_torque if holds_load(constants, last_torque) else 0.0


@compiled
def _largest_resistance(move: Move) -> float:
    """Return the largest resistance of a move, N m."""
    return max(move.first_resistance, move.crossing_resistance, move.last_resistance)


@compiled
def _deceleration(constants: Constants, move: Move, length: float) -> float:
    """Return how the load slows down until it is touched after ``length`` seconds, rad/s^2.

    Friction brakes it, and holds it once it stands.
    """
    speed, first, viscous = move.speed, move.first_resistance, constants.load_friction
    if speed < 0.0:
        braking = viscous * speed - constants.load_dry_friction - move.holding_torque
    else:
        braking = viscous * speed + (first if speed > 0.0 else min(first, 0.0))
    slows = braking / constants.load_inertia
    return speed / length if speed > 0.0 and slows * length > speed else slows


@compiled
def _touch(constants: Constants, plan: Plan) -> None:
    """Find where the motor touches the load to throw it."""
    move, throw = plan.move, plan.throw
    length = approach_time(constants, move.gap_position)
    slows = _deceleration(constants, move, length)
    move.deceleration, throw.approach_time = slows, length
    throw.angle = move.angle + move.speed * length - 0.5 * slows * length * length
    throw.touch_speed = move.speed - slows * length
    driven = move.holding_torque != 0.0 and move.first_resistance < 0.0
    throw.moves = 1.0 if move.speed != 0.0 or driven else 0.0
    # A load torque against the move will hold the load on the driving flank at its target.
    returns = plan.rest_torque != 0.0 and move.last_resistance > 0.0
    throw.back_time = constants.crossing_time if returns else 0.0


@compiled
def _carry_or_catch(constants: Constants, memory: Memory) -> None:
    """Plan for a load that is too fast to be pushed."""
    plan, move, most = memory.plan, memory.plan.move, _largest_resistance(memory.plan.move)
    if move.first_resistance < 0.0 and abs(move.speed) < CARRY_SPEED:
        # The load torque may carry it only at first, as a weight's does on the way down.
        carry(constants, plan, most if most < 0.0 else _AT_FIRST * move.first_resistance, math.inf)
        return
    catch(constants, plan, memory.load_torque)
    _leave(constants, plan)


@compiled
def _presses_instead(constants: Constants, memory: Memory) -> bool:
    """Find how the load is thrown; plan a press and return True where that is better."""
    plan, move, throw = memory.plan, memory.plan.move, memory.plan.throw
    throw.adapts = 1.0
    presses = solve_throw(constants, plan, memory.load_torque)
    # The load cannot be thrown where the torque changes so much.
    if throw.speed <= throw.touch_speed and not presses:
        move.crossing_resistance, throw.adapts = move.last_resistance, 0.0
        presses = solve_throw(constants, plan, memory.load_torque)
    if presses:
        press(constants, plan, min(move.crossing_resistance, move.last_resistance))
        return True
    # At the end the load torque brakes more than is needed.
    brakes_too_much = land(constants, move, throw, throw.speed).brake_bump > 0.0
    if brakes_too_much and move.last_resistance > 0.0 and throw.speed > throw.touch_speed:
        press(constants, plan, move.last_resistance)
        return True
    return False


@compiled
def fly(constants: Constants, memory: Memory, target: float, shafts: Shafts) -> float:
    """Plan a move of the load to rest at a target, rad; return the flank on which it ends."""
    plan, move, throw = memory.plan, memory.plan.move, memory.plan.throw
    _describe(constants, memory, target - _shortfall(constants, target - shafts.load), shafts)
    direction, most = move.direction, _largest_resistance(move)
    throw_time = 2.0 * constants.crossing_time + constants.push_time + constants.brake_time
    if most < 0.0 and abs(move.speed) < CARRY_SPEED and carry(constants, plan, most, throw_time):
        return -direction
    if hold_back(constants, memory, most):
        return -direction
    _touch(constants, plan)
    if _presses_instead(constants, memory):
        return direction
    landing = land(constants, move, throw, throw.speed)
    if throw.touch_speed > 0.0 and landing.push_bump < 0.0:
        _carry_or_catch(constants, memory)
        return -direction
    add_throw(constants, plan, landing)
    if throw.back_time > 0.0:
        return direction
    _leave(constants, plan)
    return -direction
