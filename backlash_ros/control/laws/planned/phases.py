"""Which phase the law is in: it flies to targets that leap, follows references that move, and holds in between."""

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.follow import begin_to_follow, stop_following
from backlash_ros.control.laws.planned.load_torque import holds_load, use_what_motion_showed
from backlash_ros.control.laws.planned.memory import FLIGHT, FOLLOW, HOLD, NO_MOVE, TO_FLY, Hold, Memory
from backlash_ros.control.laws.planned.motor import forget_friction_at_rest
from backlash_ros.control.laws.planned.plan import length_of
from backlash_ros.control.laws.planned.reference import CREEPS, moves_within
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, VELOCITY


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
def follow_or_stop(constants: Constants, memory: Memory, path: Array) -> None:
    """Begin to follow a reference that moves, or that is about to, and to hold where it stops."""
    sees = int((constants.crossing_time + constants.delay) / constants.period) + 3
    moves = moves_within(constants, path, 0.0, sees)
    if moves and memory.phase != FOLLOW:
        forget_friction_at_rest(constants, memory)
        begin_to_follow(constants, memory)
    elif not moves and memory.phase == FOLLOW and memory.follow.crosses == 0.0:
        stop_following(memory)
        use_what_motion_showed(constants, memory)
        start_holding(memory)
        memory.target = path[0, POSITION]


@compiled
def target_leaps(constants: Constants, memory: Memory, path: Array) -> bool:
    """Take the reference for the target, and return whether that has leapt; one that creeps is held."""
    period = constants.period
    leap = abs(path[0, POSITION] - memory.target) - constants.unit * abs(path[0, VELOCITY]) * period
    memory.target = path[0, POSITION]
    return bool(leap > CREEPS * period * constants.gap)


@compiled
def has_landed(constants: Constants, memory: Memory) -> bool:
    """Return whether a plan has come to its end, and the motor with it."""
    if memory.phase != FLIGHT:
        return False
    return memory.plan.time > length_of(memory.plan) + constants.delay + constants.period


@compiled
def choose_phase(constants: Constants, memory: Memory, path: Array) -> None:
    """Start what the path asks for, and end what is done."""
    follow_or_stop(constants, memory, path)
    if memory.phase != FOLLOW and target_leaps(constants, memory, path):
        forget_attempts(memory.hold)
        memory.next_move = TO_FLY
    elif has_landed(constants, memory):
        use_what_motion_showed(constants, memory)
        start_holding(memory)
    held = 1.0 if holds_load(constants, memory.load_torque.estimated) else 0.0
    if held != memory.held:
        memory.held = held
        if memory.phase == HOLD and memory.next_move == NO_MOVE:
            start_holding(memory)
