"""The rows of a certificate: each quantity in words, with the range of motion that it is based on."""

import math
import re
from dataclasses import dataclass

import numpy as np

from backlash_ros.drivetrain.contact import law_name
from backlash_ros.foundation.quantity import Validated, quantities
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.identify import Identified
from backlash_ros.identification.teeth import loop_of
from backlash_ros.recordings.rounding import brief, in_gear_units, in_si
from backlash_ros.recordings.subject import Subject

_BY_TEETH = {"b", "wind-up", "J_l", "lost motion", "stiffness"}
_AROUND = {"b min", "b mean", "b max", "e"}
_BY_CURVE = {"b at rest", "stiffness -", "stiffness +", "friction"}
_BY_CURVE |= {"lost motion 0", "lost motion T", "width", "T -", "T +"}
_BY_SPEED = {"B_l", "c_l", "c_m", "1 B_l + c_l", "10 B_l + c_l"}


@dataclass(frozen=True)
class Row:
    """One quantity: name, symbol, value in SI and in gear makers' units, and method, or why it has no value."""

    what: str
    symbol: str
    value: str = ""
    gear: str = ""
    method: str = ""
    why: str = ""


@dataclass(frozen=True)
class Ranges:
    """The ranges of the motion in words: torque of the teeth, speed and angle of the load.

    If no free motion was fitted, only ``around`` (the places around the turn) and ``slow`` (the slow torque) are set.
    """

    around: str
    slow: str
    teeth: str = ""
    speed: str = ""
    angle: str = ""
    delay: str = ""

    def of(self, symbol: str) -> str:
        """Return the range that matters for a quantity."""
        if symbol in _AROUND:
            return self.around
        if symbol in _BY_CURVE or (self.slow and symbol == "lost motion"):
            return self.slow
        if symbol in _BY_TEETH:
            return self.teeth
        if symbol in _BY_SPEED:
            return self.speed
        return self.delay if symbol == "delay" else self.angle


def ranges_of(subject: Subject, found: Identified) -> Ranges:
    """Return the ranges of what was fitted."""
    fit, recording, around, slow = found.fit, found.recording, "", ""
    if found.around.map is not None:
        around = f"at each of {len(found.around.map.places)} places around the turn"
    if subject.slow.valid:
        slow = f"torque slowly up and down to \u00b1{brief(subject.slow.torque)}\u00a0N\u00a0m on an output that stood"
    if fit is None or recording is None:
        return Ranges(around, slow)
    speed = float(np.max(np.abs(loop_of(subject.told, fit, recording).speed)))
    low, high = float(np.nanmin(recording.load)), float(np.nanmax(recording.load))
    least, largest = (brief(torque, 2) for torque in fit.torques)
    return Ranges(
        around,
        slow,
        teeth=f"teeth by {fit.teeth.name} law that bore {least} to {largest} N\u00a0m",
        speed=f"load at up to {brief(speed)}\u00a0rad/s",
        angle=f"load from {brief(low)} to {brief(high)}\u00a0rad",
        delay=f"samples {brief(1e3 * found.period)}\u00a0ms apart",
    )


def typeset(text: str) -> str:
    """Return a text of findings with typographic signs."""
    return re.sub(r"(?<![\w.])-(?=\d)", "\u2212", text.replace("+-", "\u00b1"))


def row_of(finding: Finding, method: str) -> Row:
    """Return a finding as a row."""
    if not finding.told:
        return Row(typeset(finding.what), finding.symbol, why=finding.why)
    return Row(typeset(finding.what), finding.symbol, in_si(finding), in_gear_units(finding), method)


def result_rows(subject: Subject, found: Identified) -> list[Row]:
    """Return all results, or why there are none; those of gap and teeth first."""
    ranges = ranges_of(subject, found)
    rows = (*found.findings[:1], *subject.derived, *found.findings[1:])
    return [row_of(f, f"fit; {ranges.of(f.symbol)}") for f in rows]


def recording_rows(subject: Subject, found: Identified) -> list[tuple[str, str]]:
    """Return what was recorded."""
    time, motor, load = subject.recording[:3]
    lost = int(np.sum(~np.isfinite(motor) & ~np.isfinite(load)))
    rows = [("file", subject.source)]
    if subject.began is not None:
        rows.append(("date, by its stamps", f"{subject.began:%Y-%m-%d %H:%M:%S} UTC"))
    rows += [
        ("length", f"{time[-1] - time[0]:.2f} s"),
        ("rate", f"{brief(1.0 / found.period)} Hz" if found.period > 0.0 else "none"),
        ("samples", f"{time.size - lost}"),
        ("samples lost", f"{lost} of {time.size}" if lost else "none seen"),
        ("used", found.stretch if found.stretch and not subject.slow.valid else "all of it"),
    ]
    names = f"{subject.joints[0]}, {subject.joints[1]}"
    for name, turn in zip(
        (f"encoder of {subject.joints[0]}", f"encoder of {subject.joints[1]}"), subject.counts, strict=True
    ):
        rows.append((name, f"{turn:.10g} counts in a turn" if turn > 0.0 else "counts not known"))
    rows.insert(1, ("joints", names))
    return rows + [("note", note) for note in subject.notes]


def told_rows(subject: Subject, found: Identified) -> list[tuple[str, str]]:
    """Return what was taken as given: motor, gear ratio and command."""
    drive = subject.told
    unused = {"coulomb_friction", "voltage_limit" if drive.takes_current else "current_limit"}
    unused |= {"resistance", "inductance"} if drive.takes_current else set()
    rows = [("command", f"{'current' if drive.takes_current else 'voltage'}, {drive.command_unit}")]
    rows += [_quantity(drive.motor, name) for name in quantities(type(drive.motor)) if name not in unused]
    rows.append(_quantity(drive.gear, "reduction"))
    if found.fit is not None:
        rows.append(("law of the teeth", "free" if found.fit.teeth.free else law_name(found.fit.contact)))
    return rows


def _quantity(part: Validated, name: str) -> tuple[str, str]:
    described = quantities(type(part))[name]
    value = getattr(part, name)
    assert math.isfinite(value)
    return described.description, f"{value:.10g} {described.unit}".rstrip().replace("^2", "\u00b2")


def counts_at_output(subject: Subject) -> tuple[float, float]:
    """Return the counts of both encoders, rad at the output; 0 if unknown."""
    motor, load = (2.0 * math.pi / turn if turn > 0.0 else 0.0 for turn in subject.counts)
    return motor * subject.told.gear.ratio, load


def fitted_part(subject: Subject, found: Identified) -> Recording:
    """Return the part of the recording that was fitted, or all of it if none was."""
    return found.recording if found.recording is not None and found.fit is not None else subject.recording
