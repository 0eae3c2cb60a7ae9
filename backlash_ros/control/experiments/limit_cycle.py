"""Learning the backlash from the limit cycle: excitation, waiting, the end, and the backlash that follows.

The fast gains keep a limit cycle in the gap (paper, fig 4). The learner starts it with a step of the reference
there and back, since a load at rest on one flank stays quiet, and measures it over several cycles. With both encoders
the gap travel R1 theta_m - R2 theta_l gives the backlash directly. With the load encoder alone the amplitude is the
load's share of the gap, J_r/(J_r + J_l) by momentum exchange; the paper takes the amplitude itself.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from backlash_ros.control.design.limit_cycle import LimitCycle, find_limit_cycle, refine
from backlash_ros.control.experiment import BacklashEstimate, Excitation, Method, NamedExperiment
from backlash_ros.control.limits import Limits
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Estimate, Measurement

_FEWEST_SAMPLES = 8
"""Smallest number of samples in a cycle: with fewer, its turning points are not seen."""
_AHEAD = 0.02
"""Time by which the load's motion is predicted, s. Tuned."""
_SWING_SHARE = 0.5
"""Share of the swing at which the prediction ends a run: the rest is a reserve for motion that late samples do not
show."""
_REST_TIME = 0.2
"""Time for which a load that swung too far must stand still, s. Tuned."""
_LONGEST_WAIT = 3.0
"""Longest wait for that, s. Tuned."""
_FEWEST_STEPS = 4
"""Encoder steps that the load's cycle must span: at rest on one flank, the reading flickers between two neighbours."""


@dataclass(frozen=True)
class LimitCycleSettings(Validated):
    """Excitation and waiting times of the learner."""

    section: ClassVar[str] = "learning.limit_cycle"

    swing: float = quantity(
        "largest distance that the load moves from its position at the start", "rad", above=0, at_most=3.2, default=0.3
    )
    kick: float = quantity("reference step that starts the cycle", "rad", above=0, at_most=3.2, default=0.025)
    kick_time: float = quantity("time for which the kick is held", "s", above=0, at_most=10, default=0.25)
    settle_time: float = quantity("wait after the kick, before measuring", "s", at_least=0, at_most=10, default=0.5)
    measure_time: float = quantity("longest record of one attempt", "s", above=0, at_most=20, default=2.0)
    cycles: int = quantity("number of cycles that must be alike", "", at_least=3, at_most=1000, whole=True, default=10)
    attempts: int = quantity(
        "number of kicks, alternately to either side", "", at_least=1, at_most=100, whole=True, default=3
    )
    resolution: float = quantity(
        "smallest oscillation that counts as a cycle, and smallest backlash", "rad", above=0, at_most=1, default=2e-4
    )
    spread: float = quantity("largest allowed (max - min)/mean over the cycles", "", above=0, at_most=1, default=0.25)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kick < self.swing:
            raise ValueError(f"{self.section}.kick must be < swing = {self.swing:g} rad, got {self.kick!r}")


class BacklashLearner:
    """One run of the learning protocol, an `Experiment`.

    Parameters
    ----------
    drive : the drive, for its gear and its inertias
    period : of the samples, s
    """

    def __init__(self, drive: Drive, settings: LimitCycleSettings, period: float, _limits: Limits) -> None:
        self.outcome: BacklashEstimate | None = None
        self._drive = drive
        self._settings = settings
        self._period = period
        self._method = Method.GAP_TRAVEL
        self._tick = 0
        self._attempt = 1
        self._record: list[Array] = []
        self._last_refusal = ""
        self._start = self._before = math.nan
        self._away, self._rest, self._calm = "", math.nan, 0

    @property
    def progress(self) -> float:
        """Progress, from 0 to 1, as if all attempts were needed."""
        if self.outcome is not None:
            return 1.0
        settings = self._settings
        attempt = settings.kick_time + settings.settle_time + settings.measure_time
        return min(1.0, (self._attempt - 1 + self._tick * self._period / attempt) / settings.attempts)

    def cancel(self, reason: str) -> None:
        """End without an estimate, for ``reason``."""
        if self.outcome is None:
            self.outcome = BacklashEstimate(0.0, self._method, valid=False, reason=f"no valid cycle: {reason}")

    def step(
        self, measured: Measurement, estimate: Estimate, _command: float, elapsed: float, _late: float
    ) -> Excitation:
        """Take a sample; see `Experiment`."""
        load = float(measured[THETA_L])
        if math.isnan(load):
            self.cancel("the load encoder is missing, and a motor encoder alone does not see the gap")
        if self.outcome is not None:
            return Excitation()
        if math.isnan(measured[THETA_M]):
            self._method = Method.LOAD_AMPLITUDE
        settings = self._settings
        if self._runs_away(load, elapsed):
            return self._come_to_rest()
        time = self._tick * self._period
        self._tick += 1
        if time < settings.kick_time:
            return Excitation(offset=settings.kick if self._attempt % 2 else -settings.kick)
        since = time - settings.kick_time - settings.settle_time
        if since >= 0:
            self._record.append(estimate.copy())
            if self._tick % max(1, round(0.1 / self._period)) == 0:
                self._judge()
            if self.outcome is None and since >= settings.measure_time:
                self._judge()
                if self.outcome is None:
                    self._next_attempt()
        return Excitation()

    def _runs_away(self, load: float, elapsed: float) -> bool:
        """Return whether the load is, or was, about to leave the swing: late samples let a cycle grow."""
        if math.isnan(self._start):
            self._start = self._before = load
        speed, self._before = (load - self._before) / elapsed, load
        way = load - self._start
        if not self._away and abs(way + _AHEAD * speed) > _SWING_SHARE * self._settings.swing:
            self._away = (
                f"the load swung by {abs(way):.3g} rad at {abs(speed):.3g} rad/s, and would have left "
                f"{self._settings.section}.swing = {self._settings.swing:g} rad: samples or commands come too late for "
                "the fast gains, or the kick is too large"
            )
            self._tick, self._rest = 0, load
        return bool(self._away)

    def _come_to_rest(self) -> Excitation:
        """Let the over-damped law act until the load rests or a time limit is over; then end."""
        self._tick += 1
        self._calm += 1
        if abs(self._before - self._rest) > self._settings.resolution:
            self._rest, self._calm = self._before, 0
        if self._calm * self._period >= _REST_TIME or self._tick * self._period >= _LONGEST_WAIT:
            self.cancel(self._away)
        return Excitation(calm=True)

    def _judge(self) -> None:
        record = np.array(self._record)
        gear = self._drive.gear
        position, speed = record[:, THETA_L], record[:, OMEGA_L]
        moving = float(np.ptp(position)) >= self._settings.resolution
        cycle = find_limit_cycle(position, speed, self._period) if moving else None
        if cycle is None or cycle.amplitude < self._settings.resolution:
            self._last_refusal = (
                f"the load comes to rest or moves less than {self._settings.resolution:g} rad; possible causes: "
                "a load torque or friction that keeps the teeth on one flank, fast gains too low to "
                "rattle, or a drive without power"
            )
            return
        step = _encoder_step(position)
        if self._method is Method.LOAD_AMPLITUDE and cycle.amplitude < _FEWEST_STEPS * step:
            self._last_refusal = (
                f"the load moves by only {cycle.amplitude:.3g} rad, less than {_FEWEST_STEPS} steps of its encoder "
                f"({step:.3g} rad each): a load torque or friction may hold it on one flank"
            )
            return
        if self._method is Method.GAP_TRAVEL:
            gap = gear.motor_radius * record[:, THETA_M] - gear.load_radius * position
            rate = gear.motor_radius * record[:, OMEGA_M] - gear.load_radius * speed
            travel = find_limit_cycle(position, speed, self._period, refine(gap, rate, self._period))
            assert travel is not None  # the same cycles as above
            angle, seen = travel.amplitude / gear.load_radius, travel
        else:
            angle, seen = cycle.amplitude / self._drive.motor_share, cycle
        self._accept_if_periodic(angle, cycle, seen)
        # Only the latest cycles count: a bad start is forgotten, and the work per call stays bounded.
        del self._record[: -math.ceil((self._settings.cycles + 2) * cycle.period / self._period)]

    def _accept_if_periodic(self, angle: float, cycle: LimitCycle, seen: LimitCycle) -> None:
        settings = self._settings
        if cycle.period < _FEWEST_SAMPLES * self._period:
            self._last_refusal = (
                f"a cycle of {cycle.period:.3g} s has fewer than {_FEWEST_SAMPLES} samples, "
                "too few to see its amplitude"
            )
        elif cycle.cycles < settings.cycles:
            self._last_refusal = f"only {cycle.cycles} of {settings.cycles} cycles within {settings.measure_time:g} s"
        elif not angle >= settings.resolution:
            self._last_refusal = (
                f"the load swings but the gap changes by only {angle:.3g} rad, less than {settings.resolution:g} rad: "
                "is the load's angle measured behind the gear?"
            )
        elif not max(cycle.period_spread, seen.amplitude_spread) <= settings.spread:
            self._last_refusal = (
                f"the cycles differ by {100 * cycle.period_spread:.0f} % in period and "
                f"{100 * seen.amplitude_spread:.0f} % in amplitude, more than {100 * settings.spread:.0f} %"
            )
        else:
            reason = (
                f"{cycle.cycles} cycles of {cycle.period:.4g} s, {cycle.amplitude:.4g} rad peak to peak at the load"
            )
            self.outcome = BacklashEstimate(
                angle,
                self._method,
                valid=True,
                reason=reason,
                amplitude=cycle.amplitude,
                period=cycle.period,
                cycles=cycle.cycles,
            )

    def _next_attempt(self) -> None:
        if self._attempt >= self._settings.attempts:
            self.cancel(f"{self._last_refusal} (after {self._attempt} kicks of {self._settings.kick:g} rad)")
        self._attempt += 1
        self._tick = 0
        self._record.clear()


def _encoder_step(position: Array) -> float:
    """Return the smallest change between samples: the encoder's step, or next to 0 without quantization."""
    changes = np.abs(np.diff(position))
    return float(np.min(changes[changes > 0], initial=math.inf))


EXPERIMENTS = {
    "limit_cycle": NamedExperiment(
        "backlash from the limit cycle of the fast gains",
        BacklashLearner,
        LimitCycleSettings(),
        swing="swing",
    )
}
