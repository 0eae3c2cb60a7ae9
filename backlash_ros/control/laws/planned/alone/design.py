"""The design of the law with one encoder alone: the constants of the plans, and the model of both shafts."""

import math
from typing import TYPE_CHECKING

import numpy as np

from backlash_ros.control.laws.planned.alone.constants import AloneConstants
from backlash_ros.control.laws.planned.constants import TABLE_SIZE, Constants
from backlash_ros.control.settings import LOAD
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array, row_of

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_LONGEST_STEP = 2.5e-4
"""Longest step of the model, s: hard teeth swing in some milliseconds."""


def alone_constants(drive: Drive, settings: "ServoSettings", plans: Constants, row: Array) -> Array:
    """Return the constants with one encoder alone; ``plans``: the constants of the plans, a view of ``row``."""
    motor, gear, n, period, unit = drive.motor, drive.gear, drive.gear.ratio, plans.period, plans.unit
    steps = 2 * math.ceil(0.5 * period / _LONGEST_STEP)
    step, radius = period / steps, gear.load_radius
    per_ampere = motor.torque_constant / n
    contact, half = gear.contact.constants(radius, drive.contact_mass), 0.5 * settings.backlash_angle * radius
    forces = [gear.contact.force(contact, half, radius * distance, 0.0) for distance in plans.teeth_distances]
    made = row_of(
        AloneConstants,
        sees_load=float(settings.encoders == LOAD),
        steps=steps,
        step=step,
        torque_per_command=per_ampere if drive.takes_current else per_ampere / motor.resistance,
        braking=0.0 if drive.takes_current else per_ampere**2 / motor.resistance / unit,
        decay=0.0 if drive.takes_current else math.exp(-motor.resistance / motor.inductance * unit * step),
        teeth_dampings=np.array([force[2] * radius**2 / unit for force in forces]).reshape(TABLE_SIZE),
        first_power=math.log(plans.teeth_torques[1] / plans.teeth_torques[0])
        / math.log(plans.teeth_distances[1] / plans.teeth_distances[0]),
    )
    made[: row.size] = row
    return made
