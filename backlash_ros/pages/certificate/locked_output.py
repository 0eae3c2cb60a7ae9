"""The certificate of a locked output: figures and curve on one self-contained page of HTML."""

import math
from collections.abc import Sequence

from backlash_ros.identification.locked_output.ramps import Figure, Ramps
from backlash_ros.identification.recordings.slow_torque import ramps_findings
from backlash_ros.pages.certificate.pictures import draw, ramps_picture
from backlash_ros.pages.certificate.rows import Row, row_of
from backlash_ros.pages.template import render

_UNCERTAINTY = (
    "Values are means over the ramps. Their standard uncertainties come from the scatter of the ramps and the angle's "
    "resolution: the mean of more such ramps is within two of them in 95 of 100 cases. They hold if the scales of "
    "torque and angle, the zero of the torque and the gear ratio are right. Repeatability is the largest difference "
    "between the ramps of the mean."
)


def page(source: str, found: Sequence[Ramps], notes: Sequence[str], command: str) -> str:
    """Return the page of all sets of ramps, or why there are none."""
    return render(
        "certificate/locked_output.html.j2",
        title=f"Lost motion: {source}",
        source=source,
        found=[_shown(ramps, number) for number, ramps in enumerate(found)],
        notes=[*([_UNCERTAINTY] if any(ramps.valid for ramps in found) else []), *notes],
        command=command,
    )


def _shown(ramps: Ramps, number: int) -> dict[str, object]:
    """Return what the page shows of a set of ramps, or why it shows nothing."""
    if not ramps.valid:
        return {"why": ramps.reason}
    return {
        "why": "",
        "words": ramps.in_words().replace("+-", "\u00b1"),
        "rows": _rows(ramps),
        "curve": draw(ramps_picture, ramps, f"ramps{number}"),
    }


def _rows(ramps: Ramps) -> list[Row]:
    figures = (ramps.at_zero, ramps.at_torque, ramps.without_friction, ramps.width, *ramps.breakaway, *ramps.stiffness)
    return [row_of(row, _repeats(figure, row.unit)) for row, figure in zip(ramps_findings(ramps), figures, strict=True)]


def _repeats(figure: Figure, unit: str) -> str:
    """Return how well the ramps repeat, in words."""
    text = f"repeatability {figure.spread:.2g} {unit}, {sum(map(math.isfinite, figure.values))} ramps"
    return f"{text}; the first {figure.first:+.2g} {unit} apart" if math.isfinite(figure.first) else text
