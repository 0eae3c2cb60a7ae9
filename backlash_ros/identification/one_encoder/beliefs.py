"""What is believed of a drive before its recording by one encoder is looked at."""

import math

from backlash_ros.drivetrain.contacts.elastic import SpringContact
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.candidates import Candidate
from backlash_ros.identification.fitting.parameters import parameters_of
from backlash_ros.identification.fitting.problem import Beliefs

_BEGIN = 0.05
"""Standard deviation of where in the gap the motion starts, rad: anywhere."""
_FARTHEST = 5e-3
"""Largest step of that, rad."""
_FIXED = 1e-6
"""Standard deviation of what is not fitted: as good as 0."""
_STIFF = 0.02
"""Standard deviation of the force of the teeth by a told law, as ln: it is taken as told."""
_SPRING = 0.7
"""Standard deviation of the force of the teeth by a spring, as ln: a factor of two; tuned."""
_FREE = 2.0
"""Standard deviation of stiffness, damping and rebound of free teeth, as ln; tuned."""
_EXPONENT = 0.2
"""Standard deviation of their exponent, as ln; tuned."""
_MOTOR = 0.08
"""Standard deviation of the motor's gain and braking, as ln: how far data sheets are off."""
_DEAD_BAND = 0.005
"""Standard deviation of the amplifier's dead band, a share of the largest command."""
_LOSS = 0.1
"""Standard deviation of the gear's loss, a share."""
_STEEPEST_TEETH = 0.9
"""Largest exponent of free teeth, as ln: 2.5, where Hertz's teeth have 1.5."""
_TOLD_TEETH = 5.0
"""Largest factor on the force of told teeth, as ln, either way."""
_LARGEST = parameters_of(
    math.inf,
    ln_half_gap=0.3,
    offset=_FARTHEST,
    gap_slope=0.1,
    ln_stiffness=0.5,
    ln_damping=0.7,
    ln_rebound=1.0,
    ln_exponent=0.2,
    gear_loss=0.1,
    ln_motor_gain=0.2,
    ln_motor_braking=0.2,
    ln_load_inertia=0.7,
    ln_load_viscous=1.0,
    load_scale_error=0.01,
)
"""Largest change of each parameter in a step of the search."""


def beliefs_of(teeth: Candidate, mean: Array, *, torque: float, gain: float, period: float, by_motor: bool) -> Beliefs:
    """Return what is believed with some teeth.

    Parameters
    ----------
    mean : what is expected, see `Parameters`
    torque : of the motor at standstill, N m at the output
    gain : that torque for each V or A of the command
    period : of the samples, s
    by_motor : whether the angle is the motor's
    """
    # Both angles are the same at first, so the offset says where in the gap the motion starts.
    return Beliefs(
        mean=mean,
        spread=parameters_of(
            _FIXED,
            ln_half_gap=3.0,
            offset=_BEGIN,
            gap_slope=0.2,
            ln_stiffness=_FREE if teeth.free else _SPRING if isinstance(teeth.contact, SpringContact) else _STIFF,
            ln_damping=_FREE if teeth.free else _FIXED,
            ln_rebound=_FREE if teeth.free else _FIXED,
            ln_exponent=_EXPONENT if teeth.free else _FIXED,
            gear_loss=_LOSS,
            ln_load_inertia=1.5,
            ln_load_viscous=3.0,
            load_coulomb=0.2 * torque,
            load_torque=0.2 * torque,
            motor_coulomb=0.2 * torque,
            load_torque_slope=0.05 * torque,
            delay=2.0 * period,
            load_scale_error=_FIXED if by_motor else 0.005,
            ln_motor_gain=_MOTOR,
            ln_motor_braking=_MOTOR,
            dead_band=_DEAD_BAND * torque / gain,
        ),
        low=parameters_of(
            -math.inf,
            ln_half_gap=-14.0,
            ln_stiffness=-math.inf if teeth.free else -_TOLD_TEETH,
            ln_exponent=0.0,
            ln_load_inertia=-25.0,
            ln_load_viscous=-18.0,
            load_coulomb=0.0,
            motor_coulomb=0.0,
            gear_loss=0.0,
            delay=0.0,
            dead_band=0.0,
        ),
        high=parameters_of(
            math.inf,
            ln_half_gap=1.0,
            ln_stiffness=math.inf if teeth.free else _TOLD_TEETH,
            ln_exponent=_STEEPEST_TEETH,
            ln_load_inertia=12.0,
            ln_load_viscous=12.0,
            gear_loss=0.0,
        ),
        largest=_LARGEST,
    )
