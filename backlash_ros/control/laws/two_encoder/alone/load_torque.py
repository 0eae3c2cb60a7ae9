"""The load torque that plans and hold use: what the model has found, while the load is held, and nothing where nothing is.

A load that is believed to be pulled by next to nothing would bounce through the model's gap for ever, and the real one
would follow. So a load that no torque holds has none.
"""

import math

from backlash_ros.control.laws.two_encoder.alone.constants import AloneConstants
from backlash_ros.control.laws.two_encoder.alone.memory import LOAD_TORQUE, STATES, AloneMemory
from backlash_ros.control.laws.two_encoder.load_torque import HOLDING_EXCESS, LEAST_SHOWN, set_load_torque
from backlash_ros.control.laws.two_encoder.memory import HOLD
from backlash_ros.control.laws.two_encoder.phases import start_holding
from backlash_ros.foundation.compiled import compiled

_KNOWN = 0.05
"""Standard deviation of the load torque, N m, below which it is believed."""
_FOLLOW_TIME = 0.02
"""Time in which it is followed, s."""
_SLOW = 0.3
"""Speed of the load, rad/s, below which nothing is taken for nothing."""
_NEXT_TO_NOTHING = 0.02
"""Standard deviation of a load torque that is taken for nothing, N m."""
_BY_MOTOR = 2e-3
"""Standard deviation of the load torque as the motor alone shows it, N m."""


@compiled
def _uncertainty(constants: AloneConstants, memory: AloneMemory) -> float:
    """Return the standard deviation of the load torque, N m."""
    if constants.sees_load == 0.0:
        return _BY_MOTOR
    return math.sqrt(max(memory.covariance[LOAD_TORQUE, LOAD_TORQUE], 0.0))


@compiled
def _take_for_nothing(constants: AloneConstants, memory: AloneMemory) -> None:
    """Take a load torque that holds nothing for none, or for what friction may hide."""
    shafts, dry = memory.shafts, constants.plans.load_dry_friction
    shafts.load_torque = min(max(shafts.load_torque, -dry), dry)
    if dry == 0.0 and constants.sees_load != 0.0:
        for k in range(STATES):
            memory.covariance[LOAD_TORQUE, k] = memory.covariance[k, LOAD_TORQUE] = 0.0
        memory.covariance[LOAD_TORQUE, LOAD_TORQUE] = _NEXT_TO_NOTHING**2


@compiled
def use_load_torque(constants: AloneConstants, memory: AloneMemory) -> None:
    """Let plans and hold know the load torque, and whether it holds the load."""
    plans, off, edge = memory.plans, _uncertainty(constants, memory), constants.plans.load_dry_friction + HOLDING_EXCESS
    load_torque, period = plans.load_torque, constants.plans.period
    if plans.phase != HOLD:
        return
    if off < _KNOWN:
        share = min(period / _FOLLOW_TIME, 1.0)
        load_torque.smoothed += share * (memory.shafts.load_torque - load_torque.smoothed)
    believed, held = load_torque.smoothed, plans.held
    if abs(believed) > edge + off:
        held = 1.0
    elif abs(believed) < edge:
        held = 0.0
    if held != plans.held:
        plans.held = held
        start_holding(plans)
    set_load_torque(load_torque, believed if held != 0.0 or abs(believed) > LEAST_SHOWN else 0.0, plans.load.angle)
    slow = abs(memory.ahead.load_speed) < _SLOW
    if held == 0.0 and slow and abs(memory.shafts.load_torque) < edge + off:
        _take_for_nothing(constants, memory)
