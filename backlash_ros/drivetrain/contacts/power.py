"""The paper's contact: a force that rises with a high power of the gap, eqs 11 to 13.

    F = beta s^n + alpha dv s^(n+1), s = gap/(d/2)

`power` is eq 13 verbatim: small but not zero inside the gap, and it pulls while the teeth part fast. `power_no_pull` is
zero where it would pull.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from backlash_ros.drivetrain.contact import (
    Constants,
    Contact,
    EnergyFunction,
    ForceFunction,
    HalfGapSlopes,
    LinearFunction,
    LinearPiece,
    PieceFunction,
    SlopesFunction,
    ToothForce,
    as_constants,
)
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.quantity import quantity


class PowerLaw(NamedTuple):
    """The constants of the law, along the pitch line."""

    beta: float  # N
    alpha: float  # N s/m
    exponent: float  # n, a whole number
    free: float  # share of half the gap within which the force is negligible


@compiled
def power_of(constants: Constants) -> PowerLaw:
    """Return the constants by name."""
    return PowerLaw(constants[0], constants[1], constants[2], constants[3])


_NEGLIGIBLE = 1e-10
"""Share of the force at the edge of the gap that is negligible."""


@compiled
def integer_power(base: float, exponent: int) -> float:
    """Return base^exponent for a whole exponent >= 0."""
    second = base * base
    fourth = second * second
    eighth = fourth * fourth
    low = (base if exponent & 1 else 1.0) * (second if exponent & 2 else 1.0)
    low *= (fourth if exponent & 4 else 1.0) * (eighth if exponent & 8 else 1.0)
    if exponent < 16:
        return low
    high = eighth * eighth
    result = low * high if exponent & 16 else low
    if exponent < 32:
        return result
    high *= high
    if exponent & 32:
        result *= high
    return result * (high * high) if exponent & 64 else result


@compiled
def power_force(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> ToothForce:
    """Return eq 13 and its derivatives."""
    beta, alpha, exponent, _ = power_of(constants)
    n = int(exponent)
    per_half_gap = 1.0 / half_gap
    s = gap * per_half_gap
    below = integer_power(s, n - 1)
    at = below * s
    damping = alpha * at * s
    force = below * (s * (beta + alpha * gap_rate * s))
    stiffness = below * per_half_gap * (beta * n + alpha * gap_rate * (n + 1) * s)
    return force, stiffness, damping, beta * at, beta * n * below * per_half_gap


@compiled
def no_pull_force(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> ToothForce:
    """Return eq 13 and its derivatives, without force where it would pull."""
    force, stiffness, damping, elastic, elastic_stiffness = power_force(constants, half_gap, gap, gap_rate)
    if force * gap < 0.0:
        return 0.0, 0.0, 0.0, elastic, elastic_stiffness
    return force, stiffness, damping, elastic, elastic_stiffness


@compiled
def no_pull_piece(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> int:
    """Return 1 where eq 13 would pull, else 0."""
    law = power_of(constants)
    return 1 if law.beta * half_gap + law.alpha * gap_rate * gap < 0.0 else 0


@compiled
def power_linear(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> LinearPiece:  # noqa: ARG001
    """Return the piece without force, if `power_force` is negligible."""
    free = power_of(constants).free * half_gap
    return 0.0, 0.0, 0.0, free, 1.0, 0.0, free, -1.0, 0.0


@compiled
def power_energy(constants: Constants, half_gap: float, gap: float) -> float:
    """Return beta (d/2) s^(n+1)/(n+1), J."""
    law = power_of(constants)
    n = int(law.exponent) + 1
    return law.beta * half_gap / n * integer_power(gap / half_gap, n)


@compiled
def power_slopes(constants: Constants, half_gap: float, gap: float, tooth: ToothForce) -> HalfGapSlopes:
    """Return the derivatives by the half gap: the force depends on gap/half_gap alone."""
    _, stiffness, _, elastic, elastic_stiffness = tooth
    s, n = gap / half_gap, power_of(constants).exponent
    return -n / (n + 1.0) * s * elastic, -s * elastic_stiffness, -s * stiffness, s * s * elastic_stiffness


@dataclass(frozen=True)
class PowerContact(Contact):
    """Eq 13 of the paper: beta, alpha and the exponent."""

    section: ClassVar[str] = "contact.power"
    force: ClassVar[ForceFunction] = staticmethod(power_force)
    energy: ClassVar[EnergyFunction] = staticmethod(power_energy)
    half_gap_slopes: ClassVar[SlopesFunction] = staticmethod(power_slopes)
    linear: ClassVar[LinearFunction] = staticmethod(power_linear)

    stiffness: float = quantity("elastic force beta at |gap| = d/2", "N", above=0, at_most=1e7, default=10.0)
    damping: float = quantity("damping alpha at |gap| = d/2", "N s/m", at_least=0, at_most=1e8, default=200.0)
    exponent: int = quantity(
        "exponent n of the elastic force, odd", "", at_least=1, at_most=101, whole=True, default=21
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponent % 2 != 1:
            raise ValueError(f"{self.section}.exponent must be an odd integer, got {self.exponent!r}")

    def constants(self, load_radius: float, mass: float) -> Constants:  # noqa: ARG002
        """Return beta, alpha, the exponent, and the share of half the gap within which the force is negligible."""
        free = _NEGLIGIBLE ** (1.0 / self.exponent)
        return as_constants(*PowerLaw(self.stiffness, self.damping, self.exponent, free))

    def deflection(self, torque: float, half_gap: float, load_radius: float) -> float:
        """Return how far beyond the gap the teeth carry ``torque`` (N m), rad at the output; 0 if within it."""
        s: float = (abs(torque) / load_radius / self.stiffness) ** (1.0 / self.exponent)
        return max(0.0, s - 1.0) * half_gap / load_radius

    def edge_stiffness(self, half_gap: float, load_radius: float) -> float:  # noqa: ARG002
        """Return beta/(d/2), N/m: the straight line from the middle of the gap to its edge."""
        return self.stiffness / half_gap


@dataclass(frozen=True)
class PowerNoPullContact(PowerContact):
    """Eq 13 of the paper, zero where it would pull."""

    section: ClassVar[str] = "contact.power_no_pull"
    force: ClassVar[ForceFunction] = staticmethod(no_pull_force)
    piece: ClassVar[PieceFunction] = staticmethod(no_pull_piece)


CONTACTS = {"power": PowerContact, "power_no_pull": PowerNoPullContact}
