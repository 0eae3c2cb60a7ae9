"""The gap around the output's turn: a probe of the gap at each of several places, and slow moves between them.

The motor goes from place to place on its own encoder, from rest to rest, and back at the end. At each place the probe
of `gap_probe` moves it across the gap. What all of them saw gives the smallest, the mean and the largest gap, and apart
from them the eccentricity: see `identification.gap_map`.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from backlash_ros.control.experiment import BacklashEstimate, Deferred, Excitation, Method, NamedExperiment, Outcome
from backlash_ros.control.experiments.gap_probe import GapProbe, GapProbeSettings
from backlash_ros.control.limits import Limits
from backlash_ros.control.motion.motor_moves import MotorLoop, Move
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.signals import THETA_L, THETA_M, Estimate, Measurement
from backlash_ros.identification.gap_map import FEWEST_PLACES, map_gaps
from backlash_ros.identification.recording import Recording

_TURN = 2.0 * math.pi
_TORQUE_SHARE = 0.02
"""Largest share of the torque that accelerates a move between places. Tuned."""
_RAMP_TIME = 0.2
"""Shortest time in which such a move reaches its speed, s. Tuned."""
_SPEED_SHARE = 0.3
"""Largest share of the no-load speed in such a move. Tuned."""
_SETTLE_TIME = 0.3
"""Time for the load to come to rest, s. Tuned."""
_MOVE_PROGRESS = 0.2
"""Share of a place's progress that counts for the move to it."""


@dataclass(frozen=True)
class GapMapSettings(Validated):
    """Places, and limits of distance, torque and time."""

    section: ClassVar[str] = "learning.gap_map"

    places: int = quantity(
        "number of places at which the gap is measured, evenly spaced",
        "",
        at_least=FEWEST_PLACES,
        at_most=64,
        whole=True,
        default=8,
    )
    turn: float = quantity(
        "range over which the places are spread, centred on the load's position at the start",
        "rad",
        at_least=0.1,
        at_most=6.3,
        default=_TURN,
    )
    swing: float = quantity(
        "largest distance that the load moves from each place", "rad", above=0, at_most=3.2, default=0.3
    )
    travel: float = quantity(
        "first travel of the motor at each place, at the output; more where the gap is wider",
        "rad",
        above=0,
        at_most=3.2,
        default=0.06,
    )
    torque: float = quantity(
        "largest share of the standstill torque under limits.command that is used", "", above=0, at_most=1, default=0.9
    )
    speed: float = quantity("speed of the load between places", "rad/s", above=0, at_most=100, default=1.0)
    time: float = quantity(
        "time after which no new place begins; the load goes back and the run ends",
        "s",
        at_least=1,
        at_most=3600,
        default=120.0,
    )

    @property
    def offsets(self) -> tuple[float, ...]:
        """The places from where the load is, rad."""
        return tuple(self.turn * ((k + 0.5) / self.places - 0.5) for k in range(self.places))

    @property
    def closed(self) -> bool:
        """Whether the last place is the neighbour of the first."""
        apart = self.turn / self.places
        return _TURN - self.turn < 0.5 * apart


class GapMapper:
    """One run of the map, an `Experiment`; parameters as those of `GapProbe`."""

    def __init__(self, drive: Drive, settings: GapMapSettings, period: float, limits: Limits) -> None:
        self.outcome: Outcome | Deferred | None = None
        self._drive, self._settings, self._period, self._limits = drive, settings, period, limits
        self._standstill = drive.standstill_torque()
        most = settings.torque * drive.standstill_torque(limits.command)
        self._loop = MotorLoop(drive, period, most)
        side = self._loop.side
        losses = side.braking + side.viscous
        self._speed = min(settings.speed, _SPEED_SHARE * most / losses if losses > 0.0 else math.inf)
        self._acceleration = min(_TORQUE_SHARE * most / side.inertia, self._speed / _RAMP_TIME)
        self._recordings: list[Recording] = []
        self._probe: GapProbe | None = None
        self._time, self._begun = 0.0, 0.0
        self._move: Move | None = None
        self._home = self._home_load = self._place = math.nan

    @property
    def progress(self) -> float:
        """Progress, from 0 to 1, as if every place took its full time."""
        if self.outcome is not None:
            return 1.0
        if self._probe is not None:
            share = _MOVE_PROGRESS + (1.0 - _MOVE_PROGRESS) * self._probe.progress
        else:
            length = self._move.length + _SETTLE_TIME if self._move else math.inf
            share = _MOVE_PROGRESS * min(1.0, (self._time - self._begun) / length)
        return (len(self._recordings) + share) / (self._settings.places + _MOVE_PROGRESS)

    def cancel(self, reason: str) -> None:
        """End without an estimate, for ``reason``."""
        if self.outcome is None:
            self.outcome = BacklashEstimate(0.0, Method.GAP_MAP, valid=False, reason=f"no map of the gap: {reason}")

    def step(
        self, measured: Measurement, estimate: Estimate, command: float, elapsed: float, late: float
    ) -> Excitation:
        """Take a sample; see `Experiment`."""
        motor, load = float(self._drive.gear.ratio * measured[THETA_M]), float(measured[THETA_L])
        if math.isnan(motor) or math.isnan(load):
            self.cancel("measuring the gap needs two encoders, and one is missing")
        if self.outcome is not None:
            return Excitation()
        if self._move is None:
            self._home, self._home_load = motor, load
            self._move = self._way_from(motor)
        else:
            self._time += elapsed
        excitation = None
        if self._probe is None:
            excitation = self._travel(self._move, motor, load, elapsed)
        if self._probe is not None:
            excitation = self._look(self._probe, measured, estimate, command, elapsed, late)
        return excitation or Excitation()

    @property
    def _last(self) -> bool:
        """Whether all places are done, so that the load only has to go back."""
        return len(self._recordings) == self._settings.places or self._time >= self._settings.time

    def _way_from(self, motor: float) -> Move:
        """Return the move from the motor's present angle, rad at the output, to the next place, or back."""
        self._begun = self._time
        self._back = self._last
        end = self._home + (0.0 if self._back else self._settings.offsets[len(self._recordings)])
        return Move.of(motor, end, self._acceleration, self._acceleration, self._speed)

    def _travel(self, move: Move, motor: float, load: float, elapsed: float) -> Excitation | None:
        """Follow the move; at its end start the probe, or end the run."""
        time, settings = self._time - self._begun, self._settings
        wanted = move.at(time + 0.5 * self._period)
        off = load - self._home_load - (wanted[0] - self._home)
        if not abs(off) <= settings.swing:
            self.cancel(
                f"between two places the load was {abs(off):.3g} rad from where the motor should have moved it, beyond "
                f"{settings.section}.swing = {settings.swing:g} rad"
            )
        elif time < move.length + _SETTLE_TIME:
            return Excitation(torque=self._loop.torque(motor, wanted, elapsed))
        elif self._back:
            self.outcome = Deferred(
                partial(_estimate_from, self._drive, tuple(self._recordings), self._standstill, settings)
            )
        else:
            probe = GapProbeSettings(swing=settings.swing, travel=settings.travel, torque=settings.torque)
            self._probe = GapProbe(self._drive, probe, self._period, self._limits, self._loop)
            self._place = load
        return None

    def _look(
        self,
        probe: GapProbe,
        measured: Measurement,
        estimate: Estimate,
        command: float,
        elapsed: float,
        late: float,
    ) -> Excitation | None:
        """Pass the sample to the probe; when it is done, go on to the next place."""
        load, swing = float(measured[THETA_L]), self._settings.swing
        if not abs(load - self._place) <= swing:
            self.cancel(
                f"the load moved {abs(load - self._place):.3g} rad from the place at {self._place:.3g} rad, beyond "
                f"{self._settings.section}.swing = {swing:g} rad"
            )
            return None
        excitation = probe.step(measured, estimate, command, elapsed, late)
        if probe.outcome is None:
            return excitation
        if not isinstance(probe.outcome, Deferred):
            self.cancel(probe.outcome.reason)
            return None
        self._recordings.append(probe.recording())
        self._probe = None
        motor = float(self._drive.gear.ratio * measured[THETA_M])
        self._move = self._way_from(motor)
        return self._travel(self._move, motor, load, elapsed)


def _estimate_from(
    drive: Drive, recordings: tuple[Recording, ...], torque: float, settings: GapMapSettings
) -> BacklashEstimate:
    """Return the estimate from the recordings: the largest gap, since the loop must be quiet everywhere."""
    found = map_gaps(drive, recordings, torque, settings.places, closed=settings.closed)
    if found.map is None:
        late = f" within {settings.section}.time = {settings.time:g} s" if len(recordings) < settings.places else ""
        reason = f"no map of the gap{late}: {found.reason}"
        return BacklashEstimate(0.0, Method.GAP_MAP, valid=False, reason=reason, fit=found.fit)
    k = found.map.largest
    return BacklashEstimate(
        found.map.gaps[k],
        Method.GAP_MAP,
        valid=True,
        reason=found.reason,
        uncertainty=found.map.uncertainties[k],
        fit=found.fit,
        map=found.map,
    )


EXPERIMENTS = {
    "gap_map": NamedExperiment(
        "backlash around the turn of the output, with both encoders",
        GapMapper,
        GapMapSettings(),
        swing="swing",
        turn="turn",
        law="",
    )
}
