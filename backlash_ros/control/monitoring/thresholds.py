"""The thresholds beyond which a healthy drive does not go: beyond them a fault is latched."""

import math
from dataclasses import dataclass
from typing import ClassVar

from backlash_ros.control.limits import NO_LIMIT
from backlash_ros.drivetrain import Drive, Validated, quantity

_EXPECTED = 0.6
"""Share of the torque at standstill that the default takes for a load: no motor bears more for long, and a runaway
shows more."""

_LEAST_GAP = 0.1
"""Of the default faults.gap, rad: gears have less backlash, and ``gear.backlash_angle`` may be a guess."""


def mechanical_time_constant(drive: Drive) -> float:
    """Return in what time the drive without friction gets to 63 % of its speed at a constant voltage, s."""
    motor = drive.motor
    return drive.effective_inertia * motor.resistance * (drive.gear.ratio / motor.torque_constant) ** 2


def pressed(drive: Drive) -> float:
    """Return how far beyond the gap the teeth go at most, to one side, as an angle at the output, rad.

    By twice the torque at standstill, a reversal at full speed, that has worked all the way through the gap.
    """
    gap, wound = drive.gear.backlash_angle, drive.gear.wind_up(2 * drive.standstill_torque())
    return wound + math.sqrt(wound * (wound + 2 * gap))  # torque (gap + pressed) = torque/wound pressed^2/2


@dataclass(frozen=True)
class FaultThresholds(Validated):
    """Beyond which speed, torque and gap the servo latches a fault; those of a drive come from `FaultThresholds.of`."""

    section: ClassVar[str] = "faults"

    velocity: float = quantity("speed of the load that is a fault", "rad/s", above=0, at_most=NO_LIMIT)
    load_torque: float = quantity(
        "unexplained torque on the output shaft that is a fault; at most 90 % of what limits.command makes there",
        "N m",
        above=0,
        at_most=NO_LIMIT,
    )
    gap: float = quantity(
        "travel of both shafts against each other, at the output, that is a fault", "rad", above=0, at_most=NO_LIMIT
    )

    @classmethod
    def of(cls, drive: Drive) -> "FaultThresholds":
        """Return thresholds that a healthy drive stays within.

        Load: 60 % of the torque at standstill. Speed: a load torque as large as the drive's own doubles the speed
        without load and pulls the load through the gap; and a quarter more. Gap: five times the backlash that
        ``drive`` has, and the teeth `pressed` in, to either side; 0.1 rad at least.
        """
        motor, gear = drive.motor, drive.gear
        torque = drive.standstill_torque()
        fall = math.sqrt(2 * torque * gear.backlash_angle / drive.load.inertia)
        no_load = gear.ratio * motor.voltage_limit / motor.torque_constant
        return cls(
            velocity=float(f"{1.25 * (2 * no_load + fall):.3g}"),
            load_torque=float(f"{_EXPECTED * torque:.3g}"),
            gap=float(f"{max(_LEAST_GAP, 5 * gear.backlash_angle + 2 * pressed(drive)):.3g}"),
        )
