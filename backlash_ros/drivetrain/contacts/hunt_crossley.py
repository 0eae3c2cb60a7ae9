"""Contact of Hunt and Crossley: a spring beyond the gap whose damping grows with its force.

    F = k delta^e (1 + d ddelta/dt), delta = abs(gap) - d/2, never pulling

Exponent 1 is a linear spring, 1.5 that of Hertz for round bodies. Teeth of steel are lively: two free gears part with
most of the speed v at which they met. That share y/x follows from energy: x - ln(1 + x) = -y - ln(1 - y) with x = d v,
whatever the exponent (Hunt & Crossley, J. Applied Mechanics 42(2), 1975). The rate of delta is the gap's.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from scipy.optimize import brentq

from backlash_ros.drivetrain.contact import (
    Constants,
    Contact,
    EnergyFunction,
    ForceFunction,
    LinearFunction,
    LinearPiece,
    PieceFunction,
    ToothForce,
    as_constants,
)
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.quantity import quantity


class LivelySpring(NamedTuple):
    """The constants of the law, along the pitch line."""

    stiffness: float  # k, N/m^e
    exponent: float  # e
    dissipation: float  # d, s/m


@compiled
def spring_of(constants: Constants) -> LivelySpring:
    """Return the constants by name."""
    return LivelySpring(constants[0], constants[1], constants[2])


def dissipation_for(restitution: float, speed: float) -> float:
    """Return the dissipation d that leaves a share, above 0 and below 1, of the ``speed`` (> 0) of an impact.

    In the reciprocal of that speed's unit: s/rad for rad/s.
    """

    def missing(x: float) -> float:
        y = restitution * x
        return x - math.log1p(x) + y + math.log1p(-y)

    # The least x is where the difference of both sides' cubic terms shows; at the largest, y is 1.
    largest = (1.0 - 1e-12) / restitution
    return float(brentq(missing, 1e-6, largest, xtol=1e-14)) / speed


@compiled
def depth_power(depth: float, exponent: float) -> float:
    """Return depth^exponent."""
    if exponent == 1.0:
        return depth
    return depth * math.sqrt(depth) if exponent == 1.5 else depth**exponent


@compiled
def hunt_crossley_force(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> ToothForce:
    """Return the force and its derivatives."""
    depth = abs(gap) - half_gap
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    k, exponent, dissipation = spring_of(constants)
    side = 1.0 if gap > 0.0 else -1.0
    spring = k * depth_power(depth, exponent)
    stiffness, lively = exponent * spring / depth, 1.0 + dissipation * gap_rate * side
    if lively <= 0.0:
        return 0.0, 0.0, 0.0, side * spring, stiffness
    return side * spring * lively, stiffness * lively, dissipation * spring, side * spring, stiffness


@compiled
def hunt_crossley_piece(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> int:
    """Return 0 apart, 1 in contact, 2 where the teeth have let go."""
    if abs(gap) <= half_gap:
        return 0
    return 2 if 1.0 + spring_of(constants).dissipation * (gap_rate if gap > 0.0 else -gap_rate) <= 0.0 else 1


@compiled
def hunt_crossley_linear(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> LinearPiece:  # noqa: ARG001
    """Return the piece without force, in the gap."""
    return 0.0, 0.0, 0.0, half_gap, 1.0, 0.0, half_gap, -1.0, 0.0


@compiled
def hunt_crossley_energy(constants: Constants, half_gap: float, gap: float) -> float:
    """Return k delta^(e+1)/(e+1), J."""
    k, exponent, _ = spring_of(constants)
    depth = max(0.0, abs(gap) - half_gap)
    return k * depth_power(depth, exponent) * depth / (exponent + 1.0)


@dataclass(frozen=True)
class HuntCrossleyContact(Contact):
    """Spring of any exponent beyond the gap, with a damping in proportion to its force."""

    section: ClassVar[str] = "contact.hunt_crossley"
    force: ClassVar[ForceFunction] = staticmethod(hunt_crossley_force)
    energy: ClassVar[EnergyFunction] = staticmethod(hunt_crossley_energy)
    piece: ClassVar[PieceFunction] = staticmethod(hunt_crossley_piece)
    linear: ClassVar[LinearFunction] = staticmethod(hunt_crossley_linear)

    wind_up: float = quantity(
        "twist of the output beyond the gap under the torque contact.hunt_crossley.torque",
        "rad",
        at_least=1e-9,
        at_most=1.0,
        default=1e-3,
    )
    torque: float = quantity(
        "torque at the output that winds the teeth up by wind_up", "N m", above=0, at_most=1e6, default=1.0
    )
    exponent: float = quantity(
        "exponent e of the spring: 1 linear, 1.5 of Hertz", "", at_least=1, at_most=3, default=1.0
    )
    dissipation: float = quantity(
        "dissipation d, per speed of the gap at the output", "s/rad", at_least=0, at_most=1e3, default=0.3
    )

    def constants(self, load_radius: float, mass: float) -> Constants:  # noqa: ARG002
        """Return k (N/m^e), e and d (s/m)."""
        stiffness = self.torque / load_radius / (self.wind_up * load_radius) ** self.exponent
        return as_constants(*LivelySpring(stiffness, self.exponent, self.dissipation / load_radius))

    def deflection(self, torque: float, half_gap: float, load_radius: float) -> float:  # noqa: ARG002
        """Return how far beyond the gap the teeth carry ``torque`` (N m), rad at the output."""
        return float(self.wind_up * (abs(torque) / self.torque) ** (1.0 / self.exponent))

    def edge_stiffness(self, half_gap: float, load_radius: float) -> float:  # noqa: ARG002
        """Return the secant to ``torque``, N/m."""
        return self.torque / (self.wind_up * load_radius**2)


CONTACTS = {"hunt_crossley": HuntCrossleyContact}
