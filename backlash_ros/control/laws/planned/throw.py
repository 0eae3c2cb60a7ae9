"""Throw: push the load, cross the gap while it coasts, and brake it on the other flank.

With fixed times, the angle where the load stops is linear in its speed after the push. So the law solves for that
speed, adapts the times, and solves again, a few times.
"""

from typing import NamedTuple

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.memory import LoadTorque, Move, Plan, Throw
from backlash_ros.control.laws.planned.moves import (
    LEAST_BRAKE,
    TOP_SPEED,
    approach,
    edge_of_gap,
    shortest_brake,
    shortest_push,
)
from backlash_ros.control.laws.planned.plan import add_contact, add_crossing, resistance_at
from backlash_ros.foundation.compiled import compiled

_ROUNDS = 5
"""Rounds in which a throw is computed."""
_BRAKE_SHARE = 1.33
"""Longest brake, as twice its share of the time in which the load would stop by itself: two thirds, so that the braking
flank has to brake, too, and stays in contact."""
_SHORT_BRAKE = 0.035
"""Time, s, below which the driving flank does the brake's work: the load is pressed. Tuned on the populations."""
_HARD = 165.0
"""Deceleration by friction and load torque, rad/s^2, from which on a load is pressed. Tuned on the populations."""


class Landing(NamedTuple):
    """The flight of a load that is pushed up to some speed."""

    end: float  # rad, where it comes to rest, without a cruise
    pushed: float  # rad, where the push ends
    push_first: float  # rad/s^2, as the push starts
    push_last: float  # rad/s^2, as it ends
    push_bump: float  # rad/s^2
    slows: float  # rad/s^2, while the motor crosses
    met_speed: float  # rad/s, as the brake starts
    brake_first: float  # rad/s^2
    brake_last: float  # rad/s^2
    brake_bump: float  # rad/s^2
    left_speed: float  # rad/s, after the brake


@compiled
def land(constants: Constants, move: Move, throw: Throw, speed: float) -> Landing:
    """Compute the flight in which the push reaches a given speed, with the times of a throw."""
    inertia, viscous, crossing = constants.load_inertia, constants.load_friction, constants.crossing_time
    push, brake, first_speed = throw.push_time, throw.brake_time, throw.touch_speed
    resists = move.crossing_resistance
    push_first = -(viscous * first_speed + move.first_resistance) / inertia if throw.moves != 0.0 else 0.0
    push_last = -(viscous * speed + resists) / inertia
    push_bump = (speed - first_speed) / push - 0.5 * (push_first + push_last)
    pushed = throw.angle
    pushed += first_speed * push + push * push * (push_first / 3.0 + push_last / 6.0 + 0.5 * push_bump)
    slows = (viscous * speed + resists) / (inertia + 0.5 * viscous * crossing)
    met = speed - slows * crossing
    angle = pushed + (speed * crossing - 0.5 * slows * crossing * crossing)
    left = move.last_resistance / inertia * throw.back_time
    brake_first = -(viscous * met + resists) / inertia
    brake_last = -(viscous * left + max(move.last_resistance, 0.0)) / inertia
    brake_bump = (left - met) / brake - 0.5 * (brake_first + brake_last)
    angle += met * brake + brake * brake * (brake_first / 3.0 + brake_last / 6.0 + 0.6 * brake_bump)
    end = angle + 0.5 * left * throw.back_time
    return Landing(end, pushed, push_first, push_last, push_bump, slows, met, brake_first, brake_last, brake_bump, left)


@compiled
def _solve_speed(constants: Constants, move: Move, throw: Throw) -> None:
    """Find the speed after the push, and how long it is kept, so that the load lands at its target."""
    top = TOP_SPEED * constants.no_load_speed
    without = land(constants, move, throw, 0.0).end
    per_speed = land(constants, move, throw, 1.0).end - without
    throw.speed, throw.cruise_time = (move.target - without) / per_speed, 0.0
    if throw.speed > top:
        throw.speed, throw.cruise_time = top, (throw.speed / top - 1.0) * per_speed


@compiled
def solve_throw(constants: Constants, plan: Plan, load_torque: LoadTorque) -> bool:
    """Find how a load that is touched is to be pushed so that it lands at its target.

    Return whether it is better pressed, on one flank.
    """
    move, throw, crossing = plan.move, plan.throw, constants.crossing_time
    throw.push_time, throw.brake_time = constants.push_time, constants.brake_time
    throw.speed = throw.cruise_time = 0.0
    for k in range(_ROUNDS + 1):
        least = min(move.crossing_resistance, move.last_resistance)
        most = max(move.crossing_resistance, move.last_resistance)
        if k == 0 and least > 0.0 and least / constants.load_inertia >= _HARD:
            return True
        _solve_speed(constants, move, throw)
        if k == _ROUNDS:
            break
        gain, resists = throw.speed - throw.touch_speed, max(move.first_resistance, move.crossing_resistance)
        throw.push_time = shortest_push(constants, throw.push_time, gain, throw.speed, resists)
        landing = land(constants, move, throw, throw.speed)
        met = landing.met_speed
        throw.brake_time = shortest_brake(constants, constants.brake_time, met)
        if least >= 0.0:
            # The load stops before the brake.
            if met <= 0.0:
                return least > 0.0
            longest = _BRAKE_SHARE * met * constants.load_inertia / (constants.load_friction * met + 2.0 * most)
            if least > 0.0 and longest < _SHORT_BRAKE:
                return True
            throw.brake_time = max(min(throw.brake_time, longest), LEAST_BRAKE)
        if throw.adapts != 0.0:
            angle = landing.pushed + throw.speed * (throw.cruise_time + 0.5 * crossing)
            angle = clamp(angle, throw.angle, move.target)
            move.crossing_resistance = resistance_at(constants, load_torque, move.direction, angle)
    return False


@compiled
def add_throw(constants: Constants, plan: Plan, landing: Landing) -> None:
    """Add the segments of a throw to the plan, up to where the load comes to rest."""
    move, throw, edge, crossing = plan.move, plan.throw, edge_of_gap(constants), constants.crossing_time
    speed, met, left, angle = throw.speed, landing.met_speed, landing.left_speed, landing.pushed
    if throw.approach_time > 0.0:
        approach(plan, throw.approach_time, edge)
    push = add_contact(plan, 1.0, throw.push_time, throw.angle, throw.touch_speed)
    push.first_acceleration, push.last_acceleration = landing.push_first, landing.push_last
    push.bump = landing.push_bump
    if throw.cruise_time > 0.0:
        add_contact(plan, 1.0, throw.cruise_time, angle, speed)
        angle += speed * throw.cruise_time
    cross = add_crossing(plan, edge, -edge, crossing, angle, speed)
    cross.first_acceleration = cross.last_acceleration = -landing.slows
    angle = angle + speed * crossing - 0.5 * landing.slows * crossing * crossing
    brake = add_contact(plan, -1.0, throw.brake_time, angle, met)
    brake.first_acceleration, brake.last_acceleration = landing.brake_first, landing.brake_last
    brake.bump, brake.ends_softly = landing.brake_bump, 1.0
    if throw.back_time > 0.0:
        angle = move.target - 0.5 * left * throw.back_time
        back = add_crossing(plan, -edge, edge, throw.back_time, angle, left)
        back.first_acceleration = back.last_acceleration = -(left / throw.back_time)
