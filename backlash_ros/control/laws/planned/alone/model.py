"""The model of both shafts: motor, teeth and load, in steps that are short beside the motion of the teeth.

    J_r w' = m - B_r w - T - tau_m sign w        L/R m' = -m + K_m/(n R) (V - K_m w/n)        p' = w
    J_l v' = T + tau - B_l v - tau_c sign v                                    theta_l' = v

Speeds are computed linearly implicit in the teeth, the current exactly. A shaft that dry friction
stops sticks exactly: a motor that creeps in the model, where the real one stands, would be lost in the gap.
"""

import math
from typing import NamedTuple

from backlash_ros.control.laws.planned.alone.constants import AloneConstants
from backlash_ros.control.laws.planned.alone.memory import Shafts
from backlash_ros.control.laws.planned.constants import TABLE_SIZE
from backlash_ros.control.laws.planned.memory import Sent
from backlash_ros.drivetrain.motion.rubbing import with_friction
from backlash_ros.foundation.compiled import compiled


class Teeth(NamedTuple):
    """What the teeth do."""

    torque: float  # N m, that drives the load
    stiffness: float  # N m/rad
    damping: float  # N m s/rad


class Response(NamedTuple):
    """How the speeds after a step depend on the torques in it, and what the teeth carried."""

    motor: float  # rad/s for each N m on the motor, of the motor's speed
    both: float  # the same of the load's speed; and of the motor's for each N m on the load
    load: float  # of the load's speed for each N m on the load
    teeth: Teeth


@compiled
def teeth_at(constants: AloneConstants, gap_position: float, closing: float) -> Teeth:
    """Return what the teeth do at g, rad, while g changes by ``closing``, rad/s."""
    torques, distances = constants.plans.teeth_torques, constants.plans.teeth_distances
    dampings, size = constants.teeth_dampings, abs(gap_position)
    side = 1.0 if gap_position > 0.0 else -1.0
    if size <= distances[0]:
        torque = torques[0] * (size / distances[0]) ** constants.first_power
        stiffness = torque * constants.first_power / max(size, 1e-12)
        damping = dampings[0] * torque / torques[0]
    else:
        k = 0
        while k < TABLE_SIZE - 2 and size > distances[k + 1]:
            k += 1
        share = (size - distances[k]) / (distances[k + 1] - distances[k])
        stiffness = (torques[k + 1] - torques[k]) / (distances[k + 1] - distances[k])
        torque = torques[k] + share * (torques[k + 1] - torques[k])
        damping = dampings[k] + min(share, 1.0) * (dampings[k + 1] - dampings[k])
    damped = damping * closing * side
    if damped < -torque:  # teeth do not pull
        return Teeth(0.0, 0.0, 0.0)
    if damped > torque:
        return Teeth(2.0 * side * torque, 2.0 * stiffness, 0.0)
    return Teeth(side * (torque + damped), stiffness, damping)


@compiled
def advance(constants: AloneConstants, shafts: Shafts, command: float, disturbance: float) -> Response:
    """Advance both shafts by a step under a command (V or A) and a torque against the motor that nothing explains."""
    plans, h = constants.plans, constants.step
    closing = shafts.speed - shafts.load_speed
    teeth = teeth_at(constants, shafts.angle - shafts.load_angle, closing)
    settles = 1.0 - constants.decay
    brakes = settles * constants.braking
    current_torque = constants.decay * shafts.current_torque + settles * constants.torque_per_command * command
    coupling = teeth.stiffness * h + teeth.damping
    a11 = plans.motor_inertia / h + plans.motor_friction + coupling + brakes
    a22 = plans.load_inertia / h + plans.load_friction + coupling
    explicit = teeth.torque - teeth.damping * closing
    on_motor = plans.motor_inertia / h * shafts.speed + current_torque - explicit - disturbance
    on_load = plans.load_inertia / h * shafts.load_speed + explicit + shafts.load_torque
    determinant = a11 * a22 - coupling * coupling
    solved = with_friction(
        (a11, -coupling, a22),
        (on_motor, on_load),
        (shafts.speed, shafts.load_speed),
        (plans.motor_dry_friction, plans.load_dry_friction),
    )
    speed, load_speed = solved.motor_speed, solved.load_speed
    sine, cosine = plans.expected_sine, plans.expected_cosine
    before = sine * math.sin(shafts.load_angle) + cosine * math.cos(shafts.load_angle)
    shafts.angle += h * speed
    shafts.load_angle += h * load_speed
    shafts.load_torque += sine * math.sin(shafts.load_angle) + cosine * math.cos(shafts.load_angle) - before
    shafts.current_torque = current_torque - brakes * speed
    shafts.speed, shafts.load_speed = speed, load_speed
    return Response(a22 / determinant, coupling / determinant, a11 / determinant, teeth)


@compiled
def command_at(constants: AloneConstants, sent: Sent, time: float) -> float:
    """Return the command that acts ``time`` s after the sample to which the newest one answered."""
    k = 0
    while time < constants.plans.delay - k * constants.plans.period:
        k += 1
    return float(sent.commands[k])


@compiled
def look_ahead(constants: AloneConstants, now: Shafts, ahead: Shafts, sent: Sent) -> None:
    """Predict both shafts when the next command begins to act."""
    ahead.angle, ahead.speed, ahead.current_torque = now.angle, now.speed, now.current_torque
    ahead.load_angle, ahead.load_speed, ahead.load_torque = now.load_angle, now.load_speed, now.load_torque
    for step in range(int(constants.plans.delay / constants.step + 0.5)):
        time = constants.plans.period + (step + 0.5) * constants.step
        advance(constants, ahead, command_at(constants, sent, time), 0.0)
