"""Carry, catch and shift: moves all on one flank that a load torque, or the load's own speed, allows."""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load_torque import load_torque_at
from backlash_ros.control.laws.planned.memory import LoadTorque, Memory, Plan
from backlash_ros.control.laws.planned.moves import (
    BUMP_PEAK,
    CARRY_SPEED,
    LEAST_BRAKE,
    LEAST_CROSSING,
    LEAST_PERIODS,
    REACHED,
    TOP_SPEED,
    approach,
    approach_time,
    edge_of_gap,
    shortest_push,
)
from backlash_ros.control.laws.planned.plan import add_contact, add_crossing, resistance_at
from backlash_ros.foundation.compiled import compiled

_USED_RESISTANCE = 0.85
"""Share of the resistance that a carry and a shift use to change the speed, so that the teeth stay in contact."""
_LEAST_RUN = 0.03
"""Shortest time, s, in which a load that is carried gains its speed, and for each half of a shift. Tuned on the
populations."""
_ON_FLANK = 0.9
"""-g, in half gaps, from which on the motor is on the braking flank. Tuned on the populations."""
_LONGEST_BRAKE = 0.3
"""Longest time to catch a load, s. Tuned on the populations."""
_CROSSING_SHARE = 0.25
"""Share of its way to the target that a fast load may travel while the motor crosses to it. Tuned on the
populations."""
_SPEED_GAIN = 1.0
"""Share of its speed by which a load torque may speed a load up while the motor crosses the gap to push it. Where it
would at least double the speed, the load is held back."""
_LEAST_SHOWING = 0.06
"""Shortest time, s, for each half of a shift if friction hides the load torque, so that the shift shows it."""


@compiled
def carry(constants: Constants, plan: Plan, resistance: float, longest: float) -> bool:
    """Plan the move on the braking flank alone if a negative resistance (N m) carries the load.

    Return False, without a plan, if it takes ``longest`` (s) or longer from the flank on, or if the load is too fast.
    """
    move, brake = plan.move, constants.brake_time
    gain = _USED_RESISTANCE * abs(resistance) / constants.load_inertia / BUMP_PEAK
    left = max(move.target - move.angle, 1e-6)
    run = 0.5 * (-brake + math.sqrt(brake * brake + 8.0 * left / gain))
    half = max(_LEAST_RUN, math.sqrt(left / gain))
    if 2.0 * half < run + brake:
        run = brake = half
    if run + brake >= longest:
        return False
    crosses = move.gap_position > -_ON_FLANK * 0.5 * constants.gap
    start = 0.0 if crosses or move.speed < CARRY_SPEED else move.speed
    speed, cruise = (left - 0.5 * start * run) / (0.5 * (run + brake)), 0.0
    # The load is too fast for so short a distance.
    if speed <= 0.0:
        return False
    if speed > TOP_SPEED * constants.no_load_speed:
        speed = TOP_SPEED * constants.no_load_speed
        cruise = (left - 0.5 * start * run) / speed - 0.5 * (run + brake)
    if crosses:
        end, length = -edge_of_gap(constants), constants.crossing_time
        segment = add_crossing(plan, move.gap_position, end, length, move.angle, move.speed)
        segment.closing_speed = move.closing_speed
    add_contact(plan, -1.0, run, move.angle, start).bump = (speed - start) / run
    if cruise > 0.0:
        add_contact(plan, -1.0, cruise, move.angle + 0.5 * (start + speed) * run, speed)
    add_contact(plan, -1.0, brake, move.target - 0.5 * speed * brake, speed).bump = -speed / brake
    return True


@compiled
def _crossing_time(constants: Constants, plan: Plan) -> float:
    """Return the time in which the motor crosses to the front side of a load that may be fast, s."""
    move, gap = plan.move, constants.gap
    share = math.sqrt(min(1.0, max(0.0, 0.5 * gap + move.gap_position) / gap))
    length, left = constants.crossing_time * max(LEAST_CROSSING, share), move.target - move.angle
    # The load is too fast for a soft crossing.
    if move.speed * length > _CROSSING_SHARE * left:
        length = max(_CROSSING_SHARE * left / move.speed, LEAST_PERIODS * constants.period)
    return length


@compiled
def catch(constants: Constants, plan: Plan, load_torque: LoadTorque) -> None:
    """Plan to meet a fast load on its front side, and to brake it."""
    move, inertia, viscous = plan.move, constants.load_inertia, constants.load_friction
    length = _crossing_time(constants, plan)
    resistance = resistance_at(constants, load_torque, move.direction, move.angle)
    move.deceleration = min((viscous * move.speed + resistance) / inertia, move.speed / length)
    # Else the load lies on that side already.
    if move.deceleration > 0.0 or move.gap_position > -REACHED * 0.5 * constants.gap:
        approach(plan, length, -edge_of_gap(constants))
    met = resistance_at(constants, load_torque, move.direction, move.angle)
    last = resistance_at(constants, load_torque, move.direction, move.target)
    brake, speed = _LONGEST_BRAKE, move.speed
    if speed > 0.0:
        least = shortest_push(constants, LEAST_BRAKE, speed, 0.0, -last)
        brake = clamp(2.0 * (move.target - move.angle) / speed, least, _LONGEST_BRAKE)
    segment = add_contact(plan, -1.0, brake, move.angle, speed)
    # A torque that helps is held by the flank from the first moment on: the load must not fall ahead.
    segment.first_acceleration = -(viscous * speed + max(met, 0.0)) / inertia
    segment.last_acceleration = -max(last, 0.0) / inertia
    mean = 0.5 * (segment.first_acceleration + segment.last_acceleration)
    segment.bump = min(-speed / brake - mean, 0.0)


@compiled
def hold_back(constants: Constants, memory: Memory, resistance: float) -> bool:
    """Plan to hold back a load that lies on the motor's braking flank and that a load torque drives on.

    Were the motor to cross the gap to push it, the load would be gone. Return False, without a plan, where it would
    not. ``resistance``: the largest of the move, N m.
    """
    plan, move = memory.plan, memory.plan.move
    acceleration = -(constants.load_friction * move.speed + move.first_resistance) / constants.load_inertia
    gain = acceleration * approach_time(constants, move.gap_position)
    on_flank = move.gap_position <= -REACHED * 0.5 * constants.gap
    if move.speed < CARRY_SPEED or not on_flank or gain < _SPEED_GAIN * move.speed:
        return False
    if resistance >= 0.0 or not carry(constants, plan, resistance, math.inf):
        catch(constants, plan, memory.load_torque)
    return True


@compiled
def shift(constants: Constants, memory: Memory, target: float, load: float) -> float:
    """Plan a move of a load that a torque holds on a flank, without leaving the flank; return the flank."""
    plan, load_torque = memory.plan, memory.load_torque
    direction, distance = 1.0 if target >= load else -1.0, abs(target - load)
    resistance, angle = resistance_at(constants, load_torque, direction, direction * load), direction * load
    braking = _USED_RESISTANCE * max(abs(resistance), 1e-4)
    least = _LEAST_SHOWING if constants.load_dry_friction > 0.0 else _LEAST_RUN
    half = max(least, math.sqrt(BUMP_PEAK * distance * constants.load_inertia / braking))
    flank, speed = math.copysign(1.0, resistance), distance / half
    plan.segment_count, plan.rest_torque, plan.move.direction = 0.0, -load_torque_at(load_torque, target), direction
    add_contact(plan, flank, half, angle, 0.0).bump = speed / half
    add_contact(plan, flank, half, angle + 0.5 * distance, speed).bump = -speed / half
    return direction * flank
