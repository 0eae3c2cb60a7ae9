"""The motor's encoder alone: the load follows its model behind the motor that is measured.

The motor's observer corrects the motor, and finds the torque that the model leaves out. In contact that torque is the
load torque's error; in the gap it means that the load is there already.
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.alone.constants import AloneConstants
from backlash_ros.control.laws.planned.alone.memory import AloneMemory
from backlash_ros.control.laws.planned.alone.model import advance, command_at, teeth_at
from backlash_ros.control.laws.planned.alone.readings import believe
from backlash_ros.control.laws.planned.motor_count import choose_gain
from backlash_ros.control.laws.planned.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled

_TOUCHES = 0.5
"""Torque of the teeth, as acceleration of the motor, rad/s^2, above which they touch."""
_TORQUE_RATE = 10.0
"""Rate with which the load torque takes what the teeth carry beyond the model, 1/s."""
_DEPTH_RATE = 20.0
"""Rate with which the depth of teeth that press a stuck load takes it, 1/s."""
_DEEPEST = 0.25
"""Largest error of that depth, as a share of the gap."""
_LOST = 0.25
"""Momentum from nothing, as speed of the motor, rad/s, above which a motor in the gap is not in the gap."""
_LOST_TIME = 0.05
"""Time in which it fades, s."""
_ERROR = 2.0
"""By how many counts a reading may be off: without the load's readings, an error looks like a torque on the load."""
_INSIDE = 0.98
"""Share of the way to a flank within which the motor is in the gap."""
_FOUND_SHARE = 0.5
"""Share of the torque on a motor that has met the load unforeseen which the load torque takes at once."""


@compiled
def _learn_in_contact(constants: AloneConstants, memory: AloneMemory, carried: float) -> None:
    """Correct the load torque, or the depth of the teeth, while they carry a torque, N m."""
    shafts, plans = memory.shafts, constants.plans
    beyond = memory.plans.motor.estimated.disturbance
    if plans.load_dry_friction > 0.0 and shafts.load_speed == 0.0:
        # Friction hides the load torque, but not the depth of the teeth.
        stiffness = teeth_at(constants, shafts.angle - shafts.load_angle, 0.0).stiffness
        # Teeth that hardly touch yield to anything.
        most = _DEEPEST * plans.gap
        shafts.load_angle -= min(plans.period * _DEPTH_RATE, 1.0) * clamp(beyond / max(stiffness, 1.0), -most, most)
        there, dry = carried + beyond, plans.load_dry_friction
        shafts.load_torque = clamp(shafts.load_torque, -there - dry, -there + dry)
    else:
        shafts.load_torque -= min(plans.period * _TORQUE_RATE, 1.0) * beyond
    memory.lost_momentum = 0.0


@compiled
def _look_for_the_load(constants: AloneConstants, memory: AloneMemory) -> None:
    """Find the load where a motor in the gap is pushed by nothing that is known."""
    shafts, plans, pushed = memory.shafts, constants.plans, memory.plans.motor.estimated.disturbance
    edge = contact_distance(plans, 0.0)
    if abs(shafts.angle - shafts.load_angle) >= _INSIDE * edge:
        memory.lost_momentum = 0.0
        return
    memory.lost_momentum += plans.period * (pushed - memory.lost_momentum / _LOST_TIME)
    if abs(memory.lost_momentum) > _LOST * plans.motor_inertia:
        flank = math.copysign(1.0, memory.lost_momentum)
        shafts.load_angle, shafts.load_speed = shafts.angle - flank * edge, shafts.speed
        shafts.load_torque -= _FOUND_SHARE * pushed
        memory.lost_momentum = 0.0


@compiled
def observe_by_motor(constants: AloneConstants, memory: AloneMemory, reading: float) -> None:
    """Take the motor's angle at the output, rad, one period after the previous one."""
    shafts, motor, estimated = memory.shafts, memory.plans.motor, memory.plans.motor.estimated
    carried = 0.0
    for step in range(int(constants.steps)):
        command = command_at(constants, memory.plans.sent, (step + 0.5) * constants.step)
        carried += advance(constants, shafts, command, estimated.disturbance).teeth.torque / constants.steps
    memory.readings.speed = shafts.speed
    if not believe(constants, memory, memory.readings, reading, shafts.angle):
        return
    choose_gain(motor, reading, _ERROR)
    error, gain = reading - shafts.angle, constants.plans.gains[int(motor.gain)]
    shafts.angle += gain.angle * error
    shafts.speed += gain.speed * error
    shafts.current_torque += gain.current_torque * error
    estimated.disturbance += gain.disturbance * error
    if abs(carried) > _TOUCHES * constants.plans.motor_inertia:
        if shafts.load_speed != 0.0:
            # Else each correction would press the teeth, and the load would bounce off.
            shafts.load_angle += gain.angle * error
            shafts.load_speed += gain.speed * error
        _learn_in_contact(constants, memory, carried)
    else:
        _look_for_the_load(constants, memory)
