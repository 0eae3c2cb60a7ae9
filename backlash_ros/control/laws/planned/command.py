"""The command: the torque that the wanted motion of the motor needs, with corrections, and the voltage for it."""

from typing import NamedTuple

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.memory import REMEMBERED, Memory, Sent
from backlash_ros.control.laws.planned.motor import dry_friction, loop_slowdown
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.signals import OMEGA_M, Estimate


class Wanted(NamedTuple):
    """What the motor is to do."""

    angle: float  # rad
    speed: float  # rad/s
    torque: float  # N m, that this motion needs
    teeth_torque: float  # N m, that the teeth are to carry
    mean_speed: float  # rad/s, whose back-EMF the voltage cancels: the plan's in flight, in hold the motor's own


@compiled
def voltage_for(constants: Constants, memory: Memory, wanted: Wanted) -> float:
    """Return the voltage that makes the motor do what is wanted, V."""
    motor = memory.motor.predicted
    error = wanted.angle - motor.angle
    torque = wanted.torque + (
        dry_friction(constants, wanted.speed + constants.friction_rate * error)
        + memory.motor.compensation
        + constants.stiffness / loop_slowdown(constants, memory) * error
        + constants.damping * (wanted.speed - motor.speed)
    )
    return constants.volts_per_torque * torque + constants.volts_per_speed * wanted.mean_speed


@compiled
def remember(constants: Constants, sent: Sent, voltage: float, teeth_torque: float, estimate: Estimate) -> None:
    """Remember the command that makes a voltage, and what the teeth are to carry meanwhile, N m."""
    for k in range(REMEMBERED - 1, 0, -1):
        sent.commands[k], sent.teeth_torques[k] = sent.commands[k - 1], sent.teeth_torques[k - 1]
    sent.commands[0] = (voltage - constants.back_emf * estimate[OMEGA_M]) / constants.resistance
    sent.teeth_torques[0] = teeth_torque
