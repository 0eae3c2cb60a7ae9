"""The certificate of a locked output: figures and curve on one self-contained page of HTML."""

import math
from collections.abc import Sequence

from backlash_ros.foundation.markup import text_of
from backlash_ros.identification.locked_output.ramps import Figure, Ramps
from backlash_ros.identification.recordings.slow_torque import ramps_findings
from backlash_ros.pages.certificate.page import results_table
from backlash_ros.pages.certificate.pictures import draw, ramps_picture
from backlash_ros.pages.certificate.rows import Row
from backlash_ros.pages.markup import document, paragraph
from backlash_ros.recordings.rounding import in_gear_units, in_si
from backlash_ros.recordings.subject import PACKAGE, version_of_package

_UNCERTAINTY = (
    "Values are means over the ramps. Their standard uncertainties come from the scatter of the ramps and the angle's "
    "resolution: the mean of more such ramps is within two of them in 95 of 100 cases. They hold if the scales of "
    "torque and angle, the zero of the torque and the gear ratio are right. Repeatability is the largest difference "
    "between the ramps of the mean."
)
_CAPTION = "Angle over torque. Lines: the ramps, the first one paler. Arrow: the lost motion at zero torque."


def page(source: str, found: Sequence[Ramps], notes: Sequence[str], command: str) -> str:
    """Return the page of all sets of ramps, or why there are none."""
    parts = [f"<h1>{text_of('Lost motion of a locked output')}</h1>", f'<p class="under">{text_of(source)}</p>']
    for number, ramps in enumerate(found):
        if not ramps.valid:
            parts.append(paragraph(f"Nothing can be told: {ramps.reason}.", "verdict bad"))
            continue
        curve = draw(ramps_picture, ramps, f"ramps{number}")
        parts += [
            paragraph(f"{ramps.in_words().replace('+-', chr(177))}.", "verdict"),
            results_table(_rows(ramps)),
            f"<figure>{curve}<figcaption>{text_of(_CAPTION)}</figcaption></figure>",
        ]
    if any(ramps.valid for ramps in found):
        parts.append(paragraph(_UNCERTAINTY))
    parts += [paragraph(note) for note in notes]
    made = f"{PACKAGE} {version_of_package()}"
    parts += ["<h2>Make it again</h2>", paragraph(made), f"<pre>{text_of(command)}</pre>"]
    return document(f"Lost motion: {source}", "\n".join(parts))


def _rows(ramps: Ramps) -> list[Row]:
    figures = (ramps.at_zero, ramps.at_torque, ramps.without_friction, ramps.width, *ramps.breakaway, *ramps.stiffness)
    return [
        Row(row.what, row.symbol, why=row.why)
        if row.why
        else Row(row.what, row.symbol, in_si(row), in_gear_units(row), _repeats(figure, row.unit))
        for row, figure in zip(ramps_findings(ramps), figures, strict=True)
    ]


def _repeats(figure: Figure, unit: str) -> str:
    """Return how well the ramps repeat, in words."""
    text = f"repeatability {figure.spread:.2g} {unit}, {sum(map(math.isfinite, figure.values))} ramps"
    return f"{text}; the first {figure.first:+.2g} {unit} apart" if math.isfinite(figure.first) else text
