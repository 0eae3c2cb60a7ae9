"""A first guess of load, friction and torque, straight from the sum of both shafts' equations.

Adding eq 1 and eq 2, both at the output, cancels the force of the teeth, in contact and apart:

    J_r w_m' + B_r w_m + c_m sign w_m + J_l w_l' + B_l w_l + c_l sign w_l - tau_l = drive torque

Weighted with smooth bumps and integrated by parts, it needs no derivative of a reading (modulating functions: Shinbrot
1957), and is linear in the unknowns.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.memory import MotorSide
from backlash_ros.identification.recording import Recording

_WIDTH = 0.1
"""Time over which the angles are smoothed, s; tuned."""
_LEAST = 1e-7
"""Inertia, kg m^2, and viscous friction, N m s/rad, assumed for a load that shows none: next to nothing."""


class Guess(NamedTuple):
    """Inertia, viscous and dry friction and torque of the load, the motor's dry friction; and the misfit, N m (rms)."""

    inertia: float
    viscous: float
    coulomb_l: float
    load_torque: float
    coulomb_m: float
    misfit: float


def guess_of(side: MotorSide, recording: Recording, delay: float) -> Guess:
    """Return the best fit for commands that act ``delay`` s after their samples.

    Angles are taken from straight lines through the readings, evenly in time; a command holds until the next.
    """
    time, motor, load, command, _ = recording
    period = float(np.median(np.diff(time)))
    even = time[0] + period * np.arange(round((time[-1] - time[0]) / period) + 1)
    p, q = (np.interp(even, time[np.isfinite(angle)], angle[np.isfinite(angle)]) for angle in (motor, load))
    half = max(4, round(0.5 * _WIDTH / period))
    s = np.arange(-half, half + 1) / half
    width = half * period
    bump = (1 - s**2) ** 4
    first = -8 * s * (1 - s**2) ** 3 / width
    second = (-8 * (1 - s**2) ** 3 + 48 * s**2 * (1 - s**2) ** 2) / width**2
    centres = np.arange(half, even.size - half, max(1, half // 4))
    rows = centres[:, None] + np.arange(-half, half + 1)
    # The command in force between samples, lagging by the winding, as the mean of each period around a sample.
    late = delay + (1.0 / side.rate if np.isfinite(side.rate) else 0.0)
    fine = 8
    grid = time[0] + (np.arange(even.size * fine) + 0.5) * period / fine - 0.5 * period
    index = np.searchsorted(time, grid - late + 1e-9 * period, side="right") - 1
    u = command[np.maximum(index, 0)].reshape(-1, fine).mean(axis=1)

    def speed(angle: Array) -> Array:
        rate = np.gradient(angle, period)
        return rate / np.sqrt(rate**2 + 0.05**2)

    def weighed(values: Array, by: Array) -> Array:
        result: Array = period * (values[rows] @ by)
        return result

    p, q = p - p[0], q - q[0]
    known = side.gain * weighed(u, bump) + side.braking * weighed(p, first) - side.inertia * weighed(p, second)
    known += side.viscous * weighed(p, first)
    scale = 1.0 / weighed(np.ones_like(q), bump)[0]
    matrix = scale * np.column_stack(
        [weighed(q, second), -weighed(q, first), weighed(speed(q), bump), weighed(speed(p), bump)]
    )
    known *= scale
    # Friction of motor and load look alike in contact: the solution itself keeps them >= 0. The torque, of either sign,
    # is the remaining mean.
    means, mean = matrix.mean(axis=0), known.mean()
    found, norm = nnls(matrix - means, known - mean)
    inertia, viscous, coulomb_l, coulomb_m = (float(value) for value in found)
    return Guess(
        inertia=max(inertia, _LEAST),
        viscous=max(viscous, _LEAST),
        coulomb_l=coulomb_l,
        load_torque=float(means @ found - mean),
        coulomb_m=coulomb_m,
        misfit=float(norm / np.sqrt(known.size)),
    )
