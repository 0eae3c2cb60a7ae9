"""The gap from a recording of both encoders: how large, how sure, or why it cannot be told."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backlash_ros.drivetrain import CONTACTS, Drive
from backlash_ros.drivetrain.contact import Contact, law_name
from backlash_ros.identification.fit import FITS, PASSES, Fit, fit
from backlash_ros.identification.recording import Recording

_FLANK = 0.04
"""Share of the torque at standstill that a flank has borne to be counted as seen."""
SCALE = 0.015
"""Largest share by which the load's encoder may read too much or too little: what an eccentric disk does."""
_SURE, _HALF_COUNT = 0.05, 0.5
"""Largest standard uncertainty: share of the gap, or counts."""
_NOISE, _MODEL, _CURVED, _COUNT = 1.25, 0.002, 0.05, 0.03
"""What the uncertainty is made of: times the standard deviation by the noise, a share of the gap, another one for each
square radian of the load's way, since a gap varies, and a share of a count."""
_HALF_PERIODS = 5
"""How many delays are tried as starts, half a period apart."""


@dataclass(frozen=True)
class Gap:
    """What a recording says of the gap: ``angle`` and standard ``uncertainty``, rad at the output, 0 unless valid."""

    angle: float
    uncertainty: float
    valid: bool
    reason: str
    fit: Fit | None = None


def contacts_of(drive: Drive) -> list[Contact]:
    """Return the contact laws that are tried: the drive's own, then those of `power` and `elastic` that it is not."""
    own = drive.gear.contact
    names = [name for name in ("power", "elastic") if name != law_name(own)]
    return [own, *(CONTACTS[name]() for name in names)]


def delays_of(period: float) -> list[float]:
    """Return the delays that are tried as starts, s, for samples with a period, s."""
    return [0.5 * period * k for k in range(_HALF_PERIODS)]


def measure_gap(drive: Drive, recording: Recording, torque: float, contacts: Sequence[Contact] = ()) -> Gap:
    """Return the gap where the load started.

    Parameters
    ----------
    drive : for its motor and gear ratio, which are taken as they are, and its contact law, which is tried first
    torque : of the motor at standstill, N m at the output
    contacts : the laws that are tried, see `contacts_of`
    """
    period = float(np.median(np.diff(recording.time)))
    found = fit(drive, recording, contacts or contacts_of(drive), delays_of(period), torque)
    gap, (count_m, count_l) = found.gap, found.counts
    deviation = _NOISE * found.gap_deviation
    way = float(np.nanmax(recording.load) - np.nanmin(recording.load))
    uncertainty = math.hypot(deviation, _MODEL * gap, _CURVED * way**2 * gap, _COUNT * math.hypot(count_m, count_l))
    why = ""
    if not max(found.rms) <= FITS:
        why = (
            f"no model of teeth, friction and load explains what was seen: its errors are {max(found.rms):.2g} times "
            f"as large as the encoders' counts allow, and may be {FITS:g} times; check that both encoders count in "
            "the direction of the gear and with its ratio, that couplings hold, and that nothing else moves the load"
        )
        if found.exhausted:
            why += f"; the search for one ended after {PASSES} passes of the filter"
    elif found.exhausted:
        why = f"the search for what explains the motion had no answer after {PASSES} passes of the filter"
    elif abs(scale := found.scale) > SCALE:
        why = (
            f"the load's angle grows by {100 * scale:+.1f} % more than the motor's through the gear, and may differ by "
            f"{100 * SCALE:g} %: check gear.reduction, and that the encoders are the right ones"
        )
    elif not found.torques[0] < -_FLANK * torque < _FLANK * torque < found.torques[1]:
        side = "negative" if found.torques[0] >= -_FLANK * torque else "positive"
        why = (
            f"the teeth never bore a {side} torque, so the far flank was not seen: the load torque is more than "
            "the motor can outrun within the swing"
        )
    elif gap <= (count := max(count_m, count_l)):
        why = (
            f"the gap is {gap:.2g} rad, no more than a count of the encoders, {count:.2g} rad: it may be wind-up "
            "alone, or the teeth never left a flank under the load torque"
        )
    elif not deviation <= max(_SURE * gap, _HALF_COUNT * count_l):
        why = f"the gap is {gap:.3g} rad with a standard uncertainty of {uncertainty:.2g} rad, too much to be used"
    if why:
        return Gap(0.0, 0.0, False, why, found)
    told = (
        f"{recording.time[-1] - recording.time[0]:.1f} s of motion, with teeth by the {law_name(found.contact)} law "
        "that bore "
        f"{found.torques[0]:.2g} to {found.torques[1]:.2g} N m"
    )
    return Gap(gap, uncertainty, True, told, found)
