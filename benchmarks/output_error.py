"""Fits a position servo to recordings of its output angle alone, and reports what they do not show.

Output error (Ljung, System Identification, 2nd ed., ch. 7): each run is simulated freely from its first sample, and
the error against the measurement is minimised. Beyond ``LOSS`` the loss grows linearly: the mean absolute error is what
counts, and one bad reading has little effect. All parameters except the offset are sought as logarithms, so that none
becomes negative.

Errors of one run are correlated from sample to sample. Standard uncertainties therefore come from the scatter of the
gradient between stretches of runs, not between samples (Liang and Zeger, Biometrika 73, 1986), and are never smaller
than independent errors would give.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from position_servo import (
    NO_LIMIT,
    PARAMETERS,
    PositionServo,
    ServoRun,
    simulate,
)
from scipy.optimize import least_squares

from backlash_ros.foundation.quantity import quantities
from backlash_ros.foundation.record import Array

LOSS = 0.02
"""Beyond this error the loss grows like its magnitude instead of its square, rad."""
_STEPS = (1e-1, 3e-2, 1e-2, 3e-3)
"""Of the parameters, for derivatives: of a logarithm, or a tenth in rad. Friction that holds or lets go and a goal that
waits make the cost rugged: long steps look over small hills, then shorter ones end the search."""
_TOLERANCE = 3e-5
"""Relative change of cost and parameters below which a search ends; tuned."""
_STRETCHES = 40
"""Smallest number of stretches for the uncertainties, unless the runs are too short."""
_SHORTEST = 20
"""Samples in a stretch."""
_UNSURE = 0.5
"""Standard uncertainty of a logarithm above which a parameter counts as unknown."""
_TIED = 0.97
"""Correlation above which two parameters may be known only together: another fit decides."""
_LEAST_MOTION = 5e-3
"""Least motion of a run, rad, that says something."""
_GAP = 5e-3
"""Where the search for a gap starts, rad, unless told."""
_REACH = 10.0
"""Largest change of a logarithm from the start; tuned."""
_TURN = 1.0
"""Largest change of an offset from the start, rad; tuned."""
_LOST = 100.0
"""Larger errors count as this, rad."""


@dataclass(frozen=True)
class ServoFit:
    """What a fit found.

    ``uncertainty`` has the standard uncertainties of the free parameters, in their units; ``untold`` gives the reason
    for parameters that the data do not show: their values serve only to simulate. ``errors`` are the mean absolute
    errors of the runs, rad, and ``cost`` is the minimum, rad^2.
    """

    servo: PositionServo
    free: tuple[str, ...]
    uncertainty: dict[str, float]
    untold: dict[str, str]
    errors: Array
    cost: float


def mean_errors(servo: PositionServo, runs: Sequence[ServoRun]) -> Array:
    """Return the mean absolute error of each run's angle, rad."""
    played = simulate(servo, runs)
    return np.array([np.mean(np.abs(angle - run.angle)) for angle, run in zip(played, runs, strict=True)])


def _linear(name: str) -> bool:
    return name == "gravity_offset"


class _Problem:
    """Residuals as a function of the free parameters."""

    def __init__(self, runs: Sequence[ServoRun], first: PositionServo, free: Sequence[str]) -> None:
        self.runs, self.first, self.free = runs, first, tuple(free)
        self.measured = np.concatenate([run.angle for run in runs])
        bounds = quantities(PositionServo)
        start: list[float] = []
        low: list[float] = []
        high: list[float] = []
        for name in self.free:
            value = getattr(first, name) or _small(name, first, runs)
            if _linear(name):
                start.append(getattr(first, name))
                low.append(max(start[-1] - _TURN, bounds[name].lower))
                high.append(min(start[-1] + _TURN, bounds[name].upper))
                continue
            if name == "speed_limit" and value >= NO_LIMIT:
                value = _fastest(runs)
            start.append(math.log(value))
            low.append(start[-1] - _REACH)
            high.append(min(start[-1] + _REACH, math.log(bounds[name].upper)))
        self.start, self.low, self.high = np.array(start), np.array(low), np.array(high)

    def servo(self, x: Array) -> PositionServo:
        """Return the servo with parameters ``x``."""
        values = {
            name: float(value) if _linear(name) else math.exp(float(value))
            for name, value in zip(self.free, x, strict=True)
        }
        return replace(self.first, **values)

    def residuals(self, x: Array) -> Array:
        """Return simulated less measured angles of all runs, rad."""
        residuals = np.concatenate(simulate(self.servo(x), self.runs)) - self.measured
        bounded: Array = np.clip(np.nan_to_num(residuals, nan=_LOST), -_LOST, _LOST)
        return bounded

    def derivatives(self, x: Array, step: float, central: bool = False) -> Array:
        """Return those of the residuals, shape (samples, parameters)."""
        columns, here = [], self.residuals(x)
        for j in range(x.size):
            shift = np.zeros_like(x)
            size = 0.1 * step if _linear(self.free[j]) else step
            shift[j] = -size if x[j] + size > self.high[j] else size
            if central and self.low[j] < x[j] - size and x[j] + size < self.high[j]:
                columns.append((self.residuals(x + shift) - self.residuals(x - shift)) / (2.0 * size))
            else:
                columns.append((self.residuals(x + shift) - here) / shift[j])
        return np.column_stack(columns)


def _small(name: str, first: PositionServo, runs: Sequence[ServoRun]) -> float:
    """Return the starting value of a parameter that is 0 so far."""
    stall = first.torque_per_volt * float(np.median(runs[0].supply))
    starts = {
        "viscous_friction": 0.05 * first.torque_per_volt * first.back_emf,
        "coulomb_friction": 0.03 * stall,
        "stribeck_friction": 0.003 * stall,
        "delay": 2.0 * runs[0].period,
        "start_duty": 0.01,
        "backlash_angle": _GAP,
    }
    return starts.get(name, 0.1)


def _fastest(runs: Sequence[ServoRun]) -> float:
    return max(float(np.quantile(np.abs(np.diff(run.angle)), 0.99)) / run.period for run in runs)


def fit_servo(runs: Sequence[ServoRun], first: PositionServo, free: Sequence[str]) -> ServoFit:
    """Fit the ``free`` parameters to ``runs``; the others stay as they are in ``first``, where the search starts.

    Raises
    ------
    ValueError
        If there are no runs, nothing moves, or a parameter is unknown or named twice.
    """
    unknown = sorted(set(free) - set(PARAMETERS))
    if unknown or not free or len(set(free)) < len(free):
        raise ValueError(f"free must name some of {list(PARAMETERS)}, each once, got {list(free)}")
    if not runs:
        raise ValueError("runs must have at least one recording, got none")
    if all(float(np.ptp(run.angle)) < _LEAST_MOTION for run in runs):
        most = max(float(np.ptp(run.angle)) for run in runs)
        raise ValueError(f"at least one run must move by >= {_LEAST_MOTION:g} rad, the largest motion is {most:g} rad")
    if "backlash_angle" in free or first.backlash_angle > 0:
        simulate(replace(first, backlash_angle=_GAP), runs)  # refuses a load without inertia
    problem = _Problem(runs, first, free)
    x, cost = _minimum(problem)
    return _judged(problem, x, cost)


def refit(runs: Sequence[ServoRun], near: PositionServo, free: Sequence[str]) -> tuple[PositionServo, float]:
    """Return the result of a fit from ``near`` it, and its cost, rad^2, without uncertainties."""
    problem = _Problem(runs, near, free)
    x, cost = _minimum(problem, _STEPS[1:])
    return problem.servo(x), cost


def _minimum(problem: _Problem, steps: Sequence[float] = _STEPS) -> tuple[Array, float]:
    """Return the best parameters and their cost, rad^2."""
    x, cost = np.clip(problem.start, problem.low + 1e-9, problem.high - 1e-9), math.inf
    for step in steps:
        found: Any = least_squares(
            problem.residuals,
            x,
            partial(problem.derivatives, step=step),
            bounds=(problem.low, problem.high),
            loss="soft_l1",
            f_scale=LOSS,
            x_scale=0.1,
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            max_nfev=40,
        )
        if found.cost < cost:
            x, cost = found.x, float(found.cost)
    return x, cost


def _judged(problem: _Problem, x: Array, cost: float) -> ServoFit:
    """Return the fit with uncertainties and with what the data do not show."""
    servo, scatters = problem.servo(x), [_scatter(problem, x, step) for step in _STEPS[2:]]
    deviation = np.max([scatter.deviation for scatter in scatters], axis=0)  # small hills look like information
    last = scatters[-1]
    uncertainty, untold = {}, {}
    for j, name in enumerate(problem.free):
        value = getattr(servo, name)
        uncertainty[name] = float(deviation[j]) * (1.0 if _linear(name) else value)
        ties = [problem.free[k] for k in np.flatnonzero(np.abs(last.correlation[j]) > _TIED) if k != j]
        if ties and not _linear(name) and _rise(problem, x, j) - cost < 2.0 * last.variance * last.inflation[j]:
            untold[name] = f"can be told only together with {' and '.join(ties)}"
            uncertainty[name] = math.inf
        elif not deviation[j] <= _UNSURE:
            untold[name] = "the angles hardly depend on it"
        elif not _linear(name) and x[j] - problem.low[j] < 1.0:
            untold[name] = "the fit is best with a value close to 0"
        elif x[j] > problem.high[j] - 1e-3:
            untold[name] = "the fit is best at its upper bound"
    return ServoFit(servo, problem.free, uncertainty, untold, mean_errors(servo, problem.runs), cost)


def _rise(problem: _Problem, x: Array, j: int) -> float:
    """Return the cost with a parameter off by `_UNSURE` and all others fitted again, rad^2."""
    way = _UNSURE if x[j] + _UNSURE < problem.high[j] else -_UNSURE
    away = problem.servo(np.where(np.arange(x.size) == j, x + way, x))
    return _minimum(_Problem(problem.runs, away, [name for k, name in enumerate(problem.free) if k != j]))[1]


class _Scatter(NamedTuple):
    """Uncertainty of the parameters: standard uncertainties and correlations.

    ``inflation`` is the factor by which the scatter between stretches raises the variance of independent errors;
    ``variance`` is that of the errors, rad^2.
    """

    deviation: Array
    correlation: Array
    inflation: Array
    variance: float


def _scatter(problem: _Problem, x: Array, step: float) -> _Scatter:
    """Return the uncertainty of ``x``, with derivatives by a step of ``step``."""
    residuals, slopes = problem.residuals(x), problem.derivatives(x, step, central=True)
    ratio = 1.0 + (residuals / LOSS) ** 2
    pull, curvature = residuals / np.sqrt(ratio), ratio**-1.5
    hessian = slopes.T @ (curvature[:, None] * slopes)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-30))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T / np.outer(scale, scale)
    apart = max(_SHORTEST, min(run.angle.size for run in problem.runs) * len(problem.runs) // _STRETCHES)
    starts: list[int] = []
    at = 0
    for run in problem.runs:
        size = run.angle.size
        parts = max(1, size // apart)
        starts += [at + k * size // parts for k in range(parts)]
        at += size
    sums = np.add.reduceat(slopes * pull[:, None], np.array(starts), axis=0)
    count, free = len(starts), x.size
    spread = inverse @ (sums.T @ sums) @ inverse * count / max(1, count - free)
    variance = float(np.mean(pull**2))
    independent = np.diag(inverse) * variance
    most = np.maximum(np.diag(spread), independent)
    root = np.sqrt(np.diag(inverse))
    correlation: Array = inverse / np.outer(root, root)
    return _Scatter(np.sqrt(most), correlation, most / np.maximum(independent, 1e-300), variance)
