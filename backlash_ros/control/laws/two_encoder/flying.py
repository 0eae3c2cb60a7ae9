"""Flight: what the motor is to do in a plan. It goes by its own encoder, without feedback from the load."""

from backlash_ros.control.laws.two_encoder.command import Wanted
from backlash_ros.control.laws.two_encoder.constants import Constants
from backlash_ros.control.laws.two_encoder.memory import Memory
from backlash_ros.control.laws.two_encoder.plan import evaluate
from backlash_ros.foundation.compiled import compiled


@compiled
def fly_on(constants: Constants, memory: Memory) -> Wanted:
    """Follow the plan for one period.

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
