"""A report as one page of HTML: tables of figures, charts to zoom, nothing loaded from elsewhere."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from backlash_ros.control.tick import MISSING
from backlash_ros.pages.report import pictures
from backlash_ros.pages.report.charts import ChartBook, Place
from backlash_ros.pages.report.cures import cure
from backlash_ros.pages.report.paths import FollowedPath
from backlash_ros.pages.report.pictures import Sketch
from backlash_ros.pages.report.report import AxisReport, Report
from backlash_ros.pages.report.steps import NEAR, Step
from backlash_ros.pages.report.timing import SETTLING, Timing
from backlash_ros.pages.template import render
from backlash_ros.recordings.rounding import brief, counted, shown
from backlash_ros.studies.metrics import SETTLED, TAIL

DOUBTFUL = 0.01
"""Share of samples missing or late above which the page warns."""
MOST_CHARTS = 60
"""Largest number of steps, of learning runs and of faults of an axis with a chart of their own, the first ones."""
_NONE = "\u2013"
_USUAL = "nominal"
"""The gain set that is not worth saying."""


@dataclass(frozen=True)
class Table:
    """Rows of text and sketches under ``heads``; ``links``: ids that the first cells lead to, empty for none."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str | Sketch]]
    links: Sequence[str] = ()

    @property
    def lines(self) -> Iterator[tuple[str, str | Sketch, list[tuple[str, str | Sketch]]]]:
        """The rows: link, first cell, and the other cells with their heads."""
        for (first, *rest), link in zip(self.rows, self.links or [""] * len(self.rows), strict=True):
            yield link, first, list(zip(self.heads[1:], rest, strict=True))


@dataclass(frozen=True)
class Part:
    """A part of an axis, to be unfolded: a table of figures, or pairs of names and values, remarks, charts and notes.

    Where the table ``leads``, it is seen at once, and each chart is unfolded on its own.
    """

    title: str
    table: Table | None = None
    pairs: Sequence[tuple[str, str]] = ()
    about: str = ""
    remarks: Sequence[str] = ()
    charts: Sequence[Place] = ()
    notes: Sequence[str] = ()
    leads: bool = False


def _number(value: float) -> str:
    """Return a number; a dash if the recording does not show it."""
    if math.isnan(value):
        return _NONE
    return "never" if math.isinf(value) else brief(value)


def _at(seconds: float) -> str:
    """Return a time from the start."""
    return f"{seconds:.3f}".replace("-", "\u2212")


def _value(value: Any) -> str:
    """Return a parameter's value as short as it can be read."""
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    return "none" if value is None else str(value)


def _in_b(report: AxisReport, angle: float) -> str:
    """Return an angle in b, or in mrad if the backlash is unknown."""
    return _NONE if math.isnan(angle) else f"{angle / report.b if report.b > 0.0 else 1e3 * angle:.3f}"


_SETTLED, _SWINGS, _NEVER, _CUT = "settled", "ended in a limit cycle", "did not settle", "ended too soon to tell"


def _end(step: Step) -> str:
    """Return how a step ended: one of four ways."""
    if math.isfinite(step.amplitude):
        return _SWINGS
    if math.isfinite(step.settling):
        return _SETTLED
    return _CUT if step.end - step.start < TAIL + SETTLING else _NEVER


def _cycle(report: AxisReport, step: Step) -> str:
    if math.isnan(step.residual):
        return _NONE
    if math.isnan(step.amplitude):
        return "none"
    often = "uneven" if math.isnan(step.frequency) else f"at {brief(step.frequency)}\u00a0Hz"
    return f"{_in_b(report, step.amplitude)} {often}"


def _law(step: Step | FollowedPath) -> str:
    """Return the law of a step or path, with its gain set if it has one of its own."""
    return " ".join(filter(None, (step.law, step.gain_set if step.gain_set != _USUAL else ""))) or _NONE


def _step_row(report: AxisReport, number: int, step: Step) -> list[str | Sketch]:
    return [
        str(number),
        pictures.sketch(report, step) if number <= MOST_CHARTS else "",
        _at(step.start),
        f"{brief(step.origin, 4)} to {brief(step.target, 4)}",
        _law(step),
        _number(step.rise),
        _NONE if _end(step) == _CUT else _number(step.settling),
        _in_b(report, step.overshoot),
        _in_b(report, step.residual),
        _cycle(report, step),
        _NONE if step.impacts < 0 else str(step.impacts),
        _number(step.peak_torque),
        _number(step.peak_speed),
    ]


def _remarks(step: Step) -> list[str]:
    """Return the notes that are needed to read the figures of a step."""
    remarks = list(step.remarks)
    if step.late_rising:
        late = counted(step.late_rising, "sample")
        remarks.append(f"{late} late, or answered late, while it rose: this changes its figures")
    if step.late_rest:
        quiet = f"{TAIL + SETTLING:g} s without a late sample"
        remarks.append(f"never {quiet} at its end: its residual may be too large")
    if step.ended_by:
        remarks.append(f"judged until {step.ended_by}, {step.end - step.start:.2f} s after the start")
    return remarks


def _step_words(report: AxisReport, step: Step) -> str:
    """Return the figures of a step in a sentence, for its chart."""
    unit = "b" if report.b > 0.0 else "mrad"
    said = [
        f"at {step.start:.3f} s",
        f"rise {_number(step.rise)} s" if math.isfinite(step.rise) else "90 % was not reached",
        f"settled after {_number(step.settling)} s" if math.isfinite(step.settling) else _end(step),
        f"overshoot {_in_b(report, step.overshoot)} {unit}",
        f"residual {_in_b(report, step.residual)} {unit}",
    ]
    cycle = _cycle(report, step)
    said += [f"limit cycle {cycle}"] if cycle not in {"none", _NONE} else []
    law = [f"law {step.law}, gain set {step.gain_set}"] if step.law else []
    return f"{'; '.join([*law, *said])}. Shaded: within {_in_b(report, step.band)} {unit} of the target."


def _steps(report: AxisReport, book: ChartBook) -> Part:
    unit = "b" if report.b > 0.0 else "mrad"
    if not report.steps:
        moves = "the reference was not known" if report.axis.reference is None else "the reference made no step"
        return Part("Steps", about=f"None: {moves}, or there were no samples of the load.")
    drawn = [
        book.add(pictures.step_chart(report, k, _step_words(report, step)))
        for k, step in enumerate(report.steps[:MOST_CHARTS], 1)
    ]
    near = f"within {pictures.ROOM * report.b:.2g} rad" if report.b > 0.0 else "near the target"
    heads: tuple[str, ...] = ("step", near, "at, s", "from, to, rad", "law, gain set", "rise, s", "settled, s")
    heads += (f"overshoot, {unit}", f"residual, {unit}", f"limit cycle, {unit}", "impacts", "peak torque, N m")
    heads += ("peak speed, rad/s",)
    rows = [_step_row(report, k, step) for k, step in enumerate(report.steps, 1)]
    band = f"{SETTLED:g} b" if report.b > 0.0 else f"{100 * NEAR:g} % of the step"
    about = (
        f"Rise from 10 to 90 %; settled within {band} of the target for good; residual and limit cycle peak to peak in "
        "the last second; impacts: how often the teeth met after the load first came within b of the target; torque "
        f"of the motor before the gear, speed of the load. {_NONE}: the recording does not tell. Sketches: the "
        f"load about its target for {pictures.SKETCH:g} s; the band is where it counts as settled."
    )
    remarks = [f"Step {k}: {'; '.join(found)}." for k, step in enumerate(report.steps, 1) if (found := _remarks(step))]
    notes = []
    if len(rows) > MOST_CHARTS:
        notes.append(f"The first {MOST_CHARTS} of {len(rows)} steps have a chart; all are in the table.")
    links = [place.identity for place in drawn] + [""] * (len(rows) - len(drawn))
    table = Table(heads, rows, links)
    return Part("Steps", table, about=about, remarks=remarks, charts=drawn, notes=notes, leads=True)


def _path_row(report: AxisReport, number: int, path: FollowedPath) -> list[str]:
    ends = (brief(path.origin, 4), brief(path.target, 4)) if math.isfinite(path.origin) else (_NONE, _NONE)
    told = [_NONE] * 5
    if (figures := path.figures) is not None:
        told = [_in_b(report, error) for error in (figures.rms, figures.largest, figures.final)]
        told += [_number(1e3 * figures.lag), str(figures.reversals)]
    return [
        str(number),
        _at(path.start),
        f"{path.end - path.start:.2f}",
        " to ".join(ends),
        _law(path),
        *told,
        _NONE if path.impacts < 0 else str(path.impacts),
    ]


def _paths(report: AxisReport, book: ChartBook) -> Part | None:
    """Return how paths were followed."""
    if not report.paths:
        return None
    unit = "b" if report.b > 0.0 else "mrad"
    heads: tuple[str, ...] = (
        "path",
        "at, s",
        "length, s",
        "from, to, rad",
        "law, gain set",
        f"rms, {unit}",
        f"largest, {unit}",
    )
    heads += (f"at the end, {unit}", "lag, ms", "reversals", "impacts")
    rows = [_path_row(report, k, path) for k, path in enumerate(report.paths, 1)]
    judged = [(k, path) for k, path in enumerate(report.paths, 1) if path.figures is not None][:MOST_CHARTS]
    drawn = {k: book.add(pictures.path_chart(report, k, path)) for k, path in judged}
    about = (
        "Error of the load from its setpoint, as the controller told both: rms and largest on the way, and at the end "
        "of half a second after it; lag: the time by which the path, shifted, fits the load best; impacts: how often "
        f"the teeth met on the way. {_NONE}: the recording does not tell."
    )
    links = [drawn[k].identity if k in drawn else "" for k in range(1, len(rows) + 1)]
    return Part("Paths", Table(heads, rows, links), about=about, charts=list(drawn.values()), leads=True)


def _holds(report: AxisReport) -> Part | None:
    """Return the rests that no step led to."""
    if not report.holds:
        return None
    unit = "b" if report.b > 0.0 else "mrad"
    heads = ("hold", "from, s", "until, s", "reference, rad", f"residual, {unit}", f"limit cycle, {unit}", "")
    rows = [
        [
            str(k),
            _at(hold.start),
            _at(hold.end),
            brief(hold.target, 4),
            _in_b(report, hold.residual),
            _cycle(report, hold),
            "; ".join(_remarks(hold)),
        ]
        for k, hold in enumerate(report.holds, 1)
    ]
    about = "Where the reference stood still after no step: from the start on, after a path, a learning run or a fault."
    return Part("Holds", Table(heads, rows), about=about)


def _learning(report: AxisReport, book: ChartBook) -> Part | None:
    runs = report.events.runs
    if not runs:
        return None
    charted = runs[:MOST_CHARTS] if report.timing else []
    drawn = [book.add(pictures.run_chart(report, k, run)) for k, run in enumerate(charted, 1)]
    rows = []
    for k, run in enumerate(runs, 1):
        learned = "nothing" if math.isnan(run.learned) else f"b = {run.learned:.5g} rad"
        ended = "" if run.ended else " (still under way at the end)"
        rows.append([str(k), _at(run.start), f"{run.end - run.start:.2f}", learned + ended])
    links = [place.identity for place in drawn] + [""] * (len(rows) - len(drawn))
    return Part("Learning runs", Table(("run", "at, s", "length, s", "learned"), rows, links), charts=drawn)


def _changes(report: AxisReport) -> Part | None:
    if not report.events.changes:
        return None
    rows = []
    for change in report.events.changes:
        step = next((k for k, s in enumerate(report.steps, 1) if s.start < change.time < s.end), 0)
        said = "; ".join(f"{name}: {_value(old)} to {_value(new)}" for name, (old, new) in change.values.items())
        rows.append([_at(change.time), said, f"during step {step}" if step else ""])
    return Part("Changes of gains, laws and other parameters", Table(("in use from, s", "changed", ""), rows))


def _faults(report: AxisReport, book: ChartBook) -> Part | None:
    if not report.events.faults:
        return None if "fault" not in report.axis.state else Part("Faults", about="None was latched.")
    rows = [
        [
            fault.name,
            _at(fault.start),
            _at(fault.end) if math.isfinite(fault.end) else "still latched at the end",
            fault.text,
        ]
        for fault in report.events.faults
    ]
    drawn = [book.add(pictures.fault_chart(report, f)) for f in report.events.faults[:MOST_CHARTS] if report.timing]
    return Part("Faults", Table(("fault", "from, s", "until, s", ""), rows), charts=drawn)


def _ms(*seconds: float) -> str:
    return ", ".join(_number(1e3 * value) for value in seconds)


def _timing(report: AxisReport, timing: Timing, book: ChartBook) -> Part:
    rows = [
        ("samples", f"{timing.samples} in {timing.length:.2f} s"),
        ("rate", f"{brief(timing.rate, 4)} Hz (period {brief(1e3 * timing.period, 4)} ms)"),
        ("jitter: standard deviation", f"{_ms(timing.jitter)} ms"),
        ("jitter: 99 % are within", f"{_ms(timing.jitter_99)} ms"),
        ("longest time between two samples", f"{_ms(timing.longest)} ms"),
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
            ("age when recorded: mean, 99 % below, most", f"{_ms(timing.age, timing.age_99, timing.age_most)} ms")
        )
    else:
        rows.append(("age when recorded", "not known: stamps and recorder have different clocks"))
    if timing.answers:
        rows.append(("commands", str(timing.answers)))
        rows.append(
            ("samples without an answer within their period, or followed by a late one", str(timing.unanswered))
        )
    if math.isfinite(timing.answered):
        rows.append(
            (
                "from sample to its command, as recorded: median, 99 % below",
                f"{_ms(timing.answered, timing.answered_99)} ms",
            )
        )
    return Part("Timing", pairs=rows, charts=[book.add(pictures.timing_chart(report))])


def _about(report: AxisReport) -> list[tuple[str, str]]:
    """Return a description of an axis, with the backlash that is the unit of its figures."""
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
    return rows + [("note", note) for note in axis.notes]


def _swing(report: AxisReport, step: Step) -> str:
    """Return the limit cycle of a step or hold in words, and what to do about it."""
    unit = "b" if report.b > 0.0 else "mrad"
    often = "unevenly" if math.isnan(step.frequency) else f"at {brief(step.frequency)}\u00a0Hz"
    act = cure(report.axis, step)
    return f"{_in_b(report, step.amplitude)} {unit} peak to peak, {often}{f'. To end it, {act}' if act else ''}"


def _widest(report: AxisReport) -> str:
    """Return which step swung most, how much, and what to do about it; empty if none swung."""
    swung = [k for k, step in enumerate(report.steps) if _end(step) == _SWINGS]
    if not swung:
        return ""
    most = max(swung, key=lambda k: report.steps[k].amplitude)
    law = f" with law {report.steps[most].law}" if report.steps[most].law else ""
    others = " most" if len(swung) > 1 else ""
    return f". Step {most + 1}{law} swung{others}: {_swing(report, report.steps[most])}"


def _verdicts(report: AxisReport) -> list[tuple[bool, str]]:
    """Return in a line how the steps went, in another what makes the recording doubtful, and whether each is good."""
    steps, timing = report.steps, report.timing
    lines = []
    if steps:
        ends = [_end(step) for step in steps]
        said = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys([_SETTLED, *ends]) if end in ends)
        widest = _widest(report)
        lines.append((not {_SWINGS, _NEVER} & set(ends), f"{counted(len(steps), 'step')}: {said}{widest}"))
    if judged := [path.figures for path in report.paths if path.figures is not None]:
        unit, largest = "b" if report.b > 0.0 else "mrad", max(figures.largest for figures in judged)
        well = largest <= (report.b if report.b > 0.0 else math.inf)
        lines.append((well, f"{counted(len(judged), 'path')}: at most {_in_b(report, largest)} {unit} off"))
    for hold in report.holds:
        if math.isfinite(hold.amplitude):
            said = f"A limit cycle while the reference stood still at {brief(hold.target, 4)} rad"
            when = f"{_at(hold.start)} to {_at(hold.end)} s"
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


def _axis(report: AxisReport, book: ChartBook) -> dict[str, Any]:
    """Return what the page shows of an axis; charts are added to the book in the order of the page."""
    axis = report.axis
    steps, paths = _steps(report, book), _paths(report, book)
    overview = book.add(pictures.overview(report)) if report.timing else None
    parts = [
        _holds(report),
        _learning(report, book),
        _changes(report),
        _faults(report, book),
        _timing(report, report.timing, book) if report.timing else None,
        Part("Not in this recording", remarks=[f"{what}." for what in axis.missing]) if axis.missing else None,
        Part("What was read, and the backlash", pairs=_about(report)),
    ]
    return {
        "name": "Axis" if axis.name == "/" else f"Axis {axis.name}",
        "verdicts": _verdicts(report),
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
                f"{found.b:.5g}" if found.b > 0.0 else _NONE,
                shown(gap.angle, gap.uncertainty, "") if gap.told else _NONE,
                brief(timing.rate, 4) if timing else _NONE,
                str(timing.lost) if timing else _NONE,
                ", ".join(dict.fromkeys(fault.name for fault in found.events.faults)) or "none",
            ]
        )
    heads = ("axis", "steps", "b in use, rad", "b estimated, rad", "rate, Hz", "samples lost", "faults")
    return Table(heads, rows, [f"axis-{k}" for k in range(1, len(rows) + 1)])


def _diagnostics(report: Report) -> Table | None:
    if not report.warnings:
        return None
    rows = [
        [
            warned.name,
            "error" if warned.level > 1 else "warning",
            warned.text,
            str(warned.times),
            _at(warned.first),
            _at(warned.last),
        ]
        for warned in report.warnings
    ]
    clock = ", recorder's clock" if any(axis.axis.clock for axis in report.axes) else ""
    heads = ("status", "level", "text, as first said", "times", f"first, s{clock}", f"last, s{clock}")
    return Table(heads, rows)


def page_of(report: Report) -> str:
    """Return the page."""
    book, contents = ChartBook(), report.contents
    began = f"{report.began:%Y-%m-%d %H:%M:%S} UTC" if report.began else "a clock that shows no date"
    messages = sum(count for _, count in contents.topics.values())
    return render(
        "report/report.html.j2",
        title=f"Recording {report.source}",
        begun=f"Begun {began}, {report.length:.2f} s long, {counted(messages, 'message')}. Times count from the start.",
        damage=contents.damage,
        messages=messages,
        index=_index(report),
        axes=[_axis(axis, book) for axis in report.axes],
        diagnostics=_diagnostics(report),
        topics=[(name, f"{count} of {kind}") for name, (kind, count) in sorted(contents.topics.items())],
        command=report.command,
        drawn=book.drawn(),
        wide=pictures.WIDE,
        high=pictures.HIGH,
    )
