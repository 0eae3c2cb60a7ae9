"""The law's unit of time: a second for usual drives, and shorter or longer for drives far faster or slower than these.

All times in constants and memory are in this unit, and so are speeds and accelerations. So the law does with a drive
whose times are all ten times as long what it does with the usual one, ten times as slowly.
"""

import math
from typing import TYPE_CHECKING

from backlash_ros.drivetrain import Drive

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_USUAL = 10.5e-3
"""Natural time, s, of the drive for which the tuned numbers hold: the nominal one at 250 Hz without delay."""
_FAST = 4.2e-3
"""Natural time, s, down to which the unit is a second. Tuned on the populations, where 19 of 20 are longer."""
_SLOW = 16.8e-3
"""Natural time, s, up to which the unit is a second. Tuned on the populations, where 19 of 20 are shorter."""


def _natural_time(drive: Drive, settings: "ServoSettings") -> float:
    """Return the mean of the motor's time and its loop's, s; their geometric one, so that each counts alike.

    The motor's: in which the standstill torque turns the motor alone, seen at the output, by half a radian. The loop's:
    its delay, with that of sampling.
    """
    motor = math.sqrt(drive.reflected_inertia / drive.standstill_torque())
    return math.sqrt(motor * (1.5 * settings.period + settings.loop_delay))


def time_unit(drive: Drive, settings: "ServoSettings") -> float:
    """Return the law's unit of time for a drive, s: beyond the usual range, continuous, soon in proportion."""
    time = _natural_time(drive, settings)
    if time > _SLOW:
        return min((time / _SLOW) ** 2, time / _USUAL)
    if time < _FAST:
        return max((time / _FAST) ** 2, time / _USUAL)
    return 1.0
