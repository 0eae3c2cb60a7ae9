"""The timing of samples: regularity, age when recorded, losses, and delay of the answers."""

import math
from dataclasses import dataclass

import numpy as np

from backlash_ros.control.monitoring.beat import Beat
from backlash_ros.control.tick import MISSING
from backlash_ros.foundation.record import Array
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.studies.metrics import TAIL

_SPAN = 4
"""Number of periods over which the period is averaged."""
SETTLING = 0.3
"""Waiting time after a disturbance, s."""


def late_answers(samples: Array, answers: Array) -> Array:
    """Return the times of samples, s, that had no answer before the next sample, or whose next sample was late."""
    passed = np.diff(samples)
    unanswered = np.diff(np.searchsorted(answers, samples)) == 0
    late: Array = samples[:-1][unanswered | (passed > MISSING * np.median(passed))]
    return late


def last_quiet(samples: Array, answers: Array, middle: float) -> float | None:
    """Return the end of the last long enough stretch after ``middle`` without a late answer, s, or None."""
    late = late_answers(samples, answers)
    edges = np.array([middle, *late[late > middle], samples[-1]])
    long_enough = np.flatnonzero(np.diff(edges) >= TAIL + SETTLING)
    return float(edges[long_enough[-1] + 1]) if long_enough.size else None


@dataclass(frozen=True)
class Timing:
    """Times in s, nan if unknown.

    Attributes
    ----------
    samples, repeated : number used, and number left out because their stamps do not increase
    length : from the first to the last sample
    period, rate : median time between samples, averaged over four, and its inverse, Hz
    jitter, jitter_99 : of the time between samples without losses: standard deviation, and 99th percentile of the
        deviation from the period
    longest : time between two samples
    lost : samples of that period that the bag lacks between the first and the last
    holes : number of times between samples above `MISSING` periods
    age, age_99, age_most : from stamp to recording: mean, 99th percentile and largest
    answers, unanswered : commands, and samples without one before the next sample, or with a late next sample
    answered, answered_99 : from the recording of a sample to that of its command: median and 99th percentile
    """

    samples: int
    repeated: int
    length: float
    period: float
    rate: float
    jitter: float
    jitter_99: float
    longest: float
    lost: int
    holes: int
    age: float = math.nan
    age_99: float = math.nan
    age_most: float = math.nan
    answers: int = 0
    unanswered: int = 0
    answered: float = math.nan
    answered_99: float = math.nan


def period_of(time: Array) -> float:
    """Return the period of samples, s, in spite of late, lost and alternately early ones."""
    size = min(_SPAN, time.size - 1)
    return float(np.median(time[size:] - time[:-size])) / size


def _answer_times(axis: Axis) -> Array:
    """Return the times from the recording of samples to that of their answers, s."""
    if axis.command is None or not np.any(np.isfinite(axis.answered)):
        return np.empty(0)
    place = {stamp: k for k, stamp in enumerate(axis.stamps)}
    pairs = [(k, place[stamp]) for k, stamp in enumerate(axis.answered) if stamp in place]
    if not pairs:
        return np.empty(0)
    answers, samples = np.array(pairs).T
    return np.asarray(axis.commands_received[answers] - axis.received[samples])


def timing_of(axis: Axis) -> Timing | None:
    """Return the timing of an axis's samples; None for fewer than three."""
    if axis.time.size < 3:
        return None
    steps = np.diff(axis.time)
    period = period_of(axis.time)
    beat = Beat(period)
    off = np.abs(steps - period)[steps <= MISSING * period]
    age = axis.received - axis.stamps if not axis.clock else np.full(1, math.nan)
    answers = _answer_times(axis)
    both = axis.command is not None and axis.command.time.size > 0
    within = axis.time[axis.time >= axis.command.time[0]] if axis.command is not None and both else axis.time[:0]
    return Timing(
        samples=axis.time.size,
        repeated=axis.repeated,
        length=float(axis.time[-1] - axis.time[0]),
        period=period,
        rate=1.0 / period,
        jitter=float(np.sqrt(np.mean(np.square(off)))),
        jitter_99=float(np.quantile(off, 0.99)),
        longest=float(np.max(steps)),
        lost=sum(beat.sample(step)[0] - 1 for step in steps.tolist()),
        holes=steps.size - off.size,
        age=float(np.mean(age)),
        age_99=float(np.quantile(age, 0.99)),
        age_most=float(np.max(age)),
        answers=axis.command.time.size if axis.command is not None else 0,
        unanswered=late_answers(within, axis.command.time).size if axis.command is not None and within.size > 1 else 0,
        answered=float(np.median(answers)) if answers.size else math.nan,
        answered_99=float(np.quantile(answers, 0.99)) if answers.size else math.nan,
    )
