"""Lost motion as gearbox makers state it: the output stands still, and the motor's torque goes slowly up and down.

The output is locked, braked or heavy. The torque turns back at either end of its range, so both flanks bear it, cycle
after cycle. One loop on the motor's own encoder does it: while the motor stands, against the teeth or its friction,
its torque changes at a given rate; while it turns, the torque is what keeps its speed. So the gap is crossed at that
speed, whatever the friction is, without a plan of where the teeth are; and a position of the motor that goes to and fro
would have to know where they are, or press at the rate that its loop's stiffness gives. What the curve of angle over
torque says is in `identification.locked_output.hysteresis`.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from backlash_ros.control.experiment import BacklashEstimate, Deferred, Excitation, Method, NamedExperiment, Outcome
from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.control.observer import low_pass_gain
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.signals import CURRENT, THETA_L, THETA_M, Estimate, Measurement
from backlash_ros.identification.fitting.problem import motor_side
from backlash_ros.identification.locked_output.hysteresis import measure_lost_motion
from backlash_ros.identification.locked_output.lost_motion import Curve

_FIRST_SHARE = 0.25
"""Share of the torque that comes first: it shows whether the load stands still. Tuned."""
_SHARE_BEFORE = 0.75
"""Share of the torque before the cycles. The speed that a swing gives a heavy load grows with its square, so the load
moves to and fro about its position and ends at rest."""
_SHARE_AFTER = math.sqrt(0.5)
"""Share of the torque after the cycles, for the same reason."""
_PARTING_SHARE = 0.15
"""Share of the torque below which it changes slowly, since the teeth part and meet there. Tuned."""
_SLOW_SHARE = 0.3
"""That share of its rate. Tuned."""
_FAULT_SHARE = 0.9
"""Share of a torque that is a fault up to which one may be planned. Tuned."""
_BLOCKED_SHARE = 0.9
"""Share of the torque at standstill that is a fault: beyond it the load is blocked, see `monitoring.bounds`."""
_CAP = 1.1
"""Times the torque that it goes to, which it keeps to while the motor is braked, too. Tuned."""
_SHORTEST_REST = 0.4
"""Shortest time for which it holds the motor before a run that went wrong ends, s. Tuned."""
_LONGEST_REST = 2.0
"""Longest time for that, s. Tuned."""
_BRAKING_BANDWIDTH = 200.0
"""Bandwidth of the speed that brakes the motor, rad/s. Tuned."""
_STANDING_BANDWIDTH = 60.0
"""Bandwidth of the speed that tells whether the motor stands, rad/s. Tuned."""
_UNBRAKED_SHARE = 0.3
"""Share of the speed through the gap up to which it is not braked: single counts would shake it against the teeth."""


@dataclass(frozen=True)
class HysteresisSettings(Validated):
    """How hard, how slowly and how often it presses, and how far the load may give way."""

    section: ClassVar[str] = "learning.hysteresis"

    swing: float = quantity(
        "largest distance that the load moves from its position at the start", "rad", above=0, at_most=3.2, default=0.05
    )
    movement: float = quantity(
        "motion of the load, or of the motor against its torque, beyond which the run ends without a result",
        "rad",
        above=0,
        at_most=0.5,
        default=0.005,
    )
    torque: float = quantity(
        "share of the standstill torque under limits.command that is used", "", above=0, at_most=0.8, default=0.45
    )
    cycle: float = quantity(
        "period of the torque, without the time in the gap", "s", at_least=1, at_most=60, default=3.0
    )
    cycles: int = quantity("number of cycles that are measured", "", at_least=2, at_most=20, whole=True, default=3)
    speed: float = quantity(
        "speed of the motor through the gap, at the output", "rad/s", above=0, at_most=10, default=0.1
    )
    time: float = quantity("time after which the run ends without a result", "s", at_least=5, at_most=600, default=60.0)
    rated_torque: float = quantity(
        "rated torque of the gear, at the output; 0: half the drive's standstill torque",
        "N m",
        at_least=0,
        at_most=1e6,
        default=0.0,
    )
    lost_motion_share: float = quantity(
        "the lost motion is measured between plus and minus this share of the rated torque",
        "",
        above=0,
        at_most=1,
        default=0.03,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.movement <= self.swing:
            raise ValueError(
                f"{self.section}.movement must be <= swing = {self.swing:g} rad, got {self.movement!r} rad"
            )

    def rated(self, drive: Drive) -> float:
        """Return the rated torque, N m at the output."""
        return self.rated_torque or 0.5 * drive.standstill_torque()

    def applied(self, drive: Drive, limits: Limits) -> float:
        """Return the torque that it goes up to, N m at the output."""
        return self.torque * drive.standstill_torque(limits.command)


def refusal(drive: Drive, settings: HysteresisSettings, limits: Limits, thresholds: FaultThresholds) -> str:
    """Return why the torque cannot be applied or does not show the lost motion; empty if neither is the case."""
    applied, section = settings.applied(drive, limits), settings.section
    allowed = min(_FAULT_SHARE * thresholds.load_torque, _BLOCKED_SHARE * _FAULT_SHARE * applied / settings.torque)
    if applied > allowed:
        return (
            f"it presses with {applied:.3g} N m against an output that stands, and from faults.load_torque = "
            f"{thresholds.load_torque:g} N m on that is a fault: lower {section}.torque = {settings.torque:g} to "
            f"{settings.torque * allowed / applied:.2g}, or raise faults.load_torque"
        )
    at = settings.lost_motion_share * settings.rated(drive)
    if at > 0.8 * applied:
        return (
            f"the lost motion is wanted at +-{at:.3g} N m, but the torque reaches only {applied:.3g} N m: raise "
            f"{section}.torque, or lower {section}.rated_torque or lost_motion_share"
        )
    return ""


class Hysteresis:
    """One run, an `Experiment`.

    Parameters
    ----------
    drive : for its motor, gear ratio and contact law
    period : of the samples, s
    limits : for the largest command
    """

    def __init__(self, drive: Drive, settings: HysteresisSettings, period: float, limits: Limits) -> None:
        self.outcome: Outcome | Deferred | None = None
        self._drive, self._settings, self._period = drive, settings, period
        self._side = motor_side(drive)
        self._most = settings.applied(drive, limits)
        self._rate = 4.0 * self._most / settings.cycle
        bandwidth = min(120.0, 0.2 / period)
        self._damping = 1.8 * self._side.inertia * bandwidth
        self._stiffness = 0.3 * self._side.inertia * bandwidth**2
        self._smooth, self._slowly = (
            low_pass_gain(_BRAKING_BANDWIDTH, period),
            low_pass_gain(_STANDING_BANDWIDTH, period),
        )
        shares = (_FIRST_SHARE, -_SHARE_BEFORE, *(1.0, -1.0) * settings.cycles, _SHARE_AFTER, 0.0)
        self._targets = [share * self._most for share in shares]
        self._whole = float(np.sum(np.abs(np.diff([0.0, *self._targets]))))
        self._branch, self._torque, self._done = 0, 0.0, 0.0
        self._rows: list[tuple[float, float, float, float, float]] = []
        self._time = self._speed = self._slow_speed = 0.0
        self._farthest = self._hold = math.nan
        self._trouble, self._rest = "", 0.0

    @property
    def progress(self) -> float:
        """How far it is, from 0 to 1."""
        if self.outcome is not None or self._branch >= len(self._targets):
            return 1.0
        left = abs(self._targets[self._branch] - self._torque)
        left += float(np.sum(np.abs(np.diff(self._targets[self._branch :]))))
        self._done = max(self._done, 1.0 - left / self._whole)
        return min(self._done, 1.0)

    def cancel(self, reason: str) -> None:
        """End without an estimate, for ``reason``."""
        if self.outcome is None:
            trouble = f"{self._trouble}; " if self._trouble not in {"", reason} else ""
            reason = f"no lost motion measured: {trouble}{reason}"
            self.outcome = BacklashEstimate(0.0, Method.HYSTERESIS, valid=False, reason=reason)

    def step(
        self, measured: Measurement, _estimate: Estimate, command: float, elapsed: float, _late: float
    ) -> Excitation:
        """Take a sample; see `Experiment`."""
        motor, load = float(self._drive.gear.ratio * measured[THETA_M]), float(measured[THETA_L])
        if math.isnan(motor) or math.isnan(load):
            self.cancel("the measurement needs two encoders, and one is missing")
        if self.outcome is not None:
            return Excitation()
        rows = self._rows
        if rows:
            self._time += elapsed
            speed = (motor - rows[-1][1]) / elapsed
            self._speed += self._smooth * (speed - self._speed)
            self._slow_speed += self._slowly * (self._speed - self._slow_speed)
        else:
            self._farthest = motor - load
        drive, side = self._drive, self._side
        if math.isnan(measured[CURRENT]):
            torque = side.gain * command - side.braking * self._speed
        else:
            torque = drive.motor.torque_constant * float(measured[CURRENT]) / drive.gear.ratio
        rows.append((self._time, motor, load, torque, float(self._branch)))
        if not self._trouble:
            self._trouble, self._hold = self._watch(motor, load), motor
        if self._trouble:
            return self._come_to_rest(motor, elapsed)
        self._go_on(elapsed, motor, load)
        if self.outcome is not None:
            return Excitation()
        return self._braked(self._torque, _UNBRAKED_SHARE * self._settings.speed)

    def _braked(self, torque: float, free: float = 0.0) -> Excitation:
        """Return a torque, reduced to brake the motor beyond a ``free`` speed, and clamped."""
        cap = _CAP * self._most
        braked = self._speed - min(max(self._speed, -free), free)
        return Excitation(torque=min(max(torque - self._damping * braked, -cap), cap))

    def _come_to_rest(self, motor: float, elapsed: float) -> Excitation:
        """Hold the motor where the trouble began until it rests or a time limit is over; then end."""
        self._rest += elapsed
        if self._rest > _LONGEST_REST or (
            self._rest > _SHORTEST_REST and abs(self._slow_speed) < 0.05 * self._settings.speed
        ):
            self.cancel(self._trouble)
            return Excitation()
        return self._braked(self._stiffness * (self._hold - motor))

    def _watch(self, motor: float, load: float) -> str:
        """Return why the run cannot go on: the load moves, the motor moves against its torque, or the time is over."""
        settings = self._settings
        where = f"{settings.section}.movement = {settings.movement:g} rad"
        if (way := abs(load - self._rows[0][2])) > settings.movement:
            return (
                f"the load moved by {way:.3g} rad, beyond {where}: the output must be locked, braked or heavy; "
                "gap_probe measures a load that is free"
            )
        way = self._direction * (self._farthest - (motor - load))
        if way > settings.movement:
            return (
                f"the motor moved by {way:.3g} rad against its torque, beyond {where}: check the sign of the command "
                "and that its encoder counts in the direction of the gear"
            )
        self._farthest = motor - load if way < 0.0 else self._farthest
        if self._time > settings.time:
            return (
                f"it had not ended after {settings.section}.time = {settings.time:g} s: the gap is wider, or the gear "
                "softer, than this time allows, or the command has no effect"
            )
        return ""

    @property
    def _direction(self) -> float:
        """Direction in which the torque changes, 1 or -1."""
        return math.copysign(1.0, self._targets[self._branch] - self._torque)

    def _go_on(self, elapsed: float, motor: float, load: float) -> None:
        """Change the torque: at its rate while the motor stands still, otherwise so that the motor keeps its speed."""
        wanted, way, target = self._settings.speed, self._direction, self._targets[self._branch]
        stands = min(max(1.0 - 2.0 * way * self._slow_speed / wanted, 0.0), 1.0)
        press = self._rate * (_SLOW_SHARE if abs(self._torque) < _PARTING_SHARE * self._most else 1.0)
        turn = self._stiffness * (wanted - way * self._speed)
        rate = min(max(stands * press + (1.0 - stands) * turn, -self._rate), self._rate)
        self._torque += way * rate * elapsed
        if way * (self._torque - target) < 0.0:
            return
        self._torque, self._farthest = target, motor - load
        if self._branch + 1 < len(self._targets):
            self._branch += 1
            return
        settings, columns = self._settings, np.array(self._rows).T
        curve = Curve(*(column.copy() for column in columns))
        at = settings.lost_motion_share * settings.rated(self._drive)
        self.outcome = Deferred(partial(_estimate_from, self._drive, curve, settings.speed, at))


def _estimate_from(drive: Drive, curve: Curve, speed: float, at: float) -> BacklashEstimate:
    """Return what a recording says of the gap and the lost motion at +-``at`` N m."""
    found = measure_lost_motion(drive, curve, speed, at)
    reason = found.reason if found.valid else f"no lost motion measured: {found.reason}"
    angle, uncertainty = (found.gap, found.gap_uncertainty) if found.valid else (0.0, 0.0)
    return BacklashEstimate(
        angle, Method.HYSTERESIS, valid=found.valid, reason=reason, uncertainty=uncertainty, lost_motion=found
    )


EXPERIMENTS = {
    "hysteresis": NamedExperiment(
        "backlash, lost motion and stiffness from torque on an output that stands, with both encoders",
        Hysteresis,
        HysteresisSettings(),
        swing="swing",
        law="",
        refusal=refusal,
    )
}
