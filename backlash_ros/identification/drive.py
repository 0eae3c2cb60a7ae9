"""A drive as a fit found it, for the controller's design and for simulation."""

import math
from dataclasses import replace

from backlash_ros.drivetrain import Drive, Motor
from backlash_ros.identification.fitting.filter import (
    COULOMB_L,
    COULOMB_M,
    LN_BRAKING,
    LN_GAIN,
    LN_INERTIA,
    LN_VISCOUS,
)
from backlash_ros.identification.fitting.fit import Fit


def _motor(drive: Drive, found: Fit) -> Motor:
    """Return the motor with gain K/R and braking K^2/R as found; its inertia, and so the unit of torque, is as told."""
    motor, gain, braking = drive.motor, float(found.parameters[LN_GAIN]), float(found.parameters[LN_BRAKING])
    constant, resistance = (gain, 0.0) if drive.takes_current else (braking - gain, braking - 2.0 * gain)
    return replace(
        motor,
        torque_constant=motor.torque_constant * math.exp(constant),
        resistance=motor.resistance * math.exp(resistance),
        coulomb_friction=float(found.parameters[COULOMB_M]) * drive.gear.ratio,
    )


def identified_drive(drive: Drive, found: Fit) -> Drive:
    """Return ``drive`` with gap, teeth, load, friction, K_m and R as found; the rotor's inertia and reduction stay.

    Raises
    ------
    ValueError
        If a value that was found is out of a drive's bounds.
    """
    x = [float(value) for value in found.parameters]
    return replace(
        drive,
        motor=_motor(drive, found),
        gear=replace(drive.gear, backlash_angle=found.gap, contact=found.contact),
        load=replace(
            drive.load,
            inertia=math.exp(x[LN_INERTIA]),
            viscous_friction=math.exp(x[LN_VISCOUS]),
            coulomb_friction=x[COULOMB_L],
        ),
    )
