"""One step of the law with one encoder alone: the model stands for the other one."""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import LAW_SIGNATURE
from backlash_ros.control.laws.planned.alone.by_load_encoder import observe_by_load
from backlash_ros.control.laws.planned.alone.by_motor_encoder import observe_by_motor
from backlash_ros.control.laws.planned.alone.constants import AloneConstants, alone_constants_at
from backlash_ros.control.laws.planned.alone.hold import hold_alone
from backlash_ros.control.laws.planned.alone.load_torque import use_load_torque
from backlash_ros.control.laws.planned.alone.memory import LOAD_ANGLE, AloneMemory, alone_memory_at
from backlash_ros.control.laws.planned.alone.model import look_ahead
from backlash_ros.control.laws.planned.alone.start import start_alone
from backlash_ros.control.laws.planned.command import Wanted, remember, voltage_for
from backlash_ros.control.laws.planned.follow import follow_path
from backlash_ros.control.laws.planned.memory import FOLLOW, HOLD, NO_MOVE, TO_FLY
from backlash_ros.control.laws.planned.phases import (
    follow_or_stop,
    forget_attempts,
    has_landed,
    start_holding,
    target_leaps,
)
from backlash_ros.control.laws.planned.plan import fly_on
from backlash_ros.control.laws.planned.take_off import take_off
from backlash_ros.foundation.compiled import compiled, compiled_as
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, THETA_L, THETA_M, Estimate, as_setpoint

_TWICE = 2.0
"""Standard deviations by which the load may be off its place."""
_UNSEEN = 0.04
"""Share of the gap by which it may be off if it is not measured."""


@compiled
def _observe(constants: AloneConstants, memory: AloneMemory, estimate: Estimate, path: Array) -> None:
    """Take a sample: both shafts at the sample, and when the command acts."""
    plans, shafts = memory.plans, memory.shafts
    if plans.started == 0.0:
        start_alone(constants, memory, estimate, as_setpoint(path[0]))
    elif constants.sees_load != 0.0:
        observe_by_load(constants, memory, estimate[THETA_L])
    else:
        observe_by_motor(constants, memory, constants.plans.ratio * estimate[THETA_M])
    look_ahead(constants, shafts, memory.ahead, plans.sent)
    motor, load = plans.motor, plans.load
    motor.estimated.angle, motor.estimated.speed = shafts.angle, shafts.speed
    motor.estimated.current_torque = shafts.current_torque
    motor.predicted.angle, motor.predicted.speed = memory.ahead.angle, memory.ahead.speed
    load.angle, load.speed = shafts.load_angle, shafts.load_speed
    load.count = _UNSEEN * constants.plans.gap
    if constants.sees_load != 0.0:
        off = math.sqrt(max(memory.covariance[LOAD_ANGLE, LOAD_ANGLE], 0.0))
        load.count = max(memory.readings.count, _TWICE * off)


@compiled
def _choose_phase(constants: AloneConstants, memory: AloneMemory, path: Array) -> None:
    """Start what the path asks for, and end what is done."""
    plans, known = memory.plans, constants.plans
    follow_or_stop(known, plans, path)
    if plans.phase != FOLLOW and target_leaps(known, plans, path):
        forget_attempts(plans.hold)
        plans.next_move = TO_FLY
    elif has_landed(known, plans):
        start_holding(plans)


@compiled
def _wanted(constants: AloneConstants, memory: AloneMemory, path: Array) -> Wanted:
    """Return what the motor is to do in this period."""
    plans, known = memory.plans, constants.plans
    if plans.phase == FOLLOW:
        return follow_path(known, plans, path)
    if plans.phase == HOLD and plans.next_move == NO_MOVE:
        wanted = hold_alone(constants, memory, path[0, POSITION])
        # Holding may just have chosen a move.
        if plans.next_move == NO_MOVE:
            return wanted
    if plans.next_move != NO_MOVE:
        take_off(known, plans)
    return fly_on(known, plans)


@compiled_as(LAW_SIGNATURE)
def alone_step(law: Array, state: Array, estimate: Estimate, path: Array, low: float, high: float) -> float:
    """Observe, plan if the setpoint has jumped or the load is off its target, and move the motor."""
    constants, memory = alone_constants_at(law), alone_memory_at(state)
    _observe(constants, memory, estimate, path)
    use_load_torque(constants, memory)
    _choose_phase(constants, memory, path)
    wanted = _wanted(constants, memory, path)
    voltage = clamp(voltage_for(constants.plans, memory.plans, wanted), low, high)
    remember(constants.plans, memory.plans.sent, voltage, wanted.teeth_torque, estimate)
    return voltage
