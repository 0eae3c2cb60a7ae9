"""The gap from a recording of one encoder: the drive's equations are fitted without the other shaft's angle.

The gear is known and the motor nearly, so the time in which it crosses the gap under a known torque shows the width,
whichever shaft is seen: the motor moves as if it had no load, and the load coasts. The filter also predicts the shaft
without encoder; each impact shows its position.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.contacts.elastic import SpringContact
from backlash_ros.foundation.record import Array
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.fitting.candidates import Candidate, contacts_of, free_teeth, told_teeth
from backlash_ros.identification.fitting.fit import Fit, Found, fit_of, shape_of, torques_of
from backlash_ros.identification.fitting.parameters import parameters_at, parameters_of, places_of
from backlash_ros.identification.fitting.problem import Beliefs, Point, Problem, loss_of, motor_side
from backlash_ros.identification.gap import Gap
from backlash_ros.identification.play import guess_in_play
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.regression import Guess, guess_of


class Stage(NamedTuple):
    """Noise that is assumed: variance of both shafts' speeds per second, rad^2/s^3; share of the teeth's torque."""

    motor: float
    load: float
    teeth: float


STAGES = (
    Stage(100.0, 400.0, 0.5),
    Stage(30.0, 120.0, 0.27),
    Stage(10.0, 40.0, 0.15),
    Stage(3.0, 12.0, 0.09),
    Stage(1.0, 4.0, 0.05),
    Stage(0.3, 1.0, 0.035),
    Stage(0.09, 0.25, 0.02),
    Stage(0.03, 0.12, 0.013),
)
"""One encoder does not show the noise of each shaft: all of it is lowered at once, and the likeliest stage counts."""
_FAR, _WARM, _NEAR = 2, 3, (4, 5)
"""Stages with which a search looks around, goes on, and ends in the gentle part."""
_UNREAD_LOAD = 0.01
"""Share of the noise between the samples for a load that is not read: no reading would correct it."""
_UNREAD_MOTOR = 0.1
"""Share of the noise between the samples for a motor that is not read: no reading would correct it."""
_WHERE = 0.01
"""Beforehand, how far one shaft may be from the middle of the gap: a count, rad, that stands for an angle not read."""
_CALM = 0.35
"""Share of the recording, which is gentle, that tells the start."""
_THIN = 4e-3
"""A reading each so many s is enough to find the way; more of them make it rugged."""
_COARSE = 2e-4
"""Counts of so many rad are enough to find the way; finer ones make it rugged."""
_WIDTHS = np.geomspace(0.003, 0.13, 12)
"""Gaps that are tried, rad; tuned."""
_INERTIAS = (0.1, 0.35, 1.0)
"""Inertias of the load over that of the motor that are tried beside a guess; tuned."""
_DELAYS = (0.25, 1.0)
"""Delays that are tried, in periods; tuned."""
_LATE = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""Delays that a load in play is tried with, in periods; tuned."""
_WIDTHS_IN_PLAY = np.geomspace(0.003, 0.13, 24)
"""Gaps that a load in play is tried with, rad; tuned."""
_WIDER = (1.0, 1.2, 1.4, 1.7, 2.0)
"""Of a gap by play: the widths that are tried, since hard teeth show too narrow a gap; tuned."""
_HEAVIER = (1.0, 1.1, 1.2)
"""Of an inertia by play: those that are tried, since hard teeth show too light a load; tuned."""
_WITHIN = (-0.6, 0.0, 0.6)
"""Where in the gap, in half gaps, such a motion is tried to start; tuned."""
_LITTLE = 4
"""Stage from which a search goes on that begins near the end: more noise would lead away; tuned."""
_DESCENTS = 12
"""Number of such starts that are improved; tuned."""
_OTHER = 0.6
"""By how much, as ln, these have to differ from the guess; tuned."""
_BEGIN = 0.05
"""Standard deviation of where in the gap the motion starts, rad: anywhere."""
_FARTHEST = 5e-3
"""Largest step of that, rad."""
_HELD = 3e-3
"""Share of the torque at standstill that a load torque has to have to hold the load on a flank at the start."""
_FIXED = 1e-6
"""Standard deviation of what is not fitted: as good as 0."""
_STIFF = 0.02
"""Standard deviation of the force of the teeth by a told law, as ln: it is taken as told."""
_SPRING = 0.7
"""Standard deviation of the force of the teeth by a spring, as ln: a factor of two; tuned."""
_FREE = 2.0
"""Standard deviation of stiffness, damping and rebound of free teeth, as ln; tuned."""
_EXPONENT = 0.2
"""Standard deviation of their exponent, as ln; tuned."""
_MOTOR = 0.08
"""Standard deviation of the motor's gain and braking, as ln: how far data sheets are off."""
_MOST_GAIN = 0.4
"""Largest difference of the motor's gain from its data sheet, as ln, with which a gap is believed."""
_DEAD_BAND = 0.005
"""Standard deviation of the amplifier's dead band, a share of the largest command."""
_LOSS = 0.1
"""Standard deviation of the gear's loss, a share."""
_MOST_LOSS = 0.95
"""Largest loss of a gear, a share."""
_SOME_LOSS = 0.02
"""Loss with which the search for one begins; tuned."""
_STEEPEST_TEETH = 0.9
"""Largest exponent of free teeth, as ln: 2.5, where Hertz's teeth have 1.5."""
_SHALLOW = 1e-7
"""Least depth of the teeth there, rad."""
_SLOWLY = 1e-3
"""Depths in a second with which their damping is seen, 1/s."""
_UNDAMPED = 1e-9
"""Least damping of free teeth at the start, N m s/rad."""
_SOME_REBOUND = 0.1
"""Share of their damping that begins as rebound; tuned."""
_BORNE = 0.05
"""Share of the torque at standstill at which free teeth begin as those that were found; tuned."""
_PUNCTUAL = 1e-5
"""Standard deviation of the times of the samples, in periods: as good as 0."""
_EARLY_OR_LATE = 0.06
"""The same where stamps jitter: of times that are even within a tenth of a period to either side."""
_TIMINGS = (_PUNCTUAL, 0.02, _EARLY_OR_LATE, 0.12)
"""Those of which the likeliest is taken at the end."""
_GENTLE = 0.3
"""Share of the recording, which is gentle: there the load bounces in the gap, and the least error grows; tuned."""
_LEAST_INERTIA = 0.06
"""Least inertia of the load over that of the motor that a guess may have; tuned."""
_LARGEST_INERTIA = 1.2
"""Largest inertia of the load over that of the motor that a guess may have; tuned."""
_LEAST_VISCOUS = 1e-3
"""Least viscous friction of the load with which such a search begins, N m s/rad; tuned."""
_VISCOUS = 2.5e-3
"""Viscous friction of the load with which a search begins, N m s/rad; tuned."""
_STARTS = 6
"""Number of starts that are improved; tuned."""
_KEPT = 3
"""Number of them that go through all stages; tuned."""
_FACTORS = (0.5, 0.65, 0.8, 0.9, 0.95, 1.05, 1.1, 1.25, 1.6)
"""Of a gap that was found: other widths that are tried."""
_PLACES = (-0.9, 0.0, 0.9)
"""Where in the gap, in half gaps, the motion is tried to start."""
_ABOUT = (0.6, 1.0, 1.6)
"""Of an inertia that was found: others that are tried with gaps of any width."""
_ANEW = 4
"""Number of widths from which the search begins anew; tuned."""
_SOFTER = (0.9, 1.1)
"""Of a gap that was found with one contact law: widths from which the other laws start."""
_DRY = 2e-3
"""Share of the torque at standstill that dry friction has to have to be tried on either side."""
_FITS = 1.3
"""Largest rms of the innovations for which the model is taken for the drive's: 1 is that of a true model."""
_PULL = 0.8
"""Largest pull of the errors on the gap, with the motor's encoder: see `Fit.pull`. On 100 drives, right gaps had up to
0.7, and ends of the search beside the drive, with gaps 5 to 40 % off, from 0.9 on; tuned."""
_SMALL_ERROR = 2.5e-3
"""Errors of the angle, as a share of the gap, that hardly matter, whatever the counts: the model is not the drive."""
_MOST = 2.5
"""Largest rms of the innovations for which they hardly matter."""
_FEWEST = 5.0
"""Counts of the encoder that a gap must have: of 80 drives that were learned, one was wrong, a gap of 2.9 counts."""
_FLANK = 0.02
"""Share of the torque at standstill that a flank has borne to be counted as seen."""
_LIGHT = 0.12
"""Inertia of a load that a motor feels, over that of the motor: of lighter ones, gaps were wrong by up to 25 %."""
_APART = 0.15
"""By how much, as ln, a gap differs to be another one, which has to be worse."""
_WORSE = 60.0
"""Cost by which another gap has to be worse; tuned."""
_SURE = 0.12
"""Largest standard uncertainty of a gap to be used, a share of it."""
_NOISE = 1.5
"""Component of the uncertainty: times the standard deviation by the noise; tuned."""
_MODEL = 0.05
"""Component of the uncertainty: a share of the gap. One angle shows errors of motor and amplifier hardly apart from the
gap; tuned on drives with one effect of real axes each."""
_UNEXPLAINED = 40.0
"""Component of the uncertainty: a share of the gap for what nothing explains on motor and load, as shares of the torque
at standstill. The gentlest motion has 5 % of it, and twice what disturbs that counts; tuned."""
_CURVED = 0.05
"""Component of the uncertainty: a share of the gap for each square radian of the way, since a gap varies."""
_SLOPE = 0.5
"""Component of the uncertainty: a share of what the gap seems to change by over the way, since the model's errors look
like that."""
_WIND_UP = 0.25
"""Component of the uncertainty: a share of how far the teeth wind up under what they bore, which may pass for gap."""
_OTHERS = 20.0
"""Cost by which another end of the search must be worse for its gap to count by 1/e in the uncertainty; tuned."""
_ROUNDS = 4
"""Largest number of times that other widths, laws and losses are tried around the best end; tuned."""
_GAINS = 3.0
"""Least gain in cost for which another round is worth it; tuned."""


class Minimum(NamedTuple):
    """The end of a minimisation: cost, parameters, problem; rms of both innovations, and the stage of the noise.

    ``both``: whether both flanks bore a torque. ``explained``: whether nothing is left to be explained: with the
    least noise it is as good as a true model.
    """

    cost: float
    x: Array
    problem: Problem
    sizes: tuple[float, float] = (math.inf, math.inf)
    stage: int = -1
    both: bool = False
    explained: bool = False


def cost_of(found: Minimum) -> float:
    """Return the cost, to sort by."""
    return found.cost


def _ln_half_gap(x: Array) -> float:
    """Return the logarithm of half the gap, rad."""
    return float(parameters_at(x).ln_half_gap)


def _widened(x: Array, factor: float) -> Array:
    """Return parameters with a gap that is wider by a factor, and the start at the same share of it."""
    wider = x.copy()
    there = parameters_at(wider)
    there.ln_half_gap += math.log(factor)
    there.offset *= factor
    return wider


def _pinned(recording: Recording) -> tuple[Recording, Array, bool]:
    """Return a recording of one angle with both at first, as the filter needs it; that angle; and if the motor's."""
    motor, load = recording.motor.copy(), recording.load.copy()
    by_motor = bool(np.isnan(load).all())
    angle = (motor if by_motor else load).copy()
    motor[0] = load[0] = angle[0]
    return recording._replace(motor=motor, load=load), angle, by_motor


def _thinned(recording: Recording, period: float) -> Recording:
    every = round(_THIN / period)
    if every <= 1:
        return recording
    kept = np.arange(recording.time.size) % every == 0
    motor, load = (np.where(kept, angle, math.nan) for angle in (recording.motor, recording.load))
    return recording._replace(motor=motor, load=load)


def _warmer(stage: Stage, by: float) -> Stage:
    return Stage(by * stage.motor, by * stage.load, math.sqrt(by) * stage.teeth)


class _Search:
    """From many starts to the bottom, by one contact law after the other."""

    def __init__(self, drive: Drive, recording: Recording, torque: float, timing: float = _PUNCTUAL) -> None:
        self._timing = timing
        self.recording, angle, self.by_motor = _pinned(recording)
        time = recording.time
        self._drive, self._torque, self._side = drive, torque, motor_side(drive)
        self._period = float(np.median(np.diff(time)))
        count = max(count_of(angle), _COARSE)
        self._counts = (count, _WHERE) if self.by_motor else (_WHERE, count)
        motor, load = (1.0, _UNREAD_LOAD) if self.by_motor else (_UNREAD_MOTOR, 1.0)
        self.stages = tuple(Stage(motor * stage.motor, load * stage.load, stage.teeth) for stage in STAGES)
        seen = recording._replace(motor=angle, load=angle)
        guesses = (guess_of(self._side, seen, 0.5 * k * self._period) for k in range(3))
        self._guess: Guess = min(guesses, key=lambda guess: guess.misfit)
        self._thin = _thinned(self.recording, self._period)
        self._calm = self._thin.part(slice(math.ceil(_CALM * time.size)))

    def _problem(self, teeth: Candidate, recording: Recording, start: Array | None = None) -> Problem:
        """Return the problem with some teeth; free ones are expected about as in ``start``."""
        torque, unbounded = self._torque, math.inf
        mean = self._start(0.02, 0.3 * self._side.inertia, 0.0, 0.0)
        if start is not None:
            shape = places_of("ln_stiffness", "ln_damping", "ln_rebound", "ln_exponent")
            mean[shape] = start[shape]
        expected = parameters_at(mean)
        expected.load_torque, expected.ln_load_viscous = 0.0, math.log(2.0 * _VISCOUS)
        # Both angles are the same at first, so the offset says where in the gap the motion starts.
        beliefs = Beliefs(
            mean=mean,
            spread=parameters_of(
                _FIXED,
                ln_half_gap=3.0,
                offset=_BEGIN,
                gap_slope=0.2,
                ln_stiffness=_FREE if teeth.free else _SPRING if isinstance(teeth.contact, SpringContact) else _STIFF,
                ln_damping=_FREE if teeth.free else _FIXED,
                ln_rebound=_FREE if teeth.free else _FIXED,
                ln_exponent=_EXPONENT if teeth.free else _FIXED,
                gear_loss=_LOSS,
                ln_load_inertia=1.5,
                ln_load_viscous=3.0,
                load_coulomb=0.2 * torque,
                load_torque=0.2 * torque,
                motor_coulomb=0.2 * torque,
                load_torque_slope=0.05 * torque,
                delay=2.0 * self._period,
                load_scale_error=_FIXED if self.by_motor else 0.005,
                ln_motor_gain=_MOTOR,
                ln_motor_braking=_MOTOR,
                dead_band=_DEAD_BAND * torque / self._side.gain,
            ),
            low=parameters_of(
                -unbounded,
                ln_half_gap=-14.0,
                ln_stiffness=-unbounded if teeth.free else -5.0,
                ln_exponent=0.0,
                ln_load_inertia=-25.0,
                ln_load_viscous=-18.0,
                load_coulomb=0.0,
                motor_coulomb=0.0,
                gear_loss=0.0,
                delay=0.0,
                dead_band=0.0,
            ),
            high=parameters_of(
                unbounded,
                ln_half_gap=1.0,
                ln_stiffness=unbounded if teeth.free else 5.0,
                ln_exponent=_STEEPEST_TEETH,
                ln_load_inertia=12.0,
                ln_load_viscous=12.0,
                gear_loss=0.0,
            ),
            largest=parameters_of(
                unbounded,
                ln_half_gap=0.3,
                offset=_FARTHEST,
                gap_slope=0.1,
                ln_stiffness=0.5,
                ln_damping=0.7,
                ln_rebound=1.0,
                ln_exponent=0.2,
                gear_loss=0.1,
                ln_motor_gain=0.2,
                ln_motor_braking=0.2,
                ln_load_inertia=0.7,
                ln_load_viscous=1.0,
                load_scale_error=0.01,
            ),
        )
        return Problem(self._side, teeth, recording, torque, beliefs, self._counts)

    def _noise(self, stage: Stage) -> Array:
        """Return the noise of a stage as a `Problem` takes it."""
        unit = 0.1 * self._torque / self._side.inertia
        motor, load = math.sqrt(stage.motor) / unit, math.sqrt(stage.load) / unit
        return np.log([motor, load, stage.teeth, self._timing])

    def solve(self, problem: Problem, x: Array, stage: Stage, most: int, enough: float) -> Minimum:
        """Minimise from ``x`` with the noise of a stage until a step gains less than ``enough``."""
        point = problem.solve(Point(math.inf, x, self._noise(stage)), most, enough)
        return Minimum(point.cost, point.parameters, problem)

    def descend(self, problem: Problem, x: Array, first: int) -> Minimum:
        """Minimise through all stages from the ``first`` one, and return the end at the likeliest."""
        ends = []
        for k in range(first, len(self.stages)):
            ends.append(self.solve(problem, x, self.stages[k], 8, 0.5)._replace(stage=k))
            x = ends[-1].x
        if len(ends) > 1 and ends[0].cost < min(end.cost for end in ends[1:]):  # even less may be explained
            ends += [
                self.solve(problem, ends[0].x, self.stages[k], 8, 0.5)._replace(stage=k)
                for k in range(first - 1, -1, -1)
            ]
        likeliest = min(ends, key=cost_of)
        noise = self.stages[likeliest.stage]
        end = self.solve(problem, likeliest.x, noise, 20, 0.02)._replace(stage=likeliest.stage)
        if not math.isfinite(problem.cost(end.x, self._noise(noise))):  # a refused step may have come last
            return end
        sizes = np.sqrt(np.mean(loss_of(problem.results.innovations[1:]), axis=0))
        end = end._replace(sizes=(float(sizes[0]), float(sizes[1])), both=self._both(problem, end.x))
        plain = end.stage == len(self.stages) - 1 and max(end.sizes) <= _FITS and end.both
        return end._replace(explained=plain and (not self.by_motor or self.fit(end).pull <= _PULL))

    def _both(self, problem: Problem, x: Array) -> bool:
        """Return whether both flanks bore a torque, after a pass of the filter: a light load's inertia shows little."""
        least, largest = torques_of(problem.results)
        share = math.exp(parameters_at(x).ln_load_inertia) / self._side.inertia
        bearing = _FLANK * self._torque * (min(share / _LIGHT, 1.0) if self.by_motor else 1.0)
        return least < -bearing and bearing < largest

    def fit(self, found: Minimum) -> Fit:
        """Return the fit at a minimum."""
        point = Point(found.cost, found.x, self._noise(self.stages[found.stage]))
        return fit_of(Found(point, found.problem), (), self._drive)

    def _start(self, gap: float, inertia: float, coulomb_l: float, coulomb_m: float, delay: float = 0.5) -> Array:
        held = self._guess.load_torque
        return parameters_of(
            ln_half_gap=math.log(0.5 * gap),
            offset=math.copysign(0.5 * gap, held) if abs(held) > _HELD * self._torque else 0.0,
            ln_load_inertia=math.log(inertia),
            ln_load_viscous=math.log(_VISCOUS),
            load_coulomb=coulomb_l,
            motor_coulomb=coulomb_m,
            load_torque=self._guess.load_torque,
            delay=delay * self._period,
        )

    def _starts(self) -> Iterator[Array]:
        """Yield gaps of any width, with light and heavy loads, and dry friction on either side."""
        unit, guess = self._side.inertia, self._guess
        near = min(max(guess.inertia, _LEAST_INERTIA * unit), _LARGEST_INERTIA * unit)
        inertias = [near, *(k * unit for k in _INERTIAS if abs(math.log(k * unit / near)) > _OTHER)]
        dry = guess.coulomb_l + guess.coulomb_m
        shares = (0.0, 0.5, 1.0) if dry > _DRY * self._torque else (0.0,)
        for inertia in inertias:
            for share in shares:
                for gap in _WIDTHS:
                    for delay in _DELAYS:
                        yield self._start(float(gap), inertia, (1.0 - share) * dry, share * dry, delay)

    def ends(self, laws: Sequence[Candidate]) -> list[Minimum]:
        """Return the minima that are found by each law itself, the best first."""
        ends = self.in_play(laws) if self.by_motor else []
        if ends and ends[0].explained:
            return ends
        begun = [self.begin(teeth) for teeth in laws]
        for k in range(_KEPT):
            ends = sorted([*ends, *(self.go_on(found[k]) for found in begun)], key=cost_of)
            if ends[0].explained:
                break
        return ends

    def in_play(self, laws: Sequence[Candidate]) -> list[Minimum]:
        """Return the minima from about where the motor carries the load in play, the best first."""
        delays = [share * self._period for share in _LATE]
        gap, delay, load = guess_in_play(self._side, self.recording, _WIDTHS_IN_PLAY, delays)
        x = self._start(gap, load.inertia, load.coulomb_l, load.coulomb_m, delay / self._period)
        there = parameters_at(x)
        there.ln_load_viscous, there.load_torque = math.log(max(load.viscous, _LEAST_VISCOUS)), load.load_torque
        noise = self._noise(self.stages[_LITTLE])
        looked: list[tuple[float, int, Array, Problem]] = []
        for teeth in laws:
            problem = self._problem(teeth, self._thin)
            for wider, heavier, place in itertools.product(_WIDER, _HEAVIER, _WITHIN):
                other = _widened(x, wider)
                there = parameters_at(other)
                there.offset = place * math.exp(there.ln_half_gap)
                there.ln_load_inertia += math.log(heavier)
                looked.append((problem.cost(other, noise), len(looked), other, problem))
        ends = []
        for _, _, other, problem in sorted(looked, key=lambda each: each[:2])[:_DESCENTS]:
            near = self.solve(problem, other, self.stages[_LITTLE], 5, 0.5)
            ends.append(self.descend(problem, near.x, _LITTLE))
        return sorted(ends, key=cost_of)

    def begin(self, teeth: Candidate) -> list[Minimum]:
        """Return the minima of the gentle part, the best first."""
        warm, warmer = self.stages[_WARM], self.stages[_FAR]
        calm = self._problem(teeth, self._calm)
        nearest: dict[float, tuple[float, int, Array]] = {}
        for k, x in enumerate(self._starts()):
            looked, width = (calm.cost(x, self._noise(warmer)), k, x), _ln_half_gap(x)
            nearest[width] = min(looked, nearest.get(width, looked), key=lambda each: each[:2])
        ends = sorted((self.solve(calm, x, warmer, 5, 1.0) for _, _, x in nearest.values()), key=cost_of)
        ends = sorted((self.solve(calm, end.x, warm, 5, 1.0) for end in ends[:_STARTS]), key=cost_of)
        for stage in _NEAR:
            ends = sorted((self.solve(calm, end.x, self.stages[stage], 12, 1.0) for end in ends[:_KEPT]), key=cost_of)
        return ends

    def go_on(self, begun: Minimum) -> Minimum:
        """Minimise with the whole recording, thinned out; near an end that explains all, without much noise."""
        whole = replace(begun.problem, recording=self._thin)
        warm, first = (_LITTLE, _LITTLE) if begun.explained else (_WARM, _FAR)
        return self.descend(whole, self.solve(whole, begun.x, self.stages[warm], 5, 0.5).x, first)

    def timed(self, timing: float) -> "_Search":
        """Return a search of the same recording with another timing."""
        other = copy(self)
        other._timing = timing
        return other

    def near(self, found: Minimum) -> Minimum:
        """Return the minimum beside one that another search has found."""
        return self.descend(found.problem, found.x, max(found.stage - 1, 0))

    def anew(self, found: Minimum) -> list[Minimum]:
        """Return the minima from gaps of any width, with the rest about as found.

        In the gentle part, which tells the start, a load torque may hold the load on one flank.
        """
        whole = replace(found.problem, recording=self._thin)
        noise = self._noise(self.stages[_FAR])
        nearest: list[tuple[float, int, Array]] = []
        for width in _WIDTHS:
            tried = []
            for factor in _ABOUT:
                for delay in (parameters_at(found.x).delay, *(share * self._period for share in _DELAYS)):
                    x = _widened(found.x, 0.5 * width / math.exp(_ln_half_gap(found.x)))
                    there = parameters_at(x)
                    there.delay = delay
                    there.ln_load_inertia += math.log(factor)
                    tried.append((whole.cost(x, noise), len(nearest), x))
            nearest.append(min(tried, key=lambda each: each[0]))
        best = sorted(nearest, key=lambda each: each[:2])[:_ANEW]
        return [self.go_on(found._replace(x=x)) for _, _, x in best]

    def widths(self, found: Minimum) -> list[Minimum]:
        """Return the minima reached from other widths of the gap."""
        return [self.go_on(found._replace(x=_widened(found.x, factor))) for factor in _FACTORS]

    def places(self, found: Minimum) -> list[Minimum]:
        """Return the minima of a motion that starts elsewhere in the gap."""
        ends, half = [], math.exp(_ln_half_gap(found.x))
        for place in _PLACES:
            x = found.x.copy()
            parameters_at(x).offset = place * half
            ends.append(self.go_on(found._replace(x=x)))
        return ends

    def other_laws(self, found: Minimum, laws: Sequence[Candidate]) -> list[Minimum]:
        """Return the minima of the other contact laws, reached from what was found.

        By themselves they may miss the right one.
        """
        ends = []
        for teeth in laws:
            if teeth.law is not found.problem.teeth.law:
                problem = self._problem(teeth, self.recording)
                for factor in _SOFTER:
                    x = _widened(found.x, factor)
                    parameters_at(x).ln_stiffness = 0.0
                    ends.append(self.go_on(found._replace(x=x, problem=problem)))
        return ends

    def freed(self, found: Minimum) -> Minimum:
        """Return the minimum with free teeth that begin as those that were found."""
        told, torque, half = found.problem.teeth, _BORNE * self._torque, math.exp(_ln_half_gap(found.x))
        shape = shape_of(told, found.x)
        depth = max(told.twist(shape, half, torque) - half, _SHALLOW)
        here, deeper = (told.torque(shape, half, half + factor * depth) for factor in (1.0, math.e))
        rate = _SLOWLY * depth
        damping = max((told.torque(shape, half, half + depth, rate) - here) / rate, _UNDAMPED)
        exponent = min(max(math.log(deeper / here), 1.0), 2.0)
        x = found.x.copy()
        there = parameters_at(x)
        there.ln_stiffness, there.ln_exponent = math.log(exponent * torque / depth), math.log(exponent)
        there.ln_damping, there.ln_rebound = math.log(damping), math.log(_SOME_REBOUND * damping / torque)
        problem = self._problem(free_teeth(depth), self._thin, x)
        return self.descend(problem, x, max(found.stage - 1, 0))

    def with_losses(self, found: Minimum) -> Minimum:
        """Return the minimum with a gear that may lose torque."""
        high, x = found.problem.beliefs.high.copy(), found.x.copy()
        parameters_at(high).gear_loss, parameters_at(x).gear_loss = _MOST_LOSS, _SOME_LOSS
        problem = replace(found.problem, recording=self._thin, beliefs=found.problem.beliefs._replace(high=high))
        return self.descend(problem, x, max(found.stage - 1, 0))

    def finish(self, found: Minimum) -> Minimum:
        """Continue with every reading, if that converges: fast readings make the cost rugged."""
        if self._thin is self.recording:
            return found
        end = self.descend(replace(found.problem, recording=self.recording), found.x, max(found.stage - 1, 0))
        return end if max(end.sizes) <= max(_FITS, *found.sizes) else found


class OneSided(NamedTuple):
    """The likeliest fit; cost by which another gap is ``worse``; how far off ends ``near`` by are, as ln.

    ``stage`` of the noise: in the first ones it takes so much that the model is not the drive's. ``both``: whether both
    flanks bore a torque.
    """

    fit: Fit
    worse: float
    near: float
    stage: int
    both: bool


def _brisk(recording: Recording) -> Recording:
    """Return the brisk part of a recording of the motor's angle."""
    late = np.arange(recording.time.size) >= _GENTLE * recording.time.size
    first = int(np.argmax(late & np.isfinite(recording.motor)))
    return recording.part(slice(first, None))


def _first_ends(
    drive: Drive, recording: Recording, torque: float, laws: Sequence[Candidate]
) -> tuple[_Search, list[Minimum]]:
    """Return a search and its ends, the best first: of one that leaves nothing to be explained, or the likeliest.

    All is tried with samples on time, then not; with the motor's encoder, then without the gentle part.
    """
    search = _Search(drive, recording, torque)
    ends = search.ends(laws)
    if ends[0].explained:
        return search, ends
    if search.by_motor:
        brisk = _Search(drive, _brisk(recording), torque)
        found = brisk.in_play(laws)
        if found[0].explained:
            return brisk, found
    jittery = _Search(drive, recording, torque, _EARLY_OR_LATE)
    found = jittery.ends(laws)
    return (jittery, found) if found[0].cost < ends[0].cost else (search, ends)


def _timed(search: _Search, found: Minimum) -> tuple[_Search, Minimum]:
    """Return the likeliest of an end and those beside it with other timings, and the search that it is of."""
    others = [search.timed(timing) for timing in _TIMINGS]
    ends = [(search, found), *((other, other.near(found)) for other in others)]
    return min(ends, key=lambda each: each[1].cost)


def fit_one_sided(drive: Drive, recording: Recording, torque: float, contacts: Sequence[Contact] = ()) -> OneSided:
    """Return the likeliest fit of a recording of one angle.

    Parameters
    ----------
    drive : for its gear, which is taken as given, and its motor, which may be off by as much as data sheets are
    recording : one angle is all nan; the other one is used
    torque : of the motor at standstill, N m at the output
    contacts : the laws to try, see `contacts_of`
    """
    laws = [told_teeth(drive, contact) for contact in contacts or contacts_of(drive)]
    search, ends = _first_ends(drive, recording, torque, laws)
    if not ends[0].explained:
        ends = sorted([*ends, *search.anew(ends[0])], key=cost_of)
    for _ in range(_ROUNDS):
        best = ends[0]
        more = [*search.widths(best), *search.places(best), *search.other_laws(best, laws), search.with_losses(best)]
        if not best.problem.teeth.free:
            more.append(search.freed(best))
        ends = sorted([*ends, *more], key=cost_of)
        if not ends[0].cost < best.cost - _GAINS:
            break
    best = ends[0]
    here = _ln_half_gap(best.x)
    others = [(abs(_ln_half_gap(end.x) - here), end.cost - best.cost) for end in ends if math.isfinite(end.cost)]
    search, best = _timed(search, best)
    end = search.finish(best)
    return OneSided(
        fit=search.fit(end),
        worse=min((cost for apart, cost in others if apart > _APART), default=math.inf),
        near=max((apart * math.exp(-cost / _OTHERS) for apart, cost in others if apart <= _APART), default=math.inf),
        stage=end.stage,
        both=end.both,
    )


def measure_gap_one_sided(drive: Drive, recording: Recording, torque: float) -> Gap:
    """Return the gap where the load started, from one angle; see `fit_one_sided`."""
    found, worse, near, stage, both = fit_one_sided(drive, recording, torque)
    gap, size = found.gap, max(found.rms)
    by_motor = bool(np.isnan(recording.load).all())
    angle = recording.motor if by_motor else recording.load
    way = float(np.nanmax(angle) - np.nanmin(angle))
    deviation = _NOISE * found.gap_deviation
    change = float(found.values.gap_slope) * way
    twist = found.teeth.twist(found.shape, 0.5 * gap, found.bearing) - 0.5 * gap
    share = math.exp(found.values.ln_load_inertia) / drive.reflected_inertia
    light = by_motor and share < _LIGHT
    unexplained = math.hypot(found.noise[0], found.noise[1])
    shares = math.hypot(_MODEL, _UNEXPLAINED * unexplained, _CURVED * way**2, near, _SLOPE * change)
    uncertainty = math.hypot(deviation, shares * gap, _WIND_UP * twist)
    why = ""
    count = count_of(angle)
    reading = max(count, _COARSE) / math.sqrt(12.0)  # its standard deviation, as it was assumed
    fits = max(_FITS, min(_SMALL_ERROR * gap / reading, _MOST))
    if not size <= fits:
        why = (
            f"no model of teeth, friction and load explains what was seen: its errors are {size:.2g} times as large "
            f"as the encoder's counts allow, and may be {fits:.2g} times; check that the encoder counts in the "
            "direction of the motor, gear.reduction and the motor's parameters, and that nothing else moves the load"
        )
    elif stage < _FAR:
        why = (
            "something moves the motor or the load that is neither the command nor the gear: as seen at the motor, "
            f"{100.0 * found.noise[0]:.2g} % of the standstill torque is unexplained; check the motor's values and "
            "gear.reduction, and that nothing else moves the load"
        )
    elif abs(off := float(found.values.ln_motor_gain)) > _MOST_GAIN:
        why = (
            f"the command seems to accelerate the motor {math.exp(off):.2g} times as much as its data sheet says: "
            "check the unit of the command, the motor's values, its supply and gear.reduction"
        )
    elif not both:
        side = "negative" if -found.torques[0] < found.torques[1] else "positive"
        why = f"the teeth never bore a {side} torque, so the far flank was not seen"
    elif light and stage < len(STAGES) - 1:
        why = (
            f"the load's inertia is {share:.2g} of the motor's, as seen at the output: below {_LIGHT:g} of it the "
            "motor hardly feels it, and what was seen is not plain enough for that"
        )
    elif by_motor and found.pull > _PULL:
        why = (
            f"the errors that are left pull the gap {found.pull:.2g} times as much as noise would, and may {_PULL:g} "
            "times: the search has ended beside the drive; learn again"
        )
    elif gap < _FEWEST * count:
        counts = gap / count
        why = f"the gap is {gap:.2g} rad, {counts:.2g} counts of the encoder: fewer than {_FEWEST:g} do not tell it"
    elif worse < _WORSE:
        why = "gaps of different widths explain what was seen equally well"
    elif not uncertainty <= _SURE * gap:
        why = f"the gap is {gap:.3g} rad with a standard uncertainty of {uncertainty:.2g} rad, too large to be used"
    if why:
        return Gap(0.0, 0.0, False, why, found)
    told = (
        f"{recording.time[-1] - recording.time[0]:.1f} s of motion of one encoder, with teeth by "
        f"{found.teeth.name} law that bore {found.torques[0]:.2g} to {found.torques[1]:.2g} N m"
    )
    return Gap(gap, uncertainty, True, told, found)
