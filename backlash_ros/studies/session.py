"""Judging a recorded session in lockstep: step responses, a swap of gains, load steps; in numbers."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.recordings.bag import Recording
from backlash_ros.studies.metrics import Array, step_response

PAPER = ("fast", "overdamped", "two_region")
COMPARED = ("two_region", "planned")
"""The laws of the paper; its adaptive one, and ours."""
LABELS = {
    "fast": "fast gains alone",
    "overdamped": "over-damped gains alone",
    "two_region": "two-region law (paper)",
    "planned": "planned moves (ours)",
}
_MOVED = 0.01
"""Distance from rest that shows that a load torque acts, in b."""


@dataclass(frozen=True)
class Interval:
    """A part of a recording: stamps of its first and last sample, s, and the target, rad."""

    start: float
    end: float
    target: float


def gap(recording_rows: Array, drive: Drive) -> Array:
    """Return R1 theta_m - R2 theta_l, m, of joint-state rows."""
    return drive.gear.motor_radius * recording_rows[:, 0] - drive.gear.load_radius * recording_rows[:, 3]


def judge_step(recording: Recording, interval: Interval, drive: Drive) -> dict[str, float]:
    """Return the metrics of the step response in ``interval``, and when it settled within b/4, s.

    It must stay there to the end and for at least the last second; inf if it never does.
    """
    part = recording.joint_states.between(interval.start, interval.end)
    time, angle, gear = part.time - interval.start, part.values[:, 3], drive.gear
    lengths = {"backlash": gear.backlash, "backlash_angle": gear.backlash_angle}
    return asdict(step_response(time, angle, gap(part.values, drive), target=interval.target, **lengths))


def came_on(recording: Recording, interval: Interval, drive: Drive) -> Interval:
    """Return ``interval`` from the last sample before a load torque moved the load."""
    part = recording.joint_states.between(interval.start, interval.end)
    way = np.abs(part.values[:, 3] - part.values[0, 3]) / drive.gear.backlash_angle
    return replace(interval, start=float(part.time[max(int(np.argmax(way > _MOVED)) - 1, 0)]))


def judge_load_step(recording: Recording, interval: Interval, torque: float, drive: Drive) -> dict[str, float]:
    """Return the effect of a load torque that begins at the start of ``interval``.

    The torque and its estimate at the end, N m; in b the largest error, and in the last second the mean error and the
    swing, peak to peak.
    """
    part = recording.joint_states.between(interval.start, interval.end)
    error = (part.values[:, 3] - interval.target) / drive.gear.backlash_angle
    estimates = recording.scalars["/controller/state/load_torque"].between(interval.start, interval.end)
    tail = error[part.time >= interval.end - 1.0]
    return {
        "torque": torque,
        "estimate": float(estimates.values[-1]),
        "largest_error": float(np.max(np.abs(error))),
        "final_error": float(np.mean(tail)),
        "residual": float(np.ptp(tail)),
    }


def judge_swap(recording: Recording, interval: Interval, drive: Drive) -> dict[str, Any]:
    """Return the load's speed when the over-damped gains were swapped, rad/s, and whether commands mix the gains.

    ``commands``: their number; ``mixed``: how many are closer to eq 15 with the gains that were not in force for their
    sample.
    """
    names = ("parameters_version", "load_angle", "load_velocity", "current", "load_torque", "range_low", "range_high")
    told = {
        name: recording.scalars[f"/controller/state/{name}"].between(interval.start, interval.end)
        for name in (*names, "command")
    }
    version, angle, speed, current, torque, low, high, command = (series.values for series in told.values())
    gains = {number: values["gains.overdamped.k"] for _, number, values in recording.in_use if number in version}
    (before, old), (after, new) = sorted(gains.items())
    motor = drive.motor
    ways = []
    for k1, k2, k3 in (old, new):
        feedforward = -drive.gear.ratio * (motor.resistance + k3) / motor.torque_constant
        wanted = feedforward * torque - k1 * (angle - interval.target) - k2 * speed - k3 * current
        ways.append(np.abs(np.clip(wanted, low, high) - command))
    in_force, other = np.where(version == before, ways, ways[::-1])
    return {
        "speed": float(speed[np.argmax(version == after)]),
        "commands": command.size,
        "mixed": int(np.sum(in_force > other)),
    }
