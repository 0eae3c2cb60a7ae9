"""What the controller says of its gains, its drive and its law: margins, what nobody told it, what it waits for."""

import math
from collections.abc import Iterable, Mapping

from backlash_ros.control import Margins, ServoSettings
from backlash_ros.control.laws import lacks

_DRIVE = ("motor.", "gear.", "load.")


def untold_drive(given: Iterable[str]) -> str:
    """Return what to say where no parameter of the drive is among the names ``given``; empty where one is."""
    if any(name.startswith(_DRIVE) for name in given):
        return ""
    return (
        "nothing was said of the drive, it is taken for the nominal one: "
        "for another one give motor.torque_constant, gear.reduction and load.inertia at least"
    )


def stands_in(settings: ServoSettings) -> str:
    """Return what to say where the over-damped law stands in for the one that is asked for; empty where it does not."""
    lacking = lacks(settings)
    if not lacking:
        return ""
    return f"law {settings.law!r} moves slowly, with the over-damped gains, until {lacking}: call identify"


def _distance(margins: Margins) -> str:
    phase = f"{math.degrees(margins.phase):.0f} deg" if math.isfinite(margins.phase) else "any phase"
    delay = f"{1e3 * margins.delay:.3g} ms" if math.isfinite(margins.delay) else "any delay"
    return f"{phase}, {delay}"


def margins_line(name: str, margins: Mapping[str, Margins], period: float) -> tuple[str, bool]:
    """Return the phase and delay margins of a gain set in words, by region, and whether they are a warning.

    They are where a region bears less than 30 deg of lag, or less than a ``period`` (s) of further delay.
    """
    listed = "; ".join(f"{region} {_distance(margin)}" for region, margin in margins.items())
    tight = [region for region, margin in margins.items() if margin.tight(period)]
    line = f"gain set {name!r}, margins of phase and delay: {listed}"
    if tight:
        line += f"; {' and '.join(tight)} below 30 deg or one period, {1e3 * period:.3g} ms: lower gains bear more"
    return line, bool(tight)
