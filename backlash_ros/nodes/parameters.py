"""ROS parameters from the package's validated values: declared with meaning, unit and bound, read back as values."""

from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive, Gear, Load, Motor, Validated, quantities

V = TypeVar("V", bound=Validated)


def describe(text: str, *, unit: str = "", constraint: str = "", read_only: bool = False) -> ParameterDescriptor:
    """Return a parameter's descriptor: what it is, in what unit, within which bounds."""
    description = f"{text} [{unit}]" if unit else text
    return ParameterDescriptor(description=description, additional_constraints=constraint, read_only=read_only)


def declare_quantities(node: Node, value: Validated, *, read_only: bool) -> dict[str, Any]:
    """Declare a parameter for each quantity of ``value``, which gives the defaults; return what the user set."""
    declared = {}
    for name, described in quantities(type(value)).items():
        full = f"{value.section}.{name}" if value.section else name
        descriptor = describe(
            described.description, unit=described.unit, constraint=described.bound, read_only=read_only
        )
        declared[full] = node.declare_parameter(full, getattr(value, name), descriptor).value
    return declared


def take(kind: type[V], values: dict[str, Any], **others: Any) -> V:
    """Build a validated value from parameters named by its section; ValueError names the one that is out of bounds."""
    prefix = f"{kind.section}." if kind.section else ""
    return kind(**{name: values[prefix + name] for name in quantities(kind)}, **others)


def declare_drive(node: Node) -> Drive:
    """Declare the drive's parameters, read-only and by default the nominal drive's, and return the drive."""
    values: dict[str, Any] = {}
    for part in (NOMINAL_DRIVE.motor, NOMINAL_DRIVE.gear, NOMINAL_DRIVE.load):
        values |= declare_quantities(node, part, read_only=True)
    return Drive(take(Motor, values), take(Gear, values), take(Load, values))


def declare_rate(node: Node) -> float:
    """Declare ``rate`` and return it, Hz: of the samples, the same for drive and controller."""
    bound = "> 0 Hz and <= 2000 Hz"
    rate = node.declare_parameter(
        "rate", 250.0, describe("rate of the samples", unit="Hz", constraint=bound, read_only=True)
    ).value
    if not 0 < rate <= 2000:
        raise ValueError(f"rate must be {bound}, got {rate!r}")
    return float(rate)


def declare_duration(node: Node, name: str, default: float, text: str) -> float:
    """Declare a read-only time in s and return it; ValueError unless > 0 and <= 10 s."""
    bound = "> 0 s and <= 10 s"
    value = node.declare_parameter(name, default, describe(text, unit="s", constraint=bound, read_only=True)).value
    if not 0 < value <= 10:
        raise ValueError(f"{name} must be {bound}, got {value!r}")
    return float(value)
