"""Follow and flight: what the motor is to do behind a setpoint that moves, and in a plan.

In both the motor goes by its own encoder, without feedback from the load.
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.two_encoder.command import Wanted
from backlash_ros.control.laws.two_encoder.constants import Constants
from backlash_ros.control.laws.two_encoder.load_torque import load_torque_at
from backlash_ros.control.laws.two_encoder.memory import Memory
from backlash_ros.control.laws.two_encoder.parking import DRY
from backlash_ros.control.laws.two_encoder.plan import evaluate
from backlash_ros.control.laws.two_encoder.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY, Setpoint

_CROSSED = 0.1
"""Share of the gap within which a flank is reached, so that the teeth carry the load. Tuned on the populations."""


@compiled
def follow_setpoint(constants: Constants, memory: Memory, setpoint: Setpoint) -> Wanted:
    """Follow a moving setpoint.

    The sign of the load's torque gives the flank; the motor crosses to it in the time of a flight's crossing.
    """
    angle, speed, acceleration = setpoint[POSITION], setpoint[VELOCITY], setpoint[ACCELERATION]
    needed = constants.load_inertia * acceleration + constants.load_friction * speed
    needed -= load_torque_at(memory.load_torque, angle)
    if speed != 0.0:
        needed += math.copysign(constants.load_dry_friction, speed)
    # A torque next to none does not change the flank.
    flank = math.copysign(1.0, needed) if abs(needed) > DRY else memory.flank
    memory.flank = flank
    end, most = flank * contact_distance(constants, needed), constants.period * constants.gap / constants.crossing_time
    step = clamp(end - memory.followed_position, -most, most)
    memory.followed_position += step
    touches = abs(end - memory.followed_position) < _CROSSED * constants.gap and needed * flank > 0.0
    carried = needed if touches else 0.0
    motor_speed = speed + (step / constants.period if carried == 0.0 else 0.0)
    torque = constants.motor_inertia * acceleration + constants.motor_friction * motor_speed + carried
    memory.target = angle
    memory.motor_target = angle + speed * constants.delay + memory.followed_position + memory.middle
    return Wanted(memory.motor_target, motor_speed, torque, carried, memory.motor.predicted.speed)


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
