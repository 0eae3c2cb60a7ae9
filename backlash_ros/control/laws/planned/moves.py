"""What all planned moves have in common: how fast a load may be, how long a push takes, how the motor approaches.

The load needs the torque J a + B v + c. Here c = tau_c - tau_l is its resistance, which brakes it at any speed. The
moves:

    throw    approach the driving flank, push, cross while the load coasts, brake on the other flank, and leave it;
             under a load torque that goes against the move cross back while the load comes to rest
    press    all on the driving flank: friction, or the load torque, brakes hard enough
    carry    all on the braking flank: the load torque carries the load
    catch    cross to the braking flank, and brake: the load is already too fast
    shift    all on the flank on which a load torque holds the load
"""

import math
from typing import NamedTuple

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.memory import Plan
from backlash_ros.control.laws.planned.plan import add_crossing
from backlash_ros.control.laws.planned.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled

BUMP_PEAK = 1.5
"""Peak of a bump divided by its mean."""
_SOFT_PEAK = 1.78
"""Peak of a bump that ends softly, divided by its mean."""
TOP_SPEED = 0.6
"""Share of the no-load speed that a plan uses. Tuned on the populations."""
CARRY_SPEED = 0.3
"""Speed of the load, rad/s, below which a carry is planned as from rest. Tuned on the populations."""
REACHED = 0.92
"""g, in half gaps, above which a flank is reached. Tuned on the populations."""
_TOUCH_TORQUE = 10.0
"""Torque with which teeth are touched, as acceleration of the motor, rad/s^2. Tuned on the populations."""
_EFFORT = 0.75
"""Share of the torque available at a speed that a push uses, and of that at standstill that a brake uses. Tuned on the
populations."""
_LEAST_EFFORT = 0.1
"""Share of the torque available at standstill that is left for a push at least, whatever resists. Tuned on the
populations."""
_SLOWEST_EFFORT = 0.9
"""Share of the no-load speed up to which the torque available falls with the speed. Tuned on the populations."""
_APPROACH_SHARE = 0.8
"""Share of the crossing time in which a flank is approached. Tuned on the populations."""
LEAST_BRAKE = 0.02
"""Shortest time of a brake, s. Tuned on the populations."""
LEAST_CROSSING = 0.3
"""Share of the crossing time that a part of the gap takes at least. Tuned on the populations."""
LEAST_PERIODS = 3.0
"""Periods that a crossing takes at least, so that the motor's loop follows it."""


class Shafts(NamedTuple):
    """Where the shafts are as a plan begins."""

    load: float  # rad
    load_speed: float  # rad/s
    motor: float  # rad, at the output, from the middle of the gap
    motor_speed: float  # rad/s, at the output


@compiled
def edge_of_gap(constants: Constants) -> float:
    """Return abs(g) at which teeth are touched, rad."""
    return contact_distance(constants, _TOUCH_TORQUE * constants.motor_inertia)


@compiled
def coasting_distance(constants: Constants, speed: float) -> float:
    """Return the distance that a load coasts from a speed (rad/s) against its friction, rad, signed."""
    inertia, viscous, dry = constants.load_inertia, constants.load_friction, constants.load_dry_friction
    size = abs(speed)
    if dry > 0.0 and viscous * size < 1e-6 * dry:
        distance = 0.5 * inertia * size * size / dry
    elif dry > 0.0:
        distance = inertia / viscous * (size - dry / viscous * math.log(1.0 + viscous * size / dry))
    else:
        distance = inertia * size / max(viscous, 1e-12)
    return math.copysign(distance, speed)


@compiled
def shortest_push(constants: Constants, length: float, gain: float, speed: float, resistance: float) -> float:
    """Return the time of a push that gains a speed: ``length``, s, or more if the motor is too weak for that."""
    inertia = constants.motor_inertia + constants.load_inertia
    steady = max(resistance, 0.0) + constants.load_friction * speed
    slower = 1.0 - min(speed / constants.no_load_speed, _SLOWEST_EFFORT)
    available = _EFFORT * constants.available_torque * slower
    if inertia * BUMP_PEAK * gain / length + steady <= available:
        return length
    left = max(available - steady, _LEAST_EFFORT * constants.available_torque)
    return max(length, inertia * BUMP_PEAK * gain / left)


@compiled
def shortest_brake(constants: Constants, length: float, speed: float) -> float:
    """Return the time of a brake from a speed (rad/s): ``length``, s, or more if the motor is too weak for that."""
    inertia = constants.motor_inertia + constants.load_inertia
    return max(length, inertia * _SOFT_PEAK * speed / (_EFFORT * constants.available_torque))


@compiled
def approach_time(constants: Constants, gap_position: float) -> float:
    """Return the time that the motor takes from g to the driving flank, s; 0 if it is there."""
    half = 0.5 * constants.gap
    if gap_position >= REACHED * 0.5 * constants.gap:
        return 0.0
    share = max(LEAST_CROSSING, math.sqrt(min(1.0, (half - gap_position) / constants.gap)))
    return _APPROACH_SHARE * constants.crossing_time * share


@compiled
def approach(plan: Plan, length: float, end: float) -> None:
    """Let the motor go to g = ``end``, rad, and the move on to where the load is touched."""
    move = plan.move
    segment = add_crossing(plan, move.gap_position, end, length, move.angle, move.speed)
    segment.first_acceleration = segment.last_acceleration = -move.deceleration
    segment.closing_speed = move.closing_speed
    move.angle = move.angle + move.speed * length - 0.5 * move.deceleration * length * length
    move.speed -= move.deceleration * length
