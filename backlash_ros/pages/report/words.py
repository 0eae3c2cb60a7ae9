"""Numbers, lengths in b and outcomes in words."""

import math
from typing import Any

from backlash_ros.pages.report.paths import FollowedPath
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.steps import Step
from backlash_ros.recordings.rounding import brief

NONE = "\u2013"
_USUAL = "nominal"
"""The gain set that is not worth saying."""
_STAMP = 1e-9
"""Resolution of stamps, s."""


def figure(value: float) -> str:
    """Return a number; a dash if the recording does not show it."""
    if math.isnan(value):
        return NONE
    return "never" if math.isinf(value) else brief(value)


def milliseconds(*seconds: float) -> str:
    """Return times in ms; what is less than a stamp's digits is 0."""
    return ", ".join(figure(0.0 if abs(value) < _STAMP else 1e3 * value) for value in seconds)


def moment(seconds: float) -> str:
    """Return a time from the start."""
    return f"{seconds:.3f}".replace("-", "\u2212")


def briefly(value: Any) -> str:
    """Return a parameter's value as short as it can be read."""
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(briefly, value))}]"
    return "none" if value is None else str(value)


def in_b(report: AxisReport, angle: float) -> str:
    """Return an angle in b, or in mrad if the backlash is unknown."""
    return NONE if math.isnan(angle) else f"{angle / report.scale:.3f}"


def cycle_words(report: AxisReport, step: Step) -> str:
    """Return the limit cycle of a step or hold: swing and frequency."""
    if math.isnan(step.residual):
        return NONE
    if math.isnan(step.amplitude):
        return "none"
    often = "uneven" if math.isnan(step.frequency) else f"at {brief(step.frequency)}\u00a0Hz"
    return f"{in_b(report, step.amplitude)} {often}"


def law_words(step: Step | FollowedPath) -> str:
    """Return the law of a step or path, with its gain set if it has one of its own."""
    return " ".join(filter(None, (step.law, step.gain_set if step.gain_set != _USUAL else ""))) or NONE
