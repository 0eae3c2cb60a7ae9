"""From the drive as validated values to the drive as the compiled functions take it."""

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from backlash_ros.drivetrain.parameters import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.signals import Array

_numba: Any = numba


class PlantConstants(NamedTuple):
    """The drive as the compiled functions read it; field names are the equations' symbols.

    An infinite L is an imposed current. ``contact`` is what the contact law's functions take. ``forward`` and
    ``backward`` are torque at the motor's shaft over R1 F while power flows to the load and to the motor.
    """

    R: float
    L: float
    K_m: float
    J_m: float
    B_m: float
    coulomb_m: float
    R1: float
    R2: float
    half_gap: float
    variation: float
    cycles: float
    phase: float
    contact: Array
    forward: float
    backward: float
    J_l: float
    B_l: float
    coulomb_l: float
    gravity: float
    gravity_offset: float
    current_scale: float
    speed_scale: float
    energy_scale: float


def plant_constants(drive: Drive) -> PlantConstants:
    """Return the named tuple that the compiled functions take."""
    motor, gear, load = drive.motor, drive.gear, drive.load
    speed = motor.voltage_limit / motor.torque_constant
    return PlantConstants(
        R=float(motor.resistance),
        L=math.inf if drive.takes_current else float(motor.inductance),
        K_m=float(motor.torque_constant),
        J_m=float(motor.inertia),
        B_m=float(motor.viscous_friction),
        coulomb_m=float(motor.coulomb_friction),
        R1=float(gear.motor_radius),
        R2=float(gear.load_radius),
        half_gap=0.5 * gear.backlash,
        variation=float(gear.backlash_variation),
        cycles=float(gear.backlash_cycles),
        phase=float(gear.backlash_phase),
        contact=np.array(gear.contact.constants(gear.load_radius, drive.contact_mass), dtype=np.float64),
        forward=1.0 / gear.efficiency_forward,
        backward=float(gear.efficiency_backward),
        J_l=float(load.inertia),
        B_l=float(load.viscous_friction),
        coulomb_l=float(load.coulomb_friction),
        gravity=float(load.gravity_torque),
        gravity_offset=float(load.gravity_offset),
        current_scale=motor.voltage_limit / motor.resistance,
        speed_scale=speed,
        energy_scale=0.5 * motor.inertia * speed**2,
    )


PLANT_TYPE: Any = _numba.typeof(plant_constants(NOMINAL_DRIVE))
"""numba's type of `PlantConstants`."""
