"""Validated physical quantities: what a parameter means, its unit and its bounds, said once.

A frozen dataclass whose fields are made with `quantity` checks every one of them when it is built; the
nodes read the same descriptions for their ROS parameters, and the documentation for its tables.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, TypeVar

EXPONENTIAL = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
"""A number such as 2e-05, which YAML 1.1 takes for text unless it has a point and a sign in its exponent."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Description, unit and bounds of one number.

    The bound is ``lower <= value <= upper``, or ``lower < value`` where ``open_lower``.
    """

    description: str
    unit: str
    lower: float
    upper: float
    open_lower: bool = False
    whole: bool = False

    @property
    def bound(self) -> str:
        """The bound in words, with the unit."""
        unit = f" {self.unit}" if self.unit else ""
        kind = "a whole number " if self.whole else ""
        return f"{kind}{'>' if self.open_lower else '>='} {self.lower:g}{unit} and <= {self.upper:g}{unit}"

    def check(self, name: str, value: float) -> None:
        """Raise ValueError, naming ``name``, the value, the bound and the unit, unless within bounds."""
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not math.isfinite(value):
            raise ValueError(f"{name} must be a finite number, {self.bound}, got {value!r}")
        below = value <= self.lower if self.open_lower else value < self.lower
        if below or value > self.upper or (self.whole and not isinstance(value, int)):
            raise ValueError(f"{name} must be {self.bound}, got {value!r}")


def quantity(
    description: str,
    unit: str,
    *,
    at_most: float,
    above: float | None = None,
    at_least: float = 0.0,
    whole: bool = False,
    default: Any = ...,
) -> Any:
    """Make a dataclass field for a number with a meaning, a unit and bounds (``above`` is a strict lower bound)."""
    lower = at_least if above is None else above
    described = Quantity(description, unit, lower, at_most, above is not None, whole)
    if default is ...:
        return field(metadata={"quantity": described})
    return field(metadata={"quantity": described}, default=default)


@dataclass(frozen=True)
class Validated:
    """Base of parameter values: checks each `quantity` field on construction.

    ``section`` is the prefix under which errors name the fields, as the ROS parameters do.
    """

    section: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for name, described in quantities(type(self)).items():
            described.check(f"{self.section}.{name}" if self.section else name, getattr(self, name))


def quantities(kind: type[Validated]) -> dict[str, Quantity]:
    """Return the quantities of a validated dataclass by field name."""
    return {f.name: f.metadata["quantity"] for f in fields(kind) if "quantity" in f.metadata}


V = TypeVar("V", bound=Validated)


def take(kind: type[V], values: Mapping[str, Any], **others: Any) -> V:
    """Build a validated value from parameters named by its section; ValueError names the one that is out of bounds."""
    prefix = f"{kind.section}." if kind.section else ""
    return kind(**{name: values[prefix + name] for name in quantities(kind)}, **others)
