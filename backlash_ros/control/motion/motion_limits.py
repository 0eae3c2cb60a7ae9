"""The limits of profiles: those that are given, or what the drive can do with its load.

The drive reaches half of the speed at which the voltage just overcomes friction, load torque and back-EMF. There a
fifth of the torque that is left accelerates: the rest is for crossing the gap, and for what is not known. The jerk
leaves time for the teeth to change sides, and for the loop.
"""

import math

from backlash_ros.control.limits import Limits
from backlash_ros.control.motion.profile import MotionLimits
from backlash_ros.control.motion.profile_parameters import LIMITED, STEP
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive

_SPEED_SHARE = 0.5
"""Share of the largest steady speed: half of the voltage is left there."""
_TORQUE_SHARE = 0.2
"""Share of the torque left at that speed. Tuned on the populations: with more the teeth are hit harder."""
_LEAST_SHARE = 0.05
"""Share of the standstill torque that counts as left where the load needs more: such a drive hardly moves."""
_FAULT_SHARE = 0.8
"""Largest share of faults.velocity."""
_CROSSINGS = 8.0
"""Crossings of the gap, by half the standstill torque, in which the acceleration turns round. Tuned on the
populations."""
_PERIODS = 12.0
"""Periods in which it does, in addition to the delay. Tuned on the populations."""


def _lost_torque(drive: Drive, settings: ServoSettings) -> float:
    """Return the torque that dry friction and load take, as far as they are known, N m."""
    friction = drive.load.coulomb_friction + drive.motor.coulomb_friction / drive.gear.ratio
    # A weight's torque and its growth are largest a quarter of a turn apart.
    found = math.hypot(settings.expected_load_torque, settings.expected_load_torque_slope)
    return friction + max(found, abs(drive.load.gravity_torque))


def _of_drive(drive: Drive, settings: ServoSettings, limits: Limits) -> MotionLimits:
    """Return what the drive can do with its load, with a margin."""
    motor, n = drive.motor, drive.gear.ratio
    back_emf = motor.torque_constant / n
    per_volt = back_emf / motor.resistance
    volts = motor.voltage_limit if drive.takes_current else min(motor.voltage_limit, limits.command)
    standstill = drive.standstill_torque(limits.command)
    usable = max(standstill - _lost_torque(drive, settings), _LEAST_SHARE * standstill)
    lost, drag = standstill - usable, drive.effective_friction
    top = (per_volt * volts - lost) / (per_volt * back_emf + drag)
    if drag > 0.0:
        top = min(top, usable / drag)
    velocity = min(_SPEED_SHARE * top, _FAULT_SHARE * settings.thresholds_of(drive).velocity)
    left = min(standstill, per_volt * (volts - back_emf * velocity)) - lost - drag * velocity
    acceleration = _TORQUE_SHARE * left / drive.effective_inertia
    gap = settings.backlash_angle or drive.gear.backlash_angle
    crossing = 2.0 * math.sqrt(gap * drive.reflected_inertia / (0.5 * standstill))
    turning = _CROSSINGS * crossing + _PERIODS * settings.period + settings.loop_delay
    return MotionLimits(velocity, acceleration, 2.0 * acceleration / turning)


def motion_limits(drive: Drive, settings: ServoSettings, limits: Limits) -> MotionLimits | None:
    """Return the limits of the setpoint's motion to a reference; None if it leaps there."""
    given = settings.profile
    if given.mode == STEP:
        return None
    if given.mode == LIMITED:
        return MotionLimits(given.velocity, given.acceleration, given.jerk)
    able = _of_drive(drive, settings, limits)
    return MotionLimits(
        min(able.velocity, given.velocity or math.inf),
        min(able.acceleration, given.acceleration or math.inf),
        min(able.jerk, given.jerk or math.inf),
    )
