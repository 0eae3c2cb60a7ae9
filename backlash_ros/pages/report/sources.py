"""The parts of an axis about the recording itself: timing, and what was read."""

import math

from backlash_ros.control.tick import MISSING
from backlash_ros.pages.report import pictures
from backlash_ros.pages.report.charts import ChartBook
from backlash_ros.pages.report.part import Part
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.words import milliseconds
from backlash_ros.recordings.rounding import brief, shown

_SAME = 0.05
"""Relative difference up to which the model has the backlash that is in use."""


def timing_part(report: AxisReport, book: ChartBook) -> Part | None:
    """Return the timing of the samples and of their answers."""
    timing = report.timing
    if timing is None:
        return None
    rows = [
        ("samples", f"{timing.samples} in {timing.length:.2f} s"),
        ("rate", f"{brief(timing.rate, 4)} Hz (period {brief(1e3 * timing.period, 4)} ms)"),
        ("jitter: standard deviation", f"{milliseconds(timing.jitter)} ms"),
        ("jitter: 99 % are within", f"{milliseconds(timing.jitter_99)} ms"),
        ("longest time between two samples", f"{milliseconds(timing.longest)} ms"),
        (
            "missing samples: expected at this rate, not in the bag",
            f"{timing.lost} of {timing.samples + timing.lost}; {timing.holes} holes of more than {MISSING:g} periods"
            if timing.lost
            else "none",
        ),
    ]
    if timing.repeated:
        rows.append(("samples left out: their stamps do not rise", str(timing.repeated)))
    if math.isfinite(timing.age):
        rows.append(
            (
                "age when recorded: mean, 99 % below, most",
                f"{milliseconds(timing.age, timing.age_99, timing.age_most)} ms",
            )
        )
    else:
        rows.append(("age when recorded", "not known: stamps and recorder have different clocks"))
    own, recorders = (", by the clock of the samples", ", by the recorder's") if report.axis.clock else ("", "")
    if timing.answers:
        rows.append(("commands", str(timing.answers)))
        late = f"samples without an answer within their period, or followed by a late one{own}"
        rows.append((late, str(timing.unanswered)))
    if math.isfinite(timing.answered):
        delay = f"from sample to its command, as recorded{recorders}: median, 99 % below"
        rows.append((delay, f"{milliseconds(timing.answered, timing.answered_99)} ms"))
    lost = f"{timing.lost} samples missing" if timing.lost else "none missing"
    title = f"Timing: {brief(timing.rate, 4)} Hz, {lost}"
    return Part(title, pairs=rows, charts=[book.add(pictures.timing_chart(report))])


def _model_told(report: AxisReport) -> str:
    """Return what the drive's model had for the backlash, where that was another value; else nothing."""
    told = [values.get("gear.backlash_angle") for _, _, values in report.axis.versions]
    if not told or told[0] is None or math.isclose(told[0], report.b, rel_tol=_SAME):
        return ""
    later = " at first" if told[-1] != told[0] else ""
    return f" The model's gear.backlash_angle, {told[0]:.4g} rad{later}, differs from it."


def backlash_told(report: AxisReport) -> str:
    """Return the backlash that figures are in, its source, and what this recording alone says about it."""
    b, gap = report.b, report.gap
    if not b > 0.0:
        return "Backlash b is not known: lengths near the target are in mrad."
    run = next((run for run in reversed(report.events.runs) if math.isclose(run.learned, b, rel_tol=1e-6)), None)
    source = f"learned at {run.start:.2f} s" if run else f"from {report.b_source}"
    alone = shown(math.degrees(gap.angle), math.degrees(gap.uncertainty), "deg") if gap.told else ""
    said = f"Backlash b = {math.degrees(b):.4g} deg ({b:.4g} rad), {source}"
    return f"{said}{f'; a fit to this recording gives {alone}' if alone else ''}.{_model_told(report)}"


def missing_part(report: AxisReport) -> Part | None:
    """Return what the recording lacks."""
    remarks = [f"{what}." for what in report.axis.missing]
    return Part(f"Not in this recording ({len(remarks)})", remarks=remarks) if remarks else None


def sources_part(report: AxisReport) -> Part:
    """Return what was read of an axis, and the backlash that is the unit of its figures."""
    axis, gap = report.axis, report.gap
    rows = [
        ("joint states", axis.joint_topic or "not in this recording"),
        (
            "joints of motor and load",
            ", ".join(name or "not in this recording" for name in (axis.motor_joint, axis.load_joint)),
        ),
        ("reference", axis.reference_source or "not in this recording"),
        ("command", axis.command_topic or "not in this recording"),
        ("motor and gear", axis.drive_source or "not known"),
    ]
    if axis.clock:
        rows.append(("clock", axis.clock))
    used = f"{report.b:.5g} rad, from {report.b_source}" if report.b > 0.0 else "not known: figures are in mrad"
    found = (
        f"{shown(gap.angle, gap.uncertainty, 'rad')}, by a fit to {gap.part}"
        if gap.told
        else f"cannot be told: {gap.why}"
    )
    rows += [("backlash b that figures are in", used), ("backlash estimated from this recording", found)]
    rows += [("note", note) for note in axis.notes]
    return Part("What was read, and the backlash", pairs=rows)
