"""Which changes of limits and drive a servo may take while it holds a load."""

from collections.abc import Iterable

from backlash_ros.control.limits import Limits
from backlash_ros.drivetrain import Drive

_OTHER = 3.0
"""Factor by which what a command's size depends on may change while the load moves. Tuned."""


def limits_rejection(old: Limits, new: Limits, positions: Iterable[float]) -> str:
    """Return why ``new`` limits exclude ``positions`` of the plan, rad; empty if they do not.

    A load that was found outside of the ``old`` ones, and is held there, is no reason.
    """
    reasons = (new.rejection_reason(each, each) for each in positions if not old.rejection_reason(each, each))
    return next(filter(None, reasons), "")


def drive_rejection(old: Drive, new: Drive) -> str:
    """Return why a ``new`` drive cannot be used while the load moves: a wrong unit would accelerate it."""
    factors = {
        "load.inertia must change the inertia at the output": new.effective_inertia / old.effective_inertia,
        "motor.torque_constant must change": new.motor.torque_constant / old.motor.torque_constant,
        "motor.resistance must change": new.motor.resistance / old.motor.resistance,
    }
    for what, factor in factors.items():
        if not 1.0 / _OTHER <= factor <= _OTHER:
            return f"{what} by a factor of {_OTHER:g} at most while the load moves, got {factor:.3g}"
    return ""
