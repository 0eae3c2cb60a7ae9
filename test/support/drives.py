"""Drives that differ from another one in some parameters."""

from dataclasses import replace
from typing import Any

from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive


def varied(drive: Drive = NOMINAL_DRIVE, /, **changes: Any) -> Drive:
    """Return a drive with other parameters, each named ``part_parameter``, as in ``load_inertia``."""
    for name, value in changes.items():
        part, _, field = name.partition("_")
        drive = replace(drive, **{part: replace(getattr(drive, part), **{field: value})})
    return drive
