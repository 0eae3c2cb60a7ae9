"""The teeth according to a fit: their torque at each sample; lost motion and stiffness as gear makers state them."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.contact import Constants, Contact, gap_at_rest, law_name
from backlash_ros.drivetrain.contacts.elastic import SpringContact
from backlash_ros.drivetrain.signals import Array
from backlash_ros.identification.filter import GAP_SLOPE, LN_HALF_GAP, LN_TEETH, OFFSET
from backlash_ros.identification.fit import Fit, motor_side
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.held_out import follow
from backlash_ros.identification.recordings.identify import Identified

LOST_MOTION_SHARE = 0.03
"""Share of the rated torque, to either side, at which gear makers state the lost motion."""
_STEP = 1e-4
"""Change of logarithms for numerical derivatives."""


class Loop(NamedTuple):
    """The teeth at each sample: ``twist`` n theta_m - theta_l from the middle of the gap (rad), their ``torque`` (N m).

    ``speed`` of the load, rad/s.
    """

    twist: Array
    torque: Array
    speed: Array


class _Teeth(NamedTuple):
    """Teeth as the filter has them."""

    contact: Contact
    constants: Constants
    radius: float
    half_gap: float
    strength: float

    def torque(self, twist: float) -> float:
        """Return the torque of teeth at rest, N m."""
        force = self.contact.force(self.constants, self.radius * self.half_gap, self.radius * twist, 0.0)
        return float(self.radius * self.strength * force[3])

    def twist(self, torque: float) -> float:
        """Return the twist from the middle of the gap at which teeth at rest bear a torque > 0, rad."""
        force = torque / (self.radius * self.strength)
        return gap_at_rest(self.contact, self.constants, self.radius * self.half_gap, force) / self.radius


def _teeth_of(drive: Drive, found: Fit) -> _Teeth:
    side, x = motor_side(drive, found.contact), found.parameters
    return _Teeth(
        found.contact, side.contact, side.load_radius, math.exp(float(x[LN_HALF_GAP])), math.exp(float(x[LN_TEETH]))
    )


def loop_of(drive: Drive, found: Fit, recording: Recording) -> Loop:
    """Return the teeth in a recording according to the filter with a fit's parameters, shapes (N,).

    Parameters
    ----------
    drive : as given; the fit took its motor and gear from it
    """
    _, states = follow(drive, found.contact, found.parameters, recording, found.counts)
    teeth, x = _teeth_of(drive, found), found.parameters
    p, w, q, v = (states[:, column] for column in (0, 1, 3, 4))
    twist, rate = p - q - x[OFFSET], w - v
    half_gaps = teeth.half_gap * np.maximum(0.1, 1.0 + x[GAP_SLOPE] * (q - q[0]))
    scale = teeth.radius * teeth.strength
    torque = [
        scale * teeth.contact.force(teeth.constants, *(teeth.radius * float(value) for value in row))[0]
        for row in zip(half_gaps, twist, rate, strict=True)
    ]
    return Loop(twist, np.array(torque), v)


def static_torque(drive: Drive, found: Fit, twist: Array) -> Array:
    """Return the torque of teeth at rest by their twist from the middle of the gap, N m."""
    teeth = _teeth_of(drive, found)
    return np.array([teeth.torque(float(value)) for value in twist])


def _lost_motion(teeth: _Teeth, torque: float) -> float:
    return 2.0 * teeth.twist(torque)


def lost_motion_of(drive: Drive, found: Identified, rated: float) -> tuple[Finding, ...]:
    """Return lost motion and stiffness of the fitted teeth; none if nothing was fitted.

    The lost motion is the way of the output from minus to plus 3 % of the ``rated`` torque (N m at the output) with
    the motor held, including the gap. Both come from the recorded motion, not from a slow cycle of the torque; the
    stiffness is that of the teeth and of all other compliance between the encoders.

    Parameters
    ----------
    drive : as given; the fit took its motor and gear from it
    """
    fit, gap, torque = found.fit, found.gap, LOST_MOTION_SHARE * rated
    if fit is None or gap is None or not found.findings:
        return ()
    lost = Finding("", "lost motion", f"lost motion at +-{torque:.3g} N m, by the fitted teeth", "rad")
    stiff = Finding("", "stiffness", "stiffness of the teeth, at the output, as fitted", "N m/rad")
    if not gap.valid:
        return replace(lost, why=gap.reason), replace(stiff, why=gap.reason)
    teeth, share = _teeth_of(drive, fit), _share_of_teeth(found)
    if isinstance(fit.contact, SpringContact):
        give = found.of("wind-up")
        stiffness = 1.0 / give.value
        stiff = (
            replace(stiff, why=give.why) if give.why else replace(stiff, value=stiffness, uncertainty=share * stiffness)
        )
    else:
        stiff = replace(stiff, why=f"teeth by the {law_name(fit.contact)} law have none that the motion would show")
    bore = min(-fit.torques[0], fit.torques[1])
    if stiff.why and isinstance(fit.contact, SpringContact):
        return replace(lost, why=stiff.why), stiff
    if torque > bore:
        why = f"the teeth bore {bore:.2g} N m to one side, less than the {torque:.2g} N m at which it is given"
        return replace(lost, why=why), stiff
    value, more = _lost_motion(teeth, torque), 1.0 + _STEP
    wider, harder = teeth._replace(half_gap=more * teeth.half_gap), teeth._replace(strength=more * teeth.strength)
    by = [(_lost_motion(other, torque) - value) / _STEP for other in (wider, harder)]
    # Correlated errors that cancel are ignored: most of either uncertainty is not noise.
    cov, i, k = fit.covariance, LN_HALF_GAP, LN_TEETH
    together = float(cov[i, k]) / math.sqrt(float(cov[i, i] * cov[k, k]))
    parts = by[0] * gap.uncertainty / gap.angle, by[1] * share
    variance = parts[0] ** 2 + parts[1] ** 2 + max(2.0 * together * parts[0] * parts[1], 0.0)
    return replace(lost, value=value, uncertainty=math.sqrt(variance)), stiff


def _share_of_teeth(found: Identified) -> float:
    """Return the relative standard uncertainty of the teeth's force: from the wind-up if found, else from the noise."""
    assert found.fit is not None
    for row in found.findings:
        if row.symbol == "wind-up" and row.told:
            return row.uncertainty / row.value
    return 2.0 * math.sqrt(float(found.fit.covariance[LN_TEETH, LN_TEETH]))
