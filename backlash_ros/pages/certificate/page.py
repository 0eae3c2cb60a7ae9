"""A certificate as one self-contained page of HTML: no script, no other file, no network."""

import math
from collections.abc import Sequence

from markupsafe import Markup

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
    counts_at_output,
    fitted_part,
    recording_rows,
    result_rows,
    told_rows,
    typeset,
)
from backlash_ros.pages.template import render
from backlash_ros.recordings.rounding import brief, in_gear_units, in_si
from backlash_ros.recordings.subject import Subject

Pictures = Sequence[tuple[Markup, str]]
"""Pictures with their captions."""

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
    summary, told = _summary(subject, found)
    missing = [] if subject.slow.valid else [_SLOW.format(subject.slow.reason)]
    missing += [] if found.around.map is not None else [_NO_MAP.format(found.around.reason)]
    return render(
        "certificate/certificate.html.j2",
        title=f"Drive certificate: {subject.joints[0]}, {subject.joints[1]}",
        source=subject.source,
        summary=summary,
        told=told,
        sheet=subject.sheet,
        rows=result_rows(subject, found),
        notes=_notes(subject, found),
        pictures=_pictures(subject, found),
        held_out=None if found.score is None else _held_out(found.score),
        missing=missing,
        recording=recording_rows(subject, found),
        given=f"from {subject.sheet}" if subject.sheet else "the nominal drive's",
        taken=told_rows(subject, found),
        command=subject.command,
    )


def _summary(subject: Subject, found: Identified) -> tuple[str, bool]:
    """Return the results in a few words, and whether there are any."""
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
    return f"{'. '.join([*told, *untold])}.", bool(told)


def _notes(subject: Subject, found: Identified) -> list[str]:
    """Return the notes that are needed to read the results."""
    notes = []
    if found.gap is not None and found.gap.valid:
        where = f"What is not said of the turn comes from {found.stretch}. " if found.around.map is not None else ""
        reason = typeset(found.gap.reason)
        notes.append(f"{where}The gap comes from {reason}. It holds for this law and these torques.")
    rated, told = subject.rated
    if any(row.symbol == "lost motion" for row in subject.derived):
        whose = (
            "the rated torque" if told else "half of the motor's torque at standstill, since no rated torque was given"
        )
        source = _BY_CURVE if subject.slow.valid else _BY_MOTION
        notes.append(_LOST.format(share=100.0 * LOST_MOTION_SHARE, whose=whose, rated=brief(rated), source=source))
    if subject.slow.valid:
        notes.append(_CURVE_UNCERTAINTY)
    return [*notes, _UNCERTAINTY] if found.findings or found.around.map is not None else notes


def _pictures(subject: Subject, found: Identified) -> Pictures:
    part, fit = fitted_part(subject, found), found.fit
    motion = draw(motion_picture, subject, part, found.before, found.score, counts_at_output(subject))
    around = [_hysteresis(subject.slow)] if subject.slow.valid else []
    around += [] if found.around.map is None else [_around(found.around.map)]
    if found.score is None or found.before is None or fit is None:
        return [(motion, "Both angles as measured, the motor's through the gear."), *around]
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
    return [(motion, caption), (loop, told), *around]


def _hysteresis(found: LostMotion) -> tuple[Markup, str]:
    caption = (
        "Dots: measured, as the torque went slowly up and down. Lines: the branches of the fit, teeth by the "
        f"{found.contact} law; friction puts those up and down apart. Shaded: the gap. Arrow: the lost motion between "
        f"\u00b1{brief(found.at)} N m at the teeth."
    )
    return draw(hysteresis_picture, found), caption


def _around(found: GapMap) -> tuple[Markup, str]:
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
    return draw(around_picture, found), caption + beside


def _held_out(score: Score) -> dict[str, object]:
    """Return the text about a second fit, and rows with the errors of both drives."""
    verdict = "as well as" if score.rms <= _AS_WELL else "less well than"
    rows = (
        ("each sample against its prediction, in standard deviations (1 is as expected)", score.rms, score.told_rms),
        (
            f"load's angle from the command alone, for {brief(score.free, 2)} s each, rms, rad",
            score.error,
            score.told_error,
        ),
    )
    text = (
        f"A second fit saw the first {score.start:.2f} s alone. From one sample to the next it predicts the "
        f"{score.length:.2f} s after {verdict} those that it saw; from the command alone its errors add up. Beside it "
        "the drive as told."
    )
    return {"text": text, "rows": [(what, _error(own), _error(told)) for what, own, told in rows]}


def _error(value: float) -> str:
    return brief(value) if math.isfinite(value) else "cannot follow"
