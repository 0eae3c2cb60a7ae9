"""Which readings of an encoder are believed: those that the drive can have reached within a period."""

from typing import NamedTuple

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.memory import HOLD, Doubt, Memory
from backlash_ros.foundation.compiled import compiled

_GAP_ERROR = 0.1
"""Share of the gap by which any reading may be off. Tuned on the populations."""
_IMPACT_ERROR = 1.5
"""Factor of the shafts' difference in speed by which a reading may be off: teeth that meet change a speed by it."""
_FLIGHT_ERROR = 0.3
"""Share of what the stall torque does in a period by which a reading may be off. Tuned on the populations."""
_HOLD_ERROR = 0.03
"""The same in hold, where torques change a speed least within a period. Tuned on the populations."""
_LEAST_MOTION = 0.05
"""Share of the error by which a shaft goes on in a period if it was moved. Tuned on the populations."""
_MOVED_READINGS = 3.0
"""Readings until a shaft that goes on is believed. Tuned on the populations."""
_LEAPT_READINGS = 11.0
"""Readings until an encoder that leapt is believed: a sample may be wrong ten times."""


class Correction(NamedTuple):
    """Whether a reading is plausible; if not, by how much the estimates change at once."""

    plausible: bool
    angle: float  # rad
    speed: float  # rad/s


@compiled
def largest_error(constants: Constants, memory: Memory, count: float) -> float:
    """Return by how much a plausible reading may be off, rad; ``count`` of the encoder, rad."""
    share = _HOLD_ERROR if memory.phase == HOLD else _FLIGHT_ERROR
    struck = _IMPACT_ERROR * abs(memory.motor.estimated.speed - memory.load.speed)
    driven = share * constants.period * constants.stall_torque / constants.motor_inertia
    return _GAP_ERROR * constants.gap + count + constants.period * (struck + driven)


@compiled
def check_reading(doubt: Doubt, error: float, unexpected_motion: float, bound: float, period: float) -> Correction:
    """Compare a reading with the expected angle, and count the implausible ones in a row.

    Parameters
    ----------
    error : reading minus expected angle, rad
    unexpected_motion : motion since the previous reading minus the expected motion, rad
    bound : largest plausible error, rad
    """
    if abs(error) <= bound:
        doubt.readings = 0.0
        return Correction(True, 0.0, 0.0)
    doubt.readings += 1.0
    if doubt.readings == 1.0:
        doubt.first_error = error
    # A shaft that was moved goes on with a part of the error each period. An encoder that leapt does not.
    readings, moved = doubt.readings, _LEAST_MOTION < unexpected_motion / error < 1.0 - _LEAST_MOTION
    if readings < (_MOVED_READINGS if moved else _LEAPT_READINGS):
        return Correction(False, 0.0, 0.0)
    doubt.readings = 0.0
    return Correction(False, error, (error - doubt.first_error) / ((readings - 1.0) * period) if moved else 0.0)
