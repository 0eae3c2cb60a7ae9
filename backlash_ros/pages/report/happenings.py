"""What happened, in parts: load torques, learning runs, changes of parameters, faults, diagnostics."""

import math
from itertools import zip_longest

from backlash_ros.control import AUTO
from backlash_ros.pages.report import pictures
from backlash_ros.pages.report.changes import Change, in_use_at
from backlash_ros.pages.report.charts import ChartBook
from backlash_ros.pages.report.part import MOST_CHARTS, Cell, Folded, Part, Table
from backlash_ros.pages.report.report import AxisReport, Report
from backlash_ros.pages.report.steps import law_of
from backlash_ros.pages.report.warned import Warned
from backlash_ros.pages.report.words import NONE, briefly, figure, in_b, moment
from backlash_ros.recordings.rounding import brief, counted
from backlash_ros.studies.metrics import SETTLED

_FEW = 6
"""Largest number of changed parameters that are seen at once."""


def learning_part(report: AxisReport, book: ChartBook) -> Part | None:
    """Return the learning runs and what they found."""
    runs = report.events.runs
    if not runs:
        return None
    charted = runs[:MOST_CHARTS] if report.timing else []
    drawn = [book.add(pictures.run_chart(report, k, run)) for k, run in enumerate(charted, 1)]
    rows = []
    for k, run in enumerate(runs, 1):
        learned = "nothing" if math.isnan(run.learned) else f"b = {run.learned:.5g} rad"
        ended = "" if run.ended else " (still under way at the end)"
        rows.append([str(k), moment(run.start), f"{run.end - run.start:.2f}", learned + ended])
    links = [place.identity for place in drawn] + [""] * (len(rows) - len(drawn))
    return Part(
        f"Learning runs ({len(rows)})", Table(("run", "at, s", "length, s", "learned"), rows, links), charts=drawn
    )


def torques_part(report: AxisReport) -> Part | None:
    """Return the load torques and what each did to the load."""
    if not report.torques:
        return None
    rows = [
        [
            moment(torque.start),
            moment(torque.end) if math.isfinite(torque.end) else "the end",
            brief(torque.torque),
            in_b(report, torque.largest),
            figure(torque.back),
        ]
        for torque in report.torques
    ]
    heads = ("from, s", "until, s", "load torque, N m", f"load off its target at most, {report.unit}")
    about = (
        "How far off its target the load was until the torque or the reference changed, and when it was back within "
        f"{SETTLED:g} b for good. {NONE}: it was not at its target before, or the recording does not tell."
    )
    return Part(f"Load torques ({len(rows)})", Table((*heads, "back after, s"), rows), about=about)


def _changed(report: AxisReport, change: Change, until: float) -> Cell:
    """Return what changed, as far as the digits show it, and the law that ``auto`` chose from then on."""
    shown = {name: (briefly(old), briefly(new)) for name, (old, new) in change.values.items()}
    seen = {name: both for name, both in shown.items() if both[0] != both[1]}
    text = "; ".join(f"{name}: {old} to {new}" for name, (old, new) in seen.items())
    law = law_of(report.axis, change.time, until)[0] if in_use_at(report.axis, change.time).get("law") == AUTO else AUTO
    acts = f" (law {law} acts)" if law != AUTO and ("law" in change.values or change.identified) else ""
    if len(seen) <= _FEW:
        return f"{text or 'less than the digits show'}{acts}"
    return Folded(f"{'identified: ' if change.identified else ''}{counted(len(seen), 'parameter')}{acts}", text)


def changes_part(report: AxisReport) -> Part | None:
    """Return the changes of parameters."""
    changes = report.events.changes
    rows: list[list[Cell]] = []
    for change, after in zip_longest(changes, changes[1:]):
        step = next((k for k, s in enumerate(report.steps, 1) if s.start < change.time < s.end), 0)
        said = _changed(report, change, after.time if after else math.inf)
        rows.append([moment(change.time), said, f"during step {step}" if step else ""])
    title = f"Changes of gains, laws and other parameters ({len(rows)})"
    return Part(title, Table(("in use from, s", "changed", ""), rows)) if rows else None


def faults_part(report: AxisReport, book: ChartBook) -> Part | None:
    """Return the faults that were latched."""
    if not report.events.faults:
        return None if "fault" not in report.axis.state else Part("No faults.")
    rows = [
        [
            fault.name,
            moment(fault.start),
            moment(fault.end) if math.isfinite(fault.end) else "still latched at the end",
            fault.text,
        ]
        for fault in report.events.faults
    ]
    drawn = [book.add(pictures.fault_chart(report, f)) for f in report.events.faults[:MOST_CHARTS] if report.timing]
    return Part(f"Faults ({len(rows)})", Table(("fault", "from, s", "until, s", ""), rows), charts=drawn)


def diagnostics_part(report: Report) -> Part | None:
    """Return the warnings and errors of diagnostics."""
    if not report.warnings:
        return None
    own = any(axis.axis.clock for axis in report.axes)

    def moments(warned: Warned) -> tuple[str, str]:
        clock = " by the recorder's clock" if own and not warned.axis else ""
        return f"{moment(warned.first)}{clock}", f"{moment(warned.last)}{clock}"

    rows = [
        [
            warned.name,
            "error" if warned.level > 1 else "warning",
            warned.text,
            str(warned.times),
            *moments(warned),
            str(warned.step or NONE),
        ]
        for warned in report.warnings
    ]
    heads = ("status", "level", "text, as first said", "times", "first, s", "last, s", "first in step")
    warnings, errors = (sum(each.times for each in report.warnings if (each.level > 1) is bad) for bad in (False, True))
    return Part(f"Warnings and errors ({warnings} + {errors})", Table(heads, rows))
