"""Identifies a drive from a recording of both encoders, whatever made it move, or says why this is impossible.

With one encoder the motion must be that of the relay, and the gear is taken as told.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.identification.drive import identified_drive
from backlash_ros.identification.fitting.fit import Fit, fit
from backlash_ros.identification.gap import Gap, delays_of, measure_gap
from backlash_ros.identification.gap_map import FEWEST_PLACES, Mapped
from backlash_ros.identification.one_encoder.gap import measure_gap_one_sided
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding, findings_of
from backlash_ros.identification.recordings.held_out import Score, first_part, score
from backlash_ros.identification.recordings.places import gap_around, liveliest, visits
from backlash_ros.identification.recordings.plausible import implausible, suspicion
from backlash_ros.identification.recordings.stretch import informative

FRICTION = "load.viscous_friction", "load.coulomb_friction"
_MOTOR = frozenset({"motor.torque_constant", "motor.resistance"})
"""Both follow from gain and braking, which are of use only together."""
_TEETH = "gear.backlash_angle"
_NOT_BY_ONE = frozenset({"offset", "eccentricity"})
"""Symbols of what one encoder does not show."""


@dataclass(frozen=True)
class Identified:
    """The result: ``findings``, or the ``reason`` why there are none.

    ``drive`` is the given drive updated with the findings, and ``replaced`` has their names in a drive file; what the
    recording does not show stays as given. ``stretch``: the part that was fitted, empty for all of it. ``period`` of
    the samples, s. ``recording`` is the fitted part, ``before`` the fit to its first three quarters. ``around``: the
    gap around the turn, from the whole recording.
    """

    reason: str
    drive: Drive
    findings: tuple[Finding, ...] = ()
    replaced: frozenset[str] = frozenset()
    score: Score | None = None
    gap: Gap | None = None
    stretch: str = ""
    period: float = 0.0
    fit: Fit | None = field(default=None, repr=False, compare=False)
    recording: Recording | None = field(default=None, repr=False, compare=False)
    before: Fit | None = field(default=None, repr=False, compare=False)
    around: Mapped = field(default=Mapped(None, "it was not looked for"), repr=False, compare=False)

    @property
    def valid(self) -> bool:
        """Whether anything was found in the part that was fitted."""
        return any(finding.told for finding in self.findings)

    def of(self, key: str) -> Finding:
        """Return the finding with a key of the drive file, or a symbol."""
        return next(finding for finding in self.findings if key in {finding.key, finding.symbol})


def identify(drive: Drive, recording: Recording, *, hold_out: bool = True) -> Identified:
    """Return the findings from a recording of a drive.

    Parameters
    ----------
    drive : as given: its motor, gear ratio and command are kept, its contact law is tried first
    recording : see `Recording`; its samples need not be evenly spaced
    hold_out : whether a part is held out for the score, which doubles the time

    Notes
    -----
    The values come from the whole fitted stretch; the score from a fit to its first three quarters. If the recording
    goes around the turn from place to place, the stretch is at one of them: elsewhere the gap differs.
    """
    if np.isnan(recording.motor).all() or np.isnan(recording.load).all():
        return _identify_by_one(drive, recording)
    places = visits(recording)
    chosen, stretch = informative(recording) if len(places) < FEWEST_PLACES else liveliest(recording, places)
    period = float(np.median(np.diff(chosen.time))) if chosen.time.size > 1 else 0.0
    around = gap_around(drive, places)
    refused = Identified("", drive, stretch=stretch, period=period, recording=chosen, around=around)
    if why := implausible(drive, chosen):
        return replace(refused, reason=why)
    gap = measure_gap(drive, chosen, drive.standstill_torque())
    found = gap.fit
    suspected = "" if gap.sound else suspicion(drive, chosen, delays_of(period))
    if found is None or not gap.sound or suspected:
        why = f"{suspected}: {gap.reason}" if suspected else gap.reason
        return replace(refused, reason=why, gap=gap, fit=found)
    rows = findings_of(drive, gap, found, period)
    fitted, replaced = _replaced(drive, found, rows)
    result = replace(refused, drive=fitted, replaced=replaced, findings=tuple(rows), gap=gap, fit=found)
    if not hold_out:
        return result
    before = fit(drive, first_part(chosen), drive.standstill_torque(), delays_of(period))
    return result if before is None else replace(result, score=score(drive, before, chosen), before=before)


def _identify_by_one(drive: Drive, recording: Recording) -> Identified:
    """Return the findings from a relay's recording of one encoder."""
    period = float(np.median(np.diff(recording.time)))
    gap = measure_gap_one_sided(drive, recording, drive.standstill_torque())
    found, refused = gap.fit, Identified("", drive, period=period, recording=recording, gap=gap, fit=gap.fit)
    if found is None or not gap.valid:
        return replace(refused, reason=gap.reason)
    told = [row for row in findings_of(drive, gap, found, period) if row.symbol not in _NOT_BY_ONE]
    fitted, replaced = _replaced(drive, found, told)
    return replace(refused, drive=fitted, replaced=replaced, findings=tuple(told))


def _replaced(drive: Drive, found: Fit, rows: list[Finding]) -> tuple[Drive, frozenset[str]]:
    """Return the given drive updated with the findings, and their names."""
    fitted = identified_drive(drive, found)
    used = {row.key for row in rows if row.plans} - {""}
    if all(row.plans for row in rows if row.symbol.endswith("B_l + c_l")):
        used |= set(FRICTION)  # their sum is right, however it is divided
    else:
        used -= set(FRICTION)
    load = {
        name: getattr(fitted.load, name)
        for name in ("inertia", "viscous_friction", "coulomb_friction")
        if f"load.{name}" in used
    }
    result = replace(drive, load=replace(drive.load, **load))
    if not used >= _MOTOR and not drive.takes_current:
        used -= _MOTOR
    motor = {
        name: getattr(fitted.motor, name)
        for name in ("coulomb_friction", "torque_constant", "resistance")
        if f"motor.{name}" in used
    }
    result = replace(result, motor=replace(drive.motor, **motor))
    if _TEETH in used:
        result = replace(result, gear=fitted.gear)
        used |= {"contact"}
    return result, frozenset(used)
