"""The gap from a recording of both encoders, with its uncertainty, or the reason why it is unknown.

That a model misses some of what was seen is no reason to refuse: it makes the gap less certain. Refused is what cannot
be known, or not well enough to be used.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.identification.counts import stuck_bit
from backlash_ros.identification.fitting.fit import PASSES, Fit, Found, Search, search_all
from backlash_ros.identification.recording import Recording

_FLANK = 0.04
"""Share of the standstill torque that a flank must have borne to count as seen."""
_ONE_FLANK = 0.2
"""Cost for each sample by which a model without the far flank must be worse."""
_SCALE = 0.015
"""Largest relative scale error of the load's encoder, such as an eccentric disk causes."""
_GAIN = 0.5
"""Largest difference of the motor's gain from its data sheet, as a logarithm."""
_SURE = 0.08
"""Largest uncertainty of a gap to be used, a share of it; tuned."""
_OF_COUNT = 0.7
"""Largest uncertainty of a gap to be used, in counts, where these are coarser; tuned."""
_APART = 0.1
"""Largest difference of a flank between both halves of the recording, a share of the gap; tuned."""
_SIGMAS = 3.0
"""Largest difference of a flank between both halves, in standard deviations: noise hardly makes as much."""
_MOTOR_UNEXPLAINED = 0.06
"""Largest unexplained torque on the motor, as a share of the stall torque; tuned."""
_LOAD_UNEXPLAINED = 0.03
"""Largest unexplained torque on the load, as a share of the stall torque; tuned."""
_TEETH_UNEXPLAINED = 0.5
"""Largest unexplained share of the teeth's torque."""
_NOISE = 2.0
"""Component of the uncertainty: a factor on the standard deviation by the noise; tuned."""
_MODEL = 0.008
"""Component of the uncertainty: a share of the gap; tuned."""
_COUNTS = 0.25
"""Component of the uncertainty: counts of the coarser encoder; tuned."""
_SHARE = 0.1
"""Component of the uncertainty: a share of the gap, times the unexplained share of the teeth's torque; tuned."""
_UNEXPLAINED = 1.5
"""Component of the uncertainty: a share of the gap, times the unexplained shares of the stall torque; tuned."""
_HERTZ = math.log(1.5)
"""Exponent of Hertz's teeth, as a logarithm: steeper ones are hardly only teeth."""
_STEEP = 0.5
"""Component of the uncertainty for these: a part of their wind-up, times how much steeper, as a logarithm; tuned."""
_LAWS = 0.05
"""Cost for each sample by which a law must be worse for its gap to count by 1/e."""
_CHANGES = 0.1
"""Component of the uncertainty: a share of the gap's change over the travel, which need not be a straight line."""
_CURVED = 0.05
"""Component of the uncertainty: a share of the gap per square radian of the travel, for a change that is too curved."""
_HALF_PERIODS = 5
"""Number of starting values for the delay, half a period apart."""


@dataclass(frozen=True)
class Gap:
    """The gap from a recording: ``angle`` and standard ``uncertainty``, rad at the output, 0 unless valid.

    ``sound``: whether the rest of the fit can be believed, even if the gap is not valid.
    """

    angle: float
    uncertainty: float
    valid: bool
    reason: str
    fit: Fit | None = None
    sound: bool = False


class _Doubt(NamedTuple):
    """Why a gap is refused; ``all``: the whole fit is."""

    reason: str
    all: bool = False


def delays_of(period: float) -> list[float]:
    """Return the starting values of the delay, s, for a sample period, s."""
    return [0.5 * period * k for k in range(_HALF_PERIODS)]


def uncertainty_of(found: Fit, way: float) -> float:
    """Return the standard uncertainty of a fit's gap, rad, where the load went over a ``way``, rad."""
    gap = found.gap
    first, second = found.laws
    steep = 0.0
    if found.teeth.free:
        above = max(float(found.values.ln_exponent) - _HERTZ, 0.0)
        steep = _STEEP * above * 2.0 * found.bearing * found.wind_up()[0]
    worse = 0.0 if found.steeper else abs(first.cost - second.cost)
    other = abs(first.gap - second.gap) * math.exp(-worse / _LAWS)
    change = gap * float(found.values.gap_slope) * way
    return math.hypot(
        _NOISE * found.gap_deviation,
        _MODEL * gap,
        _COUNTS * max(found.counts),
        _SHARE * found.noise[2] * gap,
        _UNEXPLAINED * (found.noise[0] + found.noise[1]) * gap,
        steep,
        found.scale * gap,
        other,
        _CHANGES * change,
        _CURVED * way**2 * gap,
    )


def measure_gap(drive: Drive, recording: Recording, torque: float) -> Gap:
    """Return the gap at the load's start position.

    Parameters
    ----------
    drive : for its motor and gear ratio, and its contact law, which is tried beside the free one
    torque : of the motor at standstill, N m at the output
    """
    if doubt := _wrong_readings(recording):
        return Gap(0.0, 0.0, False, doubt.reason)
    period = float(np.median(np.diff(recording.time)))
    searched = search_all(drive, recording, torque, delays_of(period))
    if searched is None:
        why = (
            "no drive with this motor and gear moves as recorded: check the units, the motor's parameters, and that "
            "both encoders and the command belong to this drive"
        )
        return Gap(0.0, 0.0, False, why)
    search, point, laws = searched
    found = search.result(point, laws)
    way = float(np.nanmax(recording.load) - np.nanmin(recording.load))
    uncertainty = uncertainty_of(found, way)
    doubt = (
        _reversed(search, point)
        or _unbelievable(found)
        or _slipped(search, point, found)
        or _doubt(found, uncertainty, torque)
        or _one_flank(search, point)
    )
    if doubt:
        return Gap(0.0, 0.0, False, _with_late_commands(doubt, recording), found, sound=not doubt.all)
    told = (
        f"{recording.time[-1] - recording.time[0]:.1f} s of motion, with teeth by {found.teeth.name} law that bore "
        f"{found.torques[0]:.2g} to {found.torques[1]:.2g} N m"
    )
    return Gap(found.gap, uncertainty, True, told, found, sound=True)


def _wrong_readings(recording: Recording) -> _Doubt | None:
    """Return why the readings of an encoder cannot be right."""
    for who, angle in (("motor", recording.motor), ("load", recording.load)):
        if bit := stuck_bit(angle):
            return _Doubt(
                f"the {who}'s encoder leaps over {bit} of each {2 * bit} counts, as if one of its bits were stuck: "
                "check the encoder and its lines",
                all=True,
            )
    return None


def _with_late_commands(doubt: _Doubt, recording: Recording) -> str:
    late = int(np.count_nonzero(recording.doubt > 0.0))
    hint = f"; {late} of {recording.time.size} commands were late: if the machine was busy, try again"
    return doubt.reason + (hint if doubt.all and late else "")


def _unbelievable(found: Fit) -> _Doubt | None:
    """Return why nothing of a fit can be believed."""
    if found.exhausted:
        return _Doubt(
            f"the search for a model that explains the motion had not ended after {PASSES:g} passes of the filter; "
            "try again with more motion across the gap",
            all=True,
        )
    if abs(off := float(found.values.ln_motor_gain)) > _GAIN:
        return _Doubt(
            f"the command accelerates the motor {math.exp(off):.2g} times as much as its data sheet says: check the "
            "sign and the unit of the command, the motor's values, and its supply",
            all=True,
        )
    if abs(scale := found.scale) > _SCALE:
        return _Doubt(
            f"the load's angle differs from the motor's through the gear by {100 * scale:+.1f} %, and may by "
            f"{100 * _SCALE:g} %: check gear.reduction, and that the encoders are the right ones",
            all=True,
        )
    for who, share, most in zip(("motor", "load"), found.noise, (_MOTOR_UNEXPLAINED, _LOAD_UNEXPLAINED), strict=False):
        if share > most:
            return _Doubt(
                f"something moves the {who} that is neither the command nor the gear: {100 * share:.2g} % of the "
                f"standstill torque is unexplained, and {100 * most:g} % may be; check that both encoders count in the "
                "direction of the gear and with its ratio, that couplings hold, and that nothing else moves the load",
                all=True,
            )
    if (share := found.noise[2]) > _TEETH_UNEXPLAINED:
        return _Doubt(
            f"no teeth pass on a torque between motor and load as recorded: {100 * share:.2g} % of it is unexplained, "
            f"and {100 * _TEETH_UNEXPLAINED:g} % may be; check both encoders and the couplings",
            all=True,
        )
    return None


def _doubt(found: Fit, uncertainty: float, torque: float) -> _Doubt | None:
    """Return why the fit itself says that its gap cannot be used."""
    gap, count = found.gap, max(found.counts)
    if not found.torques[0] < -_FLANK * torque < _FLANK * torque < found.torques[1]:
        side = "negative" if found.torques[0] >= -_FLANK * torque else "positive"
        return _Doubt(
            f"the teeth never bore a {side} torque, so the far flank was not seen: the load torque may be more than "
            "the motor can outrun within the swing; allow more swing and torque, or take load off"
        )
    if gap <= count:
        return _Doubt(
            f"the gap is {gap:.2g} rad, no more than one encoder count, {count:.2g} rad: it may be wind-up "
            "alone, or the teeth never left a flank under the load torque; a finer encoder would tell"
        )
    if not uncertainty <= max(_SURE * gap, _OF_COUNT * count):
        return _Doubt(
            f"the gap is {gap:.3g} rad with a standard uncertainty of {uncertainty:.2g} rad, too large to be used: "
            "allow more time, swing or torque"
        )
    return None


def _reversed(search: Search, point: Found) -> _Doubt | None:
    """Return that the command turns the motor backwards."""
    if search.reversed(point):
        return _Doubt(
            "the command seems to turn the motor backwards, or both encoders to count so: check the sign of the "
            "command, the motor's wires and the direction of both encoders",
            all=True,
        )
    return None


def _slipped(search: Search, point: Found, found: Fit) -> _Doubt | None:
    """Return that a flank is elsewhere in the other half of the recording."""
    gap, count = found.gap, max(found.counts)
    for apart, deviation in search.flanks_by_halves(point):
        if not apart <= max(_APART * gap, count, _SIGMAS * deviation):
            return _Doubt(
                f"a flank is {apart:.2g} rad off in the second half of the motion: an encoder or a coupling slips or "
                "freezes; check both, and that nothing else moves the load",
                all=True,
            )
    return None


def _one_flank(search: Search, point: Found) -> _Doubt | None:
    """Return that a model without the far flank explains the motion as well."""
    least = _ONE_FLANK * search.size
    if search.without_far_flank(point, least) < least:
        return _Doubt(
            "the motion is explained as well without the far flank, which was hardly met, or not at all: the load "
            "torque may be more than the motor can outrun within the swing; allow more swing and torque"
        )
    return None
