"""Contact with a coefficient of restitution: a linear spring and damper that releases when its force is zero.

The damping is the one that makes two free gears part with a given share e of the speed at which they met (Schwager &
Poeschel, Granular Matter 9, 2007), as an impact with restitution has it (Sarkar, Ellis & Moore, MSSP 11(3), 1997).
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from scipy.optimize import brentq

from backlash_ros.drivetrain.contact import (
    Constants,
    ForceFunction,
    LinearFunction,
    LinearPiece,
    PieceFunction,
    ToothForce,
    as_constants,
)
from backlash_ros.drivetrain.contacts.elastic import Spring, SpringContact, spring_of
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.quantity import quantity


def restitution_of(damping_ratio: float) -> float:
    """Return the share of the speed that is left by a linear spring-damper contact that releases at zero force.

    ``damping_ratio`` is c/(2 sqrt(k m)) with the reduced mass m of the two bodies, 0 <= ratio < 1.
    """
    root = math.sqrt(1.0 - damping_ratio**2)
    # The phase, in the damped oscillation, at which k delta + c ddelta/dt first vanishes.
    phase = math.atan2(2.0 * damping_ratio * root, 2.0 * damping_ratio**2 - 1.0)
    return math.exp(-damping_ratio / root * phase)


def damping_ratio_of(restitution: float) -> float:
    """Return the damping ratio that leaves ``restitution``, above 0.19 (nearly critical damping) and at most 1."""
    return float(brentq(lambda ratio: restitution_of(ratio) - restitution, 0.0, 0.999, xtol=1e-14))


@compiled
def restitution_force(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> ToothForce:
    """Return the force and its derivatives."""
    depth = abs(gap) - half_gap
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    k, c = spring_of(constants)
    side = 1.0 if gap > 0.0 else -1.0
    spring = k * depth
    damper = c * gap_rate * side
    if spring + damper < 0.0:
        return 0.0, 0.0, 0.0, side * spring, k
    return side * (spring + damper), k, c, side * spring, k


@compiled
def restitution_piece(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> int:
    """Return 0 apart, 1 in contact, 2 where the teeth have let go."""
    depth = abs(gap) - half_gap
    if depth <= 0.0:
        return 0
    k, c = spring_of(constants)
    damper = c * (gap_rate if gap > 0.0 else -gap_rate)
    return 2 if k * depth + damper < 0.0 else 1


@compiled
def restitution_linear(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> LinearPiece:
    """Return the linear piece that holds: see `restitution_piece`."""
    side = 1.0 if gap > 0.0 else -1.0
    depth = side * gap - half_gap
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, half_gap, 1.0, 0.0, half_gap, -1.0, 0.0
    k, c = spring_of(constants)
    time = side * c / k
    if time * gap_rate < -depth:
        return 0.0, 0.0, 0.0, -half_gap, side, 0.0, half_gap, -side, -time
    return -side * k * half_gap, k, c, -half_gap, side, 0.0, -half_gap, side, time


@dataclass(frozen=True)
class RestitutionContact(SpringContact):
    """Linear spring beyond the gap, damped for a coefficient of restitution."""

    section: ClassVar[str] = "contact.restitution"
    force: ClassVar[ForceFunction] = staticmethod(restitution_force)
    piece: ClassVar[PieceFunction] = staticmethod(restitution_piece)
    linear: ClassVar[LinearFunction] = staticmethod(restitution_linear)

    restitution: float = quantity("coefficient of restitution e", "", at_least=0.2, at_most=1, default=0.5)

    def constants(self, load_radius: float, mass: float) -> Constants:
        """Return k (N/m) and c (N s/m)."""
        k = self.edge_stiffness(0.0, load_radius)
        return as_constants(*Spring(k, 2.0 * damping_ratio_of(self.restitution) * math.sqrt(k * mass)))


CONTACTS = {"restitution": RestitutionContact}
