"""How far a drive may be from its description, and the drives of that range on which gains are tried."""

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import CONTACTS, Drive
from backlash_ros.drivetrain.contact import Contact, law_name
from backlash_ros.drivetrain.contacts.elastic import ElasticContact

Factors = tuple[float, float]

_INSIDE = 8
"""Drives inside the range that are tried in addition to its corners."""
_LARGEST = 100.0
_WIND_UP = 0.3
"""Largest wind-up of other teeth under the motor's torque at standstill, as a share of the gap."""


class Case(NamedTuple):
    """One drive of the range, the load torque on it, N m, and its differences in words."""

    drive: Drive
    load_torque: float
    label: str


@dataclass(frozen=True)
class Uncertainty:
    """Ranges, (lower, upper), as factors of the described values.

    ``load_torque``: the largest on the output, in either direction, as a share of the motor's torque at standstill.

    Raises
    ------
    ValueError
        Names the range, its values and the bound.

    Examples
    --------
    >>> Uncertainty(inertia=(1.3, 0.7))
    Traceback (most recent call last):
    ValueError: inertia must be two factors, 0.01 <= lower <= upper <= 100, got 1.3 and 0.7
    """

    inertia: Factors = (0.7, 1.3)
    viscous_friction: Factors = (0.8, 1.2)
    dry_friction: Factors = (0.5, 1.5)
    gap: Factors = (0.9, 1.1)
    load_torque: float = 0.05

    def __post_init__(self) -> None:
        for name, least in (("inertia", 0.01), ("viscous_friction", 0.0), ("dry_friction", 0.0), ("gap", 0.01)):
            lower, upper = getattr(self, name)
            if not least <= lower <= upper <= _LARGEST:
                raise ValueError(
                    f"{name} must be two factors, {least:g} <= lower <= upper <= {_LARGEST:g}, "
                    f"got {lower:g} and {upper:g}"
                )
        if not 0 <= self.load_torque <= 0.5:
            raise ValueError(
                f"load_torque must be a share of the torque at standstill, >= 0 and <= 0.5, got {self.load_torque:g}"
            )

    def cases(self, drive: Drive) -> list[Case]:
        """Return the drives that are tried: as described, load torque either way, each corner, and some inside."""
        torque = self.load_torque * drive.standstill_torque()
        cases = [Case(drive, 0.0, "as described")]
        cases += [Case(drive, sign * torque, f"load torque {sign * torque:+.3g} N m") for sign in (1, -1) if torque]
        load, motor = drive.load, drive.motor
        there = {
            "J_l": (self.inertia, load.inertia),
            "B_l": (self.viscous_friction, load.viscous_friction),
            "tau_c": (self.dry_friction, load.coulomb_friction + motor.coulomb_friction),
            "b": (self.gap, drive.gear.backlash_angle),
        }
        varied = {name: factors for name, (factors, value) in there.items() if value > 0 and factors[0] < factors[1]}
        fixed = {name: factors[0] for name, (factors, value) in there.items() if name not in varied}
        corners = [dict(zip(varied, corner, strict=True)) for corner in product(*varied.values())] if varied else []
        for number, factors in enumerate([*corners, *_inside(varied)]):
            scaled = _scaled(drive, {**fixed, **factors})
            label = [f"{name} x{factor:.3g}" for name, factor in factors.items()]
            if number.bit_count() % 2:  # of each two neighbouring corners one
                scaled = replace(scaled, gear=replace(scaled.gear, contact=_other_teeth(drive)))
                label.append("other teeth")
            cases.append(Case(scaled, 0.0, ", ".join(label)))
        return cases


def _inside(varied: dict[str, Factors]) -> list[dict[str, float]]:
    """Return factors inside their ranges, evenly spread (Halton)."""
    if not varied:
        return []
    low, high = np.array(list(varied.values())).T
    from scipy.stats import qmc  # noqa: PLC0415 - slow to load, and most who import this need it not

    shares = qmc.Halton(len(varied), scramble=False).random(_INSIDE + 1)[1:]  # the first is a corner
    return [dict(zip(varied, point, strict=True)) for point in (low + shares * (high - low)).tolist()]


def _other_teeth(drive: Drive) -> Contact:
    """Return teeth that bounce if those of the drive do not, and vice versa: a drive file rarely knows.

    The torque of the motor winds elastic ones up by a share of the gap at most, as in the nominal drive.
    """
    if law_name(drive.gear.contact) == "elastic":
        return CONTACTS["power"]()
    elastic = ElasticContact()
    wind_up = _WIND_UP * drive.gear.backlash_angle / drive.standstill_torque()
    return replace(elastic, wind_up=min(elastic.wind_up, wind_up))


def _scaled(drive: Drive, factors: dict[str, float]) -> Drive:
    """Return a drive with the load, the dry friction of both sides and the gap of ``drive`` times these factors."""
    load, friction = drive.load, factors["tau_c"]
    return replace(
        drive,
        motor=replace(drive.motor, coulomb_friction=friction * drive.motor.coulomb_friction),
        gear=replace(drive.gear, backlash_angle=factors["b"] * drive.gear.backlash_angle),
        load=replace(
            load,
            inertia=factors["J_l"] * load.inertia,
            viscous_friction=factors["B_l"] * load.viscous_friction,
            coulomb_friction=friction * load.coulomb_friction,
        ),
    )
