"""A search for the likeliest parameters of a recording of one encoder, from many starts to the bottom."""

import itertools
import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.fitting.candidates import Candidate, free_teeth
from backlash_ros.identification.fitting.fit import Fit, Found, fit_of, shape_of, torques_of
from backlash_ros.identification.fitting.parameters import parameters_at, places_of
from backlash_ros.identification.fitting.problem import Point, Problem, loss_of, motor_side
from backlash_ros.identification.one_encoder.beliefs import beliefs_of
from backlash_ros.identification.one_encoder.starts import DELAYS, VISCOUS, WIDTHS, Starts, widened
from backlash_ros.identification.recording import Recording


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
FAR, _WARM, _NEAR = 2, 3, (4, 5)
"""Stages with which a search looks around, goes on, and ends in the gentle part."""
_LITTLE = 4
"""Stage from which a search goes on that begins near the end: more noise would lead away; tuned."""
_UNREAD_LOAD = 0.01
"""Share of the noise between the samples for a load that is not read: no reading would correct it."""
_UNREAD_MOTOR = 0.1
"""Share of the noise between the samples for a motor that is not read: no reading would correct it."""
_WHERE = 0.01
"""Beforehand, how far one shaft may be from the middle of the gap: a count, rad, that stands for an angle not read."""
PUNCTUAL = 1e-5
"""Standard deviation of the times of the samples, in periods: as good as 0."""
_CALM = 0.35
"""Share of the recording, which is gentle, that tells the start."""
_THIN = 4e-3
"""A reading each so many s is enough to find the way; more of them make it rugged."""
COARSE = 2e-4
"""Counts of so many rad are enough to find the way; finer ones make it rugged."""
_DESCENTS = 12
"""Number of starts in play that are improved; tuned."""
_STARTS = 6
"""Number of starts anywhere that are improved; tuned."""
_KEPT = 3
"""Number of those that go through all stages; tuned."""
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
_MOST_LOSS = 0.95
"""Largest loss of a gear, a share."""
_SOME_LOSS = 0.02
"""Loss with which the search for one begins; tuned."""
_SHALLOW = 1e-7
"""Least depth, rad, at which free teeth are as stiff as those that were found."""
_SLOWLY = 1e-3
"""Rate, in depths a second, at which the damping of those that were found is seen."""
_UNDAMPED = 1e-9
"""Least damping of free teeth at the start, N m s/rad."""
_SOME_REBOUND = 0.1
"""Share of that damping that begins as rebound; tuned."""
_BORNE = 0.05
"""Share of the torque at standstill at which free teeth begin as those that were found; tuned."""
_STEEL = 0.05
"""Share of the gap by which a quarter of the torque at standstill winds up teeth of steel; tuned."""
_AROUND = (0.7, 0.85, 1.0, 1.15)
"""Of a gap that was found: widths with which teeth of steel are tried; tuned."""
_LIGHTER = (0.6, 1.0)
"""Of an inertia that was found: those with which they are tried; tuned."""
_DAMPED = (0.1, 0.3, 0.8)
"""Damping ratios of both shafts on them that are tried; tuned."""
_TRIED = 3
"""Number of those that are improved; tuned."""
FITS = 1.3
"""Largest rms of the innovations for which the model is taken for the drive's: 1 is that of a true model."""
PULL = 0.8
"""Largest pull of the errors on the gap, with the motor's encoder: see `Fit.pull`. On 100 drives, right gaps had up to
0.7, and ends of the search beside the drive, with gaps 5 to 40 % off, from 0.9 on; tuned."""
_FLANK = 0.02
"""Share of the torque at standstill that a flank has borne to be counted as seen."""
LIGHT = 0.12
"""Inertia of a load that a motor feels, over that of the motor: of lighter ones, gaps were wrong by up to 25 %."""
_SCHWARZ = 20.0
"""Cost of free teeth: what their three more parameters gain by chance over a thousand samples, by Schwarz's criterion
(Estimating the dimension of a model, 1978). Without it, free teeth passed for elastic ones with a gap 5 % wider."""


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
    """Return the cost, to compare minima by: free teeth must explain more than told ones."""
    return found.cost + (_SCHWARZ if found.problem.teeth.free else 0.0)


def ln_half_gap(x: Array) -> float:
    """Return the logarithm of half the gap, rad."""
    return float(parameters_at(x).ln_half_gap)


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


class Search:
    """From many starts to the bottom, by one contact law after the other.

    Parameters
    ----------
    recording : one angle is all nan; the other one is used
    torque : of the motor at standstill, N m at the output
    timing : standard deviation of the times of the samples, in periods
    """

    def __init__(self, drive: Drive, recording: Recording, torque: float, timing: float = PUNCTUAL) -> None:
        self._timing = timing
        self.recording, angle, self.by_motor = _pinned(recording)
        time = recording.time
        self._drive, self._torque, self._side = drive, torque, motor_side(drive)
        self._period = float(np.median(np.diff(time)))
        count = max(count_of(angle), COARSE)
        self._counts = (count, _WHERE) if self.by_motor else (_WHERE, count)
        motor, load = (1.0, _UNREAD_LOAD) if self.by_motor else (_UNREAD_MOTOR, 1.0)
        self.stages = tuple(Stage(motor * stage.motor, load * stage.load, stage.teeth) for stage in STAGES)
        seen = recording._replace(motor=angle, load=angle)
        self._starts = Starts(self._side, torque, self._period, seen)
        self._thin = _thinned(self.recording, self._period)
        self._calm = self._thin.part(slice(math.ceil(_CALM * time.size)))

    def _problem(self, teeth: Candidate, recording: Recording, start: Array | None = None) -> Problem:
        """Return the problem with some teeth; free ones are expected about as in ``start``."""
        torque = self._torque
        mean = self._starts.start(0.02, 0.3 * self._side.inertia, 0.0, 0.0)
        if start is not None:
            shape = places_of("ln_stiffness", "ln_damping", "ln_rebound", "ln_exponent")
            mean[shape] = start[shape]
        expected = parameters_at(mean)
        expected.load_torque, expected.ln_load_viscous = 0.0, math.log(2.0 * VISCOUS)
        beliefs = beliefs_of(
            teeth, mean, torque=torque, gain=self._side.gain, period=self._period, by_motor=self.by_motor
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
        plain = end.stage == len(self.stages) - 1 and max(end.sizes) <= FITS and end.both
        return end._replace(explained=plain and (not self.by_motor or self.fit(end).pull <= PULL))

    def _both(self, problem: Problem, x: Array) -> bool:
        """Return whether both flanks bore a torque, after a pass of the filter: a light load's inertia shows little."""
        least, largest = torques_of(problem.results)
        share = math.exp(parameters_at(x).ln_load_inertia) / self._side.inertia
        bearing = _FLANK * self._torque * (min(share / LIGHT, 1.0) if self.by_motor else 1.0)
        return least < -bearing and bearing < largest

    def fit(self, found: Minimum) -> Fit:
        """Return the fit at a minimum."""
        point = Point(found.cost, found.x, self._noise(self.stages[found.stage]))
        return fit_of(Found(point, found.problem), (), self._drive)

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
        starts, noise = list(self._starts.in_play(self.recording)), self._noise(self.stages[_LITTLE])
        problems = [self._problem(teeth, self._thin) for teeth in laws]
        looked = [(problem.cost(x, noise), x, problem) for problem in problems for x in starts]
        ends = []
        for _, x, problem in sorted(looked, key=lambda each: each[0])[:_DESCENTS]:
            near = self.solve(problem, x, self.stages[_LITTLE], 5, 0.5)
            ends.append(self.descend(problem, near.x, _LITTLE))
        return sorted(ends, key=cost_of)

    def begin(self, teeth: Candidate) -> list[Minimum]:
        """Return the minima of the gentle part, the best first."""
        warm, warmer = self.stages[_WARM], self.stages[FAR]
        calm = self._problem(teeth, self._calm)
        nearest: dict[float, tuple[float, int, Array]] = {}
        for k, x in enumerate(self._starts.anywhere()):
            looked, width = (calm.cost(x, self._noise(warmer)), k, x), ln_half_gap(x)
            nearest[width] = min(looked, nearest.get(width, looked), key=lambda each: each[:2])
        ends = sorted((self.solve(calm, x, warmer, 5, 1.0) for _, _, x in nearest.values()), key=cost_of)
        ends = sorted((self.solve(calm, end.x, warm, 5, 1.0) for end in ends[:_STARTS]), key=cost_of)
        for stage in _NEAR:
            ends = sorted((self.solve(calm, end.x, self.stages[stage], 12, 1.0) for end in ends[:_KEPT]), key=cost_of)
        return ends

    def go_on(self, begun: Minimum) -> Minimum:
        """Minimise with the whole recording, thinned out; near an end that explains all, without much noise."""
        whole = replace(begun.problem, recording=self._thin)
        warm, first = (_LITTLE, _LITTLE) if begun.explained else (_WARM, FAR)
        return self.descend(whole, self.solve(whole, begun.x, self.stages[warm], 5, 0.5).x, first)

    def anew(self, found: Minimum) -> list[Minimum]:
        """Return the minima from gaps of any width, with the rest about as found.

        In the gentle part, which tells the start, a load torque may hold the load on one flank.
        """
        whole = replace(found.problem, recording=self._thin)
        noise = self._noise(self.stages[FAR])
        nearest: list[tuple[float, int, Array]] = []
        for width in WIDTHS:
            tried = []
            for factor in _ABOUT:
                for delay in (parameters_at(found.x).delay, *(share * self._period for share in DELAYS)):
                    x = widened(found.x, 0.5 * width / math.exp(ln_half_gap(found.x)))
                    there = parameters_at(x)
                    there.delay = delay
                    there.ln_load_inertia += math.log(factor)
                    tried.append((whole.cost(x, noise), len(nearest), x))
            nearest.append(min(tried, key=lambda each: each[0]))
        best = sorted(nearest, key=lambda each: each[:2])[:_ANEW]
        return [self.go_on(found._replace(x=x)) for _, _, x in best]

    def widths(self, found: Minimum) -> list[Minimum]:
        """Return the minima reached from other widths of the gap."""
        return [self.go_on(found._replace(x=widened(found.x, factor))) for factor in _FACTORS]

    def places(self, found: Minimum) -> list[Minimum]:
        """Return the minima of a motion that starts elsewhere in the gap."""
        ends, half = [], math.exp(ln_half_gap(found.x))
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
                    x = widened(found.x, factor)
                    parameters_at(x).ln_stiffness = 0.0
                    ends.append(self.go_on(found._replace(x=x, problem=problem)))
        return ends

    def freed(self, found: Minimum) -> Minimum:
        """Return the minimum with free teeth that begin as those that were found."""
        told, torque, half = found.problem.teeth, _BORNE * self._torque, math.exp(ln_half_gap(found.x))
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
        return self.near(found._replace(problem=problem, x=x))

    def steel(self, found: Minimum) -> list[Minimum]:
        """Return the minima of free teeth that begin stiff and damped, as of steel, with the motor as told."""
        depth = 2.0 * _STEEL * math.exp(ln_half_gap(found.x))
        stiffness, starts = 0.25 * self._torque / depth, []
        for factor, lighter, damped in itertools.product(_AROUND, _LIGHTER, _DAMPED):
            x = widened(found.x, factor)
            there = parameters_at(x)
            there.ln_load_inertia += math.log(lighter)
            there.ln_motor_gain = there.ln_motor_braking = there.gear_loss = there.ln_exponent = 0.0
            inertia = 1.0 / (1.0 / self._side.inertia + math.exp(-there.ln_load_inertia))
            damping = 2.0 * damped * math.sqrt(stiffness * inertia)
            there.ln_stiffness, there.ln_damping = math.log(stiffness), math.log(damping)
            there.ln_rebound = math.log(_SOME_REBOUND * damping / self._torque)
            starts.append(x)
        problem = self._problem(free_teeth(depth), self._thin, starts[0])
        noise = self._noise(self.stages[_LITTLE])
        best = sorted(starts, key=lambda x: problem.cost(x, noise))[:_TRIED]
        return [self.descend(problem, self.solve(problem, x, self.stages[_LITTLE], 8, 0.5).x, _LITTLE) for x in best]

    def with_losses(self, found: Minimum) -> Minimum:
        """Return the minimum with a gear that may lose torque."""
        high, x = found.problem.beliefs.high.copy(), found.x.copy()
        parameters_at(high).gear_loss, parameters_at(x).gear_loss = _MOST_LOSS, _SOME_LOSS
        problem = replace(found.problem, recording=self._thin, beliefs=found.problem.beliefs._replace(high=high))
        return self.near(found._replace(problem=problem, x=x))

    def timed(self, timing: float) -> "Search":
        """Return a search of the same recording with another timing."""
        other = copy(self)
        other._timing = timing
        return other

    def near(self, found: Minimum) -> Minimum:
        """Return the minimum from parameters and a problem beside those of one that was found."""
        return self.descend(found.problem, found.x, max(found.stage - 1, 0))

    def finish(self, found: Minimum) -> Minimum:
        """Continue with every reading, if that converges: fast readings make the cost rugged."""
        if self._thin is self.recording:
            return found
        end = self.near(found._replace(problem=replace(found.problem, recording=self.recording)))
        return end if max(end.sizes) <= max(FITS, *found.sizes) else found
