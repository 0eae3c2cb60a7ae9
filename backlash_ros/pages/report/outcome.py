"""How a step ended, whether it rattled on its way, and which of several is the worst. Pure computation."""

import math

from backlash_ros.pages.report.steps import Step
from backlash_ros.pages.report.timing import SETTLING
from backlash_ros.studies.metrics import TAIL

SETTLED, SWINGS, NEVER, CUT = "settled", "ended in a limit cycle", "did not settle", "ended too soon to tell"
RESTLESS = SWINGS, NEVER
_RATTLE = 4
"""Crossings of the gap that make a rattle: to brake a load and to hold it takes two at most, a bounce makes a third."""


def ending(step: Step) -> str:
    """Return how a step ended: one of four ways."""
    if math.isfinite(step.amplitude):
        return SWINGS
    if math.isfinite(step.settling):
        return SETTLED
    return CUT if step.end - step.start < TAIL + SETTLING else NEVER


def rattled(step: Step) -> bool:
    """Return whether the teeth beat from flank to flank before the load came to rest."""
    return ending(step) not in RESTLESS and step.crossings >= _RATTLE


def trouble(step: Step) -> tuple[float, int]:
    """Return how bad a step is, to be compared: how far from rest it ended, rad, 0 if it settled; and its crossings."""
    if ending(step) not in RESTLESS:
        return 0.0, step.crossings
    return max(each for each in (step.residual, abs(step.error), 0.0) if not math.isnan(each)), step.crossings
