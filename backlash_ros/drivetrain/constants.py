"""From the drive as validated values to the drive as the compiled functions take it."""

import math

from backlash_ros.drivetrain.contact import damping_ratio_of
from backlash_ros.drivetrain.parameters import CONTACT_LAWS, Drive, PlantConstants


def plant_constants(drive: Drive) -> PlantConstants:
    """Return the named tuple that the compiled functions take."""
    motor, gear, load = drive.motor, drive.gear, drive.load
    speed = motor.voltage_limit / motor.torque_constant
    damping = gear.tooth_damping
    if gear.contact_law == "restitution":
        damping = 2.0 * damping_ratio_of(gear.restitution) * math.sqrt(gear.tooth_stiffness * drive.contact_mass)
    return PlantConstants(
        R=float(motor.resistance),
        L=math.inf if drive.takes_current else float(motor.inductance),
        K_m=float(motor.torque_constant),
        J_m=float(motor.inertia),
        B_m=float(motor.viscous_friction),
        R1=float(gear.motor_radius),
        R2=float(gear.load_radius),
        half_gap=0.5 * gear.backlash,
        beta=float(gear.contact_stiffness),
        alpha=float(gear.contact_damping),
        exponent=int(gear.contact_exponent),
        law=CONTACT_LAWS.index(gear.contact_law),
        tooth_stiffness=float(gear.tooth_stiffness),
        tooth_damping=float(damping),
        J_l=float(load.inertia),
        B_l=float(load.viscous_friction),
        coulomb=float(load.coulomb_friction),
        current_scale=motor.voltage_limit / motor.resistance,
        speed_scale=speed,
        energy_scale=0.5 * motor.inertia * speed**2,
    )
