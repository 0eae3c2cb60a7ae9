"""A report as one page of HTML: tables of figures, charts to zoom, nothing loaded from elsewhere."""

import math
from typing import Any

from backlash_ros.pages.report import pictures
from backlash_ros.pages.report.charts import ChartBook
from backlash_ros.pages.report.happenings import (
    changes_part,
    diagnostics_part,
    faults_part,
    learning_part,
    torques_part,
)
from backlash_ros.pages.report.motion import holds_part, paths_part, steps_part
from backlash_ros.pages.report.part import Part, Table
from backlash_ros.pages.report.report import AxisReport, Report
from backlash_ros.pages.report.sources import backlash_told, missing_part, sources_part, timing_part
from backlash_ros.pages.report.verdicts import verdicts_of
from backlash_ros.pages.report.words import NONE
from backlash_ros.pages.template import render
from backlash_ros.recordings.rounding import brief, counted, shown


def _axis(report: AxisReport, book: ChartBook) -> dict[str, Any]:
    """Return what the page shows of an axis; charts are added to the book in the order of the page."""
    axis = report.axis
    steps, paths = steps_part(report, book), paths_part(report, book)
    overview = book.add(pictures.overview(report)) if report.timing else None
    parts = [
        holds_part(report),
        torques_part(report),
        learning_part(report, book),
        changes_part(report),
        faults_part(report, book),
        timing_part(report, book),
        missing_part(report),
        sources_part(report),
    ]
    return {
        "name": "Axis" if axis.name == "/" else f"Axis {axis.name}",
        "verdicts": verdicts_of(report),
        "backlash": backlash_told(report),
        "steps": steps,
        "paths": paths,
        "overview": overview,
        "parts": [part for part in parts if part is not None],
    }


def _index(report: Report) -> Table | None:
    """Return a table of the axes with links to them, if there are several."""
    if len(report.axes) < 2:
        return None
    rows = []
    for found in report.axes:
        timing, gap = found.timing, found.gap
        rows.append(
            [
                found.axis.name,
                str(len(found.steps)),
                f"{found.b:.5g}" if found.b > 0.0 else NONE,
                shown(gap.angle, gap.uncertainty, "") if gap.told else NONE,
                brief(timing.rate, 4) if timing else NONE,
                str(timing.lost) if timing else NONE,
                ", ".join(dict.fromkeys(fault.name for fault in found.events.faults)) or "none",
            ]
        )
    heads = ("axis", "steps", "b in use, rad", "b estimated, rad", "rate, Hz", "samples lost", "faults")
    return Table(heads, rows, [f"axis-{k}" for k in range(1, len(rows) + 1)])


def _begun(report: Report) -> str:
    """Return when the recording began and how long it is."""
    began = f"{report.began:%Y-%m-%d %H:%M:%S} UTC" if report.began else "a clock that shows no date"
    took = f"{report.length:.2f} s"
    if math.isnan(report.own_length):
        return f"Begun {began}, {took} long"
    return f"Begun {began}, {report.own_length:.2f} s long by its own clock (recorded in {took})"


def page_of(report: Report) -> str:
    """Return the page."""
    book, contents = ChartBook(), report.contents
    counts = [(name, f"{count} of {kind}") for name, (kind, count) in sorted(contents.topics.items())]
    topics = Part(f"Topics ({len(counts)})", pairs=counts) if counts else Part("No topics.")
    messages = sum(count for _, count in contents.topics.values())
    return render(
        "report/report.html.j2",
        title=f"Recording {report.source}",
        begun=f"{_begun(report)}, {counted(messages, 'message')}. Times count from the start.",
        damage=contents.damage,
        messages=messages,
        index=_index(report),
        axes=[_axis(axis, book) for axis in report.axes],
        parts=[part for part in (diagnostics_part(report), topics) if part is not None],
        command=report.command,
        drawn=book.drawn(),
        wide=pictures.WIDE,
        high=pictures.HIGH,
    )
