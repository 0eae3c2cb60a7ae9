"""Whether the drive does what its parameters say, sample by sample: limits, and what follows from going beyond them.

Pure computation. Four things are watched, each with a limit of its own: the speed of either shaft (an encoder that
jumps moves faster than any motor), how far both shafts have moved apart (an encoder that stands still or counts
backwards), the torque that the momentum of both shafts does not explain (a motor that does not follow its command, a
load that is blocked, encoders that both stand still), and the ends of the travel.

The unexplained torque U is that of `observer`, with what the motor should make as the drive's torque D. It is held
against its limit only where the momentum goes the way of the load torque, (D + U) D <= 0.05 D^2. So a wrong inertia,
resistance or torque constant, which changes by what factor the momentum follows D, is no fault at any torque.

What passes: whatever looks like a load torque within the limit, that is encoders that both stand still (the only one,
where there is one), a blocked load or a dead motor while the command stays small, and a command or encoders of the
wrong sign until it has grown; ``limits.load_torque`` lowered to what the axis has to hold finds them that much sooner.
An encoder that stands still with its shaft. The only encoder that jumps by less than ``limits.gap`` and one sample's
way at ``limits.velocity``. A gear that slips by less than 2 % of the travel. Angles that stand still while their
measured speeds are right.

With one encoder the gap is not seen, and the momentum is that of a rigid gear: a drive that hammers from flank to
flank (the load encoder alone under a current: nothing damps the motor in the gap) and whose load is a quarter of what
its inertia says may look like a fault.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from backlash_ros.control.observer import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    OMEGA_M,
    THETA_L,
    THETA_M,
    observer_memory,
    observer_step,
)
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive, Validated, quantity

Array = NDArray[np.float64]

NO_LIMIT = 1e9
"""Stands for no limit: beyond any angle, rad."""

_BANDWIDTHS = 5.0, 50.0
"""Of the two low-passes of the torque that is held against its limit, rad/s, within which the drive's own one is taken:
an impact is over before it counts, a runaway is not; counts of an encoder on a slow drive are none."""

_HELD = 0.9
"""Share of the torque at standstill that a drive can hold against a load at all; beyond it the load is blocked."""

_EXPECTED = 0.6
"""Share of it that the default takes for a load: no motor bears more for long, and a runaway shows more."""

_FOLLOWS = 0.05
"""Share of the drive's torque by which the momentum at least changes where only its parameters are wrong."""

_RATIO_ERROR = 0.02
"""Of the gear ratio: of so much of the travel the shafts may come apart without end."""

_LEAST_GAP = 0.1
"""Of the default limits.gap, rad: gears have less backlash, and ``gear.backlash_angle`` may be a guess."""


def standstill_torque(drive: Drive, command: float) -> float:
    """Return the torque on the output shaft that a command (V or A) makes at standstill, N m.

    A current is at most what the law's voltage, within its limit, drives through the winding that it plays.
    """
    motor = drive.motor
    voltage = min(command * motor.resistance if drive.takes_current else command, motor.voltage_limit)
    return motor.torque_constant * voltage / motor.resistance / drive.gear.ratio


def mechanical_time_constant(drive: Drive) -> float:
    """Return in what time the drive without friction gets to 63 % of its speed at a constant voltage, s."""
    motor = drive.motor
    return drive.effective_inertia * motor.resistance * (drive.gear.ratio / motor.torque_constant) ** 2


def wind_up(drive: Drive, torque: float) -> float:
    """Return by how much a torque on the output shaft (N m) presses the teeth in, as an angle there, rad."""
    return drive.gear.wind_up(torque)


@dataclass(frozen=True)
class Limits(Validated):
    """What the servo must not go beyond; the defaults that depend on the drive come from `Limits.of`.

    A reference outside the positions or further away than ``step`` is refused; towards an end the command fades out
    over ``soft_zone``; beyond the others the servo latches a fault.
    """

    section: ClassVar[str] = "limits"

    velocity: float = quantity("speed of the load that is a fault", "rad/s", above=0, at_most=NO_LIMIT)
    load_torque: float = quantity(
        "unexplained torque on the output shaft that is a fault; at most 90 % of what limits.command makes there",
        "N m",
        above=0,
        at_most=NO_LIMIT,
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

        Load: 60 % of the torque at standstill. Speed: a load torque as large as the drive's own doubles the speed
        without load and pulls the load through the gap; and a quarter more. Gap: five times the backlash that
        ``drive`` has, and the teeth pressed in, to either side, as by twice the torque at standstill (a reversal at
        full speed) that has worked all the way through the gap; 0.1 rad at least.
        """
        motor, gear = drive.motor, drive.gear
        torque = standstill_torque(drive, drive.command_limit)
        fall = math.sqrt(2 * torque * gear.backlash_angle / drive.load.inertia)
        no_load = gear.ratio * motor.voltage_limit / motor.torque_constant
        gap, wound = gear.backlash_angle, wind_up(drive, 2 * torque)
        pressed = wound + math.sqrt(wound * (wound + 2 * gap))  # torque (gap + pressed) = torque/wound pressed^2/2
        return cls(
            velocity=float(f"{1.25 * (2 * no_load + fall):.3g}"),
            load_torque=float(f"{_EXPECTED * torque:.3g}"),
            command=drive.command_limit,
            gap=float(f"{max(_LEAST_GAP, 5 * gap + 2 * pressed):.3g}"),
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

    limits: Limits

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self.start()

    def use(self, settings: ServoSettings, limits: Limits) -> None:
        """Use ``settings`` and ``limits`` from the next sample on."""
        if limits != getattr(self, "limits", None):
            self._lower, self._upper = -math.inf, math.inf  # who is outside of new ends may come back in
        self.limits = limits
        own = 1.0 / mechanical_time_constant(self._drive)
        self._settings = replace(settings, torque_bandwidth=min(max(own, _BANDWIDTHS[0]), _BANDWIDTHS[1]))
        self._observer = self._settings.observer(self._drive)
        self._held = min(limits.load_torque, _HELD * standstill_torque(self._drive, limits.command))

    def start(self) -> None:
        """Forget what was seen."""
        self._memory = observer_memory()
        self._makes = self._drives = self._unexplained = self._seen = 0.0
        self._angles = {"motor": math.nan, "load": math.nan}
        self._nearest, self._farthest = math.inf, -math.inf
        self._lower, self._upper = -math.inf, math.inf

    def check(self, measured: Array, command: float, elapsed: float) -> str:
        """Take one sample and return the fault that it shows, empty where it shows none.

        Parameters
        ----------
        measured : shape (5,), as for `Servo.update`
        command : in force since the sample before, V or A
        elapsed : since the sample before, s
        """
        motor, motor_speed, _, load, load_speed = measured.tolist()
        n, elapsed = self._drive.gear.ratio, max(elapsed, self._settings.period)
        before = self._angles["motor"]
        return (
            self._speed("motor", n * motor, n * motor_speed, elapsed)
            or self._speed("load", load, load_speed, elapsed)
            or self._gap(n * motor - load, abs(n * motor - before))
            or self._torque(measured, command, elapsed)
            or self._ends(n * motor if math.isnan(load) else load)
        )

    def _speed(self, side: str, angle: float, measured: float, elapsed: float) -> str:
        limit = self.limits.velocity
        moved, self._angles[side] = abs(angle - self._angles[side]), angle
        if moved > limit * elapsed + self.limits.gap:  # one count may be much in a short period; false for nan
            return (
                f"{side} encoder moved {moved:.3g} rad at the output within {elapsed:.3g} s, faster than "
                f"limits.velocity = {limit:g} rad/s"
            )
        if abs(measured) > limit:
            return f"{side} speed of {abs(measured):.3g} rad/s at the output, limits.velocity = {limit:g} rad/s"
        return ""

    def _gap(self, apart: float, moved: float) -> str:
        if math.isnan(apart):
            return ""
        drift = max(0.0, _RATIO_ERROR * moved)  # 0 for nan
        self._nearest, self._farthest = min(self._nearest + drift, apart), max(self._farthest - drift, apart)
        travel = self._farthest - self._nearest
        if travel > self.limits.gap:
            return (
                f"encoders disagree: the shafts moved {travel:.3g} rad apart, limits.gap = {self.limits.gap:g} rad; "
                "an encoder stands still, jumps or counts backwards, or the gear slips"
            )
        return ""

    def _torque(self, measured: Array, command: float, elapsed: float) -> str:
        observer, memory = self._observer, self._memory
        if elapsed > 1.5 * observer.period:  # samples are missing
            observer = replace(self._settings, period=elapsed).observer(self._drive)
        sample = measured.copy()
        sample[CURRENT] = math.nan  # what the command should make, not what the drive reports
        if math.isnan(sample[THETA_M]):  # through the rigid gear: good enough for a limit
            sample[THETA_M], sample[OMEGA_M] = sample[THETA_L] / observer.ratio, sample[OMEGA_L] / observer.ratio
        observer_step(observer, memory, sample, command)
        self._seen += elapsed
        if self._seen < 5.0 / self._settings.velocity_bandwidth + 2.0 * observer.period:
            memory[LOAD_TORQUE] = 0.0  # the first speeds have no momentum before them
        weight = observer.torque_gain * observer.period
        makes = observer.K_m * float(memory[CURRENT]) / observer.ratio
        self._makes += weight * (makes - self._makes)  # as the observer filters the torque that it finds
        self._drives += weight * (self._makes - self._drives)
        self._unexplained += weight * (float(memory[LOAD_TORQUE]) - self._unexplained)
        drives, torque = self._drives, self._unexplained
        if abs(torque) > self._held and (drives + torque) * drives <= _FOLLOWS * drives**2:
            return (
                f"unexplained torque of {abs(torque):.3g} N m, more than {self._held:.3g} N m by limits.load_torque or "
                "limits.command; the motor does not follow its command, the load is blocked, or encoders stand still "
                "or count backwards"
            )
        return ""

    def _ends(self, angle: float) -> str:
        limits = self.limits
        for beyond, side, end in (
            (self._lower - angle, "lower", limits.position_lower),
            (angle - self._upper, "upper", limits.position_upper),
        ):
            if beyond > limits.soft_zone:
                return (
                    f"load at {angle:.4g} rad, further than limits.soft_zone = {limits.soft_zone:g} rad "
                    f"beyond limits.position_{side} = {end:g} rad"
                )
        # Who starts outside may come back in, and not out again.
        self._lower = min(limits.position_lower, max(self._lower, angle))
        self._upper = max(limits.position_upper, min(self._upper, angle))
        return ""
