"""Linear models of the drive with its current as their last state: sampled by either interface, or with L = 0.

Under the voltage interface the winding is the drive's, and the current a state like the others. Under the current
interface the drive's inner loop imposes the current, and the controller plays the winding without its inductance:
i = (V - K_m omega_m)/R, from the speed of the sample, held for a period.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from backlash_ros.drivetrain.parameters import Drive

Array = NDArray[np.float64]


def _held(a: Array, b: Array, period: float) -> tuple[Array, Array]:
    """Return the matrices of d/dt x = a x + b u from sample to sample, u held."""
    n, inputs = b.shape
    both = expm(np.block([[a, b], [np.zeros((inputs, n + inputs))]]) * period)
    return both[:n, :n], both[:n, n:]


def _played(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rows that give the current, with L di/dt = 0, from the other states and from the voltage."""
    return a[-1:, :-1] / -a[-1, -1], b[-1:] / -a[-1, -1]


def without_inductance(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the model in the limit L -> 0, where the current is no state.

    Parameters
    ----------
    a, b : shape (N, N) and (N, 1): d/dt x = a x + b V, the current (A) the last of x, V in volts

    Returns
    -------
    (A, B) : shape (N - 1, N - 1) and (N - 1, 1)
    """
    from_states, from_voltage = _played(a, b)
    per_ampere = a[:-1, -1:]
    return a[:-1, :-1] + per_ampere @ from_states, per_ampere @ from_voltage


def sampled(drive: Drive, a: Array, b: Array, period: float) -> tuple[Array, Array]:
    """Return the model from sample to sample, as the drive's command interface holds the answer to each.

    Parameters
    ----------
    a, b : shape (N, N) and (N, 1): d/dt x = a x + b V, the current (A) the last of x, V in volts
    period : of the samples, s

    Returns
    -------
    (A, B) : shape (N, N) and (N, 1): x(k+1) = A x(k) + B V(k); the last of x is the current as measured with the others
    """
    if not drive.takes_current:
        return _held(a, b, period)
    motion, per_ampere = _held(a[:-1, :-1], a[:-1, -1:], period)
    from_states, from_voltage = _played(a, b)
    following = np.vstack([motion + per_ampere @ from_states, from_states])
    forgotten = np.zeros((following.shape[0], 1))  # the current held before acts on nothing by itself
    return np.hstack([following, forgotten]), np.vstack([per_ampere, np.eye(1)]) @ from_voltage
