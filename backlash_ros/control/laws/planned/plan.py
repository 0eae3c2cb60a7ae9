"""A plan: its segments, and where the motor is and what the teeth carry at any time in it.

In each segment the load's acceleration is a straight line plus a bump. Either the motor is in contact on one flank, at
the depth at which the teeth carry the load's torque, or it crosses the gap while the load coasts. Everything is written
for a move forward; a move backward is its mirror image.
"""

from typing import NamedTuple

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.command import Wanted
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load_torque import load_torque_at
from backlash_ros.control.laws.planned.memory import LoadTorque, Memory, Plan, Segment
from backlash_ros.control.laws.planned.teeth import GapPosition, contact_distance, on_the_way
from backlash_ros.foundation.compiled import compiled

_STEP_SHARE = 0.02
"""Share of a torque by which it is changed to see how the teeth give way."""
_LEAST_STEP = 5e-4
"""Torque, as acceleration of the motor, rad/s^2, by which it is changed at least."""


@compiled
def _add(plan: Plan, duration: float, angle: float, speed: float) -> Segment:
    segment = plan.segments[int(plan.segment_count)]
    plan.segment_count += 1.0
    segment.duration, segment.direction = duration, plan.move.direction
    segment.angle, segment.speed = angle, speed
    segment.first_acceleration = segment.last_acceleration = segment.bump = segment.ends_softly = 0.0
    segment.flank = segment.crosses_from = segment.crosses_to = segment.closing_speed = 0.0
    return segment


@compiled
def add_contact(plan: Plan, flank: float, duration: float, angle: float, speed: float) -> Segment:
    """Add a segment in contact on a flank, from an angle and a speed of the load on; it goes on at that speed."""
    segment = _add(plan, duration, angle, speed)
    segment.flank = flank
    return segment


@compiled
def add_crossing(plan: Plan, start: float, end: float, duration: float, angle: float, speed: float) -> Segment:
    """Add a segment in which the motor crosses from g = ``start`` to ``end``, rad, while the load coasts."""
    segment = _add(plan, duration, angle, speed)
    segment.crosses_from, segment.crosses_to = start, end
    return segment


@compiled
def length_of(plan: Plan) -> float:
    """Return the duration of the plan, s."""
    total = 0.0
    for k in range(int(plan.segment_count)):
        total += plan.segments[k].duration
    return total


@compiled
def resistance_at(constants: Constants, load_torque: LoadTorque, direction: float, angle: float) -> float:
    """Return the torque that brakes the load at an angle, whatever its speed, N m; both in the move's direction."""
    return constants.load_dry_friction - direction * load_torque_at(load_torque, direction * angle)


class PlannedMotion(NamedTuple):
    """What a plan says of one time."""

    angle: float  # p, rad
    speed: float  # w, rad/s
    teeth_torque: float  # N m


class _LoadMotion(NamedTuple):
    """The motion of the load, in the move's own direction."""

    angle: float  # rad
    speed: float  # rad/s
    acceleration: float  # rad/s^2
    jerk: float  # rad/s^3


@compiled
def _load_motion(segment: Segment, time: float) -> _LoadMotion:
    """Return the motion of the load at a time in a segment, s."""
    length, first, bump = segment.duration, segment.first_acceleration, segment.bump
    u, rise = time / length, segment.last_acceleration - first
    if segment.ends_softly == 0.0:
        rate, shape = 6.0 * (1.0 - 2.0 * u), 6.0 * u * (1.0 - u)
        in_speed, in_angle = u * u * (3.0 - 2.0 * u), u * u * u * (1.0 - 0.5 * u)
    else:
        rate, shape = 12.0 * (1.0 - u) * (1.0 - 3.0 * u), 12.0 * u * (1.0 - u) * (1.0 - u)
        in_speed, in_angle = u * u * (6.0 - 8.0 * u + 3.0 * u * u), u * u * u * (2.0 - 2.0 * u + 0.6 * u * u)
    acceleration = first + rise * u + bump * shape
    speed = segment.speed + length * (first * u + 0.5 * rise * u * u + bump * in_speed)
    angle = segment.angle + segment.speed * time
    angle += length * length * (0.5 * first * u * u + rise * u * u * u / 6.0 + bump * in_angle)
    return _LoadMotion(angle, speed, acceleration, (rise + bump * rate) / length)


@compiled
def _yield_rate(constants: Constants, torque: float) -> float:
    """Return how much the teeth give way for each torque, rad/(N m)."""
    small = _STEP_SHARE * abs(torque) + _LEAST_STEP * constants.motor_inertia
    more, less = abs(torque) + small, max(abs(torque) - small, 0.0)
    return (contact_distance(constants, more) - contact_distance(constants, less)) / (2.0 * small)


@compiled
def evaluate(constants: Constants, memory: Memory, time: float) -> PlannedMotion:
    """Return what the plan says of a time in it, s."""
    plan, k = memory.plan, 0
    last = int(plan.segment_count) - 1
    while k < last and time > plan.segments[k].duration:
        time -= plan.segments[k].duration
        k += 1
    segment = plan.segments[k]
    direction, flank, over = segment.direction, segment.flank, time >= segment.duration
    time = clamp(time, 0.0, segment.duration)
    load, at_rest = _load_motion(segment, time), over and k == last
    torque = direction * plan.rest_torque if at_rest else 0.0
    if flank == 0.0:
        u, begin, end = time / segment.duration, segment.crosses_from, segment.crosses_to
        at = on_the_way(begin, end, segment.closing_speed, segment.duration, u)
    else:
        if not at_rest:
            resistance = resistance_at(constants, memory.load_torque, direction, load.angle)
            torque = constants.load_inertia * load.acceleration + constants.load_friction * load.speed + resistance
        # A flank cannot pull.
        if torque * flank < 0.0:
            torque = 0.0
        closing = 0.0
        if torque != 0.0 and not over:
            rate = constants.load_inertia * load.jerk + constants.load_friction * load.acceleration
            closing = _yield_rate(constants, torque) * rate
        at = GapPosition(flank * contact_distance(constants, torque), closing)
    angle = direction * (load.angle + at.position) + memory.middle
    return PlannedMotion(angle, direction * (load.speed + at.speed), direction * torque)


@compiled
def fly_on(constants: Constants, memory: Memory) -> Wanted:
    """Follow the plan for one period: the motor goes by its own encoder; of the load only the middle counts.

    The torque is that of an inverse model of the motor, read ahead by the winding's time constant.
    """
    plan, period = memory.plan, constants.period
    time, later = plan.time, plan.time + constants.electrical_time
    now, end = evaluate(constants, memory, time), evaluate(constants, memory, time + period)
    carried = evaluate(constants, memory, time + 0.5 * period).teeth_torque
    first = evaluate(constants, memory, later)
    half = evaluate(constants, memory, later + 0.5 * period)
    last = evaluate(constants, memory, later + period)
    acceleration_torque = constants.motor_inertia * (last.speed - first.speed) / period
    torque = acceleration_torque + constants.motor_friction * (last.angle - first.angle) / period
    torque += (first.teeth_torque + 4.0 * half.teeth_torque + last.teeth_torque) / 6.0
    memory.motor_target = end.angle
    plan.time += period
    return Wanted(now.angle, now.speed, torque, carried, (end.angle - now.angle) / period)
