"""The law's unit of time: a second for usual drives, and less or more for drives that are far faster or slower.

Times, speeds and accelerations in constants and memory are in this unit, and so are the tuned numbers and the user's
parameters. A drive of which all times are ten times as long is moved the same way, ten times as slowly. Torques,
voltages and currents stay as they are.
"""

import math
from typing import TYPE_CHECKING

from backlash_ros.drivetrain import Drive

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_USUAL = 10.5e-3
"""Natural time, s, of the drive for which the numbers hold: the nominal one at 250 Hz without delay."""
_FAST = 4.2e-3
"""Natural time, s, down to which the unit is a second. Tuned on the populations."""
_SLOW = 16.8e-3
"""Natural time, s, up to which the unit is a second. Tuned on the populations: between both are all drives of `core`,
and 93 % of `full`."""


def natural_time(drive: Drive, settings: "ServoSettings") -> float:
    """Return the geometric mean of two times, s: of the motor and of its loop.

    The motor's: in which the standstill torque turns the motor alone, from rest, by half a radian of the output. The
    loop's: its delay, that of sampling included.
    """
    motor = math.sqrt(drive.reflected_inertia / drive.standstill_torque())
    return math.sqrt(motor * (1.5 * settings.period + settings.loop_delay))


def time_unit(drive: Drive, settings: "ServoSettings") -> float:
    """Return the law's unit of time for a drive, s: it grows without a leap, and soon in proportion."""
    time = natural_time(drive, settings)
    if time > _SLOW:
        return min((time / _SLOW) ** 2, time / _USUAL)
    if time < _FAST:
        return max((time / _FAST) ** 2, time / _USUAL)
    return 1.0
