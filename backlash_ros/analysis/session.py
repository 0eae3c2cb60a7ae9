"""Judging a recorded session: step responses, a swap of gains, a load step, learning; in numbers."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backlash_ros.analysis.bag import Recording
from backlash_ros.analysis.metrics import StepResponse, step_response
from backlash_ros.control import Gains
from backlash_ros.control.tick import MISSING
from backlash_ros.drivetrain import Drive

TAIL, SETTLING = 1.0, 0.3
"""Time over which a residual is taken, and after a disturbance until it may be, s."""

LABELS = {"fast": "fast gains alone", "overdamped": "over-damped gains alone", "two_region": "two-region law"}


@dataclass(frozen=True)
class Interval:
    """A part of a recording: ``start`` and ``end``, s since the epoch, and the target, rad."""

    start: float
    end: float
    target: float


@dataclass(frozen=True)
class LoadStep:
    """What a step of load torque did: torque and its estimate at the end (N m), largest and last error (b)."""

    torque: float
    estimate: float
    largest_error: float
    final_error: float
    residual: float


def gap(recording_rows: NDArray[np.float64], drive: Drive) -> NDArray[np.float64]:
    """Return R1 theta_m - R2 theta_l, m, of joint-state rows."""
    return drive.gear.motor_radius * recording_rows[:, 0] - drive.gear.load_radius * recording_rows[:, 3]


def late_answers(samples: NDArray[np.float64], answers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the times of the samples, in s, that had no answer before the next one, or whose next one came late."""
    passed = np.diff(samples)
    unanswered = np.diff(np.searchsorted(answers, samples)) == 0
    late: NDArray[np.float64] = samples[:-1][unanswered | (passed > MISSING * np.median(passed))]
    return late


def quiet_end(recording: Recording, interval: Interval) -> float | None:
    """Return the end of the last stretch in which the loop ran as it should: every sample answered in its period.

    A shared machine is late now and then, and a late answer widens a limit cycle for a while. The stretch lies in the
    second half of the interval; None where there is none.
    """
    samples = recording.joint_states.between(interval.start, interval.end).time
    answers = recording.scalars["/command"].between(interval.start, interval.end).time
    return last_quiet(samples, answers, 0.5 * (interval.start + interval.end))


def last_quiet(samples: NDArray[np.float64], answers: NDArray[np.float64], middle: float) -> float | None:
    """Return the end of the last stretch after ``middle`` without a late answer that is long enough, s, or None."""
    late = late_answers(samples, answers)
    edges = np.array([middle, *late[late > middle], samples[-1]])
    long_enough = np.flatnonzero(np.diff(edges) >= TAIL + SETTLING)
    return float(edges[long_enough[-1] + 1]) if long_enough.size else None


def judge_step(recording: Recording, interval: Interval, drive: Drive) -> StepResponse:
    """Return the metrics of the step response in ``interval``; its residual is taken at a `quiet_end`, if any."""
    part = recording.joint_states.between(interval.start, interval.end)
    end = quiet_end(recording, interval) or interval.end
    tail = recording.joint_states.between(end - TAIL, end).values[:, 3]
    residual = float(np.ptp(tail)) / drive.gear.backlash_angle
    response = step_response(
        part.time - interval.start,
        part.values[:, 3],
        gap(part.values, drive),
        target=interval.target,
        backlash=drive.gear.backlash,
        backlash_angle=drive.gear.backlash_angle,
    )
    return replace(response, residual=residual)


def in_time(recording: Recording, interval: Interval, rising: float) -> dict[str, bool]:
    """Return what of a response says something of the law: no sample was late while ``rising``, s, or at the end."""
    samples = recording.joint_states.between(interval.start, interval.start + rising).time
    answers = recording.scalars["/command"].between(interval.start, interval.start + rising).time
    late = late_answers(samples, answers)
    return {"rising": not late.size, "end": quiet_end(recording, interval) is not None}


def judge_load_step(recording: Recording, interval: Interval, torque: float, drive: Drive) -> LoadStep:
    """Return what a load torque put on at the start of ``interval`` did."""
    part = recording.joint_states.between(interval.start, interval.end)
    b = drive.gear.backlash_angle
    error = (part.values[:, 3] - interval.target) / b
    estimates = recording.scalars["/controller/state/load_torque"].between(interval.start, interval.end)
    tail = error[part.time >= interval.end - 1.0]
    return LoadStep(
        torque=torque,
        estimate=float(estimates.values[-1]),
        largest_error=float(np.max(np.abs(error))),
        final_error=float(np.mean(tail)),
        residual=float(np.ptp(tail)),
    )


def swap_delay(
    recording: Recording, swapped: float, before: Gains, after: Gains, interval: Interval, torque_constant: float
) -> float:
    """Return the time from ``swapped`` to the first command that the new gains made, s; nan where none did.

    A command is the new gains' where it lies closer to what eq 15 gives with them, on the sample that it answers,
    than to what it gives with the old ones.
    """
    samples = recording.joint_states
    commands = recording.scalars["/command"].between(swapped, interval.end)
    for time, voltage in zip(commands.time, commands.values, strict=True):
        _, _, torque, angle, speed, _ = samples.values[np.searchsorted(samples.time, time) - 1]
        state = np.array([angle - interval.target, speed, torque / torque_constant])
        old, new = (-float(gains.as_array() @ state) for gains in (before, after))
        if abs(voltage - new) < abs(voltage - old):
            return float(time - swapped)
    return float("nan")
