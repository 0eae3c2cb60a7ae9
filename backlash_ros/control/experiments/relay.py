"""Learning the backlash with one encoder, the load's or the motor's: a relay turns the motor to and fro behind it.

The motor's torque has one of two values. It turns over where the shaft that is seen, with the way that it takes to
stop, passes a distance to either side; late as that is, both shafts keep up a cycle, in which the motor crosses the gap
time and again (the delayed relay of Ruderman, Yamada & Fujimoto, Backlash identification in two-mass systems by delayed
relay feedback, 2019). They read the gap off that cycle; here it comes from the drive's equations, fitted to all that
was recorded: see `identification.one_encoder`. The torque goes from gentle to brisk, and grows where friction holds.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from backlash_ros.control.experiment import BacklashEstimate, Deferred, Excitation, Method, NamedExperiment, Outcome
from backlash_ros.control.limits import Limits
from backlash_ros.control.motion.motor_moves import MotorLoop
from backlash_ros.control.observer import low_pass_gain
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.signals import THETA_L, THETA_M, Estimate, Measurement
from backlash_ros.identification.one_encoder.gap import measure_gap_one_sided
from backlash_ros.identification.recording import Recording, with_late_answers

_RECORDED_FROM = 0.3
"""Time from which on the run is recorded, s. Tuned."""
_HELD_UNTIL = 0.5
"""Time until which it holds the shaft, to see what torque that takes, s. Tuned."""
_HELD_AFTER = 0.2
"""Time for which it holds the shaft at the end, s. Tuned."""
_LEVELS = (0.05, 0.13, 0.3, 0.9)
"""Share of the torque in each level. The last outruns a load torque: by 0.6 light loads stayed on one flank. Tuned."""
_TURNS = (1.0, 1.5, 1.5, 1.0)
"""Turning point in each level, as a multiple of ``travel``. Tuned."""
_WIDE = 1.5
"""Least such multiple with the motor's encoder: the motor itself has to meet both flanks. Tuned."""
_SWING_SHARE = 0.4
"""Largest turning point as a share of the swing. Tuned."""
_LEVEL_TIME = 1.2
"""Time of a level, s. Tuned."""
_LOADED = 0.005
"""Share of the standstill torque above which a load torque must be outrun, by the last level. Tuned."""
_TO_OUTRUN = 1
"""Number of levels that a load without a torque does not need."""
_SPEED_BANDWIDTH = 200.0
"""Bandwidth of the speed, rad/s. Tuned."""
_CENTRING = 1200.0
"""Gain of the torque that centres the cycle, 1/s^3. Tuned."""
_PERIODS_AHEAD = 2.5
"""Periods that pass until the motor reverses."""
_STILL_SHARE = 0.02
"""A shaft stands still if it moves by less than this share of ``travel`` within a time. Tuned."""
_STILL_BEFORE = 0.02
"""That time before its second reversal, s. Tuned."""
_STILL_AFTER = 0.25
"""That time after its second reversal, s. Tuned."""
_GROWS_OF_ALL = 0.01
"""The torque on a shaft that stands still grows by at least this share of the available torque. Tuned."""
_GROWS_OF_ITSELF = 0.6
"""The torque on a shaft that stands still grows by at least this share of itself. Tuned."""


@dataclass(frozen=True)
class RelaySettings(Validated):
    """Limits of distance and torque for moving the load."""

    section: ClassVar[str] = "learning.relay"

    swing: float = quantity(
        "largest distance that the load moves from its position at the start", "rad", above=0, at_most=3.2, default=0.3
    )
    travel: float = quantity(
        "first distance, to either side, at which the relay reverses the motor; later up to 1.5 times as far",
        "rad",
        above=0,
        at_most=3.2,
        default=0.04,
    )
    torque: float = quantity(
        "largest share of the standstill torque under limits.command that is used", "", above=0, at_most=1, default=0.9
    )


class Relay:
    """One run of the relay, an `Experiment`.

    Parameters
    ----------
    drive : for its motor and gear ratio
    period : of the samples, s
    limits : for the largest command
    """

    def __init__(self, drive: Drive, settings: RelaySettings, period: float, limits: Limits) -> None:
        self.outcome: Outcome | Deferred | None = None
        self._drive, self._settings, self._period = drive, settings, period
        self._standstill = drive.standstill_torque()
        self._most = settings.torque * drive.standstill_torque(limits.command)
        self._loop = MotorLoop(drive, period, self._most)
        self._smooth = low_pass_gain(_SPEED_BANDWIDTH, period)
        self._by_motor = False
        self._rows: list[tuple[float, float, float, float]] = []
        self._held: list[float] = []
        self._time = self._speed = self._bias = self._dry = 0.0
        self._levels, self._level, self._side = len(_LEVELS), -1, 1.0
        self._home = self._mark = self._since = math.nan
        self._unseen = self._unseen_speed = 0.0
        self._turned = 0

    @property
    def progress(self) -> float:
        """Progress, from 0 to 1."""
        return 1.0 if self.outcome is not None else min(1.0, self._time / (self._end + _HELD_AFTER))

    @property
    def _end(self) -> float:
        return _HELD_UNTIL + self._levels * _LEVEL_TIME

    def cancel(self, reason: str) -> None:
        """End without an estimate, for ``reason``."""
        if self.outcome is None:
            self.outcome = BacklashEstimate(0.0, Method.RELAY, valid=False, reason=f"no gap measured: {reason}")

    def step(
        self, measured: Measurement, _estimate: Estimate, command: float, elapsed: float, late: float
    ) -> Excitation:
        """Take a sample; see `Experiment`."""
        if not self._rows:
            self._by_motor = math.isnan(measured[THETA_L])
        angle = self._drive.gear.ratio * measured[THETA_M] if self._by_motor else measured[THETA_L]
        if math.isnan(angle):
            self.cancel("the encoder that the run started with is missing")
        if self.outcome is not None:
            return Excitation()
        if self._rows:
            self._time += elapsed
            self._speed += self._smooth * ((angle - self._rows[-1][1]) / elapsed - self._speed)
        else:
            self._home = angle
        self._rows.append((self._time, angle, command, late))
        if self._time >= self._end + _HELD_AFTER:
            self.outcome = Deferred(self.work())
            return Excitation()
        if not _HELD_UNTIL <= self._time < self._end:
            torque = self._loop.torque(angle, (self._home, 0.0, 0.0), elapsed)
            if _RECORDED_FROM <= self._time < _HELD_UNTIL:
                self._held.append(torque)
            return Excitation(torque=torque)
        torque = self._relay(angle, elapsed)
        return Excitation(torque=min(max(torque, -self._most), self._most))

    def work(self) -> Callable[[], Outcome]:
        """Return the work that finds the gap in the recording."""
        return partial(_estimate_from, self._drive, self.recording(), self._standstill)

    def recording(self) -> Recording:
        """Return the recording from the time when the shaft was held."""
        time, angle, *answers = np.array(self._rows).T
        command, late = (np.append(values[1:], 0.0) for values in answers)
        first = int(np.searchsorted(time, _RECORDED_FROM))
        none, seen = np.full(time.size - first, math.nan), angle[first:]
        motor, load = (seen, none) if self._by_motor else (none, seen)
        return with_late_answers(time[first:], motor, load, command[first:], late[first:], self._period)

    def _relay(self, angle: float, elapsed: float) -> float:
        """Return the torque, N m at the output."""
        if self._level < 0:
            self._bias = float(np.mean(self._held))
            if abs(self._bias) < _LOADED * self._standstill:
                self._levels -= _TO_OUTRUN
        level = min(int((self._time - _HELD_UNTIL) / _LEVEL_TIME + 1e-9), self._levels - 1)
        if level != self._level:
            self._level = level
            self._moved(angle)
        settings, inertia, way, speed = self._settings, self._loop.side.inertia, angle - self._home, self._speed
        force = self._dry + _LEVELS[level] * self._most
        turn = max(_TURNS[level], _WIDE if self._by_motor else 0.0) * settings.travel
        stops = abs(speed) * _PERIODS_AHEAD * self._period + inertia * speed * speed / force
        ahead = self._side * (way + math.copysign(stops, speed))
        if ahead > min(turn, _SWING_SHARE * settings.swing) and self._side * speed >= 0.0:
            self._side, self._turned = -self._side, self._turned + 1
            self._moved(angle)
        elif abs(angle - self._mark) > _STILL_SHARE * settings.travel:
            self._moved(angle)
        elif self._runs_unseen(force - (self._dry if self._turned > 1 else 0.0), elapsed):
            self.cancel(
                f"nothing moved under a torque of {force:.3g} N m at the output, which may have moved the motor by "
                f"{settings.section}.swing = {settings.swing:g} rad: friction or a brake holds it, or the encoder "
                "stands still"
            )
            return 0.0
        elif self._time - self._since > (_STILL_AFTER if self._turned > 1 else _STILL_BEFORE):
            self._dry += max(_GROWS_OF_ALL * self._most, _GROWS_OF_ITSELF * self._dry)
            self._since = self._time
        self._bias -= _CENTRING * inertia * way * elapsed
        return self._bias + self._side * force

    def _moved(self, angle: float) -> None:
        self._mark, self._since = angle, self._time
        self._unseen = self._unseen_speed = 0.0

    def _runs_unseen(self, force: float, elapsed: float) -> bool:
        """Return whether this torque would have moved the motor beyond the swing since the last motion was seen.

        Until the shaft has moved both ways, the torque that overcame friction counts too.
        """
        side = self._loop.side
        braked = (side.braking + side.viscous) * self._unseen_speed
        self._unseen_speed += elapsed * (force - braked) / side.inertia
        self._unseen += elapsed * self._unseen_speed
        return self._unseen > self._settings.swing


def _estimate_from(drive: Drive, recording: Recording, torque: float) -> BacklashEstimate:
    """Return what a recording says of the gap."""
    gap = measure_gap_one_sided(drive, recording, torque)
    reason = gap.reason if gap.valid else f"no gap measured: {gap.reason}"
    return BacklashEstimate(
        gap.angle, Method.RELAY, valid=gap.valid, reason=reason, uncertainty=gap.uncertainty, fit=gap.fit
    )


EXPERIMENTS = {
    "relay": NamedExperiment(
        "backlash with one encoder, by a relay behind it",
        Relay,
        RelaySettings(),
        swing="swing",
        law="",
    )
}
