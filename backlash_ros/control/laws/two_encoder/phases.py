"""Which phase the law is in: it takes off for planned moves, follows setpoints that move, and holds in between."""

from backlash_ros.control.laws.two_encoder.constants import Constants
from backlash_ros.control.laws.two_encoder.flight import fly
from backlash_ros.control.laws.two_encoder.follow import begin_to_follow, stop_following
from backlash_ros.control.laws.two_encoder.load_torque import holds_load, use_what_motion_showed
from backlash_ros.control.laws.two_encoder.memory import FLIGHT, FOLLOW, HOLD, Hold, Memory
from backlash_ros.control.laws.two_encoder.moves import Shafts
from backlash_ros.control.laws.two_encoder.plan import length_of
from backlash_ros.control.laws.two_encoder.reference import moves_within
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, VELOCITY

_CREEPS = 0.1
"""Leap of the target in a sample, in gaps per second, up to which it creeps: it is held like one at rest."""
_PLANNED_SPEED = 0.02
"""Speed of the load, rad/s, below which it stands as a flight is planned. Tuned on the populations."""
STUCK_SPEED = 0.05
"""Speed of the load, rad/s, below which it was stuck. Tuned on the populations."""


@compiled
def rest_from_motion(constants: Constants, memory: Memory) -> None:
    """Forget the friction at rest, which does not act in motion."""
    has_friction = constants.load_dry_friction + constants.motor_dry_friction > 0.0
    if has_friction and abs(memory.load.speed) < STUCK_SPEED:
        memory.motor.compensation = memory.motor.estimated.disturbance = 0.0


@compiled
def take_off(constants: Constants, memory: Memory) -> None:
    """Start a plan that was just made."""
    memory.phase, memory.plan.time, memory.hold.time_since_landing = FLIGHT, 0.0, 0.0
    rest_from_motion(constants, memory)


@compiled
def fly_to_target(constants: Constants, memory: Memory) -> None:
    """Plan a flight to the target from the drive's position at the time when the command acts, and start it."""
    load, motor = memory.load, memory.motor.predicted
    speed = load.speed if abs(load.speed) > _PLANNED_SPEED else 0.0
    angle = load.angle + constants.delay * speed
    shafts = Shafts(angle, speed, motor.angle - memory.middle, motor.speed)
    memory.flank = fly(constants, memory, memory.target, shafts)
    take_off(constants, memory)


@compiled
def start_holding(memory: Memory) -> None:
    """Start to hold, or change the kind of holding."""
    hold, memory.phase = memory.hold, HOLD
    hold.waiting_time = hold.leading_flank = hold.leading_time = 0.0
    hold.parking_time = -1.0


@compiled
def forget_attempts(hold: Hold) -> None:
    """Forget earlier attempts to move the load."""
    hold.attempts, hold.error_share, hold.last_error = 0.0, 1.0, 0.0


@compiled
def _follow_or_stop(constants: Constants, memory: Memory, path: Array) -> None:
    """Begin to follow a reference that moves, or that is about to, and to hold where it stops."""
    sees = int((constants.crossing_time + constants.delay) / constants.period) + 3
    moves = moves_within(constants, path, 0.0, sees)
    if moves and memory.phase != FOLLOW:
        rest_from_motion(constants, memory)
        begin_to_follow(constants, memory)
    elif not moves and memory.phase == FOLLOW and memory.follow.crosses == 0.0:
        stop_following(memory)
        use_what_motion_showed(constants, memory)
        start_holding(memory)
        memory.target = path[0, POSITION]


@compiled
def _fly_where_target_leaps(constants: Constants, memory: Memory, path: Array) -> None:
    """Plan a flight if the target has leapt; one that creeps is held."""
    period = constants.period
    leap = abs(path[0, POSITION] - memory.target) - abs(path[0, VELOCITY]) * period
    memory.target = path[0, POSITION]
    if leap > _CREEPS * period * constants.gap:
        forget_attempts(memory.hold)
        fly_to_target(constants, memory)


@compiled
def _has_landed(constants: Constants, memory: Memory) -> bool:
    """Return whether a plan has come to its end, and the motor with it."""
    if memory.phase != FLIGHT:
        return False
    return memory.plan.time > length_of(memory.plan) + constants.delay + constants.period


@compiled
def choose_phase(constants: Constants, memory: Memory, path: Array) -> None:
    """Start what the path asks for, and end what is done."""
    _follow_or_stop(constants, memory, path)
    if memory.phase != FOLLOW:
        _fly_where_target_leaps(constants, memory, path)
    if _has_landed(constants, memory):
        use_what_motion_showed(constants, memory)
        start_holding(memory)
    held = 1.0 if holds_load(constants, memory.load_torque.estimated) else 0.0
    if held != memory.held:
        memory.held = held
        if memory.phase == HOLD:
            start_holding(memory)
