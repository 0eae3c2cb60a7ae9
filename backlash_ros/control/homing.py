"""Homing: the axis goes slowly to a stop, or until a switch closes, to find where its zero is.

A loop on the motor's encoder (the load's, if that is alone) follows a steady motion, with a bounded torque. Against a
stop the torque grows to its bound, and both shafts stand still. Where the load's torque alone, or friction, needs that
bound, they stand still, too. So a stop is believed only if the load came there freely: over the last stretch of its way
the torque was well below the bound. An axis that stands at once is first moved away, and comes again.

What cannot be told from a stop is an obstacle that is as sudden as one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from backlash_ros.control.experiment import Excitation, Method, NamedExperiment, Outcome, Refusal, ZeroEstimate
from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.control.motion.motor_moves import MotorLoop, Move
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.signals import THETA_L, THETA_M, Estimate, Measurement
from backlash_ros.identification.fitting.problem import motor_side

_RAMP_TIME = 0.2
"""Shortest time in which a move reaches its speed, s. Tuned."""
_TORQUE_SHARE = 0.3
"""Largest share of the torque that accelerates a move. Tuned."""
_SPEED_SHARE = 0.5
"""Largest share of the torque that the speed alone takes, as back-EMF."""
_STANDS_TIME = 0.25
"""Time for which both shafts must stand while the torque is at its bound, s. Tuned."""
_STANDS_SHARE = 0.1
"""They stand if they move by less than this share of the way that the speed makes in that time. Tuned."""
_AT_BOUND = 0.95
"""Share of the bound from which on the torque is at it."""
_FREE_SHARE = 0.7
"""Share of the bound up to which a load comes freely. Tuned."""
_STRETCH = 0.5
"""Length of the stretch before the stop over which the load must come freely, as a share of ``back_off``."""
_PRESSED = 0.1
"""Share of that stretch, next to the stop, in which the stop itself gives way. Tuned."""
_SETTLE_TIME = 0.4
"""Time for the load to come to rest after a move, s. Tuned."""
_FAULT_SHARE = 0.9
"""Share of faults.load_torque up to which a torque may be planned."""
_PATIENCE = 10.0
"""Time, s, beside twice that of the way, after which a run ends without a result."""

Stage = Callable[[float, float], None]
"""What a run does at a sample: it takes the angles of motor and load, rad at the output."""


@dataclass(frozen=True)
class HomingSettings(Validated):
    """Which way it goes, how fast, how far and how hard, and what the place is that it finds."""

    section: ClassVar[str] = "homing"

    speed: float = quantity(
        "speed with which ~/home moves the load, with the sign of the direction; 0: the axis is not homed",
        "rad/s",
        at_least=-10,
        at_most=10,
        default=0.0,
    )
    torque: float = quantity(
        "share of the standstill torque under limits.command with which it presses against the stop at most",
        "",
        above=0,
        at_most=0.8,
        default=0.2,
    )
    way: float = quantity(
        "largest distance that the load moves from its position at the start; it must be given",
        "rad",
        at_least=0,
        at_most=1e6,
        default=0.0,
    )
    position: float = quantity(
        "position of the load at the stop or the switch", "rad", at_least=-1e6, at_most=1e6, default=0.0
    )
    back_off: float = quantity(
        "distance by which the load is moved away from the stop or the switch at the end",
        "rad",
        above=0,
        at_most=100,
        default=0.1,
    )

    @property
    def direction(self) -> float:
        """Direction of the motion, 1 or -1."""
        return math.copysign(1.0, self.speed)

    def bound(self, drive: Drive, limits: Limits) -> float:
        """Return the largest torque, N m at the output."""
        return self.torque * drive.standstill_torque(limits.command)


def refusal(drive: Drive, settings: HomingSettings, limits: Limits, thresholds: FaultThresholds) -> str:
    """Return why a run cannot begin; empty if it can."""
    bound, lost = settings.bound(drive, limits), motor_side(drive).braking * abs(settings.speed)
    end = settings.position - settings.direction * settings.back_off
    if settings.speed == 0.0:
        return "homing.speed must not be 0 rad/s: it says which way to go, and how fast"
    if not settings.way > settings.back_off:
        return f"homing.way must be > homing.back_off = {settings.back_off:g} rad, got {settings.way:g}"
    if lost > _SPEED_SHARE * bound:
        return (
            f"homing.speed = {settings.speed:g} rad/s alone takes {lost:.3g} N m of the {bound:.3g} N m that "
            f"homing.torque = {settings.torque:g} allows: lower the speed, or raise the torque"
        )
    if bound > _FAULT_SHARE * thresholds.load_torque:
        return (
            f"it presses with {bound:.3g} N m, and from faults.load_torque = {thresholds.load_torque:g} N m on that is "
            "a fault: lower homing.torque, or raise faults.load_torque"
        )
    why = limits.rejection_reason(end, end)
    return why and f"it ends {settings.back_off:g} rad (homing.back_off) from homing.position, but {why}"


class Homing:
    """One run against a stop, an `Experiment`.

    Parameters
    ----------
    drive : for its motor and gear ratio
    period : of the samples, s
    limits : for the largest command
    """

    place = "stop"

    def __init__(self, drive: Drive, settings: HomingSettings, period: float, limits: Limits) -> None:
        self.outcome: Outcome | None = None
        self._drive, self._settings, self._period = drive, settings, period
        self._bound, side = settings.bound(drive, limits), motor_side(drive)
        self._speed = abs(settings.speed)
        self._acceleration = min(self._speed / _RAMP_TIME, _TORQUE_SHARE * self._bound / side.inertia)
        self._stage: Stage = self._approach
        self._moved_away = False
        self._loop: MotorLoop | None = None
        self._move = Move.rest(0.0, 0.0)
        self._time = self._passed = self._torque = 0.0
        self._start = self._begun = self._found = math.nan
        self._rows: list[tuple[float, float, float]] = []  # motor and load, rad, and torque, N m

    @property
    def progress(self) -> float:
        """How far it is, from 0 to 1, as if the place were at the end of the way."""
        if self.outcome is not None:
            return 1.0
        done = min(1.0, self._time / (self._move.length + _SETTLE_TIME))
        return 0.1 * done if self._stage == self._leave else 0.1 + 0.8 * done if math.isnan(self._found) else 0.9

    def cancel(self, reason: str) -> None:
        """End without a result, for ``reason``."""
        if self.outcome is None:
            self.outcome = Refusal(f"not homed: {reason}")

    def step(
        self, measured: Measurement, _estimate: Estimate, command: float, elapsed: float, _late: float
    ) -> Excitation:
        """Take a sample; see `Experiment`."""
        motor, load = float(self._drive.gear.ratio * measured[THETA_M]), float(measured[THETA_L])
        motor, load = (load if math.isnan(motor) else motor), (motor if math.isnan(load) else load)
        if math.isnan(motor):
            self.cancel("no encoder shows where it is")
        if self.outcome is not None:
            return Excitation()
        if self._loop is None:
            side = motor_side(self._drive)
            # It adds what the speed takes: both together stay within the bound.
            most = self._bound - side.braking * self._speed
            self._loop = MotorLoop(self._drive, self._period, most, side.gain * command)
            self._start = self._begun = load
            self._move = self._to(motor, self._settings.way)
        self._passed += elapsed
        if trouble := self._trouble(load):
            self.cancel(trouble)
            return Excitation()
        # A load that is held up must not catch up later: the move waits for it.
        if abs(self._torque) < _AT_BOUND * self._bound:
            self._time += elapsed
        wanted = self._move.at(self._time + 0.5 * self._period)
        self._torque = self._loop.torque(motor, wanted, elapsed)
        self._rows.append((motor, load, self._torque))
        self._stage(motor, load)
        return Excitation(torque=self._torque if self.outcome is None else 0.0)

    def _trouble(self, load: float) -> str:
        """Return why the run cannot go on: it takes too long, or the load goes the other way; else an empty text."""
        settings = self._settings
        if settings.direction * (load - self._start) < -2.0 * settings.back_off:
            return (
                f"the load went {abs(load - self._start):.3g} rad the other way: its own torque is larger than the "
                f"{self._bound:.3g} N m that homing.torque allows"
            )
        if self._passed > 2.0 * (settings.way + 3.0 * settings.back_off) / self._speed + _PATIENCE:
            return f"it had not ended after {self._passed:.3g} s"
        return ""

    def _to(self, motor: float, way: float) -> Move:
        """Return the move by a way in the direction, rad, from rest to rest."""
        end = motor + self._settings.direction * way
        return Move.of(motor, end, self._acceleration, self._acceleration, self._speed)

    def _next(self, stage: Stage, motor: float, load: float, way: float) -> None:
        """Begin another stage, with a move by a way in the direction, rad."""
        self._stage, self._move, self._time = stage, self._to(motor, way), 0.0
        self._begun, self._rows = load, []

    @property
    def _over(self) -> bool:
        """Whether the move is over, and the load has had time to come to rest."""
        return self._time > self._move.length + _SETTLE_TIME

    @property
    def _stands(self) -> bool:
        """Whether both shafts stand while the torque is at its bound."""
        count = math.ceil(_STANDS_TIME / self._period)
        if len(self._rows) < count or abs(self._torque) < _AT_BOUND * self._bound:
            return False
        last = np.array(self._rows[-count:])
        still = np.ptp(last[:, :2], axis=0) <= _STANDS_SHARE * self._speed * _STANDS_TIME
        pressed = math.copysign(1.0, self._move.end - self._move.start) * last[:, 2]
        return bool(np.all(still) and np.min(pressed) >= _AT_BOUND * self._bound)

    # The stages.

    def _approach(self, motor: float, load: float) -> None:
        """Go on until the place is found, or the way is over."""
        settings = self._settings
        if self._stands:
            self._stop(motor, load)
        elif self._over:
            self.cancel(
                f"there was no {self.place} within homing.way = {settings.way:g} rad: the load moved "
                f"{abs(load - self._start):.3g} rad"
            )

    def _stop(self, motor: float, load: float) -> None:
        """Judge the place where the load stands: back off from a stop, or come again, or end."""
        settings, rows = self._settings, np.array(self._rows)
        stretch = _STRETCH * settings.back_off
        if settings.direction * (load - self._begun) < stretch:
            if self._moved_away:
                self.cancel(f"the load stood still {abs(load - self._begun):.3g} rad from where it was moved to")
            else:
                self._next(self._leave, motor, load, -settings.back_off)
            return
        left = settings.direction * (load - rows[:, 1])
        before = rows[(left > _PRESSED * stretch) & (left < stretch), 2]
        taken = settings.direction * float(np.mean(before)) if before.size else self._bound
        if taken > _FREE_SHARE * self._bound:
            self.cancel(
                f"the load stood still, but it took {taken:.3g} N m of {self._bound:.3g} N m to move it there, so that "
                "friction or its own torque may have held it: raise homing.torque"
            )
            return
        self._find(motor, load)

    def _find(self, motor: float, load: float) -> None:
        self._found = float(np.median([each for _, each, _ in self._rows[-3:]]))  # one wrong reading moves no zero
        self._next(self._back_off, motor, load, -self._settings.back_off)

    def _leave(self, motor: float, load: float) -> None:
        """Move away from where the load stood at once; then come again."""
        if not (self._over or self._stands):
            return
        if abs(load - self._begun) < _STRETCH * self._settings.back_off:
            self.cancel(f"the load moves neither way with {self._bound:.3g} N m: raise homing.torque")
            return
        self._moved_away = True
        self._next(self._approach, motor, load, self._settings.way + self._settings.back_off)

    def _back_off(self, _motor: float, load: float) -> None:
        """Move away from the place that was found; the result counts once the load has left it."""
        if not (self._over or self._stands):
            return
        settings = self._settings
        if abs(load - self._begun) < _STRETCH * settings.back_off:
            self.cancel(
                f"the load did not come away from the {self.place} with {self._bound:.3g} N m: raise homing.torque"
            )
            return
        self.outcome = ZeroEstimate(
            0.0,
            Method.HOMING,
            valid=True,
            reason=f"a {self.place} at a reading of {self._found:.6g} rad, where the position is {settings.position:g}",
            zero=self._found - settings.position,
        )


class HomingBySwitch(Homing):
    """One run until a switch closes. A load that stands before that has not arrived."""

    place = "switch"
    tripped = False

    def trip(self) -> None:
        """Take it that the switch has closed."""
        self.tripped = True

    def _approach(self, motor: float, load: float) -> None:
        if self.tripped:
            self._find(motor, load)
        else:
            super()._approach(motor, load)

    def _stop(self, _motor: float, load: float) -> None:
        self.cancel(f"the load stood still after {abs(load - self._start):.3g} rad, before home_switch closed")


HOMING = {
    name: NamedExperiment(
        f"the zero of the axis, by a {run.place}",
        run,
        HomingSettings(),
        swing="way",
        law="",
        finds_zero=True,
        refusal=refusal,
    )
    for name, run in {"homing": Homing, "homing_by_switch": HomingBySwitch}.items()
}
"""What ``~/home`` runs: no experiments to choose, since they learn nothing of the drive."""
