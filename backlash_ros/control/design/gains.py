"""State-feedback gains as values, and their design from LQR weights (eq 14)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_continuous_are

from backlash_ros.drivetrain import Drive, rigid_model, without_inductance
from backlash_ros.foundation.record import Array

_LARGEST = 1e6

DEFAULT_WEIGHTS: dict[str, list[float]] = {"fast": [1000.0, 1.0], "overdamped": [4.0, 0.0]}
"""LQR weights [Q11, Q22] by region, with which each of the paper's qualitative claims holds on the nominal drive."""


@dataclass(frozen=True)
class Gains:
    """State-feedback gains of eq 15, V = k_tau tau_l - k1 (theta_l - reference) - k2 omega_l - k3 i.

    Parameters
    ----------
    position : k1, on the error of the load's angle, V/rad
    velocity : k2, on the load's speed, V s/rad
    current : k3, on the motor's current, V/A
    """

    position: float
    velocity: float
    current: float

    @classmethod
    def from_sequence(cls, name: str, k: Sequence[float]) -> "Gains":
        """Return the gains ``[k1, k2, k3]``.

        Raises
        ------
        ValueError
            Names ``name``, the gain, its bound and its unit: three finite gains, k1 > 0.

        Examples
        --------
        >>> Gains.from_sequence("gains.fast.k", [20.0, 0.6, 0.1])
        Gains(position=20.0, velocity=0.6, current=0.1)
        >>> Gains.from_sequence("gains.fast.k", [0.0, 0.6, 0.1])
        Traceback (most recent call last):
        ValueError: gains.fast.k: k1 (position) must be > 0 V/rad, got 0.0
        """
        if len(k) != 3:
            raise ValueError(f"{name} must be three gains [k1 V/rad, k2 V s/rad, k3 V/A], got {len(k)}")
        labels = ("k1 (position)", "k2 (velocity)", "k3 (current)")
        for label, unit, value in zip(labels, ("V/rad", "V s/rad", "V/A"), k, strict=True):
            if not abs(value) <= _LARGEST:
                raise ValueError(f"{name}: {label} must be finite and within +-{_LARGEST:g} {unit}, got {value!r}")
        if not k[0] > 0:
            raise ValueError(f"{name}: k1 (position) must be > 0 V/rad, got {k[0]!r}")
        return cls(*(float(value) for value in k))

    def as_array(self) -> Array:
        """Return ``[k1, k2, k3]``: position, velocity, current, shape (3,)."""
        return np.array([self.position, self.velocity, self.current])


@dataclass(frozen=True)
class GainSet:
    """The gains of both regions: ``fast`` for a large error, ``overdamped`` inside the backlash."""

    fast: Gains
    overdamped: Gains

    @classmethod
    def of(cls, drive: Drive) -> "GainSet":
        """Return the gains of the default weights, `DEFAULT_WEIGHTS`, for a drive; ValueError if there are none."""
        return cls(**{region: design_gains(region, drive, weights) for region, weights in DEFAULT_WEIGHTS.items()})


def design_gains(name: str, drive: Drive, weights: Sequence[float]) -> Gains:
    """Design gains that minimize eq 14 on the rigid model (eq 9), control weight 1.

    If the drive takes a current, it handles the electrical pole itself: the model has L = 0, and the current gain is 0.

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
    >>> print(f"{gains.position:.3f} {gains.velocity:.4f} {gains.current:.4f}")
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
    except (ValueError, ArithmeticError) as error:
        raise ValueError(f"{name}: no gains can be computed from Q11 = {q11!r}, Q22 = {q22!r}: {error}") from error


@lru_cache(maxsize=64)  # a request for other parameters is validated with the same gains
def _optimal(drive: Drive, q11: float, q22: float) -> Gains:
    a, b = rigid_model(drive)
    b = b[:, :1]
    if drive.takes_current:
        a, b = without_inductance(a, b)
    with np.errstate(invalid="ignore"):  # scipy casts non-finite values before it reports them
        cost = solve_continuous_are(a, b, np.diag([q11, q22, 0.0][: len(a)]), np.eye(1))
    return Gains(*(float(value) for value in (*(b.T @ cost)[0], 0.0)[:3]))
