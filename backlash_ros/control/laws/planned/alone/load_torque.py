"""The load torque that plans and hold use: what the model finds in hold, and 0 where that hardly pulls the load.

A load that is believed to be pulled by next to nothing would bounce through the model's gap for ever, and the real one
would follow. So a load that no torque holds has none.
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.alone.by_load_encoder import APART
from backlash_ros.control.laws.planned.alone.constants import AloneConstants
from backlash_ros.control.laws.planned.alone.memory import STATES, TORQUE, AloneMemory
from backlash_ros.control.laws.planned.load_torque import LEAST_SHOWN, set_load_torque
from backlash_ros.control.laws.planned.memory import HOLD
from backlash_ros.control.laws.planned.phases import start_holding
from backlash_ros.control.laws.planned.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled

_KNOWN = 25.0
"""Standard deviation of the load torque, as acceleration of the motor, rad/s^2, below which it is believed."""
_FOLLOW_TIME = 0.02
"""Time in which it is followed, s."""
_SLOW = 0.3
"""Speed of the load, rad/s, below which a torque that does not hold it may be taken for nothing."""
_NEXT_TO_NOTHING = 5.0
"""Standard deviation of a load torque that is taken for nothing, in torques that just hold the load."""
_LEAST_PULL = 2.0
"""Acceleration, rad/s^2, that a load torque gives the load at least to hold it."""
_UNSURE = 0.25
"""By how much a load torque must be above what holds the load to begin to hold it, as a share of that; less where it
is known better."""
_SHOWN = 1.5
"""Load torques of less than so many that just hold the load are 0 in plans."""
_BY_MOTOR = 1.0
"""Standard deviation of the load torque as the motor alone shows it, as acceleration of the motor, rad/s^2."""


@compiled
def _uncertainty(constants: AloneConstants, memory: AloneMemory) -> float:
    """Return the standard deviation of the load torque, N m."""
    if constants.sees_load == 0.0:
        return _BY_MOTOR * constants.plans.motor_inertia
    return math.sqrt(max(memory.covariance[TORQUE, TORQUE], 0.0))


@compiled
def _take_for_nothing(constants: AloneConstants, memory: AloneMemory, holding: float) -> None:
    """Take a load torque of a touched load that holds nothing for none, or for what friction may hide."""
    shafts, known = memory.shafts, constants.plans
    sees = constants.sees_load != 0.0
    if sees and abs(shafts.angle - shafts.load_angle) < APART * contact_distance(known, 0.0):
        # The load shows by itself, in the gap, what pulls it.
        return
    shafts.load_torque = clamp(shafts.load_torque, -known.load_dry_friction, known.load_dry_friction)
    if sees and known.load_dry_friction == 0.0:
        for k in range(STATES):
            memory.covariance[TORQUE, k] = memory.covariance[k, TORQUE] = 0.0
        memory.covariance[TORQUE, TORQUE] = (_NEXT_TO_NOTHING * holding) ** 2


@compiled
def _least_holding(constants: AloneConstants) -> float:
    """Return the torque beyond friction that holds the load, N m."""
    excess = constants.plans.holding_excess
    if constants.sees_load == 0.0:
        return excess
    return min(excess, _LEAST_PULL * constants.plans.load_inertia)


@compiled
def use_load_torque(constants: AloneConstants, memory: AloneMemory) -> None:
    """Let plans and hold know the load torque, and whether it holds the load."""
    plans, off, holding = memory.plans, _uncertainty(constants, memory), _least_holding(constants)
    load_torque, period, edge = plans.load_torque, constants.plans.period, constants.plans.load_dry_friction + holding
    if plans.phase != HOLD:
        return
    if off < _KNOWN * constants.plans.motor_inertia:
        share = min(period / _FOLLOW_TIME, 1.0)
        load_torque.smoothed += share * (memory.shafts.load_torque - load_torque.smoothed)
    believed, held = load_torque.smoothed, plans.held
    if abs(believed) > edge + min(off, _UNSURE * holding):
        held = 1.0
    elif abs(believed) < edge:
        held = 0.0
    if held != plans.held:
        plans.held = held
        start_holding(plans)
    least = min(LEAST_SHOWN * constants.plans.motor_inertia, _SHOWN * holding)
    set_load_torque(load_torque, believed if held != 0.0 or abs(believed) > least else 0.0, plans.load.angle)
    slow = abs(memory.ahead.load_speed) < _SLOW
    if held == 0.0 and slow and abs(memory.shafts.load_torque) < edge + off:
        _take_for_nothing(constants, memory, holding)
