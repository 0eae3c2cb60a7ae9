"""Limits of the servo: values, their defaults, and the references that they allow."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated, quantity

NO_LIMIT = 1e9
"""Means no limit: beyond any angle, rad."""

_TURN = 2 * math.pi
"""Of the output, rad."""


@dataclass(frozen=True)
class Limits(Validated):
    """Limits of the servo; the default that depends on the drive comes from `Limits.of`.

    A reference outside the positions or further away than ``step`` is refused; towards an end the command fades out
    over ``soft_zone``. By default a step is at most one turn of the output: a joint's travel is seldom more, while a
    reference in degrees, in counts or at the motor soon is. A plan that moves without a leap may go further.
    """

    section: ClassVar[str] = "limits"

    command: float = quantity(
        "largest magnitude of the command, V or A as command_interface says", "V or A", above=0, at_most=1e6
    )
    position_lower: float = quantity(
        "lower end of the load's travel", "rad", at_least=-NO_LIMIT, at_most=NO_LIMIT, default=-NO_LIMIT
    )
    position_upper: float = quantity(
        "upper end of the load's travel", "rad", at_least=-NO_LIMIT, at_most=NO_LIMIT, default=NO_LIMIT
    )
    soft_zone: float = quantity(
        "distance before an end over which the command towards it fades out; as far beyond the end is a fault",
        "rad",
        above=0,
        at_most=10,
        default=0.05,
    )
    step: float = quantity(
        "largest step of the reference; one turn of the output by default, so that degrees are refused",
        "rad",
        above=0,
        at_most=NO_LIMIT,
        default=_TURN,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.position_lower < self.position_upper:
            raise ValueError(
                f"limits.position_lower must be < limits.position_upper = {self.position_upper:g} rad, "
                f"got {self.position_lower!r}"
            )

    @classmethod
    def of(cls, drive: Drive) -> "Limits":
        """Return limits without ends of the travel, with the largest command that ``drive`` obeys."""
        return cls(command=drive.command_limit)

    def rejection_reason(self, reference: float, present: float) -> str:
        """Return why a ``reference`` (rad) is refused if ``present`` is the one in use; empty if it is accepted."""
        if not self.position_lower <= reference <= self.position_upper:
            return (
                f"reference must be within limits.position_lower = {self.position_lower:g} rad and "
                f"limits.position_upper = {self.position_upper:g} rad, got {reference:g}"
            )
        if abs(reference - present) > self.step:
            return f"reference must be within limits.step = {self.step:g} rad of {present:g} rad, got {reference:g}"
        return ""

    @property
    def endless(self) -> "Limits":
        """The same limits without ends of the travel."""
        return replace(self, position_lower=-NO_LIMIT, position_upper=NO_LIMIT)

    def moved(self, by: float) -> "Limits":
        """Return the same limits with the ends of the travel moved by an angle, rad; where there is none, none is."""

        def end(there: float) -> float:
            return there if abs(there) == NO_LIMIT else min(max(there + by, -NO_LIMIT), NO_LIMIT)

        return replace(self, position_lower=end(self.position_lower), position_upper=end(self.position_upper))

    def clamp(self, reference: float) -> float:
        """Return ``reference`` (rad), clamped to the travel."""
        return min(max(reference, self.position_lower), self.position_upper)
