"""The content of a report, for page and JSON: every axis of a bag with its events, steps, timing and gap."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.pages.report.events import Events, events_of
from backlash_ros.pages.report.gap import GapFound, gap_found
from backlash_ros.pages.report.paths import FollowedPath, paths_of
from backlash_ros.pages.report.steps import Step, holds_of, steps_of
from backlash_ros.pages.report.timing import Timing, timing_of
from backlash_ros.pages.report.torques import LoadTorque, torques_of
from backlash_ros.pages.report.warned import Warned, warnings_of
from backlash_ros.pages.report.yardstick import Yardstick, yardstick_of
from backlash_ros.recordings.axes.axes import axes_of
from backlash_ros.recordings.axes.axis import Axis, backlash_in_use
from backlash_ros.recordings.axes.contents import Contents, read_contents
from backlash_ros.recordings.axes.options import Options
from backlash_ros.recordings.samples import DATES

_SAME_CLOCK = 0.03
"""Relative difference of two lengths of a recording that is no other pace of a clock."""


@dataclass(frozen=True)
class AxisReport:
    """An axis and its figures; ``holds`` are rests that no step led to, ``paths`` what was no step.

    ``yard``: what it is measured by; the unit of the figures is its backlash ``b``, rad, from ``b_source``.
    """

    axis: Axis
    events: Events
    steps: Sequence[Step]
    holds: Sequence[Step]
    paths: Sequence[FollowedPath]
    torques: Sequence[LoadTorque]
    timing: Timing | None
    gap: GapFound
    yard: Yardstick
    b_source: str

    @property
    def b(self) -> float:
        """The backlash, rad; 0 if unknown."""
        return self.yard.b

    @property
    def unit(self) -> str:
        """The unit of lengths near the target."""
        return "b" if self.b > 0.0 else "mrad"

    @property
    def scale(self) -> float:
        """That unit, rad."""
        return self.b if self.b > 0.0 else 1e-3


@dataclass(frozen=True)
class Report:
    """The report of a bag; ``source`` is its path, ``command`` the command line that makes the report."""

    source: str
    command: str
    contents: Contents
    axes: Sequence[AxisReport]
    warnings: Sequence[Warned]

    @property
    def began(self) -> datetime | None:
        """When the first message was recorded, UTC; None if the recorder's clock shows no date."""
        start = self.contents.start
        return datetime.fromtimestamp(start, timezone.utc) if DATES[0] <= start <= DATES[1] else None

    @property
    def length(self) -> float:
        """Time from the first to the last message, s; 0 without messages."""
        length = self.contents.end - self.contents.start
        return 0.0 if math.isnan(length) else length

    @property
    def own_length(self) -> float:
        """Time from the first to the last sample by the axes' own clock, s; nan where that is the recorder's time."""
        lengths = [axis.timing.length for axis in self.axes if axis.axis.clock and axis.timing]
        longest = max(lengths, default=math.nan)
        return math.nan if abs(longest - self.length) < _SAME_CLOCK * self.length else longest


def _axis_report(path: Path, axis: Axis, contents: Contents, options: Options) -> AxisReport:
    events = events_of(axis, contents.told)
    gap = gap_found(path, axis, contents, options, events.runs)
    b, source = backlash_in_use(axis)
    if not b > 0.0 and options.backlash_angle > 0.0:
        b, source = options.backlash_angle, "--backlash-angle"
    if not b > 0.0 and gap.told:
        b, source = gap.angle, "the estimate from this recording"
    yard = yardstick_of(axis, b)
    steps = steps_of(axis, events, yard)
    return AxisReport(
        axis,
        events,
        steps,
        holds_of(axis, events, steps, yard),
        paths_of(axis, events, yard),
        torques_of(axis, events, yard),
        timing_of(axis),
        gap,
        yard,
        source,
    )


def report_of(path: Path, options: Options, command: str) -> Report:
    """Return the report of a bag.

    Raises
    ------
    OSError, ValueError
        If there is no bag, or an option does not fit it, which is named.
    """
    contents = read_contents(path)
    axes = [_axis_report(path, axis, contents, options) for axis in axes_of(contents, options)]
    return Report(str(path), command, contents, axes, warnings_of(contents, [(axis.axis, axis.steps) for axis in axes]))


def _step(step: Step, b: float) -> dict[str, Any]:
    values = asdict(step)
    in_b = {f"{name}_b": values[name] / b for name in ("overshoot", "residual", "error", "amplitude") if b > 0.0}
    counts = {name: None if values[name] < 0 else values[name] for name in ("impacts", "crossings")}
    return {**values, **in_b, **counts}


def _path(path: FollowedPath, b: float) -> dict[str, Any]:
    values = asdict(path)
    figures = values.pop("figures") or {}
    in_b = {f"{name}_b": figures[name] / b for name in ("rms", "largest", "final") if figures and b > 0.0}
    return {**values, **figures, **in_b, "impacts": None if path.impacts < 0 else path.impacts}


def _axis_content(report: AxisReport) -> dict[str, Any]:
    axis, events = report.axis, report.events
    return {
        "name": axis.name,
        "clock": axis.clock or "seconds from the start of the bag",
        "joint_topic": axis.joint_topic,
        "motor_joint": axis.motor_joint,
        "load_joint": axis.load_joint,
        "reference": axis.reference_source,
        "command": axis.command_topic,
        "drive": axis.drive_source,
        "backlash_angle": report.b if report.b > 0.0 else None,
        "backlash_angle_from": report.b_source,
        "estimate": {**asdict(report.gap), "told": report.gap.told},
        "steps": [_step(step, report.b) for step in report.steps],
        "holds": [_step(hold, report.b) for hold in report.holds],
        "paths": [_path(path, report.b) for path in report.paths],
        "load_torques": [asdict(torque) for torque in report.torques],
        "learning_runs": [run._asdict() for run in events.runs],
        "changes": [
            {"time": change.time, "values": {name: list(both) for name, both in change.values.items()}}
            for change in events.changes
        ],
        "faults": [fault._asdict() for fault in events.faults],
        "timing": None if report.timing is None else asdict(report.timing),
        "notes": list(axis.notes),
        "missing": list(axis.missing),
    }


def content_of(report: Report) -> dict[str, Any]:
    """Return all numbers of a report, ready for JSON: angles in rad at the output, times in s, torque in N m."""
    content = {
        "bag": report.source,
        "began": None if report.began is None else report.began.isoformat(),
        "length": report.length,
        "own_length": report.own_length,
        "damage": report.contents.damage,
        "topics": {name: {"type": kind, "messages": n} for name, (kind, n) in report.contents.topics.items()},
        "axes": [_axis_content(axis) for axis in report.axes],
        "diagnostics": [asdict(warned) for warned in report.warnings],
    }
    result: dict[str, Any] = jsonable(content)
    return result
