"""The results of an identification, as a table for people and as JSON for programs."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from backlash_ros.commands.output import say
from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.held_out import Score
from backlash_ros.identification.recordings.identify import Identified
from backlash_ros.recordings.rounding import shown
from backlash_ros.recordings.subject import Subject


def _figures(finding: Finding) -> tuple[str, str]:
    """Return value and uncertainty with as many digits as the uncertainty justifies."""
    if not finding.uncertainty > 0.0:
        return f"{finding.value:.6g}", "0"
    if abs(finding.value) < 1e-3 * finding.uncertainty:
        return "0", f"{finding.uncertainty:.2g}"
    digits = max(0, math.floor(math.log10(max(abs(finding.value), finding.uncertainty))) - _place(finding) + 2)
    return f"{round(finding.value, 1 - _place(finding)):.{max(digits, 1)}g}", f"{finding.uncertainty:.2g}"


def _place(finding: Finding) -> int:
    return math.floor(math.log10(finding.uncertainty))


def _scored(score: Score) -> str:
    def compared(own: float, told: float) -> str:
        return f"{own:.3g} (as told: {told:.3g})" if math.isfinite(told) else f"{own:.3g} (as told: cannot follow)"

    return (
        f"Held out: fitted to the first {score.start:.2f} s, judged on the {score.length:.2f} s after.\n"
        f"  each sample against its prediction, in standard deviations: {compared(score.rms, score.told_rms)}\n"
        f"  the load's angle from the command alone, for {score.free:.2g} s each, rms, rad: "
        f"{compared(score.error, score.told_error)}"
    )


def _told_by(subject: Subject) -> str:
    return subject.sheet or "the nominal drive: give yours with --drive"


def show(subject: Subject, found: Identified, console: Console) -> None:
    """Print the results, or why there are none."""
    say(console, f"{subject.source}; motor and gear ratio as told by {_told_by(subject)}")
    for note in subject.notes:
        say(console, f"  {note}")
    if found.stretch and not subject.slow.valid:
        say(console, f"  used: {found.stretch}")
    if found.around.map is not None:
        say(console, f"Around the turn, by {found.around.reason}.")
    if subject.slow.valid:
        say(console, f"By {subject.slow.reason}.")
    if found.reason:
        told = found.around.map is not None or subject.slow.valid
        say(console, f"Nothing {'else ' if told else ''}can be told: {found.reason}.")
        return
    show_findings(found.findings, console)
    if found.gap is not None and found.gap.valid:
        say(console, f"The gap comes from {found.gap.reason}.")
    if found.score is not None:
        say(console, _scored(found.score))


def show_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print findings as a table, and why others have no value."""
    table = Table(box=None, pad_edge=False, header_style="")
    for name, style in (("", ""), ("value", ""), ("+-", ""), ("unit", ""), ("", "")):
        table.add_column(name, style=style, justify="right" if name in {"value", "+-"} else "left", no_wrap=name != "")
    reasons: dict[str, list[str]] = {}
    for finding in findings:
        if finding.told:
            table.add_row(finding.symbol, *_figures(finding), finding.unit, finding.what)
        else:
            roughly = f" (roughly {shown(finding.value, finding.uncertainty, finding.unit)})" if finding.rough else ""
            reasons.setdefault(finding.why, []).append(f"{finding.symbol}{roughly}")
    console.print(table, highlight=False, markup=False)
    if reasons:
        console.print("The recording cannot tell:", highlight=False)
    for why, symbols in reasons.items():
        say(console, f"  {', '.join(symbols)}: {why}")


def content_of(subject: Subject, found: Identified) -> dict[str, Any]:
    """Return all results and what is derived from them, ready for JSON; what has a reason has no value."""
    content = {
        "recording": subject.source,
        "drive": _told_by(subject),
        "valid": found.valid,
        "reason": found.reason,
        "notes": subject.notes,
        "stretch": found.stretch,
        "period": found.period,
        "findings": [{**asdict(finding), "told": finding.told} for finding in found.findings],
        "derived": [{**asdict(finding), "told": finding.told} for finding in subject.derived],
        "gap_around_turn": {
            "reason": found.around.reason,
            **(asdict(found.around.map) if found.around.map is not None else {}),
        },
        "hysteresis": {"valid": subject.slow.valid, "reason": subject.slow.reason},
        "held_out": None if found.score is None else asdict(found.score),
    }
    result: dict[str, Any] = jsonable(content)
    return result
