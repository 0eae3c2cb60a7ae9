"""What the servo clamps or refuses: values, their defaults, and which references they allow."""

import math
from dataclasses import dataclass
from typing import ClassVar

from backlash_ros.drivetrain import Drive, Validated, quantity

NO_LIMIT = 1e9
"""Stands for no limit: beyond any angle, rad."""

_TURN = 2 * math.pi
"""Of the output, rad."""


@dataclass(frozen=True)
class Limits(Validated):
    """What the servo clamps or refuses; the default that depends on the drive comes from `Limits.of`.

    A reference outside the positions or further away than ``step`` is refused; towards an end the command fades out
    over ``soft_zone``. A step is one turn of the output at most, unless told otherwise: from one end of a joint's
    travel to the other it is seldom more, while degrees, counts or the motor's angle for the load's come to more soon.
    A plan that moves there without a leap may be longer.
    """

    section: ClassVar[str] = "limits"

    command: float = quantity("largest command; its unit is that of command_interface", "V or A", above=0, at_most=1e6)
    position_lower: float = quantity(
        "lower end of the load's travel", "rad", at_least=-NO_LIMIT, at_most=NO_LIMIT, default=-NO_LIMIT
    )
    position_upper: float = quantity(
        "upper end of the load's travel", "rad", at_least=-NO_LIMIT, at_most=NO_LIMIT, default=NO_LIMIT
    )
    soft_zone: float = quantity(
        "way before an end over which the command towards it fades out; as far beyond it is a fault",
        "rad",
        above=0,
        at_most=10,
        default=0.05,
    )
    step: float = quantity(
        "largest change of the reference at once; by default one turn of the output, so that degrees are refused",
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
        """Return limits without ends of the travel, and the command that ``drive`` obeys."""
        return cls(command=drive.command_limit)

    def rejection_reason(self, reference: float, present: float) -> str:
        """Return why a ``reference`` (rad) is refused where ``present`` is the one in use; empty where it is not."""
        if not self.position_lower <= reference <= self.position_upper:
            return (
                f"reference must be within limits.position_lower = {self.position_lower:g} rad and "
                f"limits.position_upper = {self.position_upper:g} rad, got {reference:g}"
            )
        if abs(reference - present) > self.step:
            return f"reference must be within limits.step = {self.step:g} rad of {present:g} rad, got {reference:g}"
        return ""

    def clamp(self, reference: float) -> float:
        """Return ``reference`` (rad), or the end of the travel that it is beyond."""
        return min(max(reference, self.position_lower), self.position_upper)
