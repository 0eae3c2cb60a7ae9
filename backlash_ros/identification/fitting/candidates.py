"""The tooth laws that a fit tries: one with free stiffness, dampers and exponent, and a contact law as it was told.

The free law contains the linear spring of couplings and of steel on steel, Hertz's power of 3/2 and the damping of Hunt
& Crossley (J. Appl. Mech. 42(2), 1975), and never pulls. For the depth delta beyond the gap and its rate r, all at the
output:

    T = max(0, s (1 + d r) + clip(c r, -s, s)),   s = (k delta_0/e) (delta/delta_0)^e

The stiffness k is the slope at the depth delta_0.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from backlash_ros.drivetrain import CONTACTS, Drive
from backlash_ros.drivetrain.contact import Constants, Contact, ForceFunction, SlopesFunction, gap_at_rest, law_name
from backlash_ros.drivetrain.contacts.elastic import SpringContact
from backlash_ros.foundation.compiled import compiled, specialize, unbound


class ToothTorque(NamedTuple):
    """The torque of the teeth, N m, and its derivatives.

    By the twist (N m/rad), by its rate (N m s/rad) and by half the gap (N m/rad); by the logarithms of stiffness,
    damping, rebound and exponent (N m).
    """

    torque: float
    by_twist: float
    by_rate: float
    by_half_gap: float
    by_ln_stiffness: float
    by_ln_damping: float
    by_ln_rebound: float
    by_ln_exponent: float


APART = ToothTorque(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Of teeth that do not touch."""

_force: ForceFunction = unbound
_slopes: SlopesFunction = unbound


class Shape(NamedTuple):
    """What a fit varies of the teeth.

    ``stiffness`` k at the ``depth`` delta_0 (N m/rad, rad), ``damping`` c (N m s/rad), ``rebound`` d (s/rad) and
    ``exponent`` e. Of a told law, ``stiffness`` is a factor on its force and ``depth`` the load's pitch radius (m).
    """

    stiffness: float
    damping: float
    rebound: float
    exponent: float
    depth: float


@compiled
def free_torque(constants: Constants, shape: Shape, half_gap: float, twist: float, rate: float) -> ToothTorque:  # noqa: ARG001
    """Return the torque of the free law and its derivatives, for half the gap, a twist (rad) and its rate (rad/s)."""
    depth = abs(twist) - half_gap
    if depth <= 0.0:
        return APART
    side = 1.0 if twist > 0.0 else -1.0
    log = math.log(depth / shape.depth)
    spring = shape.stiffness * shape.depth / shape.exponent * math.exp(shape.exponent * log)
    closing = side * rate
    factor, damper, damping = 1.0 + shape.rebound * closing, shape.damping * closing, shape.damping
    if abs(damper) > spring:
        factor += 1.0 if damper > 0.0 else -1.0
        damper = damping = 0.0
    torque = spring * factor + damper
    if torque <= 0.0:
        return APART
    by_twist = shape.exponent * spring / depth * factor
    return ToothTorque(
        torque=side * torque,
        by_twist=by_twist,
        by_rate=damping + spring * shape.rebound,
        by_half_gap=-side * by_twist,
        by_ln_stiffness=side * spring * factor,
        by_ln_damping=side * damper,
        by_ln_rebound=side * spring * shape.rebound * closing,
        by_ln_exponent=side * spring * (shape.exponent * log - 1.0) * factor,
    )


def _told_torque(constants: Constants, shape: Shape, half_gap: float, twist: float, rate: float) -> ToothTorque:
    """Return the torque of a contact law times a factor, and its derivatives."""
    radius = shape.depth
    tooth = _force(constants, radius * half_gap, radius * twist, radius * rate)
    torque, factor = radius * shape.stiffness * tooth[0], radius * radius * shape.stiffness
    by_half_gap = factor * _slopes(constants, radius * half_gap, radius * twist, tooth)[2]
    return ToothTorque(torque, factor * tooth[1], factor * tooth[2], by_half_gap, torque, 0.0, 0.0, 0.0)


TorqueFunction = Callable[[Constants, Shape, float, float, float], ToothTorque]


@cache
def torque_by(law: type[Contact] | None) -> TorqueFunction:
    """Return the compiled torque of a contact law, or of the free law for None."""
    if law is None:
        return free_torque
    bound: Any = {"_force": law.force, "_slopes": law.half_gap_slopes}
    return specialize(_told_torque, fused=True, **bound)


class Candidate(NamedTuple):
    """Teeth to try: a told ``contact`` with its ``constants``, or the free law for None; ``depth`` as in `Shape`."""

    contact: Contact | None
    constants: Constants
    depth: float

    @property
    def free(self) -> bool:
        """Whether it is the free law."""
        return self.contact is None

    @property
    def law(self) -> type[Contact] | None:
        """The class of the told contact, None for the free law."""
        return None if self.contact is None else type(self.contact)

    @property
    def name(self) -> str:
        """The name of the law, in words."""
        return "a free" if self.contact is None else f"the {law_name(self.contact)}"

    def torque(self, shape: Shape, half_gap: float, twist: float, rate: float = 0.0) -> float:
        """Return the torque of the teeth, N m, for a twist from the middle of the gap, rad, and its rate, rad/s."""
        return torque_by(self.law)(self.constants, shape, half_gap, twist, rate).torque  # type: ignore[arg-type]

    def twist(self, shape: Shape, half_gap: float, torque: float) -> float:
        """Return the twist from the middle of the gap at which teeth at rest bear a torque > 0 (N m), rad."""
        if self.contact is None:
            spring = torque * shape.exponent / (shape.stiffness * shape.depth)
            return half_gap + shape.depth * float(spring ** (1.0 / shape.exponent))
        radius = shape.depth
        force = torque / (radius * shape.stiffness)
        return gap_at_rest(self.contact, self.constants, radius * half_gap, force) / radius


def free_teeth(depth: float) -> Candidate:
    """Return the free law with its stiffness at a ``depth``, rad."""
    return Candidate(None, (0.0,) * 8, depth)


def told_teeth(drive: Drive, contact: Contact) -> Candidate:
    """Return a contact law as the teeth of ``drive``."""
    radius = drive.gear.load_radius
    return Candidate(contact, contact.constants(radius, drive.contact_mass), radius)


def told_contact(drive: Drive) -> Contact:
    """Return the contact law to try beside the free one: the drive's own, or `power` if the free law contains that."""
    own = drive.gear.contact
    return CONTACTS["power"]() if isinstance(own, SpringContact) else own


def contacts_of(drive: Drive) -> list[Contact]:
    """Return the drive's own contact law, then `power` and `elastic` unless it is one of them."""
    own = drive.gear.contact
    names = [name for name in ("power", "elastic") if name != law_name(own)]
    return [own, *(CONTACTS[name]() for name in names)]
