"""How likely a recording is, by the parameters of a drive and by the noise, and steps that make it likelier.

The filter's innovations enter a pseudo-Huber loss, so that a single outlier has no effect. The noise is fitted, not
assumed: it is what the model does not explain. Levenberg and Marquardt's steps improve the parameters, with the noise
as it is; Newton's steps, from passes without derivatives, improve the noise. At a poor point the likeliest noise is
large, which lets the search see far.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, row_of, size_of, view_of
from backlash_ros.identification.fitting.candidates import Candidate
from backlash_ros.identification.fitting.filter import filter_with
from backlash_ros.identification.fitting.memory import FINE, STATES, MotorSide, Noise, Results, Steps, Teeth, trace_at
from backlash_ros.identification.fitting.parameters import PARAMETERS
from backlash_ros.identification.recording import Recording


class Unexplained(Record):
    """The noise, as shares; a row of their logarithms is fitted."""

    motor: float  # torque on the motor for `_ACTS`, of the stall torque that its inertia would take to follow it
    load: float  # the same for the load
    teeth: float  # of the teeth's torque
    timing: float  # of a period


NOISES = size_of(Unexplained)
unexplained_at = view_of(Unexplained)
LEAST_NOISE = np.log(row_of(Unexplained, motor=3e-4, load=6e-4, teeth=4e-3, timing=1e-5))
"""What the filter's steps leave unexplained."""
MOST_NOISE = np.log(row_of(Unexplained, motor=1.0, load=1.0, teeth=3.0, timing=0.3))
"""The most that is fitted; tuned."""
KNEE = 2.0
"""Standard deviations above which an innovation counts by its magnitude, not its square; tuned."""
_ACTS = 1e-2
"""Time for which an unexplained torque acts, s: the unit of its noise."""
_SMALL = 1e-12
"""Variance of a reading beside its counts, rad^2: without it, one without counts would have none."""
_CHEAP = 0.35
"""Cost of a pass without derivatives, in passes with them: it takes about a third of the time."""
_COARSE = 0.4
"""Cost of a pass in coarse steps, in passes in fine ones: it takes about a third of the time."""
_DAMPINGS = 5
"""Number of dampings that a step tries; tuned."""
_APART = 0.2
"""Difference of a noise's logarithm by which derivatives are taken; tuned."""
_FARTHEST = 1.6
"""Largest step of a noise's logarithm, a factor of 5; tuned."""
_LOWER = 0.7
"""What the noise is lowered by, as logarithm, for the parameters to go on: to half of it; tuned."""
_FIRST = 0.02
"""Time from which the first speeds are taken, s; tuned."""
_MOVING = 0.3
"""Speed below which the first speeds count as 0, rad/s; tuned."""


def motor_side(drive: Drive) -> MotorSide:
    """Return the motor of ``drive`` as the filter needs it."""
    n, motor, current = drive.gear.ratio, drive.motor, drive.takes_current
    K, R = motor.torque_constant, motor.resistance
    return MotorSide(
        inertia=drive.reflected_inertia,
        viscous=motor.viscous_friction / n**2,
        rate=math.inf if current else R / motor.inductance,
        gain=K / n if current else K / (n * R),
        braking=0.0 if current else K * K / (n * n * R),
    )


def first_states(recording: Recording) -> Array:
    """Return room for the filter's states, shape (N, `STATES`), with initial speeds if it starts in motion."""
    states = np.zeros((recording.time.size, STATES))
    first = recording.time <= recording.time[0] + _FIRST

    def speed_of(angle: Array) -> float:
        read = first & np.isfinite(angle)
        if np.sum(read) <= 2:
            return 0.0
        speed = float(np.polyfit(recording.time[read], angle[read], 1)[0])
        return speed if abs(speed) > _MOVING else 0.0

    start = trace_at(states[0]).state
    start.motor_speed, start.load_speed = speed_of(recording.motor), speed_of(recording.load)
    return states


def loss_of(innovations: Array) -> Array:
    """Return the pseudo-Huber loss of innovations, twice what enters a likelihood: near 0 their squares."""
    return np.asarray(2.0 * KNEE**2 * (np.sqrt(1.0 + (innovations / KNEE) ** 2) - 1.0))


@compiled
def _normal_equations(innovations: Array, slopes: Array) -> tuple[Array, Array]:
    """Return half the gradient of the loss of innovations, shape (N,), and Gauss and Newton's matrix beside it.

    Not by BLAS: its threads wait for each other, and beside a busy process a fit takes 20 times as long.
    """
    parameters = slopes.shape[1]
    gradient, matrix = np.zeros(parameters), np.zeros((parameters, parameters))
    for k in range(innovations.size):
        weight = 1.0 / math.sqrt(1.0 + (innovations[k] / KNEE) ** 2)
        for i in range(parameters):
            weighed = weight * slopes[k, i]
            if weighed != 0.0:
                gradient[i] += weighed * innovations[k]
                for j in range(parameters):
                    matrix[i, j] += weighed * slopes[k, j]
    return gradient, matrix


@dataclass
class Effort:
    """Passes of the filter over a recording that a search may still take: a time limit, the same on any machine."""

    left: float = math.inf

    @property
    def spent(self) -> bool:
        """Whether none is left."""
        return self.left <= 0.0


class Beliefs(NamedTuple):
    """What is believed of the parameters beforehand: ``mean`` and standard deviation ``spread``, of one value each.

    They stay between ``low`` and ``high``, and change by at most ``largest`` in one step.
    """

    mean: Array
    spread: Array
    low: Array
    high: Array
    largest: Array


class Point(NamedTuple):
    """A point of a search: minus twice the logarithm of the likelihood; parameters; logarithms of `Unexplained`."""

    cost: float
    parameters: Array
    noise: Array


@dataclass
class Problem:
    """One recording with one law of the teeth.

    Parameters
    ----------
    torque : of the motor at standstill, N m at the output
    counts : of both encoders, rad
    whole : number of samples that count as one pass for the ``effort``; those of the recording for 0
    """

    side: MotorSide
    teeth: Candidate
    recording: Recording
    torque: float
    beliefs: Beliefs
    counts: tuple[float, float]
    effort: Effort = field(default_factory=Effort)
    whole: int = 0
    results: Results = field(init=False)

    def __post_init__(self) -> None:
        size = self.recording.time.size
        self.results = Results(
            innovations=np.zeros((size, 2)),
            derivatives=np.zeros((size, 2, PARAMETERS)),
            logs=np.zeros((size, 2)),
            states=first_states(self.recording),
        )
        self._period = float(np.median(np.diff(self.recording.time)))
        self._share = size / (self.whole or size)

    def variances(self, noise: Array) -> Noise:
        """Return the variances that the filter takes."""
        motor, load, teeth, timing = (float(value) for value in np.exp(noise))
        readings = [count * count / 12.0 + _SMALL for count in self.counts]
        unit = (self.torque / self.side.inertia) ** 2 * _ACTS
        return Noise(readings[0], readings[1], motor**2 * unit, load**2 * unit, teeth**2, (timing * self._period) ** 2)

    def _run(self, parameters: Array, noise: Array, steps: Steps, *, derive: bool) -> float:
        """Run the filter and return the cost."""
        cost = (1.0 if derive else _CHEAP) * (1.0 if steps is FINE else _COARSE)
        self.effort.left -= cost * self._share
        predict = filter_with(self.teeth.law)  # type: ignore[arg-type]
        logs = predict(
            self.side,
            Teeth(self.teeth.constants, self.teeth.depth),
            self.variances(noise),
            parameters,
            steps,
            self.recording,
            self.results,
            derive,
        )
        off = (parameters - self.beliefs.mean) / self.beliefs.spread
        result = float(np.sum(loss_of(self.results.innovations[1:]))) + logs + float(off @ off)
        return result if math.isfinite(result) else math.inf

    def cost(self, parameters: Array, noise: Array, steps: Steps = FINE) -> float:
        """Return minus twice the logarithm of the likelihood."""
        return self._run(parameters, noise, steps, derive=False)

    def look(self, parameters: Array, noise: Array, steps: Steps = FINE) -> tuple[float, Array, Array]:
        """Return half the cost's gradient and Gauss and Newton's matrix beside it; the variances count as constant."""
        cost = self._run(parameters, noise, steps, derive=True)
        if not math.isfinite(cost):
            return math.inf, np.zeros(PARAMETERS), np.eye(PARAMETERS)
        innovations, slopes = self.results.innovations[1:].ravel(), self.results.derivatives[1:].reshape(-1, PARAMETERS)
        gradient, matrix = _normal_equations(innovations, slopes)
        mean, spread = self.beliefs.mean, self.beliefs.spread
        return cost, gradient + (parameters - mean) / spread**2, matrix + np.diag(1.0 / spread**2)

    def pressed(self, parameters: Array, gradient: Array) -> NDArray[np.bool_]:
        """Return which parameters are pressed against a bound, where they stay."""
        low, high = self.beliefs.low, self.beliefs.high
        return (parameters <= low) & (gradient > 0.0) | (parameters >= high) & (gradient < 0.0)

    def solve(self, start: Point, most: int, enough: float, steps: Steps = FINE) -> Point:
        """Improve the parameters until a step gains less than ``enough`` or ``most`` steps are done."""
        damping, parameters = 1e-3, start.parameters
        cost, gradient, matrix = self.look(parameters, start.noise, steps)
        low, high, largest = self.beliefs.low, self.beliefs.high, self.beliefs.largest
        for _ in range(most):
            if self.effort.spent or not math.isfinite(cost):
                break
            gain = 0.0
            free = ~self.pressed(parameters, gradient)
            curved = matrix[np.ix_(free, free)]
            for tried in range(_DAMPINGS):
                step = np.zeros(PARAMETERS)
                step[free] = np.linalg.solve(curved + damping * np.diag(np.diag(curved)), -gradient[free])
                new = np.clip(parameters + np.clip(step, -largest, largest), low, high)
                # After a step that was too long, the next one is first looked at without derivatives.
                if tried and not self.cost(new, start.noise, steps) < cost:
                    damping = 10.0 * max(damping, 1e-4)
                    continue
                found = self.look(new, start.noise, steps)
                if found[0] < cost:
                    gain, parameters = cost - found[0], new
                    cost, gradient, matrix = found
                    damping = max(0.1 * damping, 1e-6)
                    break
                damping = 10.0 * max(damping, 1e-4)
            if gain < enough:
                break
        return Point(cost, parameters, start.noise)

    def tune(self, start: Point, most: int, enough: float) -> Point:
        """Improve the noise until a step gains less than ``enough`` or ``most`` steps are done."""
        cost, parameters, noise = self.cost(start.parameters, start.noise), start.parameters, start.noise
        least = np.zeros(NOISES, dtype=bool)  # as small as it may be, and should not be larger
        for _ in range(most):
            if self.effort.spent or not math.isfinite(cost):
                break
            gradient, matrix = self._slopes_by_noise(cost, parameters, noise, least)
            least |= (noise <= LEAST_NOISE) & (gradient > 0.0)
            free = np.logical_not(least)
            if not free.any() or not np.all(np.isfinite(gradient)):
                break
            step, gain = np.zeros(NOISES), 0.0
            step[free] = np.linalg.solve(matrix[np.ix_(free, free)], -gradient[free])
            for shrunk in (1.0, 0.3, 0.1):
                new = np.clip(noise + np.clip(shrunk * step, -_FARTHEST, _FARTHEST), LEAST_NOISE, MOST_NOISE)
                found = self.cost(parameters, new)
                if found < cost:
                    gain, cost, noise = cost - found, found, new
                    break
            if gain < enough:
                break
        return Point(cost, parameters, noise)

    def _slopes_by_noise(self, cost: float, parameters: Array, noise: Array, least: Array) -> tuple[Array, Array]:
        """Return the cost's gradient by the noise and a matrix for Newton's step, after a pass at this point."""
        innovations, logs = self.results.innovations[1:].ravel().copy(), self.results.logs[1:].ravel().copy()
        gradient = np.zeros(NOISES)
        by_logs, by_innovations = np.zeros((NOISES, logs.size)), np.zeros((NOISES, logs.size))
        for k in np.flatnonzero(least == 0):
            apart = -_APART if noise[k] > MOST_NOISE[k] - _APART else _APART
            other = noise.copy()
            other[k] += apart
            gradient[k] = (self.cost(parameters, other) - cost) / apart
            by_logs[k] = (self.results.logs[1:].ravel() - logs) / apart
            by_innovations[k] = (self.results.innovations[1:].ravel() - innovations) / apart
        # Where the model misses by more than the noise, the cost bends more than it would for the likeliest noise.
        bends = np.maximum(1.0, loss_of(innovations))
        matrix = (by_logs * bends) @ by_logs.T + 2.0 * by_innovations @ by_innovations.T
        return gradient, matrix + np.diag(1e-2 * np.diag(matrix) + 1e-3)

    def settle(self, start: Point, rounds: int, most: int, enough: float) -> Point:
        """Improve parameters and noise in turn, until a round gains less than ``enough`` or all are done.

        With the likeliest noise both creep: the parameters need to explain no more than that noise leaves. So they are
        improved with less noise, as long as this pays.
        """
        best, lower = start, _LOWER
        for _ in range(rounds):
            noise = np.maximum(best.noise - lower, LEAST_NOISE)
            point = self.tune(self.solve(best._replace(noise=noise), most, 0.3 * enough), 1, 0.3 * enough)
            gain = best.cost - point.cost
            if gain > 0.0:
                best = point
            if self.effort.spent or not (gain > enough or lower > 0.0):
                break
            if not gain > enough:
                lower = 0.0
        return best
