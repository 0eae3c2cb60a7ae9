"""Follow: the motor goes ahead of a reference in motion, by the gap and by the depth at which the teeth carry the load.

The flank changes with the sign of the torque that the load needs, halfway through a crossing that begins in time. The
load's angle corrects only what is slow: where each flank is. What motion costs beyond the model is learned, too.
"""

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.command import Wanted
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.crossing import choose_flank, gap_motion_at, lies_on_flank, sure_seat
from backlash_ros.control.laws.planned.drag import begin_to_learn_drag, learn_drag
from backlash_ros.control.laws.planned.load_torque import holds_load
from backlash_ros.control.laws.planned.memory import FOLLOW, Memory
from backlash_ros.control.laws.planned.middle import LARGEST_SHARE
from backlash_ros.control.laws.planned.motor import friction_sticks, loop_slowdown
from backlash_ros.control.laws.planned.reference import (
    direction_at,
    learned_of,
    needed_torque,
    reference_at,
    resting_torque,
)
from backlash_ros.control.laws.planned.teeth import gap_position
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

_PUSHES = 20.0
"""Acceleration of the load, rad/s^2, from which on its teeth surely push. Tuned on random drives."""
_NEAR_SEAT = 0.1
"""Share of the gap from the seat within which the teeth surely touch."""
_SETTLES = 0.012
"""Time after a crossing, s, for which a landing swings. Tuned on random drives."""
_OTHER_SIDE = 0.1
"""Share of the gap: a motor that is further than this beyond the middle surely does not touch the flank."""
_SEAT_RATE = 12.0
"""Rate with which the error of a flank's seat is learned, 1/s. Tuned on random drives."""
_FIRST_TIME = 0.03
"""Time, s, from which on it is learned as the mean over the time spent on the flank, while that is faster. Tuned on
random drives."""
_QUARTER_COUNT = 0.25
"""Share of a count below which an error is none."""
_FINE_COUNT = 0.2
"""Share of the gap up to which an encoder count is allowed for, here and near the seat."""
_LARGEST_ERROR = 0.3
"""Share of the gap: the largest error from which is learned."""
_LARGEST_SEAT = 0.8
"""Share of the gap: the largest error of a seat."""


@compiled
def begin_to_follow(constants: Constants, memory: Memory) -> None:
    """Begin to follow from where the motor is in the gap."""
    memory.phase, memory.hold.time_since_landing, follow = FOLLOW, 0.0, memory.follow
    follow.crosses = follow.time_on_flank = follow.time_fallen = follow.direction = follow.doubt = 0.0
    follow.side = follow.beats = follow.crossing.end = 0.0
    for learned in (follow.forward, follow.backward):
        learned.seat = learned.seat_time = 0.0
    begin_to_learn_drag(constants, memory)
    follow.flank = lies_on_flank(constants, memory, holds_load(constants, memory.load_torque.estimated))


@compiled
def stop_following(memory: Memory) -> None:
    """Take what was learned of the flank in use for the middle of the gap."""
    follow = memory.follow
    follow.beats = 0.0
    memory.middle += follow.crossing.end if follow.flank == 0.0 else sure_seat(follow)


@compiled
def _teeth_touch(constants: Constants, memory: Memory, path: Array) -> bool:
    """Return whether the teeth surely carry the load, so that the load's angle shows where the flank is."""
    follow, count = memory.follow, memory.load.count
    if follow.crosses != 0.0 or follow.flank == 0.0 or follow.time_on_flank <= _SETTLES + constants.delay:
        return False
    if gap_position(memory) * follow.flank < -_OTHER_SIDE * constants.gap:
        return False
    if abs(needed_torque(constants, memory, path, 0.0)) > _PUSHES * constants.load_inertia:
        return True
    near = _NEAR_SEAT * constants.gap + (count if count < _FINE_COUNT * constants.gap else 0.0)
    return abs(gap_position(memory) - gap_motion_at(constants, memory, path, 0.0).position) < near


@compiled
def _learn_seat(constants: Constants, memory: Memory, path: Array) -> None:
    """Learn how far off the flank in use is from where it should be, from the load's error."""
    if not _teeth_touch(constants, memory, path):
        return
    learned, load, period, gap = (
        learned_of(memory.follow, memory.follow.flank),
        memory.load,
        constants.period,
        constants.gap,
    )
    learned.seat_time += period
    rate = max(_SEAT_RATE, 1.0 / (learned.seat_time + _FIRST_TIME)) / loop_slowdown(constants, memory)
    error = reference_at(constants, path, 0.0).angle - load.angle
    if abs(error) <= (_QUARTER_COUNT * load.count if load.count < _FINE_COUNT * gap else 0.0):
        return
    change = min(rate * period, LARGEST_SHARE) * clamp(error, -_LARGEST_ERROR * gap, _LARGEST_ERROR * gap)
    learned.seat = clamp(learned.seat + change, -_LARGEST_SEAT * gap, _LARGEST_SEAT * gap)


@compiled
def _wanted(constants: Constants, memory: Memory, path: Array) -> Wanted:
    """Return the motion of the motor when the command acts, and the torque for it over the period."""
    period, k = constants.period, constants.delay / constants.period
    later = k + constants.electrical_time / period
    now, gap_now = reference_at(constants, path, k), gap_motion_at(constants, memory, path, k)
    end, gap_end = reference_at(constants, path, k + 1.0), gap_motion_at(constants, memory, path, k + 1.0)
    first, last = gap_motion_at(constants, memory, path, later), gap_motion_at(constants, memory, path, later + 1.0)
    half = gap_motion_at(constants, memory, path, later + 0.5)
    begins = reference_at(constants, path, later).speed + first.speed
    ends = reference_at(constants, path, later + 1.0).speed + last.speed
    torque = constants.motor_inertia * (ends - begins) / period + constants.motor_friction * 0.5 * (begins + ends)
    torque += (first.torque + 4.0 * half.torque + last.torque) / 6.0
    carried = gap_motion_at(constants, memory, path, k + 0.5).torque
    memory.motor_target = now.angle + gap_now.position + memory.middle
    mean_speed = (end.angle - now.angle + gap_end.position - gap_now.position) / period
    return Wanted(memory.motor_target, now.speed + gap_now.speed, torque, carried, mean_speed)


@compiled
def follow_path(constants: Constants, memory: Memory, path: Array) -> Wanted:
    """Follow the reference for one period."""
    follow = memory.follow
    # As time goes on, a crossing that has begun lies further back.
    follow.crossing.starts -= 1.0
    reference = reference_at(constants, path, 0.0)
    follow.direction = direction_at(reference, follow.direction)
    if follow.direction == 0.0:
        follow.direction = direction_at(reference_at(constants, path, float(path.shape[0] - 1)), 0.0)
    learn_drag(constants, memory, path)
    held = holds_load(constants, resting_torque(constants, memory, reference.angle))
    free = not friction_sticks(constants, constants.load_dry_friction) and not held
    choose_flank(constants, memory, path, free)
    _learn_seat(constants, memory, path)
    memory.flank = follow.flank if follow.crosses == 0.0 else follow.crossing.flank
    memory.target = reference.angle
    return _wanted(constants, memory, path)
