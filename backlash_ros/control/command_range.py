"""From the law's voltage to the drive's command; the law gets the drive's voltage range before it acts.

Every law is written for the voltage V. A drive that takes a voltage gets it. For one that takes a current the
controller emulates the winding without its inductance, i = (V - K_m omega_m)/R: gains keep their meaning, and the motor
the damping of its back-EMF. Inside the gap this needs the motor's encoder: the load's speed through the rigid gear
damps nothing there, and the limit cycle stays.

Nothing changes the command after the law: the range includes supply, current limit, ``limits.command`` and the soft
zones before the ends of the travel, so that a law's memory agrees with what was applied.
"""

from backlash_ros.control.limits import Limits
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Record, row_of, view_of
from backlash_ros.foundation.signals import OMEGA_M, THETA_L, Estimate


class RangeConstants(Record):
    """The winding that the controller emulates, and what limits the command."""

    back_emf: float  # V s/rad; 0 where the command is the voltage
    resistance: float  # ohm; 1 where the command is the voltage
    limit: float  # V or A, of the command
    voltage_limit: float  # V
    lower_end: float  # rad, of the load's travel
    upper_end: float  # rad
    soft_zone: float  # rad
    feedforward: float  # V/(N m): makes 1 N m at the output shaft, at standstill


_constants_at = view_of(RangeConstants)


def range_constants(drive: Drive, limits: Limits) -> RangeConstants:
    """Return the constants that turn the law's voltage into the command of ``drive`` within ``limits``."""
    motor = drive.motor
    row = row_of(
        RangeConstants,
        back_emf=motor.torque_constant if drive.takes_current else 0.0,
        resistance=motor.resistance if drive.takes_current else 1.0,
        limit=min(drive.command_limit, limits.command),
        voltage_limit=motor.voltage_limit,
        lower_end=limits.position_lower,
        upper_end=limits.position_upper,
        soft_zone=limits.soft_zone,
        feedforward=drive.gear.ratio * motor.resistance / motor.torque_constant,
    )
    return _constants_at(row)


@compiled
def clamp(value: float, low: float, high: float) -> float:
    """Return ``value``, clamped to the bounds."""
    return float(min(max(value, low), high))


@compiled
def voltage_range(constants: RangeConstants, estimate: Estimate) -> tuple[float, float]:
    """Return the least and the largest voltage that the drive can follow at this sample, V.

    Towards an end of the travel the range fades to 0 V over the soft zone; beyond the end only the way back is allowed.
    For a drive that takes a current, 0 V is the braking current of a motor with short-circuited terminals, not 0 A, and
    any allowed current may be had up to the speed that the supply allows. If the motor is too fast for the supply to
    make any allowed current, the nearest allowed current is used.
    """
    angle = estimate[THETA_L]
    induced, reach = constants.back_emf * estimate[OMEGA_M], constants.resistance * constants.limit
    up = clamp((constants.upper_end - angle) / constants.soft_zone, 0.0, 1.0)
    down = clamp((angle - constants.lower_end) / constants.soft_zone, 0.0, 1.0)
    high = up * min(constants.voltage_limit, max(induced, 0.0) + reach)
    low = -down * min(constants.voltage_limit, max(-induced, 0.0) + reach)
    return clamp(low, induced - reach, induced + reach), clamp(high, induced - reach, induced + reach)


@compiled
def command_of(constants: RangeConstants, estimate: Estimate, voltage: float) -> float:
    """Return the command (V or A) for a voltage (V) within the range; the clamp only catches rounding."""
    command = (voltage - constants.back_emf * estimate[OMEGA_M]) / constants.resistance
    return clamp(command, -constants.limit, constants.limit)
