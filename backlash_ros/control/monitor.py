"""Whether the drive does what its parameters say, sample by sample: limits, and what follows from going beyond them.

Pure computation. Four things are watched, each with a limit of its own: the speed of either shaft (an encoder that
jumps moves faster than any motor), how far both shafts have moved apart (an encoder that stands still or counts
backwards), the torque that the momentum of both shafts does not explain (a motor that does not follow its command, a
load that is blocked, encoders that both stand still), and the ends of the travel.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from backlash_ros.control.observer import (
    CURRENT,
    LOAD_TORQUE,
    observer_memory,
    observer_step,
)
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive, Validated, quantity

Array = NDArray[np.float64]

NO_LIMIT = 1e9
"""Stands for no limit: beyond any angle, rad."""

_TORQUE_BANDWIDTH = 20.0
"""Of the torque that is held against its limit, rad/s: an impact is over before it counts, a runaway is not."""


@dataclass(frozen=True)
class Limits(Validated):
    """What the servo must not go beyond; the defaults that depend on the drive come from `Limits.of`.

    A reference outside the positions or further away than ``step`` is refused; towards an end the command fades out
    over ``soft_zone``; beyond the others the servo latches a fault.
    """

    section: ClassVar[str] = "limits"

    velocity: float = quantity("speed of the load that is a fault", "rad/s", above=0, at_most=NO_LIMIT)
    load_torque: float = quantity(
        "unexplained torque on the output shaft that is a fault", "N m", above=0, at_most=NO_LIMIT
    )
    command: float = quantity("largest command; its unit is that of command_interface", "V or A", above=0, at_most=1e6)
    gap: float = quantity(
        "travel of both shafts against each other, at the output, that is a fault",
        "rad",
        above=0,
        at_most=NO_LIMIT,
    )
    position_lower: float = quantity(
        "lower end of the load's travel", "rad", at_least=-NO_LIMIT, at_most=NO_LIMIT, default=-NO_LIMIT
    )
    position_upper: float = quantity(
        "upper end of the load's travel", "rad", at_least=-NO_LIMIT, at_most=NO_LIMIT, default=NO_LIMIT
    )
    soft_zone: float = quantity(
        "way before an end over which the command towards it fades out; as far beyond it is a fault",
        "rad",
        above=0,
        at_most=10,
        default=0.05,
    )
    step: float = quantity(
        "largest change of the reference at once", "rad", above=0, at_most=NO_LIMIT, default=NO_LIMIT
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.position_lower < self.position_upper:
            raise ValueError(
                f"limits.position_lower must be < limits.position_upper = {self.position_upper:g} rad, "
                f"got {self.position_lower!r}"
            )

    @classmethod
    def of(cls, drive: Drive) -> "Limits":
        """Return limits that a healthy drive stays within.

        Half as fast again as without load, half the stall torque, five times the backlash that ``drive`` has.
        """
        motor, n = drive.motor, drive.gear.ratio
        current = motor.current_limit if drive.takes_current else motor.voltage_limit / motor.resistance
        stall = motor.torque_constant * current / n
        return cls(
            velocity=float(f"{1.5 * n * motor.voltage_limit / motor.torque_constant:.3g}"),
            load_torque=float(f"{0.5 * stall:.3g}"),
            command=drive.command_limit,
            gap=float(f"{5 * drive.gear.backlash_angle:.3g}"),
        )

    def refusal(self, reference: float, present: float) -> str:
        """Return why a ``reference`` (rad) is refused where ``present`` is the one in use; empty where it is not."""
        if not self.position_lower <= reference <= self.position_upper:
            return (
                f"reference must be within limits.position_lower = {self.position_lower:g} rad and "
                f"limits.position_upper = {self.position_upper:g} rad, got {reference:g}"
            )
        if abs(reference - present) > self.step:
            return f"reference must be within limits.step = {self.step:g} rad of {present:g} rad, got {reference:g}"
        return ""

    def clip(self, reference: float) -> float:
        """Return ``reference`` (rad) within the travel."""
        return min(max(reference, self.position_lower), self.position_upper)

    def soften(self, command: float, angle: float) -> float:
        """Return the command within ``command``, fading out towards an end; beyond it none but back."""
        upward = min(1.0, max(0.0, (self.position_upper - angle) / self.soft_zone)) * self.command
        downward = min(1.0, max(0.0, (angle - self.position_lower) / self.soft_zone)) * self.command
        return min(max(command, -downward), upward)


class DriveMonitor:
    """Watches one drive from the first sample after `start` on."""

    def __init__(self, drive: Drive, limits: Limits, settings: ServoSettings) -> None:
        self.limits = limits
        self._ratio = drive.gear.ratio
        self._period = settings.period
        self._observer = replace(settings, torque_bandwidth=_TORQUE_BANDWIDTH).observer(drive)
        self.start()

    def use(self, limits: Limits) -> None:
        """Use ``limits`` from the next sample on."""
        if limits != self.limits:
            self.limits = limits
            self._lower, self._upper = math.inf, -math.inf  # who is outside of them now may come back in

    def start(self) -> None:
        """Forget what was seen."""
        self._memory = observer_memory()
        self._angles = {"motor": math.nan, "load": math.nan}
        self._nearest, self._farthest = math.inf, -math.inf
        self._lower, self._upper = math.inf, -math.inf

    def check(self, measured: Array, command: float, elapsed: float) -> str:
        """Take one sample and return the fault that it shows, empty where it shows none.

        Parameters
        ----------
        measured : shape (5,), as for `Servo.update`
        command : in force since the sample before, V or A
        elapsed : since the sample before, s
        """
        motor, motor_speed, _, load, load_speed = measured.tolist()
        n, elapsed = self._ratio, max(elapsed, self._period)
        return (
            self._speed("motor", n * motor, n * motor_speed, elapsed)
            or self._speed("load", load, load_speed, elapsed)
            or self._gap(n * motor - load)
            or self._torque(measured, command, elapsed)
            or self._ends(n * motor if math.isnan(load) else load)
        )

    def _speed(self, side: str, angle: float, measured: float, elapsed: float) -> str:
        limit = self.limits.velocity
        moved, self._angles[side] = abs(angle - self._angles[side]), angle
        if moved / elapsed > limit:  # false for nan
            return (
                f"{side} encoder moved {moved:.3g} rad at the output within {elapsed:.3g} s, faster than "
                f"limits.velocity = {limit:g} rad/s"
            )
        if abs(measured) > limit:
            return f"{side} speed of {abs(measured):.3g} rad/s at the output, limits.velocity = {limit:g} rad/s"
        return ""

    def _gap(self, apart: float) -> str:
        if math.isnan(apart):
            return ""
        self._nearest, self._farthest = min(self._nearest, apart), max(self._farthest, apart)
        travel = self._farthest - self._nearest
        if travel > self.limits.gap:
            return (
                f"encoders disagree: the shafts moved {travel:.3g} rad apart, limits.gap = {self.limits.gap:g} rad; "
                "an encoder stands still, jumps or counts backwards, or the gear slips"
            )
        return ""

    def _torque(self, measured: Array, command: float, elapsed: float) -> str:
        if elapsed > 1.5 * self._period:
            self._memory = observer_memory()  # samples are missing: the momentum they had is not known
        by_position = measured.copy()
        by_position[CURRENT] = math.nan  # what the command should make, not what the drive reports
        observer_step(self._observer, self._memory, by_position, command)
        torque = abs(float(self._memory[LOAD_TORQUE]))
        if torque > self.limits.load_torque:
            return (
                f"unexplained torque of {torque:.3g} N m, limits.load_torque = {self.limits.load_torque:g} N m; the "
                "motor does not follow its command, the load is blocked, or encoders stand still or count backwards"
            )
        return ""

    def _ends(self, angle: float) -> str:
        if self._lower > self._upper:  # the first sample with these limits: who starts outside may come back in
            self._lower = min(self.limits.position_lower, angle)
            self._upper = max(self.limits.position_upper, angle)
        for beyond, side, end in (
            (self._lower - angle, "lower", self.limits.position_lower),
            (angle - self._upper, "upper", self.limits.position_upper),
        ):
            if beyond > self.limits.soft_zone:
                return (
                    f"load at {angle:.4g} rad, further than limits.soft_zone = {self.limits.soft_zone:g} rad "
                    f"beyond limits.position_{side} = {end:g} rad"
                )
        return ""
