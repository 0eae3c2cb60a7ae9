"""Press: a move all on the driving flank, because friction, or the load torque, brakes hard enough."""

import math
from typing import NamedTuple

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load_torque import set_load_torque
from backlash_ros.control.laws.planned.memory import Memory, Move, Plan
from backlash_ros.control.laws.planned.moves import (
    BUMP_PEAK,
    TOP_SPEED,
    Shafts,
    approach,
    approach_time,
    edge_of_gap,
    shortest_push,
)
from backlash_ros.control.laws.planned.plan import add_contact, resistance_at
from backlash_ros.foundation.compiled import compiled

_USED_RESISTANCE = 0.5
"""Share of what brakes the load by itself that a press uses, so that the teeth stay in contact."""
_USED_FRICTION = 0.3
"""Share of the load's viscous friction that a press counts with, so that the teeth stay in contact."""
_ROUNDS = 6
"""Rounds in which speed and durations of a press are computed, as they depend on each other."""
_FALLEN_GAPS = 8.0
"""A load torque that would pull the load through four gaps while the motor approaches has laid it on the motor's flank:
8, since twice the way is an acceleration times the time squared. Tuned on the populations."""
_LEAST_RESISTANCE = 0.3
"""Least resistance of a stuck load, as a share of its friction, whatever load torque that hides. Tuned on the
populations."""


class _Press(NamedTuple):
    """Speed and times of a press."""

    speed: float  # rad/s, after the push
    push: float  # s
    cruise: float  # s
    brake: float  # s


@compiled
def _solve(constants: Constants, move: Move, resistance: float) -> _Press:
    """Return speed and times with which a load that is touched stops at its target."""
    left, top = move.target - move.angle, TOP_SPEED * constants.no_load_speed
    push = brake = constants.push_time
    speed = cruise = 0.0
    for _ in range(_ROUNDS):
        braking = resistance + _USED_FRICTION * constants.load_friction * speed
        deceleration = _USED_RESISTANCE * braking / constants.load_inertia
        needed = left - 0.5 * move.speed * push
        if needed <= 0.0:
            speed = 0.0
            break
        # The brake takes so much of the distance for each square of the speed.
        per_square = 0.4 * BUMP_PEAK / deceleration
        speed = (-0.5 * push + math.sqrt(0.25 * push * push + 4.0 * per_square * needed)) / (2.0 * per_square)
        cruise = 0.0
        if speed > top:
            speed = top
            cruise = (needed - 0.5 * speed * push - per_square * speed * speed) / speed
        brake = BUMP_PEAK * speed / deceleration
        push = shortest_push(constants, push, speed - move.speed, speed, resistance)
    if brake < constants.push_time:
        brake, cruise = constants.push_time, 0.0
        speed = max((left - 0.5 * move.speed * push) / (0.5 * push + 0.4 * brake), 0.0)
    return _Press(speed, push, cruise, brake)


@compiled
def press(constants: Constants, plan: Plan, resistance: float) -> None:
    """Plan the move on the driving flank alone, against a resistance > 0, N m."""
    move = plan.move
    length = approach_time(constants, move.gap_position)
    # A large load torque has long laid the load on that flank, wherever the middle is thought to be.
    if move.deceleration * length * length > _FALLEN_GAPS * constants.gap:
        length = 0.0
    if length > 0.0:
        approach(plan, length, edge_of_gap(constants))
    found = _solve(constants, move, resistance)
    angle, speed = move.angle, found.speed
    add_contact(plan, 1.0, found.push, angle, move.speed).bump = (speed - move.speed) / found.push
    angle += 0.5 * (move.speed + speed) * found.push
    if found.cruise > 0.0:
        add_contact(plan, 1.0, found.cruise, angle, speed)
        angle += found.cruise * speed
    brake = add_contact(plan, 1.0, found.brake, angle, speed)
    brake.bump, brake.ends_softly = -speed / found.brake, 1.0


@compiled
def press_stuck_load(constants: Constants, memory: Memory, target: float, shafts: Shafts) -> float:
    """Plan to push a load that dry friction holds to its target, rad; return the flank.

    A load torque that would leave less resistance than `_LEAST_RESISTANCE` is believed to be smaller.
    """
    plan, move, friction = memory.plan, memory.plan.move, constants.load_dry_friction
    direction = 1.0 if target >= shafts.load else -1.0
    resistance = resistance_at(constants, memory.load_torque, direction, direction * shafts.load)
    resistance = max(resistance, _LEAST_RESISTANCE * friction)
    set_load_torque(memory.load_torque, direction * (friction - resistance), shafts.load)
    plan.segment_count = plan.rest_torque = 0.0
    move.direction, move.target = direction, direction * target
    move.angle, move.speed, move.deceleration = direction * shafts.load, 0.0, 0.0
    move.gap_position = direction * (shafts.motor - shafts.load)
    move.closing_speed = direction * shafts.motor_speed
    press(constants, plan, resistance)
    return direction
