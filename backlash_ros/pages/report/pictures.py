"""The charts of an axis: all of it, each step, learning run and fault by itself, and the timing of its samples."""

import math
from typing import NamedTuple

import numpy as np

from backlash_ros.foundation.record import Array
from backlash_ros.pages.report.charts import Chart, Line, Panel
from backlash_ros.pages.report.events import FaultSeen, LearningRun, held
from backlash_ros.pages.report.paths import FollowedPath, error_of
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.steps import Mask, Step
from backlash_ros.recordings.bag import Series
from backlash_ros.recordings.rounding import brief

_AROUND = 0.05
"""Time before a step that its chart shows, too, s."""
_MARGIN = 1.3
"""Range that is shown near the target, as a multiple of the largest relevant value there."""


SKETCH, ROOM = 2.0, 1.0
"""Time that the sketch of a step shows, s, and how far from the target, to either side, b."""
WIDE, HIGH = 120, 32
"""Size of a sketch."""


class Sketch(NamedTuple):
    """A step in a small picture of `WIDE` by `HIGH`: the load near its target; ``path`` and ``band`` in its units."""

    path: str
    band: tuple[float, float]
    told: str


def sketch(report: AxisReport, step: Step) -> Sketch:
    """Return the sketch of a step: of each column the least and the largest value."""
    part = _part(report, step.start, min(step.end, step.start + SKETCH))
    room = ROOM * report.b if report.b > 0.0 else 4.0 * step.band
    time, error = report.axis.time[part] - step.start, (report.axis.position[part] - step.target) / room
    seen = np.isfinite(error)
    column = np.minimum((time[seen] / SKETCH * WIDE).astype(int), WIDE - 1)
    height = 0.5 * HIGH * (1.0 - np.clip(error[seen], -1.0, 1.0))
    points = []
    for at in np.unique(column):
        values = height[column == at]
        points += [f"{at} {value:.1f}" for value in dict.fromkeys((float(np.max(values)), float(np.min(values))))]
    half = 0.5 * HIGH * step.band / room
    told = f"the load about its target, up to {room:.2g} rad, for {SKETCH:g} s"
    return Sketch(f"M{'L'.join(points)}" if points else "", (0.5 * HIGH - half, 2.0 * half), told)


def _known(values: Array) -> bool:
    return bool(np.any(np.isfinite(values)))


def _angles(report: AxisReport, part: Mask) -> Panel:
    axis = report.axis
    time, lines = axis.time[part], []
    if axis.reference is not None:
        lines.append(Line("reference", time, held(axis.reference, time), "ink", dashed=True, step=True))
    if axis.drive is not None and _known(axis.motor):
        lines.append(Line("motor through the gear", time, axis.motor[part] * axis.ratio, "motor"))
    elif _known(axis.motor):
        lines.append(Line("motor, before the gear", time, axis.motor[part], "motor"))
    if _known(axis.load):
        lines.append(Line("load", time, axis.load[part], "load"))
    return Panel("angle, rad", lines)


def _effort(report: AxisReport, part: Mask) -> list[Panel]:
    """Return the command, and the motor's torque if it was recorded."""
    axis, panels = report.axis, []
    time = axis.time[part]
    if not time.size:
        return []
    if axis.command is not None and axis.command.time.size:
        shown: Series = axis.command.between(float(time[0]), float(time[-1]))
        unit = f", {axis.command_unit}" if axis.command_unit else ""
        panels.append(Panel(f"command{unit}", [Line("command", shown.time, shown.values, "good", step=True)]))
    if _known(axis.torque[part]):
        panels.append(Panel("motor torque, N m", [Line("motor torque", time, axis.torque[part], "motor")]))
    return panels


def _gap(report: AxisReport, part: Mask) -> list[Panel]:
    axis, b = report.axis, report.b
    if not math.isfinite(report.yard.centre):
        return []
    twist = (axis.twist[part] - report.yard.centre) / b
    gap = Line("gap", axis.time[part], twist, "motor")
    return [Panel("teeth in the gap, b; dotted: the flanks", [gap], at=(-0.5, 0.5))]


def _part(report: AxisReport, start: float, end: float) -> Mask:
    return (report.axis.time >= start) & (report.axis.time <= end)


def _disturbances(report: AxisReport) -> list[tuple[float, str]]:
    """Return the changes of the load torque and the faults."""
    marks = [(time, f"{torque:g} N m") for time, torque in report.events.torques]
    return [*marks, *((fault.start, fault.name) for fault in report.events.faults)]


def _marks(report: AxisReport, start: float, end: float) -> list[tuple[float, str]]:
    """Return the changes of parameters that move the loop, load torques and faults in a stretch."""
    events = report.events
    marks = [
        (change.time, next((n for n in ("law", "gain_set") if n in change.values), "parameters"))
        for change in events.changes
        if change.moves
    ]
    return [mark for mark in (*marks, *_disturbances(report)) if start <= mark[0] <= end]


def overview(report: AxisReport) -> Chart:
    """Return the chart of all of an axis."""
    part = np.ones(report.axis.time.size, dtype=bool)
    marks = [(step.start, f"{k}") for k, step in enumerate(report.steps, 1)]
    marks += _disturbances(report)
    last = float(report.axis.time[-1])
    spans = [(run.start, min(run.end, last), f"run {k}") for k, run in enumerate(report.events.runs, 1)]
    told = ["Numbered: steps."] * bool(report.steps) + ["Shaded: learning runs."] * bool(spans)
    told += ["In N m: load torques."] * bool(report.torques)
    return Chart("All of it", " ".join(told), [_angles(report, part), *_effort(report, part)], marks, spans)


def _near(report: AxisReport, step: Step, part: Mask) -> list[Panel]:
    """Return the load near the target, in b, or in mrad if the backlash is unknown."""
    axis = report.axis
    largest = [abs(step.target - step.origin) * 0.02, 4.0 * step.band, step.overshoot, step.residual + abs(step.error)]
    room = _MARGIN * max(value for value in largest if math.isfinite(value)) / report.scale
    room = float(f"{room:.2g}")
    error = (axis.position[part] - step.target) / report.scale
    band = step.band / report.scale
    line = Line("load from target", axis.time[part], error, "load")
    return [Panel(f"load from target, {report.unit}", [line], bands=[(-band, band)], at=(0.0,), low=-room, high=room)]


def step_chart(report: AxisReport, number: int, outcome: str, told: str) -> Chart:
    """Return the chart of one step, in full resolution; how it ended and, ``told``, its figures in words."""
    step = report.steps[number - 1]
    start = step.start - _AROUND
    part = _part(report, start, step.end)
    panels = [_angles(report, part), *_near(report, step, part), *_gap(report, part), *_effort(report, part)]
    title = f"Step {number}: {brief(step.origin, 4)} to {brief(step.target, 4)} rad"
    title = f"{title}{f', law {step.law}' if step.law else ''}: {outcome}"
    return Chart(title, told, panels, _marks(report, start, step.end))


def path_chart(report: AxisReport, number: int, path: FollowedPath) -> Chart:
    """Return the chart of one path and of the load's error."""
    start, end = path.start - _AROUND, path.end + 10.0 * _AROUND
    part, (time, setpoint, error) = _part(report, start, end), error_of(report.axis, start, end)
    off = Line("load from setpoint", time, error / report.scale, "load")
    panels = [
        Panel(
            "load, rad",
            [Line("setpoint", time, setpoint, "ink", dashed=True), Line("load", time, setpoint + error, "load")],
        ),
        Panel(f"load from setpoint, {report.unit}", [off], at=(0.0,)),
        *_gap(report, part),
        *_effort(report, part),
    ]
    title = f"Path {number}: {brief(path.origin, 4)} to {brief(path.target, 4)} rad"
    told = f"{path.end - path.start:.2f} s, from {path.start:.3f} s on."
    return Chart(title, told, panels, _marks(report, start, end))


def run_chart(report: AxisReport, number: int, run: LearningRun) -> Chart:
    """Return the chart of a learning run."""
    part = _part(report, run.start - _AROUND, run.end + _AROUND)
    learned = f"learned b = {run.learned:.5g} rad" if math.isfinite(run.learned) else "nothing was learned"
    told = f"{run.end - run.start:.2f} s; {learned}."
    return Chart(f"Learning run {number}", told, [_angles(report, part), *_gap(report, part), *_effort(report, part)])


def fault_chart(report: AxisReport, fault: FaultSeen) -> Chart:
    """Return the chart of the second before a fault and the one after it."""
    start, end = fault.start - 1.0, fault.start + 1.0
    part = _part(report, start, end)
    panels = [_angles(report, part), *_gap(report, part), *_effort(report, part)]
    return Chart(f"Fault {fault.name}", "The second before it and the one after.", panels, _marks(report, start, end))


def timing_chart(report: AxisReport) -> Chart:
    """Return the chart of the time from sample to sample, and of their age."""
    axis = report.axis
    panels = [
        Panel(
            "from the last one, ms",
            [Line("time from the last sample", axis.time[1:], 1e3 * np.diff(axis.time), "load")],
        )
    ]
    if not axis.clock:
        age = 1e3 * (axis.received - axis.stamps)
        panels.append(Panel("age, ms", [Line("age when recorded", axis.time, age, "motor")]))
    return Chart("Timing", "Time from one sample to the next, and from its stamp to its recording.", panels)
