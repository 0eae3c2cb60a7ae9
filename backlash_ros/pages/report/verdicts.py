"""How an axis went, in a line for each thing that matters, and whether that is good."""

import math

from backlash_ros.pages.report.cures import cure
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.steps import Step
from backlash_ros.pages.report.words import NEVER, SETTLED, SWINGS, ending, in_b, moment
from backlash_ros.recordings.rounding import brief, counted

DOUBTFUL = 0.01
"""Share of samples missing or late above which the page warns."""


def _swing(report: AxisReport, step: Step) -> str:
    """Return the limit cycle of a step or hold in words, and what to do about it."""
    often = "unevenly" if math.isnan(step.frequency) else f"at {brief(step.frequency)}\u00a0Hz"
    act = cure(report.axis, step)
    return f"{in_b(report, step.amplitude)} {report.unit} peak to peak, {often}{f'. To end it, {act}' if act else ''}"


def _widest(report: AxisReport) -> str:
    """Return which step swung most, how much, and what to do about it; empty if none swung."""
    swung = [k for k, step in enumerate(report.steps) if ending(step) == SWINGS]
    if not swung:
        return ""
    most = max(swung, key=lambda k: report.steps[k].amplitude)
    law = f" with law {report.steps[most].law}" if report.steps[most].law else ""
    others = " most" if len(swung) > 1 else ""
    return f". Step {most + 1}{law} swung{others}: {_swing(report, report.steps[most])}"


def verdicts_of(report: AxisReport) -> list[tuple[bool, str]]:
    """Return in a line how the steps went, in another what makes the recording doubtful, and whether each is good."""
    steps, timing = report.steps, report.timing
    lines = []
    if steps:
        ends = [ending(step) for step in steps]
        said = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys([SETTLED, *ends]) if end in ends)
        widest = _widest(report)
        lines.append((not {SWINGS, NEVER} & set(ends), f"{counted(len(steps), 'step')}: {said}{widest}"))
    if judged := [path.figures for path in report.paths if path.figures is not None]:
        largest = max(figures.largest for figures in judged)
        well = largest <= (report.b if report.b > 0.0 else math.inf)
        lines.append((well, f"{counted(len(judged), 'path')}: at most {in_b(report, largest)} {report.unit} off"))
    for hold in report.holds:
        if math.isfinite(hold.amplitude):
            said = f"A limit cycle while the reference stood still at {brief(hold.target, 4)} rad"
            when = f"{moment(hold.start)} to {moment(hold.end)} s"
            lines.append((False, f"{said}, {when}: {_swing(report, hold)}"))
    if report.events.faults:
        names = ", ".join(dict.fromkeys(fault.name for fault in report.events.faults))
        lines.append((False, f"{counted(len(report.events.faults), 'fault')}: {names}"))
    if timing and timing.lost + timing.unanswered > DOUBTFUL * timing.samples:
        lines.append(
            (
                False,
                f"of {timing.samples + timing.lost} samples {timing.lost} are missing and {timing.unanswered} were not "
                "answered within their period: what the load does here may be due to the machine's timing",
            )
        )
    return lines
