"""From the law's voltage to the drive's command, within the drive's limits: the last step before the motor.

Every law is written for the voltage V. A drive that takes a voltage gets it. For one that takes a current the
controller plays the winding without its inductance, i = (V - K_m omega_m)/R: gains keep their meaning, and the motor
the damping of its back-EMF. Inside the gap that takes the motor's encoder: the speed of a load through the rigid gear
damps nothing there, and the limit cycle stays.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backlash_ros.control.observer import OMEGA_M
from backlash_ros.drivetrain import Drive, compiled

Array = NDArray[np.float64]


class CommandConstants(NamedTuple):
    """The winding that the controller plays (none: back-EMF 0 V s/rad, resistance 1), and the limits of the drive."""

    back_emf: float
    resistance: float
    limit: float
    voltage_limit: float


def command_constants(drive: Drive) -> CommandConstants:
    """Return what turns the law's voltage into the command of ``drive``."""
    motor = drive.motor
    return CommandConstants(
        back_emf=float(motor.torque_constant) if drive.takes_current else 0.0,
        resistance=float(motor.resistance) if drive.takes_current else 1.0,
        limit=float(drive.command_limit),
        voltage_limit=float(motor.voltage_limit),
    )


@compiled
def within(value: float, low: float, high: float) -> float:
    """Return ``value``, or the bound that it is beyond."""
    return float(min(max(value, low), high))


@compiled
def voltage_range(constants: CommandConstants, estimate: Array) -> tuple[float, float]:
    """Return the least and the largest voltage that the drive can follow at the estimated motor speed, V."""
    induced = constants.back_emf * estimate[OMEGA_M]
    reach, limit = constants.resistance * constants.limit, constants.voltage_limit
    return within(induced - reach, -limit, limit), within(induced + reach, -limit, limit)


@compiled
def command_of(constants: CommandConstants, estimate: Array, voltage: float) -> float:
    """Return the command (V or A) for the law's voltage (V) at the estimated motor speed; its limit comes last."""
    command = (voltage - constants.back_emf * estimate[OMEGA_M]) / constants.resistance
    return within(command, -constants.limit, constants.limit)
