"""What a tooth contact is: a validated value with one compiled force. The laws are in `contacts`, one a file.

For a gap (m), its rate (m/s) and half the local backlash (m), a law gives, in this order:

    force              F, N, positive where the motor's gear drives the load forward
    stiffness          its derivative by the gap, N/m
    damping            its derivative by the gap rate, N s/m
    elastic            the part of F that stores energy, N: the derivative of that energy by the gap
    elastic_stiffness  its derivative by the gap, N/m

The rest of F is lost as heat. If the backlash varies along the turn, the stored energy also depends on the half gap,
and this dependence exerts a torque on the load: see `dynamics`.
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol

from scipy.optimize import brentq

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.quantity import Validated

Constants = tuple[float, ...]
"""A contact law's constants, eight numbers: see `as_constants`."""

_CONSTANTS = 8
_FARTHEST = 1e9
"""Largest depth that teeth are pressed in, in half gaps."""

ToothForce = tuple[float, float, float, float, float]
"""force, stiffness, damping, elastic, elastic_stiffness."""

HalfGapSlopes = tuple[float, float, float, float]
"""Derivatives by the half gap: of the stored energy (N), of the elastic force (N/m), of the force (N/m), and the second
one of the stored energy (N/m)."""


class ForceFunction(Protocol):
    """A compiled function: the force of the teeth and its derivatives."""

    def __call__(self, constants: Constants, half_gap: float, gap: float, gap_rate: float, /) -> ToothForce:
        """Return them for half the backlash (m), a gap (m) and its rate (m/s)."""


class EnergyFunction(Protocol):
    """A compiled function: what the teeth store."""

    def __call__(self, constants: Constants, half_gap: float, gap: float, /) -> float:
        """Return it for half the backlash (m) and a gap (m), J."""


class SlopesFunction(Protocol):
    """A compiled function: derivatives by the half gap."""

    def __call__(self, constants: Constants, half_gap: float, gap: float, tooth: ToothForce, /) -> HalfGapSlopes:
        """Return them for half the backlash (m) and a gap (m), at which the force function answered ``tooth``."""


LinearPiece = tuple[float, float, float, float, float, float, float, float, float]
"""A straight line of force, and where it holds: offset (N), stiffness (N/m) and damping (N s/m) of

    F = offset + stiffness gap + damping gap_rate

then two bounds, each bound + by_gap gap + by_rate gap_rate (m; no unit; s), both >= 0 where it holds."""


class LinearFunction(Protocol):
    """A compiled function: the linear piece of the force."""

    def __call__(self, constants: Constants, half_gap: float, gap: float, gap_rate: float, /) -> LinearPiece:
        """Return the piece that holds for half the backlash (m), a gap (m) and its rate (m/s), if there is one."""


class PieceFunction(Protocol):
    """A compiled function: which piece of the force holds."""

    def __call__(self, constants: Constants, half_gap: float, gap: float, gap_rate: float, /) -> int:
        """Return its number for half the backlash (m), a gap (m) and its rate (m/s)."""


@compiled
def one_piece(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> int:  # noqa: ARG001
    """Return 0: a force that is smooth throughout."""
    return 0


@compiled
def nowhere_linear(constants: Constants, half_gap: float, gap: float, gap_rate: float) -> LinearPiece:  # noqa: ARG001
    """Return a piece that holds nowhere."""
    return 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, -1.0, 0.0, 0.0


@compiled
def dead_zone_slopes(constants: Constants, half_gap: float, gap: float, tooth: ToothForce) -> HalfGapSlopes:  # noqa: ARG001
    """Return the derivatives by the half gap of any law that depends on the depth abs(gap) - half_gap alone."""
    _, stiffness, _, elastic, elastic_stiffness = tooth
    side = 1.0 if gap > 0.0 else -1.0
    return -side * elastic, -side * elastic_stiffness, -side * stiffness, elastic_stiffness


@dataclass(frozen=True)
class Contact(Validated):
    """Base of the contact laws: a subclass adds its parameters, each with a default, and its compiled functions.

    ``section`` is ``contact.`` and the law's name: the prefix of its ROS parameters and in its errors.

    Attributes
    ----------
    force : compiled, ``(constants, half_gap, gap, gap_rate) -> ToothForce``
    energy : compiled, ``(constants, half_gap, gap)`` -> what the teeth store, J
    half_gap_slopes : compiled, ``(constants, half_gap, gap, tooth) -> HalfGapSlopes``, with what ``force`` answered;
        the default is right for every law in which only the depth beyond the gap counts
    piece : compiled, ``(constants, half_gap, gap, gap_rate)`` -> a number for each piece in which the force is
        smooth; 0 throughout by default
    linear : compiled, ``(constants, half_gap, gap, gap_rate) -> LinearPiece``, where the force is linear: there the
        motion is exact, and quick; nowhere by default
    """

    force: ClassVar[ForceFunction]
    energy: ClassVar[EnergyFunction]
    half_gap_slopes: ClassVar[SlopesFunction] = staticmethod(dead_zone_slopes)
    piece: ClassVar[PieceFunction] = staticmethod(one_piece)
    linear: ClassVar[LinearFunction] = staticmethod(nowhere_linear)

    def constants(self, load_radius: float, mass: float) -> Constants:
        """Return what the compiled functions take as ``constants``: see `as_constants`.

        Parameters
        ----------
        load_radius : pitch radius R2 of the load's gear, m
        mass : reduced mass of both gears along the pitch line, kg
        """
        raise NotImplementedError

    def deflection(self, torque: float, half_gap: float, load_radius: float) -> float:
        """Return by how much a torque on the output shaft (N m) presses the teeth in beyond the gap, rad there."""
        raise NotImplementedError

    def edge_stiffness(self, half_gap: float, load_radius: float) -> float:
        """Return the stiffness of the teeth at the edge of the gap, N/m along the pitch line."""
        raise NotImplementedError


def gap_at_rest(contact: Contact, constants: Constants, half_gap: float, force: float) -> float:
    """Return the gap at which teeth at rest carry a ``force`` (N, > 0), m: beyond its edge, or within it.

    Parameters
    ----------
    constants : of ``contact``
    half_gap : half the backlash, m

    Raises
    ------
    ValueError
        If they cannot carry so large a force.
    """

    def missing(gap: float) -> float:
        return contact.force(constants, half_gap, gap, 0.0)[0] - force

    high = half_gap
    while missing(high) < 0.0:
        high *= 2.0
        if high > _FARTHEST * half_gap:
            raise ValueError(f"the teeth cannot carry a force of {force:g} N")
    return float(brentq(missing, 0.0, high, xtol=1e-30, rtol=1e-14))


def law_name(contact: Contact) -> str:
    """Return the name of the law of ``contact`` in `contacts.CONTACTS`."""
    return contact.section.removeprefix("contact.")


def as_constants(*values: float) -> Constants:
    """Return up to eight numbers in the form that the compiled functions take; ValueError for more."""
    if len(values) > _CONSTANTS:
        raise ValueError(f"a contact law has at most {_CONSTANTS} constants, got {len(values)}")
    return tuple(float(value) for value in values) + (0.0,) * (_CONSTANTS - len(values))
