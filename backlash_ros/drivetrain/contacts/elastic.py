"""Elastic contact: a dead zone, then a linear spring and damper whose force neither jumps at contact nor pulls.

    F = k delta + c ddelta/dt, delta = abs(gap) - d/2, with the damping part at most as large as the spring's

As in Nordin, Galic & Gutman, Int. J. Adapt. Control Signal Process. 11, 1997, and in
Modelica.Mechanics.Rotational.Components.ElastoBacklash2. The rate of delta is the gap's, where the backlash varies too.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

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


class Spring(NamedTuple):
    """The constants of a law with a linear spring, along the pitch line."""

    stiffness: float  # k, N/m
    damping: float  # c, N s/m


@compiled
def spring_of(constants: Constants) -> Spring:
    """Return the constants by name."""
    return Spring(constants[0], constants[1])


@compiled
def elastic_force(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> ToothForce:
    """Return the force and its derivatives."""
    depth = abs(gap) - half_gap
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    k, c = spring_of(constants)
    side = 1.0 if gap > 0.0 else -1.0
    spring = k * depth
    damper = c * gap_rate * side
    if damper > spring:
        return 2.0 * side * spring, 2.0 * k, 0.0, side * spring, k
    if damper < -spring:
        return 0.0, 0.0, 0.0, side * spring, k
    return side * (spring + damper), k, c, side * spring, k


@compiled
def elastic_piece(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> int:
    """Return 0 if apart, or the damper's state: unlimited, limited to the spring's force, or limited not to pull."""
    depth = abs(gap) - half_gap
    if depth <= 0.0:
        return 0
    k, c = spring_of(constants)
    spring = k * depth
    damper = c * (gap_rate if gap > 0.0 else -gap_rate)
    if damper > spring:
        return 2
    return 3 if damper < -spring else 1


@compiled
def elastic_linear(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> LinearPiece:
    """Return the linear piece that holds: see `elastic_piece`."""
    side = 1.0 if gap > 0.0 else -1.0
    depth = side * gap - half_gap
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, half_gap, 1.0, 0.0, half_gap, -1.0, 0.0
    k, c = spring_of(constants)
    time = side * c / k
    if time * gap_rate > depth:
        return -2.0 * side * k * half_gap, 2.0 * k, 0.0, -half_gap, side, 0.0, half_gap, -side, time
    if time * gap_rate < -depth:
        return 0.0, 0.0, 0.0, -half_gap, side, 0.0, half_gap, -side, -time
    return -side * k * half_gap, k, c, -half_gap, side, -time, -half_gap, side, time


@compiled
def elastic_energy(constants: Constants, half_gap: float, gap: float) -> float:
    """Return k delta^2/2, J."""
    depth = max(0.0, abs(gap) - half_gap)
    return 0.5 * spring_of(constants).stiffness * depth * depth


@dataclass(frozen=True)
class SpringContact(Contact):
    """Base of the laws that have a linear spring beyond the gap."""

    energy: ClassVar[EnergyFunction] = staticmethod(elastic_energy)

    wind_up: float = quantity(
        "wind-up of the teeth: twist of the output per newton metre of output torque",
        "rad/(N m)",
        at_least=1e-9,
        at_most=1e3,
        default=1e-3,
    )

    def deflection(self, torque: float, half_gap: float, load_radius: float) -> float:  # noqa: ARG002
        """Return how far beyond the gap the teeth carry ``torque`` (N m), rad at the output."""
        return abs(torque) * self.wind_up

    def edge_stiffness(self, half_gap: float, load_radius: float) -> float:  # noqa: ARG002
        """Return k, N/m."""
        return 1.0 / (self.wind_up * load_radius**2)


@dataclass(frozen=True)
class ElasticContact(SpringContact):
    """Linear spring and damper beyond the gap."""

    section: ClassVar[str] = "contact.elastic"
    force: ClassVar[ForceFunction] = staticmethod(elastic_force)
    piece: ClassVar[PieceFunction] = staticmethod(elastic_piece)
    linear: ClassVar[LinearFunction] = staticmethod(elastic_linear)

    damping: float = quantity("damping c along the pitch line", "N s/m", at_least=0, at_most=1e8, default=50.0)

    def constants(self, load_radius: float, mass: float) -> Constants:  # noqa: ARG002
        """Return k (N/m) and c (N s/m)."""
        return as_constants(*Spring(self.edge_stiffness(0.0, load_radius), self.damping))


CONTACTS = {"elastic": ElasticContact}
