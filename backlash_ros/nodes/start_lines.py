"""Lines of the controller's log at the start: margins, what was not described, the encoders, what the law waits for."""

from collections.abc import Iterable, Mapping

from backlash_ros.control import AUTO, Margins, ServoSettings
from backlash_ros.control.laws import BEST, UNTIL_THEN, best_refusal, lacks
from backlash_ros.control.settings import BOTH
from backlash_ros.drivetrain import Drive

_DRIVE = ("motor.", "gear.", "load.")


def untold_drive(given: Iterable[str]) -> str:
    """Return a warning if no parameter of the drive is among the names ``given``; else an empty text."""
    if any(name.startswith(_DRIVE) for name in given):
        return ""
    return (
        "no drive parameters were given, so the nominal drive is assumed: "
        "for another drive set at least motor.torque_constant, gear.reduction and load.inertia"
    )


def drive_found(encoders: str) -> str:
    """Return which encoders the first sample had."""
    return "drive found: both encoders" if encoders == BOTH else f"drive found: the {encoders}'s encoder alone"


def stands_in(drive: Drive, settings: ServoSettings) -> str:
    """Return what ``auto`` stands for, or what replaces the chosen law for now, and why; else an empty text."""
    lacking = lacks(settings)
    if settings.law == AUTO:
        if lacking:
            return f"law 'auto' is {UNTIL_THEN!r} until {lacking}, and {BEST!r} from then on: call identify"
        refusal = best_refusal(drive, settings)
        return f"law 'auto' stays {UNTIL_THEN!r}: {refusal}" if refusal else f"law 'auto' is {BEST!r} from now on"
    if not lacking:
        return ""
    return f"law {settings.law!r} uses the over-damped gains, which are slow, until {lacking}: call identify"


def margins_line(name: str, margins: Mapping[str, Margins], period: float) -> tuple[str, bool]:
    """Return the margins of a gain set in words, by region, and whether one is `Margins.tight` at a ``period`` (s)."""
    listed = "; ".join(f"{region} {margin.in_words()}" for region, margin in margins.items())
    tight = [region for region, margin in margins.items() if margin.tight(period)]
    line = f"gain set {name!r}, margins: {listed}"
    if tight:
        line += f"; {' and '.join(tight)} below 30 deg or one period, {1e3 * period:.3g} ms: lower the gains"
    return line, bool(tight)
