"""The teeth according to a fit: their torque at each sample; lost motion and stiffness as gear makers state them."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.fit import Fit, half_gap_of, shape_of
from backlash_ros.identification.fitting.memory import motion_of
from backlash_ros.identification.fitting.parameters import places_of
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import NOISE, Finding
from backlash_ros.identification.recordings.held_out import follow
from backlash_ros.identification.recordings.identify import Identified

LOST_MOTION_SHARE = 0.03
"""Share of the rated torque, to either side, at which gear makers state the lost motion."""
_STEP = 1e-4
"""Change of logarithms for numerical derivatives."""
_SHAPE = places_of("ln_half_gap", "ln_stiffness", "ln_exponent")
"""What the twist of teeth at rest depends on."""


class Loop(NamedTuple):
    """The teeth at each sample: ``twist`` n theta_m - theta_l from the middle of the gap (rad), their ``torque`` (N m).

    ``speed`` of the load, rad/s.
    """

    twist: Array
    torque: Array
    speed: Array


def loop_of(drive: Drive, found: Fit, recording: Recording) -> Loop:
    """Return the teeth in a recording according to the filter with a fit's parameters, shapes (N,).

    Parameters
    ----------
    drive : as given; the fit took its motor and gear from it
    """
    _, states = follow(drive, found, recording)
    x, shape = found.values, found.shape
    p, w, _, q, v = motion_of(states)
    twist, rate = p - q - x.offset, w - v
    half_gaps = half_gap_of(found.parameters) * np.maximum(0.1, 1.0 + x.gap_slope * (q - q[0]))
    rows = zip(half_gaps.tolist(), twist.tolist(), rate.tolist(), strict=True)
    return Loop(twist, np.array([found.teeth.torque(shape, *row) for row in rows]), v)


def static_torque(found: Fit, twist: Array) -> Array:
    """Return the torque of teeth at rest by their twist from the middle of the gap, N m."""
    shape, half_gap = found.shape, half_gap_of(found.parameters)
    return np.array([found.teeth.torque(shape, half_gap, value) for value in twist.tolist()])


def _lost_motion(found: Fit, parameters: Array, torque: float) -> float:
    """Return the way of the output from minus to plus a torque, N m, with the motor held, rad."""
    return 2.0 * found.teeth.twist(shape_of(found.teeth, parameters), half_gap_of(parameters), torque)


def lost_motion_of(found: Identified, rated: float) -> tuple[Finding, ...]:
    """Return lost motion and stiffness of the fitted teeth; none if nothing was fitted.

    The lost motion is the way of the output from minus to plus 3 % of the ``rated`` torque (N m at the output) with
    the motor held, including the gap. Both come from the recorded motion, not from a slow cycle of the torque; the
    stiffness is that of the teeth and of all other compliance between the encoders.
    """
    fit, gap, torque = found.fit, found.gap, LOST_MOTION_SHARE * rated
    if fit is None or gap is None or not found.findings:
        return ()
    lost = Finding("", "lost motion", f"lost motion at +-{torque:.3g} N m, by the fitted teeth", "rad")
    stiff = Finding("", "stiffness", "stiffness of the teeth, at the output, as fitted", "N m/rad")
    if not gap.valid:
        return replace(lost, why=gap.reason), replace(stiff, why=gap.reason)
    give = found.of("wind-up") if fit.teeth.free else None
    if give is None:
        stiff = replace(stiff, why=f"teeth by {fit.teeth.name} law have none that the motion would show")
    elif give.why:
        return replace(lost, why=give.why), replace(stiff, why=give.why)
    else:
        stiff = replace(stiff, value=1.0 / give.value, uncertainty=give.uncertainty / give.value**2)
    bore = min(-fit.torques[0], fit.torques[1])
    if torque > bore:
        why = f"the teeth bore {bore:.2g} N m to one side, less than the {torque:.2g} N m at which it is given"
        return replace(lost, why=why), stiff
    value = _lost_motion(fit, fit.parameters, torque)
    by = []
    for index in _SHAPE:
        more = fit.parameters.copy()
        more[index] += _STEP
        by.append((_lost_motion(fit, more, torque) - value) / _STEP)
    slopes = np.array(by)
    noise = float(slopes @ fit.covariance[np.ix_(_SHAPE, _SHAPE)] @ slopes)
    # What of the gap's uncertainty is not noise.
    rest = max(gap.uncertainty**2 - (NOISE * fit.gap_deviation) ** 2, 0.0)
    return replace(lost, value=value, uncertainty=math.sqrt(NOISE**2 * max(noise, 0.0) + rest)), stiff
