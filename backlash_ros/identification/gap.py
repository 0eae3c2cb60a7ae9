"""The gap from a recording of both encoders, with its uncertainty, or the reason why it is unknown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backlash_ros.drivetrain import CONTACTS, Drive
from backlash_ros.drivetrain.contact import Contact, law_name
from backlash_ros.identification.filter import GAP_SLOPE
from backlash_ros.identification.fit import FITS, PASSES, Fit, fit
from backlash_ros.identification.recording import Recording

_FLANK = 0.04
"""Share of the standstill torque that a flank must have borne to count as seen."""
SCALE = 0.015
"""Largest relative scale error of the load's encoder, such as an eccentric disk causes."""
_SURE, _OF_COUNT = 0.04, 0.4
"""Largest standard deviation by the noise: share of the gap, or counts."""
_MODEL, _CHANGES, _CURVED = 5e-4, 0.1, 0.05
"""Components of the uncertainty beside the noise: a share of the gap; a share of its change over the load's travel as
fitted, which need not be a straight line; and another share of the gap per square radian of this travel, for a change
that is too curved to be fitted."""
_HALF_PERIODS = 5
"""Number of starting values for the delay, half a period apart."""


@dataclass(frozen=True)
class Gap:
    """The gap from a recording: ``angle`` and standard ``uncertainty``, rad at the output, 0 unless valid."""

    angle: float
    uncertainty: float
    valid: bool
    reason: str
    fit: Fit | None = None


def contacts_of(drive: Drive) -> list[Contact]:
    """Return the contact laws to try: the drive's own, then `power` and `elastic` unless it is one of them."""
    own = drive.gear.contact
    names = [name for name in ("power", "elastic") if name != law_name(own)]
    return [own, *(CONTACTS[name]() for name in names)]


def delays_of(period: float) -> list[float]:
    """Return the starting values of the delay, s, for a sample period, s."""
    return [0.5 * period * k for k in range(_HALF_PERIODS)]


def measure_gap(drive: Drive, recording: Recording, torque: float, contacts: Sequence[Contact] = ()) -> Gap:
    """Return the gap at the load's start position.

    Parameters
    ----------
    drive : for its motor and gear ratio, which are taken as given, and its contact law, which is tried first
    torque : of the motor at standstill, N m at the output
    contacts : the laws to try, see `contacts_of`
    """
    period = float(np.median(np.diff(recording.time)))
    found = fit(drive, recording, contacts or contacts_of(drive), delays_of(period), torque)
    gap, (count_m, count_l) = found.gap, found.counts
    deviation = found.gap_deviation
    way = float(np.nanmax(recording.load) - np.nanmin(recording.load))
    change = gap * float(found.parameters[GAP_SLOPE]) * way
    uncertainty = math.hypot(deviation, _MODEL * gap, _CHANGES * change, _CURVED * way**2 * gap)
    why = ""
    if not max(found.rms) <= FITS:
        why = (
            f"no model of teeth, friction and load explains what was seen: its errors are {max(found.rms):.2g} times "
            f"as large as the encoders' counts allow, the limit is {FITS:g} times; check that both encoders count in "
            "the direction of the gear and with its ratio, that couplings hold, and that nothing else moves the load; "
            "a gear that loses a quarter of the torque or more is not modelled"
        )
        if late := np.count_nonzero(recording.doubt > 0.0):
            why += f"; {late} of {recording.time.size} commands were late: if the machine was busy, try again"
        if found.exhausted:
            why += f"; the search stopped after {PASSES} passes of the filter"
    elif found.exhausted:
        why = f"the search for a model that explains the motion found none in {PASSES} passes of the filter"
    elif abs(scale := found.scale) > SCALE:
        why = (
            f"the load's angle differs from the motor's through the gear by {100 * scale:+.1f} %, and may by "
            f"{100 * SCALE:g} %: check gear.reduction, and that the encoders are the right ones"
        )
    elif not found.torques[0] < -_FLANK * torque < _FLANK * torque < found.torques[1]:
        side = "negative" if found.torques[0] >= -_FLANK * torque else "positive"
        why = (
            f"the teeth never bore a {side} torque, so the far flank was not seen: the load torque is larger than "
            "the motor can outrun within the swing"
        )
    elif gap <= (count := max(count_m, count_l)):
        why = (
            f"the gap is {gap:.2g} rad, no more than one encoder count, {count:.2g} rad: it may be wind-up "
            "alone, or the teeth never left a flank under the load torque"
        )
    elif found.rival > 0.0:
        why = (
            f"a gap of {found.rival:.3g} rad explains the motion as well as one of {gap:.3g} rad, so the far flank was "
            "hardly met, or not at all: the load torque may be more than the motor can outrun within the swing; allow "
            "more swing and torque"
        )
    elif not deviation <= max(_SURE * gap, _OF_COUNT * count_l):
        why = f"the gap is {gap:.3g} rad with a standard uncertainty of {uncertainty:.2g} rad, too large to be used"
    if why:
        return Gap(0.0, 0.0, False, why, found)
    told = (
        f"{recording.time[-1] - recording.time[0]:.1f} s of motion, with teeth by the {law_name(found.contact)} law "
        "that bore "
        f"{found.torques[0]:.2g} to {found.torques[1]:.2g} N m"
    )
    return Gap(gap, uncertainty, True, told, found)
