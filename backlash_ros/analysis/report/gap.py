"""The backlash as this recording alone tells it, with its uncertainty: by a fit to a learning run, or to all of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from backlash_ros.analysis.recordings.bag_topics import Messages, columns_of
from backlash_ros.analysis.recordings.samples import Columns, drive_for, recording_of
from backlash_ros.analysis.report.events import LearningRun
from backlash_ros.analysis.report.reading.axes import Axis, joint_columns
from backlash_ros.analysis.report.reading.contents import Contents
from backlash_ros.analysis.report.reading.options import Options
from backlash_ros.identification.recordings.identify import identify

_BEFORE, _AFTER = 0.1, 0.1
"""Time around a learning run that is read too, s."""


@dataclass(frozen=True)
class GapFound:
    """The backlash at the output, rad, its standard uncertainty, and the part that tells it; else why there is none."""

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
    """Return the axis's samples and commands as identification takes them."""
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


def gap_found(path: Path, axis: Axis, contents: Contents, options: Options, runs: Sequence[LearningRun]) -> GapFound:
    """Return what the recording of an axis tells of its backlash: a learning run that tells it, else all of it."""
    if axis.drive is None:
        return GapFound(why="motor and gear are not known: give them with --drive")
    for joint, shaft in ((axis.motor_joint, "motor"), (axis.load_joint, "load")):
        if not joint:
            return GapFound(why=f"the {shaft}'s angle is not in the recording")
    if not axis.command_topic:
        return GapFound(why="commands are not in the recording")
    try:
        columns = _columns(path, axis, contents, options)
    except ValueError as error:
        return GapFound(why=str(error).removeprefix(f"{path}: "))
    first, why, drive = axis.time[0], "", drive_for(axis.drive, options.reading)
    parts = [
        (max(0.0, run.start - first - _BEFORE), run.end - first + _AFTER, f"the learning run at {run.start:.2f} s")
        for run in reversed([run for run in runs if run.ended])
        if math.isfinite(run.learned)
    ]
    for start, end, name in [*parts, (0.0, math.inf, "")]:
        try:
            recording, _ = recording_of(columns, replace(options.reading, start=start, end=end), drive)
            found = identify(drive, recording, hold_out=False)
        except ValueError as error:
            why = str(error)
            continue
        if found.gap is not None and found.gap.valid and not found.reason:
            gap = found.of("b")
            return GapFound(gap.value, gap.uncertainty, name or found.stretch or "all of the recording")
        why = found.reason or (found.gap.reason if found.gap is not None else "")
    return GapFound(why=why)
