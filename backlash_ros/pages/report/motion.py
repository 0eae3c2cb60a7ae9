"""The parts of an axis about its motion: steps, paths and holds."""

import math

from backlash_ros.pages.report import pictures
from backlash_ros.pages.report.charts import ChartBook
from backlash_ros.pages.report.outcome import CUT, ending
from backlash_ros.pages.report.outcome import SETTLED as AT_REST
from backlash_ros.pages.report.part import MOST_CHARTS, Cell, Part, Table
from backlash_ros.pages.report.paths import FollowedPath
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.steps import NEAR, Step
from backlash_ros.pages.report.timing import SETTLING
from backlash_ros.pages.report.words import NONE, cycle_words, figure, in_b, law_words, moment
from backlash_ros.recordings.rounding import brief, counted
from backlash_ros.studies.metrics import SETTLED, TAIL


def _step_row(report: AxisReport, number: int, step: Step) -> list[Cell]:
    return [
        str(number),
        pictures.sketch(report, step) if number <= MOST_CHARTS else "",
        moment(step.start),
        f"{brief(step.origin, 4)} to {brief(step.target, 4)}",
        law_words(step),
        figure(step.rise),
        NONE if ending(step) == CUT else figure(step.settling),
        in_b(report, step.overshoot),
        in_b(report, step.residual),
        cycle_words(report, step),
        NONE if step.impacts < 0 else str(step.impacts),
        figure(step.peak_torque),
        figure(step.peak_speed),
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


def _outcome(step: Step) -> str:
    """Return how a step ended, for its title."""
    settled = ending(step) == AT_REST
    said = f"settled after {figure(step.settling)} s" if settled else ending(step)
    return f"{said}, {counted(step.impacts, 'impact')}" if step.impacts > 0 else said


def _step_words(report: AxisReport, step: Step) -> str:
    """Return the figures of a step in a sentence, for its chart."""
    said = [
        *([f"gain set {step.gain_set}"] if step.gain_set else []),
        f"from {step.start:.3f} s on",
        f"rise {figure(step.rise)} s" if math.isfinite(step.rise) else "90 % was not reached",
        f"overshoot {in_b(report, step.overshoot)} {report.unit}",
        f"residual {in_b(report, step.residual)} {report.unit}",
    ]
    cycle = cycle_words(report, step)
    said += [f"limit cycle {cycle}"] if cycle not in {"none", NONE} else []
    text = "; ".join(said)
    return f"{text[0].upper()}{text[1:]}. Shaded: within {in_b(report, step.band)} {report.unit} of the target."


def steps_part(report: AxisReport, book: ChartBook) -> Part:
    """Return the steps, each with its chart."""
    if not report.steps:
        moves = "the reference was not known" if report.axis.reference is None else "the reference made no step"
        return Part("Steps", about=f"None: {moves}, or there were no samples of the load.")
    drawn = [
        book.add(pictures.step_chart(report, k, _outcome(step), _step_words(report, step)))
        for k, step in enumerate(report.steps[:MOST_CHARTS], 1)
    ]
    near = f"within {pictures.ROOM * report.b:.2g} rad" if report.b > 0.0 else "near the target"
    heads: tuple[str, ...] = ("step", near, "at, s", "from, to, rad", "law, gain set", "rise, s", "settled, s")
    heads += (
        f"overshoot, {report.unit}",
        f"residual, {report.unit}",
        f"limit cycle, {report.unit}",
        "impacts",
        "peak torque, N m",
    )
    heads += ("peak speed, rad/s",)
    rows = [_step_row(report, k, step) for k, step in enumerate(report.steps, 1)]
    band = f"{SETTLED:g} b" if report.b > 0.0 else f"{100 * NEAR:g} % of the step"
    about = (
        f"Rise from 10 to 90 %; settled within {band} of the target for good; residual and limit cycle peak to peak in "
        "the last second; impacts: how often the teeth met after the load first came within b of the target; torque "
        f"of the motor before the gear, speed of the load. {NONE}: the recording does not tell. Sketches: the "
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
    ends = (brief(path.origin, 4), brief(path.target, 4)) if math.isfinite(path.origin) else (NONE, NONE)
    told = [NONE] * 5
    if (figures := path.figures) is not None:
        told = [in_b(report, error) for error in (figures.rms, figures.largest, figures.final)]
        told += [figure(1e3 * figures.lag), str(figures.reversals)]
    return [
        str(number),
        moment(path.start),
        f"{path.end - path.start:.2f}",
        " to ".join(ends),
        law_words(path),
        *told,
        NONE if path.impacts < 0 else str(path.impacts),
    ]


def paths_part(report: AxisReport, book: ChartBook) -> Part | None:
    """Return how paths were followed."""
    if not report.paths:
        return None
    heads: tuple[str, ...] = (
        "path",
        "at, s",
        "length, s",
        "from, to, rad",
        "law, gain set",
        f"rms, {report.unit}",
        f"largest, {report.unit}",
    )
    heads += (f"at the end, {report.unit}", "lag, ms", "reversals", "impacts")
    rows = [_path_row(report, k, path) for k, path in enumerate(report.paths, 1)]
    judged = [(k, path) for k, path in enumerate(report.paths, 1) if path.figures is not None][:MOST_CHARTS]
    drawn = {k: book.add(pictures.path_chart(report, k, path)) for k, path in judged}
    about = (
        "Error of the load from its setpoint, as the controller told both: rms and largest on the way, and at the end "
        "of half a second after it; lag: the time by which the path, shifted, fits the load best; impacts: how often "
        f"the teeth met on the way. {NONE}: the recording does not tell."
    )
    links = [drawn[k].identity if k in drawn else "" for k in range(1, len(rows) + 1)]
    return Part("Paths", Table(heads, rows, links), about=about, charts=list(drawn.values()), leads=True)


def holds_part(report: AxisReport) -> Part | None:
    """Return the rests that no step led to."""
    if not report.holds:
        return None
    heads = (
        "hold",
        "from, s",
        "until, s",
        "reference, rad",
        f"residual, {report.unit}",
        f"limit cycle, {report.unit}",
        "",
    )
    rows = [
        [
            str(k),
            moment(hold.start),
            moment(hold.end),
            brief(hold.target, 4),
            in_b(report, hold.residual),
            cycle_words(report, hold),
            "; ".join(_remarks(hold)),
        ]
        for k, hold in enumerate(report.holds, 1)
    ]
    about = (
        "Where the reference stood still after no step: from the start on, after a path, a learning run, a fault, or "
        f"what ended another rest; {TAIL + SETTLING:g} s at least."
    )
    swing = sum(math.isfinite(hold.amplitude) for hold in report.holds)
    found = f": {counted(swing, 'limit cycle')}" if swing else ""
    return Part(f"Holds ({len(rows)}){found}", Table(heads, rows), about=about)
