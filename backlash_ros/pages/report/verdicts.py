"""How an axis went, in a line for each thing that matters, and whether that is good."""

import math
from typing import NamedTuple

from backlash_ros.pages.report.cures import cure
from backlash_ros.pages.report.outcome import RESTLESS, SETTLED, SWINGS, ending, rattled, trouble
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.steps import Step
from backlash_ros.pages.report.words import in_b, moment
from backlash_ros.recordings.rounding import brief, counted

GOOD, DOUBT, BAD = "", "doubt", "bad"
"""Classes of the page's style: green, amber and red."""
DOUBTFUL = 0.01
"""Share of samples missing or late above which the page warns."""


class Verdict(NamedTuple):
    """A line of the first screen; ``tone``: `GOOD`, `DOUBT` or `BAD`."""

    tone: str
    text: str


def _often(step: Step) -> str:
    return "unevenly" if math.isnan(step.frequency) else f"at {brief(step.frequency)}\u00a0Hz"


def _swing(report: AxisReport, step: Step) -> str:
    """Return a limit cycle in words, and what to do about it."""
    return f"{in_b(report, step.amplitude)} {report.unit} peak to peak, {_often(step)}{_to_end_it(report, step)}"


def _to_end_it(report: AxisReport, step: Step) -> str:
    act = cure(report.axis, step, report.steps)
    return f". To end it, {act}" if act else ""


def _worst(report: AxisReport) -> str:
    """Return which of several steps was the worst, how bad it was, and what to do about it; empty if none was bad."""
    steps = report.steps
    bad = [k for k, step in enumerate(steps) if ending(step) in RESTLESS]
    found = bad or [k for k, step in enumerate(steps) if rattled(step)]
    if not found:
        return ""
    worst = max(found, key=lambda k: trouble(steps[k]))
    step, most = steps[worst], " most" if len(found) > 1 else ""
    named = f". Step {worst + 1}{f' with law {step.law}' if step.law else ''}"
    if not bad:
        impacts = f"{counted(step.impacts, 'impact')}{_to_end_it(report, step)}"
        return f"{named} rattled{most} on its way: {impacts}"
    if ending(step) == SWINGS:
        return f"{named} swung{most}: {_swing(report, step)}"
    if len(steps) == 1:  # its row says the same
        return ""
    off = f", {in_b(report, abs(step.error))} {report.unit} off its target" if abs(step.error) > step.band else ""
    moved = f"{in_b(report, step.residual)} {report.unit} peak to peak in its last second{off}"
    act = _to_end_it(report, step) if step.residual > 2.0 * step.band else ""
    return f"{named} was the furthest from settled: {moved}{act}"


def _steps_verdict(report: AxisReport) -> Verdict:
    ends = [ending(step) for step in report.steps]
    said = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys([SETTLED, *ends]) if end in ends)
    tone = BAD if set(RESTLESS) & set(ends) else DOUBT if any(map(rattled, report.steps)) else GOOD
    return Verdict(tone, f"{counted(len(ends), 'step')}: {said}{_worst(report)}")


def verdicts_of(report: AxisReport) -> list[Verdict]:
    """Return in a line how the steps went, in others what else is bad, and what makes the recording doubtful."""
    timing = report.timing
    lines = []
    if report.steps:
        lines.append(_steps_verdict(report))
    if judged := [path.figures for path in report.paths if path.figures is not None]:
        largest = max(figures.largest for figures in judged)
        well = largest <= (report.b if report.b > 0.0 else math.inf)
        lines.append(
            Verdict(
                GOOD if well else BAD,
                f"{counted(len(judged), 'path')}: at most {in_b(report, largest)} {report.unit} off",
            )
        )
    for hold in report.holds:
        if math.isfinite(hold.amplitude):
            said = f"A limit cycle while the reference stood still at {brief(hold.target, 4)} rad"
            when = f"{moment(hold.start)} to {moment(hold.end)} s"
            lines.append(Verdict(BAD, f"{said}, {when}: {_swing(report, hold)}"))
    if report.events.faults:
        names = ", ".join(dict.fromkeys(fault.name for fault in report.events.faults))
        lines.append(Verdict(BAD, f"{counted(len(report.events.faults), 'fault')}: {names}"))
    if timing and timing.lost + timing.unanswered > DOUBTFUL * timing.samples:
        lines.append(
            Verdict(
                BAD,
                f"of {timing.samples + timing.lost} samples {timing.lost} are missing and {timing.unanswered} were not "
                "answered within their period: what the load does here may be due to the machine's timing",
            )
        )
    return lines
