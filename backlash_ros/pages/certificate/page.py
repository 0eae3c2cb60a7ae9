"""A certificate as one self-contained page of HTML: no script, no other file, no network."""

import math
import re

from backlash_ros.foundation.markup import pairs, text_of
from backlash_ros.identification.gap_map import GapMap
from backlash_ros.identification.locked_output.lost_motion import LostMotion
from backlash_ros.identification.recordings.held_out import Score
from backlash_ros.identification.recordings.identify import Identified
from backlash_ros.identification.recordings.places import map_findings
from backlash_ros.identification.teeth import LOST_MOTION_SHARE
from backlash_ros.pages.certificate.pictures import (
    around_picture,
    draw,
    hysteresis_picture,
    loop_picture,
    motion_picture,
)
from backlash_ros.pages.certificate.rows import (
    Row,
    counts_at_output,
    fitted_part,
    recording_rows,
    result_rows,
    told_rows,
)
from backlash_ros.pages.markup import document, paragraph
from backlash_ros.recordings.rounding import brief, in_gear_units, in_si
from backlash_ros.recordings.subject import PACKAGE, Subject, version_of_package

_UNCERTAINTY = (
    "Values of the motion come from fits to all samples that were used, those around the turn from one fit at each "
    "place: a Kalman filter on the equations of motor, teeth and load, whose prediction errors are minimised, and "
    "whose noise is what these equations do not explain. Uncertainties are standard uncertainties: the true value is "
    "within two of them in 95 of 100 cases. They combine that noise, counted twice, with a share for the model, and "
    "hold if the motor's inertia and the gear ratio that were given are right."
)
_CURVE_UNCERTAINTY = (
    "The hysteresis curve is fitted with teeth and friction. Its standard uncertainties include the scatter of the "
    "residuals and the cycles, other laws of the teeth that explain the curve equally well, and a share for the "
    "model and the encoders' counts."
)
_AS_WELL = 1.15
"""Largest rms of prediction errors that is as expected."""
_SLOW = (
    "A hysteresis curve, with lost motion and stiffness from a slow torque: {}. A run of the experiment hysteresis on "
    "an output that is locked, braked or heavy tells them, and so does any recording of a torque that goes slowly up "
    "and down there."
)
_NO_MAP = (
    "The gap around the turn: {}. A run of the experiment gap_map tells it, and so does any recording that goes from "
    "place to place, rests there, and takes the teeth to and fro."
)
_LOST = (
    "Lost motion is the travel of the output between \u2212{share:g} % and +{share:g} % of {whose} ({rated} N m at "
    "the output), motor held, including the gap. Lost motion and stiffness come from {source}."
)
_BY_MOTION = "the teeth as fitted to the motion, not from a slow cycle of the torque"
_BY_CURVE = "the hysteresis curve; stiffness from half of the torque on"


def certificate(subject: Subject, found: Identified) -> str:
    """Return the page.

    Parameters
    ----------
    found : what was identified in ``subject.recording``; if nothing was, the page gives the reason
    """
    title = f"Drive certificate: {subject.joints[0]}, {subject.joints[1]}"
    rows = result_rows(subject, found)
    parts = [
        f"<h1>{text_of(title)}</h1>",
        f'<p class="under">{text_of(subject.source)}</p>',
        _verdict(subject, found),
        *([] if subject.sheet else [paragraph(_NO_SHEET, "verdict bad")]),
    ]
    if rows:
        parts += ["<h2>Results</h2>", results_table(rows), *_about(subject, found)]
    parts += ["<h2>Pictures</h2>", '<div class="pictures">', *_pictures(subject, found), "</div>"]
    if found.score is not None:
        parts += ["<h2>Held out</h2>", _held_out(found.score)]
    missing = [] if subject.slow.valid else [_SLOW.format(subject.slow.reason)]
    missing += [] if found.around.map is not None else [_NO_MAP.format(found.around.reason)]
    if missing:
        parts += ["<h2>Not in this recording</h2>", *map(paragraph, missing)]
    given = f"from {subject.sheet}" if subject.sheet else "the nominal drive's"
    parts += [
        "<h2>Recording</h2>",
        pairs(recording_rows(subject, found)),
        "<h2>Taken as given</h2>",
        paragraph(f"These are {given}. The recording shows errors in them only where they are large."),
        pairs(told_rows(subject, found)),
        "<h2>Make it again</h2>",
        paragraph(f"{PACKAGE} {version_of_package()}"),
        f"<pre>{text_of(subject.command)}</pre>",
    ]
    return document(title, "\n".join(parts))


_NO_SHEET = (
    "No drive file was given, so motor and gear ratio are those of the nominal drive. The values below hold only for "
    "a drive that has this motor and this ratio."
)


def _words(text: str) -> str:
    """Return a text of findings with typographic signs."""
    return re.sub(r"(?<![\w.])-(?=\d)", "\u2212", text.replace("+-", "\u00b1"))


def _verdict(subject: Subject, found: Identified) -> str:
    """Return a summary of the results in a few words."""
    told, untold = [], []
    if found.gap is not None and found.gap.valid and found.findings:
        width = found.of("b")
        where = "at one place" if found.around.map is not None else "where the load started"
        told.append(f"The gap is {in_gear_units(width)} ({in_si(width)}) at the output {where}")
    if subject.slow.valid:
        gap, lost, *_ = map(in_gear_units, subject.derived)
        at = f"\u00b1{brief(subject.slow.at)} N m"
        told.append(f"Under a slow torque the gap is {gap}, and the lost motion {lost} between {at} at the output")
    if found.around.map is not None:
        small, _, large, _ = map(in_gear_units, map_findings(found.around.map))
        told.append(f"Around the turn the gap is from {small} to {large}")
    if found.reason:
        untold.append(f"Nothing {'else ' if told else ''}can be determined: {found.reason}")
    elif found.gap is not None and not found.gap.valid:
        untold.append(f"The recording does not show the gap: {found.gap.reason}")
    if missing := sum(not row.told for row in found.findings):
        untold.append(f"{missing} of {len(found.findings)} quantities cannot be determined")
    return paragraph(f"{'. '.join([*told, *untold])}.", "verdict" if told else "verdict bad")


def results_table(rows: list[Row]) -> str:
    """Return a table of results."""
    lines = [
        "<table>",
        '<thead><tr><th scope="col">quantity</th><th scope="col">value \u00b1 standard uncertainty</th>'
        '<th scope="col">in gear makers\u2019 units</th><th scope="col">method, and what it comes from</th>'
        "</tr></thead>",
        "<tbody>",
    ]
    for row in rows:
        name = f'<th scope="row">{text_of(_words(row.what))} <span class="symbol">{text_of(row.symbol)}</span></th>'
        if row.why:
            lines.append(f'<tr>{name}<td class="why" colspan="3">cannot be determined: {text_of(row.why)}</td></tr>')
            continue
        lines.append(
            f'<tr>{name}<td class="number">{text_of(row.value)}</td><td class="number">{text_of(row.gear)}</td>'
            f"<td>{text_of(row.method)}</td></tr>"
        )
    return "\n".join([*lines, "</tbody>", "</table>"])


def _about(subject: Subject, found: Identified) -> list[str]:
    """Return the notes that are needed to read the results."""
    parts = []
    if found.gap is not None and found.gap.valid:
        where = f"What is not said of the turn comes from {found.stretch}. " if found.around.map is not None else ""
        reason = _words(found.gap.reason)
        parts.append(paragraph(f"{where}The gap comes from {reason}. It holds for this law and these torques."))
    rated, told = subject.rated
    if any(row.symbol == "lost motion" for row in subject.derived):
        whose = (
            "the rated torque" if told else "half of the motor's torque at standstill, since no rated torque was given"
        )
        source = _BY_CURVE if subject.slow.valid else _BY_MOTION
        parts.append(
            paragraph(_LOST.format(share=100.0 * LOST_MOTION_SHARE, whose=whose, rated=brief(rated), source=source))
        )
    if subject.slow.valid:
        parts.append(paragraph(_CURVE_UNCERTAINTY))
    return [*parts, paragraph(_UNCERTAINTY)] if found.findings or found.around.map is not None else parts


def _figure(picture: str, caption: str) -> str:
    return f"<figure>{picture}<figcaption>{text_of(caption)}</figcaption></figure>"


def _pictures(subject: Subject, found: Identified) -> list[str]:
    part, fit = fitted_part(subject, found), found.fit
    motion = draw(motion_picture, subject, part, found.before, found.score, counts_at_output(subject))
    around = [_hysteresis(subject.slow)] if subject.slow.valid else []
    around += [] if found.around.map is None else [_around(found.around.map)]
    if found.score is None or found.before is None or fit is None:
        return [_figure(motion, "Both angles as measured, the motor's through the gear."), *around]
    caption = (
        f"Dots: measured. Lines: simulated from the command alone, begun anew every {brief(found.score.free, 2)} s, by "
        "a fit that did not see this part. Below: measured less simulated. The motor's angle is taken through the gear "
        "and so is a count of its encoder. Angles are counted from where they began."
    )
    width = found.of("b")
    loop = draw(loop_picture, subject, part, fit, width)
    shaded = "Shaded: the gap where the load started. " if width.told else "The gap is unknown. "
    told = (
        f"{shaded}Dots: torque and twist at each sample as the filter has them. Line: the law of the teeth that was "
        "fitted, at rest. Dots beside the line are damping of the teeth, and noise."
    )
    return [_figure(motion, caption), _figure(loop, told), *around]


def _hysteresis(found: LostMotion) -> str:
    caption = (
        "Dots: measured, as the torque went slowly up and down. Lines: the branches of the fit, teeth by the "
        f"{found.contact} law; friction puts those up and down apart. Shaded: the gap. Arrow: the lost motion between "
        f"\u00b1{brief(found.at)} N m at the teeth."
    )
    return _figure(draw(hysteresis_picture, found), caption)


def _around(found: GapMap) -> str:
    beside = (
        f" Apart from the gap, the load's encoder reads {brief(1e3 * found.eccentricity)} mrad \u00d7 "
        f"sin(angle + {brief(found.phase)} rad) too much, which an eccentric encoder or gear does."
        if found.eccentric
        else f" Apart from it, {found.eccentricity_in_words()}."
    )
    caption = (
        "Dots: the gap from a fit at each place; bars: its standard uncertainty, where it is larger than the dot. "
        "Between the places the gap was not measured."
    )
    return _figure(draw(around_picture, found), caption + beside)


def _held_out(score: Score) -> str:
    verdict = "as well as" if score.rms <= _AS_WELL else "less well than"
    head = '<thead><tr><th scope="col"></th><th scope="col">as found</th><th scope="col">as told</th></tr></thead>'
    rows = (
        ("each sample against its prediction, in standard deviations (1 is as expected)", score.rms, score.told_rms),
        (
            f"load's angle from the command alone, for {brief(score.free, 2)} s each, rms, rad",
            score.error,
            score.told_error,
        ),
    )
    cells = [
        f'<tr><th scope="row">{text_of(what)}</th>' + _scored("as found", own) + _scored("as told", told) + "</tr>"
        for what, own, told in rows
    ]
    text = (
        f"A second fit saw the first {score.start:.2f} s alone. From one sample to the next it predicts the "
        f"{score.length:.2f} s after {verdict} those that it saw; from the command alone its errors add up. Beside it "
        "the drive as told."
    )
    return "\n".join([paragraph(text), "<table>", head, "<tbody>", *cells, "</tbody>", "</table>"])


def _scored(name: str, value: float) -> str:
    return f'<td class="number" data-name="{name}">{brief(value) if math.isfinite(value) else "cannot follow"}</td>'
