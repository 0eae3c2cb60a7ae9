"""The fault thresholds, which a healthy drive does not exceed."""

import math
from dataclasses import dataclass
from typing import ClassVar

from backlash_ros.control.limits import NO_LIMIT
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity

_EXPECTED = 0.6
"""Share of the standstill torque that the default allows for a load: no motor bears more for long, and a runaway shows
more."""

_LEAST_GAP = 0.1
"""Smallest default of faults.gap, rad: gears have less backlash, and ``gear.backlash_angle`` may be a guess."""

_GAPS = 5
"""Default of faults.gap in gaps: ``gear.backlash_angle`` may be a guess. Tuned."""

_LEAST_TRACKING = 0.05
"""Smallest default of faults.tracking, rad, for overshoot with coarse encoders and late commands."""
GAPS_AWAY = 2.0
"""The least that faults.tracking may be, in gaps: the load falls or rattles in them. Tuned."""
_DRIVEN = 1.5
"""Speed to which a knock, a load torque or an overshoot drives a healthy load, in no-load speeds, in the default of
faults.tracking. Tuned."""
FOUND = 0.025
"""Time in which the cause is found, s: that of the default torque_bandwidth."""
_SPEED_RESERVE = 1.25
"""Factor between the largest speed of a healthy load and the default of faults.velocity. Tuned."""


def mechanical_time_constant(drive: Drive) -> float:
    """Return the time in which the drive without friction reaches 63 % of its speed at a constant voltage, s."""
    motor = drive.motor
    return drive.effective_inertia * motor.resistance * (drive.gear.ratio / motor.torque_constant) ** 2


def pressed(drive: Drive) -> float:
    """Return the largest wind-up of the teeth beyond the gap, to one side, as an angle at the output, rad.

    It is caused by twice the standstill torque, a reversal at full speed, that has acted across the whole gap.
    """
    gap, wound = drive.gear.backlash_angle, drive.gear.wind_up(2 * drive.standstill_torque())
    return wound + math.sqrt(wound * (wound + 2 * gap))  # torque (gap + pressed) = torque/wound pressed^2/2


@dataclass(frozen=True)
class FaultThresholds(Validated):
    """Speed, torque and gap beyond which the servo latches a fault; `FaultThresholds.of` gives those of a drive."""

    section: ClassVar[str] = "faults"

    velocity: float = quantity("load speed above which a fault is latched", "rad/s", above=0, at_most=NO_LIMIT)
    load_torque: float = quantity(
        "unexplained torque on the output shaft that latches a fault; capped at 90 % of what limits.command makes",
        "N m",
        above=0,
        at_most=NO_LIMIT,
    )
    gap: float = quantity(
        "relative travel of the two shafts, at the output, above which a fault is latched",
        "rad",
        above=0,
        at_most=NO_LIMIT,
    )

    tracking: float = quantity(
        "growth within a second of the distance between load and reference that latches a fault, beyond what moves of "
        "the reference and load torques explain; at least twice the backlash",
        "rad",
        above=0,
        at_most=NO_LIMIT,
    )

    @classmethod
    def of(cls, drive: Drive) -> "FaultThresholds":
        """Return thresholds that a healthy drive stays within.

        Load: 60 % of the standstill torque. Speed: a load torque as large as the drive's own doubles the no-load speed
        and accelerates the load through the gap; plus a quarter. Gap: five times the backlash of ``drive`` plus the
        wind-up of the teeth (`pressed`) to either side; at least 0.1 rad. Tracking: the way at 1.5 times
        the no-load speed in the mechanical time constant and 25 ms; at least twice the backlash and 0.05 rad.
        """
        gear, no_load = drive.gear, drive.no_load_speed
        torque = drive.standstill_torque()
        fall = math.sqrt(2 * torque * gear.backlash_angle / drive.load.inertia)
        driven = _DRIVEN * no_load * (mechanical_time_constant(drive) + FOUND)
        return cls(
            velocity=float(f"{_SPEED_RESERVE * (2 * no_load + fall):.3g}"),
            load_torque=float(f"{_EXPECTED * torque:.3g}"),
            gap=float(f"{max(_LEAST_GAP, _GAPS * gear.backlash_angle + 2 * pressed(drive)):.3g}"),
            tracking=float(f"{max(_LEAST_TRACKING, GAPS_AWAY * gear.backlash_angle, driven):.3g}"),
        )
