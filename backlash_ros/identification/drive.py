"""A drive as a fit found it, for the controller's design and for simulation."""

import math
from dataclasses import replace

from backlash_ros.drivetrain import Drive
from backlash_ros.identification.fitting.filter import COULOMB_L, COULOMB_M, LN_INERTIA, LN_VISCOUS
from backlash_ros.identification.fitting.fit import Fit


def identified_drive(drive: Drive, found: Fit) -> Drive:
    """Return ``drive`` with gap, teeth, load and friction as found; motor and reduction stay.

    Raises
    ------
    ValueError
        If a value that was found is out of a drive's bounds.
    """
    x = [float(value) for value in found.parameters]
    return replace(
        drive,
        motor=replace(drive.motor, coulomb_friction=x[COULOMB_M] * drive.gear.ratio),
        gear=replace(drive.gear, backlash_angle=found.gap, contact=found.contact),
        load=replace(
            drive.load,
            inertia=math.exp(x[LN_INERTIA]),
            viscous_friction=math.exp(x[LN_VISCOUS]),
            coulomb_friction=x[COULOMB_L],
        ),
    )
