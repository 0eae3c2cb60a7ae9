"""State-feedback gains: values, their design from LQR weights (eq 14), and the check that they are safe to use."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from backlash_ros.drivetrain import Drive, motor_model, rigid_model, sampled, without_inductance

_LARGEST = 1e6


@dataclass(frozen=True)
class Gains:
    """State-feedback gains of eq 15: k1 (V/rad), k2 (V s/rad), k3 (V/A)."""

    k1: float
    k2: float
    k3: float

    @classmethod
    def from_sequence(cls, name: str, k: Sequence[float]) -> "Gains":
        """Build from ``[k1, k2, k3]``; a ValueError names ``name``, the offending gain and its bound."""
        if len(k) != 3:
            raise ValueError(f"{name} must be three gains [k1 V/rad, k2 V s/rad, k3 V/A], got {len(k)}")
        for label, unit, value in zip(("k1", "k2", "k3"), ("V/rad", "V s/rad", "V/A"), k, strict=True):
            if not abs(value) <= _LARGEST:
                raise ValueError(f"{name}: {label} must be finite and within +-{_LARGEST:g} {unit}, got {value!r}")
        if not k[0] > 0:
            raise ValueError(f"{name}: k1 must be > 0 V/rad, got {k[0]!r}")
        return cls(*(float(value) for value in k))

    def as_array(self) -> NDArray[np.float64]:
        """Return ``[k1, k2, k3]``, shape (3,)."""
        return np.array([self.k1, self.k2, self.k3])


@dataclass(frozen=True)
class GainSet:
    """The gains of both regions: ``fast`` for a large error, ``overdamped`` inside the backlash."""

    fast: Gains
    overdamped: Gains


def design_gains(name: str, drive: Drive, weights: Sequence[float]) -> Gains:
    """Design gains that minimise eq 14 on the rigid model (eq 9), control weight 1.

    Where the drive takes a current the electrical pole is its own: the model is that of L = 0, and k3 is 0.

    Parameters
    ----------
    name : how errors name the weights
    weights : [Q11, Q22], on the squared position error (1/rad^2) and the squared speed (s^2/rad^2)

    Raises
    ------
    ValueError
        Unless there are two finite weights, Q11 > 0 and Q22 >= 0, from which the Riccati equation can be solved.

    Examples
    --------
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> gains = design_gains("fast", NOMINAL_DRIVE, [1000.0, 1.0])
    >>> print(f"{gains.k1:.3f} {gains.k2:.4f} {gains.k3:.4f}")
    31.623 0.8718 0.1674
    """
    if len(weights) != 2:
        raise ValueError(f"{name} must be two weights [Q11, Q22], got {len(weights)}")
    q11, q22 = weights
    if not 0 < q11 <= 1e12:
        raise ValueError(f"{name}: Q11 must be > 0 and <= 1e+12, got {q11!r}")
    if not 0 <= q22 <= 1e12:
        raise ValueError(f"{name}: Q22 must be >= 0 and <= 1e+12, got {q22!r}")
    try:
        return _optimal(drive, float(q11), float(q22))
    except ValueError as error:
        raise ValueError(f"{name}: no gains can be computed from Q11 = {q11!r}, Q22 = {q22!r}: {error}") from error


@lru_cache(maxsize=64)  # a request for other parameters is validated with the same gains
def _optimal(drive: Drive, q11: float, q22: float) -> Gains:
    a, b = rigid_model(drive)
    if drive.takes_current:
        a, b = without_inductance(a, b[:, :1])
    with np.errstate(invalid="ignore"):  # scipy casts what is not finite before it says so
        riccati = solve_continuous_are(a, b[:, :1], np.diag([q11, q22, 0.0][: len(a)]), np.eye(1))
    k = b[:, :1].T @ riccati
    return Gains(*(float(value) for value in (*np.asarray(k)[0], 0.0)[:3]))


def check_stable(name: str, drive: Drive, gains: Gains, period: float) -> None:
    """Raise ValueError unless ``gains``, sampled every ``period`` seconds, are stable in contact and inside the gap.

    In contact the drive is the rigid model (eq 9); inside the gap the motor turns alone, and k3 alone acts on it. The
    loop is that of the drive's command interface: where the current is held, k3 sees the one before. All signals are
    taken as measured: speeds that come from positions lag, and gains near the bound are unstable with them.
    """
    for where, worst in _slowest_poles(drive, gains, period).items():
        if not worst < 1.0:
            raise ValueError(
                f"{name} = [{gains.k1:g}, {gains.k2:g}, {gains.k3:g}] is unstable at {1 / period:g} Hz {where}: "
                f"pole magnitude must be < 1, got {worst:.4g}"
            )


@lru_cache(maxsize=64)
def _slowest_poles(drive: Drive, gains: Gains, period: float) -> dict[str, float]:
    """Return the largest magnitude of a sampled pole in each of the two loops."""
    loops = {
        "even without backlash": (*rigid_model(drive), gains.as_array()[None, :]),
        "inside the gap, where the motor turns alone": (*motor_model(drive), np.array([[0.0, gains.k3]])),
    }
    worst = {}
    for where, (a, b, feedback) in loops.items():
        held, driven = sampled(drive, a, b[:, :1], period)
        worst[where] = float(np.max(np.abs(np.linalg.eigvals(held - driven @ feedback))))
    return worst
