"""Take off: plan the move that was chosen, from where the drive is when the command acts, and start it."""

from backlash_ros.control.laws.planned.carry import shift
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.flight import fly
from backlash_ros.control.laws.planned.load import STANDSTILL
from backlash_ros.control.laws.planned.memory import FLIGHT, NO_MOVE, TO_FLY, TO_SHIFT, Memory
from backlash_ros.control.laws.planned.motor import forget_friction_at_rest
from backlash_ros.control.laws.planned.moves import Shafts
from backlash_ros.control.laws.planned.press import press_stuck_load
from backlash_ros.foundation.compiled import compiled


@compiled
def _plan(constants: Constants, memory: Memory) -> float:
    """Plan the move that was chosen; return the flank on which it ends."""
    load, motor = memory.load, memory.motor.predicted
    if memory.next_move == TO_SHIFT:
        return shift(constants, memory, memory.next_target, load.angle)
    position = motor.angle - memory.middle
    if memory.next_move == TO_FLY:
        speed = load.speed if abs(load.speed) > STANDSTILL else 0.0
        shafts = Shafts(load.angle + constants.delay * speed, speed, position, motor.speed)
        return fly(constants, memory, memory.target, shafts)
    shafts = Shafts(load.angle + constants.delay * load.speed, 0.0, position, motor.speed)
    return press_stuck_load(constants, memory, memory.next_target, shafts)


@compiled
def take_off(constants: Constants, memory: Memory) -> None:
    """Plan the move that was chosen, and start it."""
    memory.flank, memory.next_move = _plan(constants, memory), NO_MOVE
    memory.phase, memory.plan.time, memory.hold.time_since_landing = FLIGHT, 0.0, 0.0
    forget_friction_at_rest(constants, memory)
