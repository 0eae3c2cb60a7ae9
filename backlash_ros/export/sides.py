"""Both sides of a drive as simulators describe them: bodies, friction, and the limits of the motor."""

import math
from dataclasses import dataclass

from backlash_ros.drivetrain import Drive

STANDARD_GRAVITY = 9.81
"""MuJoCo's own, m/s^2."""
LONGEST_ARM = 0.1
"""Of the load's weight, m."""


@dataclass(frozen=True)
class Body:
    """A body that turns about the y axis through its origin; z is up.

    ``mass`` in kg, ``centre`` of mass in m, ``inertia`` about the centre of mass in kg m^2, the same about every axis.
    ``viscous`` friction in N m s/rad, ``coulomb`` friction in N m.
    """

    mass: float
    centre: tuple[float, float, float]
    inertia: float
    viscous: float
    coulomb: float


def rotor_of(drive: Drive) -> Body:
    """Return the motor's side at its own speed, before the gear; its mass is arbitrary."""
    motor = drive.motor
    return Body(1.0, (0.0, 0.0, 0.0), motor.inertia, motor.viscous_friction, motor.coulomb_friction)


def output_of(drive: Drive) -> Body:
    """Return the load's side; of its inertia at most half belongs to the weight on its arm."""
    load = drive.load
    if not load.gravity_torque:
        return Body(1.0, (0.0, 0.0, 0.0), load.inertia, load.viscous_friction, load.coulomb_friction)
    arm = min(LONGEST_ARM, 0.5 * load.inertia * STANDARD_GRAVITY / load.gravity_torque)
    mass = load.gravity_torque / (STANDARD_GRAVITY * arm)
    centre = -arm * math.sin(load.gravity_offset), 0.0, -arm * math.cos(load.gravity_offset)
    return Body(mass, centre, load.inertia - mass * arm**2, load.viscous_friction, load.coulomb_friction)


def torque_limits(drive: Drive) -> tuple[float, float]:
    """Return the torque of the motor at standstill, N m: at its own shaft and at the output."""
    torque = drive.standstill_torque()
    return torque * drive.gear.ratio, torque


def speed_limits(drive: Drive) -> tuple[float, float]:
    """Return the no-load speed of the motor, rad/s: at its own shaft and at the output."""
    motor = drive.motor
    constant = motor.torque_constant
    speed = constant * motor.voltage_limit / (constant**2 + motor.resistance * motor.viscous_friction)
    return speed, speed * drive.gear.ratio
