"""Which phase the law is in: it flies to targets that leap, follows setpoints that move, and holds in between."""

from backlash_ros.control.laws.two_encoder.constants import Constants
from backlash_ros.control.laws.two_encoder.load_torque import holds_load, use_what_motion_showed
from backlash_ros.control.laws.two_encoder.memory import FLIGHT, FOLLOW, HOLD, NO_MOVE, TO_FLY, Hold, Memory
from backlash_ros.control.laws.two_encoder.plan import length_of
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY, Setpoint

_CREEPS = 0.1
"""Speed of a setpoint, in gaps per second, up to which it is held like one at rest; and the same as a leap in a sample.
Holding lets the load be off by a twelfth of the gap, so nothing is lost."""


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
def _moves(constants: Constants, setpoint: Setpoint) -> bool:
    """Return whether a setpoint moves, or begins or ends to move within a crossing of the gap."""
    speed = abs(setpoint[VELOCITY]) + constants.crossing_time * abs(setpoint[ACCELERATION])
    return bool(speed > _CREEPS * constants.gap)


@compiled
def _follow_or_stop(constants: Constants, memory: Memory, setpoint: Setpoint) -> None:
    """Begin to follow a setpoint that moves, and to hold where it stops."""
    if not _moves(constants, setpoint):
        if memory.phase == FOLLOW:
            use_what_motion_showed(constants, memory)
            start_holding(memory)
            memory.target = setpoint[POSITION]
        return
    if memory.phase != FOLLOW:
        memory.phase, memory.hold.time_since_landing = FOLLOW, 0.0
        memory.followed_position = memory.motor.predicted.angle - memory.load.angle - memory.middle


@compiled
def _target_leaps(constants: Constants, memory: Memory, setpoint: Setpoint) -> bool:
    """Take the setpoint for the target, and return whether that has leapt; one that creeps is held."""
    period = constants.period
    leap = abs(setpoint[POSITION] - memory.target) - abs(setpoint[VELOCITY]) * period
    memory.target = setpoint[POSITION]
    return bool(leap > _CREEPS * period * constants.gap)


@compiled
def _has_landed(constants: Constants, memory: Memory) -> bool:
    """Return whether a plan has come to its end, and the motor with it."""
    if memory.phase != FLIGHT:
        return False
    return memory.plan.time > length_of(memory.plan) + constants.delay + constants.period


@compiled
def choose_phase(constants: Constants, memory: Memory, setpoint: Setpoint) -> None:
    """Start what the setpoint asks for, and end what is done."""
    _follow_or_stop(constants, memory, setpoint)
    if memory.phase != FOLLOW and _target_leaps(constants, memory, setpoint):
        forget_attempts(memory.hold)
        memory.next_move = TO_FLY
    elif _has_landed(constants, memory):
        use_what_motion_showed(constants, memory)
        start_holding(memory)
    held = 1.0 if holds_load(constants, memory.load_torque.estimated) else 0.0
    if held != memory.held:
        memory.held = held
        if memory.phase == HOLD and memory.next_move == NO_MOVE:
            start_holding(memory)
