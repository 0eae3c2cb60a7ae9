"""The backlash from this recording alone, with its uncertainty: by a fit to a learning run, or to all of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from backlash_ros.control.monitoring.beat import Beat
from backlash_ros.drivetrain import Drive
from backlash_ros.identification.recording import Recording, with_late_answers
from backlash_ros.identification.recordings.identify import identify
from backlash_ros.pages.report.events import LearningRun
from backlash_ros.pages.report.timing import period_of
from backlash_ros.recordings.axes.axes import joint_columns
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.recordings.axes.contents import Contents
from backlash_ros.recordings.axes.options import Options
from backlash_ros.recordings.bag_topics import Messages, columns_of
from backlash_ros.recordings.samples import Columns, drive_for, recording_of

_BEFORE = 1.0
"""Time before a learning run that shows the usual delay of answers, s."""
_FEWEST = 10
"""Samples of a learning run."""


@dataclass(frozen=True)
class GapFound:
    """The backlash at the output, rad, its standard uncertainty and the part that it is from; or why there is none."""

    angle: float = math.nan
    uncertainty: float = math.nan
    part: str = ""
    why: str = ""

    @property
    def told(self) -> bool:
        """Whether there is a value."""
        return not self.why


def _ns(seconds: float) -> int:
    return round(1e9 * seconds)


def _columns(path: Path, axis: Axis, contents: Contents, options: Options) -> Columns:
    """Return the axis's samples and commands for identification."""
    samples, joints = contents.samples[axis.joint_topic], (axis.motor_joint, axis.load_joint)
    motor, load = (joint_columns(samples, joint)[:, 0].tolist() for joint in joints)
    index = options.topics.index
    commands = [
        (_ns(said.received), None if math.isnan(said.answers) else _ns(said.answers), float(said.values[index]))
        for said in contents.numbers[axis.command_topic]
        if index < len(said.values)
    ]
    found = Messages(
        [_ns(sample.stamp) for sample in samples],
        [_ns(sample.received) for sample in samples],
        list(zip(motor, load, strict=True)),
        commands,
        set(joints),
    )
    topics = replace(options.topics, motor_joint=joints[0], load_joint=joints[1])
    return columns_of(found, axis.joint_topic, axis.command_topic, topics, path)


def _run_of(axis: Axis, run: LearningRun) -> Recording | None:
    """Return the samples of a learning run, with what is known of late answers; None without samples."""
    place = {stamp: k for k, stamp in enumerate(axis.stamps)}
    answers = (
        {
            place[stamp]: (value, at)
            for stamp, value, at in zip(axis.answered, axis.command.values, axis.command.time, strict=True)
            if stamp in place
        }
        if axis.command is not None
        else {}
    )
    told = axis.versions[-1][2].get("rate") if axis.versions else None
    period = 1.0 / told if told else period_of(axis.time)
    beat, rows, command, time, before = Beat(period), [], 0.0, 0.0, math.nan
    for k in np.flatnonzero((axis.time >= run.start - _BEFORE) & (axis.time <= run.end)).tolist():
        periods, late = beat.sample(float(axis.time[k] - before))
        before, time = float(axis.time[k]), time + periods * period
        if k in answers:
            command, at = answers[k]
            beat.answered(at)
        if axis.time[k] >= run.start:
            rows.append((time, axis.motor[k] * axis.ratio, axis.load[k], command, late))
    if len(rows) < _FEWEST or not answers:
        return None
    times, motor, load, commands, lateness = np.array(rows).T
    return with_late_answers(times, motor, load, commands, np.append(lateness[1:], 0.0), period)


def _found_in(drive: Drive, recording: Recording, part: str) -> GapFound:
    found = identify(drive, recording, hold_out=False)
    if found.gap is not None and found.gap.valid and not found.reason:
        gap = found.of("b")
        return GapFound(gap.value, gap.uncertainty, part or found.stretch or "all of the recording")
    return GapFound(why=found.reason or (found.gap.reason if found.gap is not None else "there is no motion"))


def gap_found(path: Path, axis: Axis, contents: Contents, options: Options, runs: Sequence[LearningRun]) -> GapFound:
    """Return the backlash of an axis: from the first learning run that shows it, else from the whole recording."""
    if axis.drive is None:
        return GapFound(why="motor and gear are not known: give them with --drive")
    for joint, shaft in ((axis.motor_joint, "motor"), (axis.load_joint, "load")):
        if not joint:
            return GapFound(why=f"the {shaft}'s angle is not in the recording")
    if not axis.command_topic:
        return GapFound(why="commands are not in the recording")
    drive = drive_for(axis.drive, options.reading)
    for run in reversed([run for run in runs if run.ended and math.isfinite(run.learned)]):
        part = _run_of(axis, run)
        if part is not None and (found := _found_in(drive, part, f"the learning run at {run.start:.2f} s")).told:
            return found
    try:
        recording, _ = recording_of(_columns(path, axis, contents, options), options.reading, drive)
    except ValueError as error:
        return GapFound(why=str(error).removeprefix(f"{path}: "))
    return _found_in(drive, recording, "")
