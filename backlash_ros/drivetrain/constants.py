"""From the drive as validated values to the drive as the compiled functions take it."""

import math
from typing import Any, NamedTuple

import numba

from backlash_ros.drivetrain.contact import Constants, as_constants
from backlash_ros.drivetrain.effects.constants import effect_row, effects_in
from backlash_ros.drivetrain.parameters import NOMINAL_DRIVE, Drive
from backlash_ros.foundation.record import Array

_numba: Any = numba


class PlantConstants(NamedTuple):
    """The drive as the compiled functions read it; field names are the equations' symbols.

    An infinite L is an imposed current. ``contact`` is what the contact law's functions take. ``forward`` and
    ``backward`` are torque at the motor's shaft over R1 F while power flows to the load and to the motor. ``rate`` is
    the fastest of the drive's own rates, 1/s, teeth apart. ``per_*`` are reciprocals: of J_m, J_l and L, and of what
    errors are judged by: the narrowest gap as an angle at either shaft, speeds without load, the current at standstill.
    ``J_l`` is without the outer part of a load that is not rigid.
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
    contact: Constants
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
    rate: float
    per_inertia_m: float
    per_inertia_l: float
    per_inductance: float
    per_angle_m: float
    per_angle_l: float
    per_speed_m: float
    per_speed_l: float
    per_current: float
    effects: Array


def plant_constants(drive: Drive) -> PlantConstants:
    """Return the named tuple that the compiled functions take, of the drive as it is built."""
    drive = drive.as_built
    motor, gear, load, effects = drive.motor, drive.gear, drive.load, effects_in(effect_row(drive))
    outer = float(effects.J_outer)
    inertia = load.inertia - outer
    speed = motor.voltage_limit / motor.torque_constant
    stall_current = motor.voltage_limit / motor.resistance
    narrowest = gear.backlash_angle * (1.0 - gear.backlash_variation)
    rates = [motor.viscous_friction / motor.inertia, load.viscous_friction / inertia]
    if not drive.takes_current:
        rates.append(motor.resistance / motor.inductance)
        rates.append(motor.torque_constant / math.sqrt(motor.inductance * motor.inertia))
    if outer > 0.0:
        rates.append(math.sqrt(float(effects.k_outer) * (1.0 / outer + 1.0 / inertia)))
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
        contact=as_constants(*gear.contact.constants(gear.load_radius, drive.contact_mass)),
        forward=1.0 / gear.efficiency_forward,
        backward=float(gear.efficiency_backward),
        J_l=float(inertia),
        B_l=float(load.viscous_friction),
        coulomb_l=float(load.coulomb_friction),
        gravity=float(load.gravity_torque),
        gravity_offset=float(load.gravity_offset),
        current_scale=stall_current,
        speed_scale=speed,
        energy_scale=0.5 * motor.inertia * speed**2,
        rate=max(rates),
        per_inertia_m=1.0 / motor.inertia,
        per_inertia_l=1.0 / inertia,
        per_inductance=0.0 if drive.takes_current else 1.0 / motor.inductance,
        per_angle_m=gear.ratio / narrowest,
        per_angle_l=1.0 / narrowest,
        per_speed_m=1.0 / speed,
        per_speed_l=1.0 / (speed * gear.ratio),
        per_current=1.0 / stall_current,
        effects=effect_row(drive),
    )


PLANT_TYPE: Any = _numba.typeof(plant_constants(NOMINAL_DRIVE))
"""numba's type of `PlantConstants`."""
