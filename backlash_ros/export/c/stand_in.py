"""Two masses and a gap, as the example in C has them in place of the drive: its constants, with their meanings."""

import math

from backlash_ros.drivetrain import Drive

_PRESSED = 0.05
"""Share of the gap by which the torque at standstill presses the teeth in: softer than real ones, for few steps."""
_DAMPING_RATIO = 0.3
_SLOW = 0.01
"""Speed of the load, rad/s, over which dry friction changes its sign."""
_STEP = 0.1
"""Longest step, in units of the shortest time constant."""
_LEAST_GAP = 1e-4
"""Gap, rad, in place of one of 0."""

Constants = dict[str, tuple[float, str]]


def stand_in(drive: Drive, period: float, start: float, way: float) -> Constants:
    """Return the constants of the stand-in by name, each with its meaning.

    Parameters
    ----------
    period : of the samples, s
    start, way : where the load is at first, and how far it goes, rad
    """
    motor, load, n = drive.motor, drive.load, drive.gear.ratio
    gap = max(drive.gear.backlash_angle, _LEAST_GAP)
    rotor = motor.inertia / n**2
    together = rotor * load.inertia / (rotor + load.inertia)
    stiffness = drive.standstill_torque() / (_PRESSED * gap)
    damping = 2.0 * _DAMPING_RATIO * math.sqrt(stiffness * together)
    braking = 0.0 if drive.takes_current else motor.torque_constant**2 / motor.resistance
    fastest = max(
        math.sqrt(stiffness / together),
        (motor.viscous_friction + braking + motor.coulomb_friction * n / _SLOW) / motor.inertia,
        (load.viscous_friction + load.coulomb_friction / _SLOW) / load.inertia,
    )
    return {
        "SUBSTEPS": (math.ceil(period * fastest / _STEP), "steps of the simulation in a period"),
        "REDUCTION": (n, "speed of the output over that of the motor"),
        "HALF_GAP": (0.5 * gap, "rad, at the output"),
        "STIFFNESS": (stiffness, "N m/rad, of the teeth at the output"),
        "DAMPING": (damping, "N m s/rad"),
        "TAKES_CURRENT": (int(drive.takes_current), "whether the command is a current"),
        "TORQUE_CONSTANT": (motor.torque_constant, "N m/A, V s/rad"),
        "RESISTANCE": (motor.resistance, "ohm"),
        "MOTOR_INERTIA": (motor.inertia, "kg m^2"),
        "MOTOR_FRICTION": (motor.viscous_friction, "N m s/rad"),
        "MOTOR_DRY_FRICTION": (motor.coulomb_friction, "N m"),
        "LOAD_INERTIA": (load.inertia, "kg m^2"),
        "LOAD_FRICTION": (load.viscous_friction, "N m s/rad"),
        "LOAD_DRY_FRICTION": (load.coulomb_friction, "N m"),
        "WEIGHT": (load.gravity_torque, "N m, where the load's arm is level"),
        "WEIGHT_ANGLE": (load.gravity_offset, "rad, between the load and straight down at an angle of 0"),
        "SLOW": (_SLOW, "rad/s, of the load, over which dry friction changes its sign"),
        "START": (start, "rad, of the load"),
        "WAY": (way, "rad"),
    }
