"""The parts of an axis about what happened: learning runs, changes of parameters, faults, diagnostics."""

import math

from backlash_ros.pages.report import pictures
from backlash_ros.pages.report.charts import ChartBook
from backlash_ros.pages.report.part import MOST_CHARTS, Part, Table
from backlash_ros.pages.report.report import AxisReport, Report
from backlash_ros.pages.report.warned import Warned
from backlash_ros.pages.report.words import NONE, briefly, figure, in_b, moment
from backlash_ros.recordings.rounding import brief
from backlash_ros.studies.metrics import SETTLED


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
    return Part("Learning runs", Table(("run", "at, s", "length, s", "learned"), rows, links), charts=drawn)


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


def changes_part(report: AxisReport) -> Part | None:
    """Return the changes of parameters."""
    if not report.events.changes:
        return None
    rows = []
    for change in report.events.changes:
        step = next((k for k, s in enumerate(report.steps, 1) if s.start < change.time < s.end), 0)
        said = "; ".join(f"{name}: {briefly(old)} to {briefly(new)}" for name, (old, new) in change.values.items())
        rows.append([moment(change.time), said, f"during step {step}" if step else ""])
    return Part("Changes of gains, laws and other parameters", Table(("in use from, s", "changed", ""), rows))


def faults_part(report: AxisReport, book: ChartBook) -> Part | None:
    """Return the faults that were latched."""
    if not report.events.faults:
        return None if "fault" not in report.axis.state else Part("Faults", about="None was latched.")
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
    return Part("Faults", Table(("fault", "from, s", "until, s", ""), rows), charts=drawn)


def diagnostics_table(report: Report) -> Table | None:
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
    return Table(heads, rows)
