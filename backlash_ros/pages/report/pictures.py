"""The charts of an axis: all of it, each step, learning run and fault by itself, and the timing of its samples."""

import math

import numpy as np

from backlash_ros.foundation.record import Array
from backlash_ros.pages.report.charts import Chart, Line, Panel, held
from backlash_ros.pages.report.events import FaultSeen, LearningRun
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.steps import Mask, Step
from backlash_ros.recordings.bag import Series

_AROUND = 0.05
"""Time before a step that its chart shows, too, s."""
_ROOM = 1.3
"""Range that is shown near the target, as a multiple of the largest relevant value there."""


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
    if not math.isfinite(report.centre):
        return []
    twist = (axis.twist[part] - report.centre) / b
    return [Panel("teeth in the gap, b", [Line("gap", axis.time[part], twist, "motor")], at=(-0.5, 0.5))]


def _part(report: AxisReport, start: float, end: float) -> Mask:
    return (report.axis.time >= start) & (report.axis.time <= end)


def _marks(report: AxisReport, start: float, end: float) -> list[tuple[float, str]]:
    """Return the changes of parameters that move the loop, load torques and faults in a stretch."""
    events = report.events
    marks = [
        (change.time, next((n for n in ("law", "gain_set") if n in change.values), "parameters"))
        for change in events.changes
        if change.moves
    ]
    marks += [(time, f"{torque:g} N m") for time, torque in events.torques]
    marks += [(fault.start, fault.name) for fault in events.faults]
    return [mark for mark in marks if start <= mark[0] <= end]


def overview(report: AxisReport) -> Chart:
    """Return the chart of all of an axis."""
    part = np.ones(report.axis.time.size, dtype=bool)
    marks = [(step.start, f"{k}") for k, step in enumerate(report.steps, 1)]
    marks += [(fault.start, fault.name) for fault in report.events.faults]
    last = float(report.axis.time[-1])
    spans = [(run.start, min(run.end, last), f"run {k}") for k, run in enumerate(report.events.runs, 1)]
    told = ["Numbered: steps."] * bool(report.steps) + ["Shaded: learning runs."] * bool(spans)
    return Chart("All of it", " ".join(told), [_angles(report, part), *_effort(report, part)], marks, spans)


def _near(report: AxisReport, step: Step, part: Mask) -> list[Panel]:
    """Return the load near the target, in b, or in mrad if the backlash is unknown."""
    axis = report.axis
    unit, scale = ("b", report.b) if report.b > 0.0 else ("mrad", 1e-3)
    largest = [abs(step.target - step.origin) * 0.02, 4.0 * step.band, step.overshoot, step.residual + abs(step.error)]
    room = _ROOM * max(value for value in largest if math.isfinite(value)) / scale
    room = float(f"{room:.2g}")
    error = (axis.position[part] - step.target) / scale
    band = step.band / scale
    line = Line("load from target", axis.time[part], error, "load")
    return [Panel(f"load from target, {unit}", [line], bands=[(-band, band)], at=(0.0,), low=-room, high=room)]


def step_chart(report: AxisReport, number: int, told: str) -> Chart:
    """Return the chart of one step, in full resolution; ``told`` are its figures in words."""
    step = report.steps[number - 1]
    start = step.start - _AROUND
    part = _part(report, start, step.end)
    panels = [_angles(report, part), *_near(report, step, part), *_gap(report, part), *_effort(report, part)]
    return Chart(f"Step {number}", told, panels, _marks(report, start, step.end))


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
