"""The middle of the gap: teeth that push or hold show where it is, and no teeth are beyond the gap."""

import math

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load import STANDSTILL
from backlash_ros.control.laws.planned.load_torque import SETTLE_TIME
from backlash_ros.control.laws.planned.memory import FLIGHT, HOLD, Memory
from backlash_ros.control.laws.planned.teeth import contact_distance, gap_position
from backlash_ros.foundation.compiled import compiled

_LEAST_TORQUE = 25.0
"""Torque, as acceleration of the motor, rad/s^2, from which on the teeth surely carry it, beyond the motor's dry
friction. Tuned on the populations."""
_FALL_TIME = 8e-3
"""A load torque that pulls the load through the gap within this time, s, has laid it on its flank. Tuned on the
populations."""
_FALL_SPEED = 0.5
"""Speed of the load, rad/s, up to which it lies on that flank. Tuned on the populations."""
_PUSH_TIME = 0.012
"""Time, s, in which teeth that push show where they are. Tuned on the populations."""
_WRONG = 0.6
"""Share of the gap from which on g is too far off to show where teeth that push are. Tuned on the populations."""
_BEYOND_TIME = 0.03
"""Time, s, in which teeth that cannot be where they seem show where they are. Tuned on the populations."""
_BEYOND = 0.02
"""Share of the gap by which g may be beyond it. Tuned on the populations."""
_UNKNOWN_TORQUE = 10.0
"""Torque, as acceleration of the motor, rad/s^2, that the teeth may carry beyond what is known. Tuned on the
populations."""
LARGEST_SHARE = 0.3
"""Largest share of an error that is learned in one period. Tuned on the populations."""


@compiled
def set_middle_by_contact(constants: Constants, memory: Memory, load_torque: float) -> None:
    """Assume that the load rests on the flank where a load torque (N m) holds it, if the teeth surely carry it."""
    if abs(load_torque) > constants.motor_dry_friction + _LEAST_TORQUE * constants.motor_inertia:
        distance = math.copysign(contact_distance(constants, load_torque), load_torque)
        memory.middle = memory.motor.estimated.angle - memory.load.angle + distance


@compiled
def _rests_on_a_flank(constants: Constants, memory: Memory) -> bool:
    """Return whether a load torque, if there is one, has laid the load on its flank."""
    if memory.phase != HOLD:
        return False
    load_torque, speed = memory.load_torque, abs(memory.load.speed)
    # A large load torque pulls the load through the gap at once. Both estimates of it must agree on its sign.
    sure = min(load_torque.estimated * load_torque.smoothed, load_torque.smoothed**2)
    large = 2.0 * constants.load_inertia * constants.gap / _FALL_TIME**2
    if sure > large * large and speed < _FALL_SPEED:
        return True
    return memory.hold.waiting_time > SETTLE_TIME and speed < STANDSTILL


@compiled
def learn_middle(constants: Constants, memory: Memory) -> None:
    """Learn the middle of the gap from teeth that push or hold, and from the fact that no teeth are beyond the gap."""
    if _rests_on_a_flank(constants, memory):
        set_middle_by_contact(constants, memory, memory.load_torque.smoothed)
    carried = memory.sent.teeth_torques[int(constants.whole_periods)]
    position = gap_position(memory)
    if memory.phase == FLIGHT and abs(carried) > _LEAST_TORQUE * constants.motor_inertia:
        error = position - math.copysign(contact_distance(constants, carried), carried)
        if abs(error) < _WRONG * constants.gap:
            memory.middle += min(LARGEST_SHARE, constants.period / _PUSH_TIME) * error
        return
    unknown = constants.motor_dry_friction + _UNKNOWN_TORQUE * constants.motor_inertia
    torque = abs(carried + memory.motor.estimated.disturbance) + unknown
    farthest = contact_distance(constants, torque)
    beyond = abs(position) - farthest - _BEYOND * constants.gap - memory.load.count
    if beyond > 0.0:
        memory.middle += min(LARGEST_SHARE, constants.period / _BEYOND_TIME) * math.copysign(beyond, position)
