"""The motor's observer: a Kalman filter on its model, and the prediction over the delay.

The estimates are for the instant of the sample. The command of the sample acts later.
"""

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.constants import Constants, MotorModel
from backlash_ros.control.laws.planned.memory import FLIGHT, HOLD, REMEMBERED, Memory, Motor, MotorState, Sent
from backlash_ros.control.laws.planned.motor_count import choose_gain
from backlash_ros.control.laws.planned.readings import check_reading, largest_error
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

FULL_FRICTION_SPEED = 0.2
"""Speed, rad/s, from which on all of the dry friction acts. Tuned on the populations."""
REST_SPEED = 0.05
"""Speed, rad/s, below which the motor rests, so that its dry friction is unknown. Tuned on the populations."""
_AT_TARGET = 0.1
"""Share of the gap within which the motor has reached its target. Tuned on the populations."""
_STICKING_FRICTION = 1.5
"""Friction, as acceleration of the motor, rad/s^2, above which a shaft stays where it stops. Tuned on the
populations."""
_ERROR = 1.0
"""By how many counts a reading may be off. Tuned on the populations."""
STUCK_SPEED = 0.05
"""Speed of the load, rad/s, below which it was stuck. Tuned on the populations."""


@compiled
def forget_friction_at_rest(constants: Constants, memory: Memory) -> None:
    """Forget the torque that friction took at rest, as a motion begins: it does not act in motion."""
    has_friction = constants.load_dry_friction + constants.motor_dry_friction > 0.0
    if has_friction and abs(memory.load.speed) < STUCK_SPEED:
        memory.motor.compensation = memory.motor.estimated.disturbance = 0.0


@compiled
def dry_friction(constants: Constants, speed: float) -> float:
    """Return the dry friction of a motor that turns, N m; less if it hardly turns."""
    return constants.motor_dry_friction * clamp(speed / FULL_FRICTION_SPEED, -1.0, 1.0)


@compiled
def momentum_at(constants: Constants, motor_speed: float, load_speed: float) -> float:
    """Return the momentum of both shafts at their speeds (rad/s), N m s."""
    return constants.motor_inertia * motor_speed + constants.load_inertia * load_speed


@compiled
def known_torque(constants: Constants, motor: MotorState, load_speed: float) -> float:
    """Return the torque of the current less the viscous friction of both shafts, N m."""
    return motor.current_torque - constants.motor_friction * motor.speed - constants.load_friction * load_speed


@compiled
def friction_sticks(constants: Constants, friction: float) -> bool:
    """Return whether a shaft with this dry friction (N m) stays where it stops."""
    return friction > _STICKING_FRICTION * constants.motor_inertia


@compiled
def _next(row: Array, motor: MotorState, command: float, torque: float) -> float:
    """Return what a state becomes: the row's factors times states and inputs."""
    free = row[0] * motor.angle + row[1] * motor.speed + row[2] * motor.current_torque + row[3] * motor.disturbance
    return float(free + (row[4] * command + row[5] * torque))


@compiled
def _advance(constants: Constants, model: MotorModel, motor: MotorState, command: float, teeth_torque: float) -> None:
    """Advance the motor by the part of a period that the model is for."""
    torque = teeth_torque + dry_friction(constants, motor.speed)
    angle = _next(model.angle, motor, command, torque)
    speed = _next(model.speed, motor, command, torque)
    current_torque = _next(model.current_torque, motor, command, torque)
    motor.angle, motor.speed, motor.current_torque = angle, speed, current_torque


@compiled
def loop_slowdown(constants: Constants, memory: Memory) -> float:
    """Return by which factor the loops are slower while the teeth carry the load, except in flights, which are short.

    They are designed for the motor alone. With a load on it that has four times its inertia or more, they would swing.
    """
    if memory.phase != FLIGHT and memory.sent.teeth_torques[0] != 0.0:
        return max(constants.load_inertia / constants.motor_inertia, 1.0)
    return 1.0


@compiled
def observe_motor(constants: Constants, memory: Memory, reading: float) -> None:
    """Take the motor's angle at the output, rad, one period after the previous one."""
    motor, estimated, sent = memory.motor, memory.motor.estimated, memory.sent
    k = int(constants.whole_periods)
    if constants.rest_of_delay > 0.0:
        _advance(constants, constants.before, estimated, sent.commands[k + 1], sent.teeth_torques[k + 1])
    _advance(constants, constants.after, estimated, sent.commands[k], sent.teeth_torques[k])
    error = reading - estimated.angle
    unexpected_motion = reading - motor.last_reading - constants.period * estimated.speed
    bound = largest_error(constants, memory, 0.0)
    correction = check_reading(motor.doubt, error, unexpected_motion, bound, constants.period)
    estimated.angle += correction.angle
    estimated.speed += correction.speed
    if correction.plausible:
        choose_gain(motor, reading, _ERROR)
        gain = constants.gains[int(motor.gain)]
        estimated.angle += gain.angle * error
        estimated.speed += gain.speed * error
        estimated.current_torque += gain.current_torque * error
        # Teeth that beat strike the motor, and the torque of a strike does not last.
        estimated.disturbance += gain.disturbance * error / (1.0 + memory.follow.beats)
    motor.last_reading = reading
    rests = memory.phase == HOLD and abs(estimated.speed) < REST_SPEED
    rests = rests and abs(memory.motor_target - estimated.angle) < _AT_TARGET * constants.gap
    # The dry friction at rest must not wind up.
    if not rests or constants.motor_dry_friction == 0.0:
        share = constants.compensation_share / (loop_slowdown(constants, memory) * (1.0 + memory.follow.beats))
        motor.compensation += share * (estimated.disturbance - motor.compensation)


@compiled
def predict_motor(constants: Constants, motor: Motor, sent: Sent) -> None:
    """Predict the motor when the next command begins to act."""
    estimated, predicted, whole = motor.estimated, motor.predicted, int(constants.whole_periods)
    predicted.angle, predicted.speed = estimated.angle, estimated.speed
    predicted.current_torque, predicted.disturbance = estimated.current_torque, estimated.disturbance
    split = constants.rest_of_delay > 0.0
    if split:
        _advance(constants, constants.before, predicted, sent.commands[whole], sent.teeth_torques[whole])
    for k in range(whole - 1, -1, -1):
        _advance(constants, constants.after, predicted, sent.commands[k], sent.teeth_torques[k])
        if split:
            _advance(constants, constants.before, predicted, sent.commands[k], sent.teeth_torques[k])


@compiled
def attribute_to_teeth(motor: Motor, sent: Sent, torque: float) -> None:
    """Take another torque (N m) for that of the teeth at rest; the disturbance is less by it, so the command stays."""
    change = torque - sent.teeth_torques[0]
    motor.estimated.disturbance -= change
    motor.compensation -= change
    for k in range(REMEMBERED):
        sent.teeth_torques[k] += change
