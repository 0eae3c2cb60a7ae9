"""A drive as a fit found it, for the controller's design and for simulation."""

import math
from dataclasses import replace

from backlash_ros.drivetrain import Drive, Motor
from backlash_ros.identification.fitting.fit import Fit


def _motor(drive: Drive, found: Fit) -> Motor:
    """Return the motor with gain K/R and braking K^2/R as found; its inertia, and so the unit of torque, is as told."""
    motor, gain, braking = drive.motor, float(found.values.ln_motor_gain), float(found.values.ln_motor_braking)
    constant, resistance = (gain, 0.0) if drive.takes_current else (braking - gain, braking - 2.0 * gain)
    return replace(
        motor,
        torque_constant=motor.torque_constant * math.exp(constant),
        resistance=motor.resistance * math.exp(resistance),
        coulomb_friction=float(found.values.motor_coulomb) * drive.gear.ratio,
    )


def identified_drive(drive: Drive, found: Fit) -> Drive:
    """Return ``drive`` with gap, teeth, load, friction, K_m and R as found; the rotor's inertia and reduction stay.

    Raises
    ------
    ValueError
        If a value that was found is out of a drive's bounds.
    """
    x = found.values
    return replace(
        drive,
        motor=_motor(drive, found),
        gear=replace(drive.gear, backlash_angle=found.gap, contact=found.contact),
        load=replace(
            drive.load,
            inertia=math.exp(x.ln_load_inertia),
            viscous_friction=math.exp(x.ln_load_viscous),
            coulomb_friction=float(x.load_coulomb),
        ),
    )
