"""The gap by the fit of a recording of one encoder, with its uncertainty, or why there is none."""

import math
from dataclasses import replace

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.fitting.parameters import parameters_of, place_of
from backlash_ros.identification.gap import Gap
from backlash_ros.identification.one_encoder.fit import OneSided, fit_one_sided
from backlash_ros.identification.one_encoder.search import COARSE, FAR, FITS, LIGHT, PULL, STAGES
from backlash_ros.identification.recording import Recording

_SMALL_ERROR = 2.5e-3
"""Errors of the angle, as a share of the gap, that hardly matter, whatever the counts: the model is not the drive."""
_MOST = 2.5
"""Largest rms of the innovations for which they hardly matter."""
_MOST_GAIN = 0.4
"""Largest difference of the motor's gain from its data sheet, as ln, with which a gap is believed."""
_FEWEST = 5.0
"""Counts of the encoder that a gap must have: of 80 drives that were learned, one was wrong, a gap of 2.9 counts."""
_WORSE = 60.0
"""Cost by which another gap has to be worse; tuned."""
_SURE = 0.12
"""Largest standard uncertainty of a gap to be used, a share of it."""
_NOISE = 1.5
"""Component of the uncertainty: times the standard deviation by the noise; tuned."""
_MODEL = 0.05
"""Component of the uncertainty: a share of the gap. One angle shows errors of motor and amplifier hardly apart from the
gap; tuned on drives with one effect of real axes each."""
_UNEXPLAINED = 40.0
"""Component of the uncertainty: a share of the gap for what nothing explains on motor and load, as shares of the torque
at standstill. The gentlest motion has 5 % of it, and twice what disturbs that counts; tuned."""
_UNSEEN_MOTOR = 1.5
"""How much more that counts with the load's encoder, which does not see the motor: a gap was told 19 % too wide where
the motor's torque rippled; tuned."""
_CURVED = 0.05
"""Component of the uncertainty: a share of the gap for each square radian of the way, since a gap varies."""
_SLOPE = 0.5
"""Component of the uncertainty: a share of what the gap seems to change by over the way, since the model's errors look
like that."""
_WIND_UP = 0.25
"""Component of the uncertainty: a share of how far the teeth wind up under what they bore, which may pass for gap."""
_MOST_WIND_UP = 0.08
"""The most of that, a share of the gap: the swing on soft teeth shows how stiff they are. Of ten drives whose teeth
wound up by 0.36 to 0.54 of the gap, nine gaps were right within 1.6 %, and one within 6.2 %; tuned."""
_ALSO_OFF = "ln_load_inertia", "ln_load_viscous", "load_coulomb"
"""What else ends of the search that are nearly as likely leave uncertain: a narrower gap goes with a lighter load."""


def _uncertainty(one: OneSided, by_motor: bool, way: float) -> float:
    """Return the standard uncertainty of the gap, rad; ``way``: how far the angle went, rad."""
    found = one.fit
    change = float(found.values.gap_slope) * way
    twist = found.teeth.twist(found.shape, 0.5 * found.gap, found.bearing) - 0.5 * found.gap
    wound_up = min(_WIND_UP * twist, _MOST_WIND_UP * found.gap)
    unexplained = _UNEXPLAINED * (1.0 if by_motor else _UNSEEN_MOTOR) * math.hypot(found.noise[0], found.noise[1])
    shares = math.hypot(_MODEL, unexplained, _CURVED * way**2, one.near[place_of("ln_half_gap")], _SLOPE * change)
    return math.hypot(_NOISE * found.gap_deviation, shares * found.gap, wound_up)


def _not_the_drive(one: OneSided, count: float) -> str:
    """Return why the model is not the drive's; empty if it may be. ``count``: of the encoder, rad."""
    found, size = one.fit, max(one.fit.rms)
    reading = max(count, COARSE) / math.sqrt(12.0)  # its standard deviation, as it was assumed
    fits = max(FITS, min(_SMALL_ERROR * found.gap / reading, _MOST))
    if not size <= fits:
        return (
            f"no model of teeth, friction and load explains what was seen: its errors are {size:.2g} times as large "
            f"as the encoder's counts allow, and may be {fits:.2g} times; check that the encoder counts in the "
            "direction of the motor, gear.reduction and the motor's parameters, and that nothing else moves the load"
        )
    if one.stage < FAR:
        return (
            "something moves the motor or the load that is neither the command nor the gear: as seen at the motor, "
            f"{100.0 * found.noise[0]:.2g} % of the standstill torque is unexplained; check the motor's values and "
            "gear.reduction, and that nothing else moves the load"
        )
    if abs(off := float(found.values.ln_motor_gain)) > _MOST_GAIN:
        return (
            f"the command seems to accelerate the motor {math.exp(off):.2g} times as much as its data sheet says: "
            "check the unit of the command, the motor's values, its supply and gear.reduction"
        )
    return ""


def _not_seen(drive: Drive, one: OneSided, by_motor: bool, count: float) -> str:
    """Return why the motion does not tell the gap; empty if it does. ``count``: of the encoder, rad."""
    found = one.fit
    least = math.exp(found.values.ln_load_inertia - one.near[place_of("ln_load_inertia")]) / drive.reflected_inertia
    if not one.both:
        side = "negative" if -found.torques[0] < found.torques[1] else "positive"
        return f"the teeth never bore a {side} torque, so the far flank was not seen"
    if least < LIGHT and (one.stage < len(STAGES) - 1 or found.pull > PULL):
        return (
            f"the load's inertia may be only {least:.2g} of the motor's, as seen at the output: below {LIGHT:g} of it "
            "the motor hardly feels it, and what was seen is not plain enough for that"
        )
    if by_motor and found.pull > PULL:
        return (
            f"the errors that are left pull the gap {found.pull:.2g} times as much as noise would, and may {PULL:g} "
            "times: the search has ended beside the drive; learn again"
        )
    if found.gap < _FEWEST * count:
        counts = found.gap / count
        return (
            f"the gap is {found.gap:.2g} rad, {counts:.2g} counts of the encoder: fewer than {_FEWEST:g} do not tell it"
        )
    return "gaps of different widths explain what was seen equally well" if one.worse < _WORSE else ""


def measure_gap_one_sided(drive: Drive, recording: Recording, torque: float) -> Gap:
    """Return the gap where the load started, from one angle; see `fit_one_sided`."""
    one = fit_one_sided(drive, recording, torque)
    found, by_motor = one.fit, bool(np.isnan(recording.load).all())
    angle = recording.motor if by_motor else recording.load
    gap, uncertainty = found.gap, _uncertainty(one, by_motor, float(np.nanmax(angle) - np.nanmin(angle)))
    count = count_of(angle)
    why = _not_the_drive(one, count) or _not_seen(drive, one, by_motor, count)
    if not why and not uncertainty <= _SURE * gap:
        why = f"the gap is {gap:.3g} rad with a standard uncertainty of {uncertainty:.2g} rad, too large to be used"
    if why:
        return Gap(0.0, 0.0, False, why, found)
    near = parameters_of(**{name: float(one.near[place_of(name)]) for name in _ALSO_OFF})
    found = replace(found, covariance=found.covariance + np.diag(near**2))
    told = (
        f"{recording.time[-1] - recording.time[0]:.1f} s of motion of one encoder, with teeth by "
        f"{found.teeth.name} law that bore {found.torques[0]:.2g} to {found.torques[1]:.2g} N m"
    )
    return Gap(gap, uncertainty, True, told, found)
