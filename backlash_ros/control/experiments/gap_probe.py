"""Learning the backlash with both encoders: the motor goes to and fro across the gap, whatever acts on the load.

The motor follows moves from rest to rest on its own encoder, which is stable whatever the load does, and which bounds
the load's way, too: it is never farther from the motor than half the gap. A load that is free or held by friction is
met on both flanks when the motor turns back. One that a torque holds on one flank is thrown against that torque: the
motor runs up with it, turns faster than the torque turns the load, meets the far flank, and brakes both where they
began; harder from one throw to the next, until the teeth part no farther. The gap then comes from all that was
recorded: see `identification`.
"""

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, NamedTuple

import numpy as np

from backlash_ros.control.experiment import BacklashEstimate, Deferred, Excitation, Method, NamedExperiment, Outcome
from backlash_ros.control.limits import Limits
from backlash_ros.control.motion.motor_moves import MotorLoop, Move, Throw
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.signals import THETA_L, THETA_M, Estimate, Measurement
from backlash_ros.identification.gap import measure_gap
from backlash_ros.identification.recording import Recording, with_late_answers
from backlash_ros.identification.regression import Guess, guess_of


class _Level(NamedTuple):
    """How the motor moves to and fro: all tuned."""

    speed: float  # share of the speed that the acceleration reaches over the travel
    torque: float  # share of the torque


_LEVELS = (_Level(0.25, 0.02), _Level(0.45, 0.07), _Level(0.7, 0.16))
_LEVEL_TIME = 1.0
"""Time of a level, s. Tuned."""
_HELD_BEFORE = 0.25
"""Time for which the motor is held at the start, s. Tuned."""
_HELD_AFTER = 0.2
"""Time for which the motor is held at the end, s. Tuned."""
_BACK_TORQUE = 0.02
"""Share of the torque with which the motor goes back to its start. Tuned."""
_BACK_SPEED = 0.25
"""Share of the speed that this reaches over the travel. Tuned."""
_FOLLOWS = 0.3
"""Share of the travel by which a load moves at least that has met both flanks. Tuned."""
_WIDER = 1.7
"""Factor by which the travel grows until it does. Tuned."""
_DRAGGED = 2e-3
"""Share of the standstill torque from which on a torque drags the load. Tuned."""
_DRAGGED_SHARE = 0.05
"""Share of the load torque that must be left of it beyond dry friction. Tuned."""
_THROW_TIME = 2.4
"""Time of all throws, s. Tuned."""
_SETTLE_TIME = 0.08
"""Time at rest after a throw, s. Tuned."""
_STANDS = 0.3
"""Share of the swing by which the motor swings at most before a throw, when it should stand. Tuned."""
_LIGHTEST = 0.05
"""Least inertia that a load is taken to have, as a share of the motor's. Tuned."""
_FASTER = 1.25
"""Times the load's acceleration with which the first throw reverses the motor, and a share of the torque. Tuned."""
_FASTER_TORQUE = 0.08
"""That share. Tuned."""
_RUN_UP = 0.7
"""Share of the torque left beside the load torque with which the motor runs up with the load. Tuned."""
_RUN_UP_TORQUE = 0.07
"""Least share of all torque for that. Tuned."""
_GAINS = 0.1
"""Least share of the motor's acceleration by which it gains on the load. Tuned."""
_THROW_SHARE = 0.65
"""How far the motor goes in a throw, as a share of the swing. The load goes farther than the motor is told to, by the
gap, and where both together turn late."""
_REACH = 0.85
"""How far the load may go by what is seen, as a share of the swing. Tuned."""
_THROW_SAMPLES = 2.0
"""Samples in which a throw runs up, and in which it turns, at least: the loop follows nothing shorter."""
_FARTHER = 1.15
"""The teeth parted farther than before from this multiple on; the next throw turns so much longer, too. Tuned."""
_NO_NEARER = 0.85
"""They parted as far as before from this multiple on: the far flank was met. Tuned."""
_HARDER = 1.2
"""Factor by which the next throw is harder. Tuned."""


@dataclass(frozen=True)
class GapProbeSettings(Validated):
    """Limits of distance, torque and time for moving the load."""

    section: ClassVar[str] = "learning.gap_probe"

    swing: float = quantity(
        "largest distance that the load moves from its position at the start", "rad", above=0, at_most=3.2, default=0.3
    )
    travel: float = quantity(
        "first travel of the motor, at the output; more where the gap is wider",
        "rad",
        above=0,
        at_most=3.2,
        default=0.06,
    )
    torque: float = quantity(
        "largest share of the standstill torque under limits.command that is used", "", above=0, at_most=1, default=0.9
    )
    time: float = quantity(
        "time after which the load goes back and the run ends", "s", at_least=1, at_most=60, default=8.0
    )


class GapProbe:
    """One run of the probe, an `Experiment`.

    Parameters
    ----------
    drive : for its motor and gear ratio
    period : of the samples, s
    limits : for the largest command
    loop : the loop that has moved the motor so far; a new one by default
    """

    def __init__(
        self,
        drive: Drive,
        settings: GapProbeSettings,
        period: float,
        limits: Limits,
        loop: MotorLoop | None = None,
    ) -> None:
        self.outcome: Outcome | Deferred | None = None
        self._drive, self._settings, self._period = drive, settings, period
        self._standstill = drive.standstill_torque()
        self._most = settings.torque * drive.standstill_torque(limits.command)
        self._loop = loop or MotorLoop(drive, period, self._most)
        self._rows: list[tuple[float, float, float, float, float]] = []
        self._time, self._begun = 0.0, 0.0
        self._move: Move | Throw = Move.rest(0.0, _HELD_BEFORE)
        self._moves = self._program()
        self._target = 0.0

    @property
    def progress(self) -> float:
        """Progress, from 0 to 1, as if it took its full time."""
        return 1.0 if self.outcome is not None else min(1.0, self._time / self._settings.time)

    def cancel(self, reason: str) -> None:
        """End without an estimate, for ``reason``."""
        if self.outcome is None:
            self.outcome = BacklashEstimate(0.0, Method.GAP_PROBE, valid=False, reason=f"no gap measured: {reason}")

    def step(
        self, measured: Measurement, _estimate: Estimate, command: float, elapsed: float, late: float
    ) -> Excitation:
        """Take a sample; see `Experiment`."""
        motor, load = self._drive.gear.ratio * measured[THETA_M], measured[THETA_L]
        if math.isnan(motor) or math.isnan(load):
            self.cancel("measuring the gap needs two encoders, and one is missing")
        if self.outcome is not None:
            return Excitation()
        if self._rows:
            self._time += elapsed
        else:
            self._target = motor
            self._move = next(self._moves)
        self._rows.append((self._time, motor, load, command, late))
        while self._time >= self._begun + self._move.length - 1e-9:
            self._begun += self._move.length
            try:
                self._move = next(self._moves)
            except StopIteration:
                self.outcome = Deferred(self.work())
                return Excitation()
        wanted = self._move.at(self._time - self._begun + 0.5 * self._period)
        return Excitation(torque=self._loop.torque(motor, wanted, elapsed))

    def work(self) -> Callable[[], Outcome]:
        """Return the work that computes the outcome from the recording."""
        return partial(_estimate_from, self._drive, self.recording(), self._standstill)

    def recording(self) -> Recording:
        """Return the recording so far."""
        time, motor, load, *answers = np.array(self._rows).T
        command, late = (np.append(values[1:], 0.0) for values in answers)
        return with_late_answers(time, motor, load, command, late, self._period)

    def _to(self, end: float, up: float, down: float, speed: float) -> Move:
        start, self._target = self._target, end
        return Move.of(start, end, up, down, speed)

    def _back(self, home: float) -> Move:
        gentle = _BACK_TORQUE * self._most / self._loop.side.inertia
        return self._to(home, gentle, gentle, _BACK_SPEED * math.sqrt(gentle * self._settings.travel))

    def _program(self) -> Generator[Move | Throw, None, None]:
        """Yield the moves, each when the previous one has ended."""
        home, settings, inertia = self._target, self._settings, self._loop.side.inertia
        yield Move.rest(home, _HELD_BEFORE)
        travel, level, way = min(settings.travel, settings.swing), 0, 1.0
        while level < len(_LEVELS) and self._time < settings.time:
            acceleration = _LEVELS[level].torque * self._most / inertia
            first, end = len(self._rows), min(self._time + _LEVEL_TIME, settings.time)
            while self._time < end:
                speed = _LEVELS[level].speed * math.sqrt(acceleration * travel)
                yield self._to(home + 0.5 * way * travel, acceleration, acceleration, speed)
                way = -way
            load = np.array(self._rows[first:])[:, 2]
            if np.ptp(load) < _FOLLOWS * travel < _FOLLOWS * settings.swing:
                travel = min(_WIDER * travel, settings.swing)
                continue
            level += 1
            if level == 1 and (dragged := self._dragged()):
                yield from self._outrun(home, dragged)
                break
        yield self._back(home)
        yield Move.rest(home, _HELD_AFTER)

    def _dragged(self) -> Guess | None:
        """Return a guess at how a torque drags the load once the teeth part; None if friction holds the load."""
        recording = self.recording()
        guesses = (guess_of(self._loop.side, recording, 0.5 * self._period * late) for late in range(3))
        guess = min(guesses, key=lambda guess: guess.misfit)
        left = abs(guess.load_torque) - guess.coulomb_l
        return guess if left >= max(_DRAGGED * self._standstill, _DRAGGED_SHARE * abs(guess.load_torque)) else None

    def _outrun(self, home: float, load: Guess) -> Generator[Move | Throw, None, None]:
        """Yield throws of a load that rests on a flank, each farther and harder, until the far flank is met."""
        settings, inertia = self._settings, self._loop.side.inertia
        most, torque = self._most / inertia, abs(load.load_torque)
        drag = (torque - load.coulomb_l) / max(load.inertia, _LIGHTEST * inertia)
        hard = min(_FASTER * drag + _FASTER_TORQUE * most, most)
        both = max(_RUN_UP * (self._most - torque) / (inertia + load.inertia), _RUN_UP_TORQUE * most)
        # The teeth part while the motor reverses.
        turning = math.sqrt(2.0 * settings.travel / 3.0 / max(hard - drag, _GAINS * hard))
        widest, met, most_way = 0.0, 0, _THROW_SHARE * settings.swing
        end = min(self._time + _THROW_TIME, settings.time)
        yield self._back(home)
        while self._time < end:
            swings = float(np.ptp([row[1] for row in self._rows[-math.ceil(0.5 * _SETTLE_TIME / self._period) :]]))
            if swings > _STANDS * settings.swing:
                self.cancel(
                    f"the motor swings by {swings:.2g} rad at the output where it should stand: its loop is not "
                    "stable; samples or commands may be later than loop_delay says, or the motor's values wrong"
                )
                return
            hard = min(hard, most_way / (_THROW_SAMPLES * self._period) ** 2)
            soft = min(both, hard)
            speed = min(0.5 * hard * turning, Throw.fastest(most_way, soft, hard))
            throw, first = Throw(home, math.copysign(1.0, load.load_torque), speed, soft, hard), len(self._rows)
            yield throw
            yield Move.rest(home, _SETTLE_TIME)
            motor, angle = np.array(self._rows[first:])[:, 1:3].T
            went = float(np.max(np.abs(angle - self._rows[0][2])))
            most_way = min(most_way, throw.way * _REACH * settings.swing / max(went, 1e-9))
            parted = float(np.ptp(motor - angle))
            # From throw to throw the motor goes farther: teeth that part no farther have met the far flank.
            met = 0 if parted > _FARTHER * widest else met + (parted > _NO_NEARER * widest)
            widest = max(widest, parted)
            if met < 2:
                hard, turning = min(_HARDER * hard, most), _FARTHER * turning


def _estimate_from(drive: Drive, recording: Recording, torque: float) -> BacklashEstimate:
    """Return the gap that a recording shows."""
    gap = measure_gap(drive, recording, torque)
    reason = gap.reason if gap.valid else f"no gap measured: {gap.reason}"
    return BacklashEstimate(
        gap.angle, Method.GAP_PROBE, valid=gap.valid, reason=reason, uncertainty=gap.uncertainty, fit=gap.fit
    )


EXPERIMENTS = {
    "gap_probe": NamedExperiment(
        "backlash from motion across the gap, with both encoders",
        GapProbe,
        GapProbeSettings(),
        swing="swing",
        law="",
    )
}
