"""ROS parameters from the package's validated values: declared with description, unit and bound, read as values."""

import math
import re
from array import array
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterEvent, ParameterValue
from rclpy.node import Node
from rclpy.parameter import Parameter

from backlash_ros.drivetrain import COMMAND_INTERFACES, CONTACTS, NOMINAL_DRIVE
from backlash_ros.drivetrain.contact import law_name
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.quantity import EXPONENTIAL, Quantity, Validated, quantities, take
from backlash_ros.foundation.signals import STATE_NAMES

KINDS = {
    Parameter.Type.BOOL: "true or false",
    Parameter.Type.INTEGER: "a whole number",
    Parameter.Type.DOUBLE: "a number",
    Parameter.Type.STRING: "a text",
    Parameter.Type.DOUBLE_ARRAY: "a list of numbers",
    Parameter.Type.STRING_ARRAY: "a list of texts",
}
"""The types of parameters in words."""

ALL, NONE = ("",), ()
"""Prefixes of the names of parameters that may change while the node runs."""

_ABOVE = 1e-12
"""Offset of a range's start from an excluded lower bound, since a range has no open end. No real value is smaller."""


def _describe(text: str, unit: str, constraint: str, *, read_only: bool) -> ParameterDescriptor:
    """Return a parameter's descriptor: description, unit and bounds."""
    return ParameterDescriptor(
        description=f"{text} [{unit}]" if unit else text, additional_constraints=constraint, read_only=read_only
    )


_UNIT = re.compile(r" \[([^]]+)\]$")


def in_parts(descriptor: ParameterDescriptor) -> tuple[str, str, str]:
    """Return a parameter's description, its unit, and its bounds without the unit, from `_describe`'s descriptor."""
    text, bound = descriptor.description, descriptor.additional_constraints
    unit = "".join(_UNIT.findall(text))
    if descriptor.floating_point_range and unit:
        bound = re.sub(rf"(?<=\d) {re.escape(unit)}(?= |$)", "", bound)
    return _UNIT.sub("", text), unit, bound


def convert(value: Any, kind: Parameter.Type) -> Any:
    """Return ``value`` in a parameter's type if the conversion is exact, else unchanged: 250 for 250.0, 3.0 for 3.

    `ros2 param` sends small numbers as text, "2e-05".
    """
    if kind == Parameter.Type.DOUBLE_ARRAY and isinstance(value, (list, tuple, array)):
        return [convert(item, Parameter.Type.DOUBLE) for item in value]
    if kind == Parameter.Type.STRING_ARRAY and value is None:
        return []  # rcl has no type for it
    if kind == Parameter.Type.DOUBLE:
        exact = isinstance(value, int) and not isinstance(value, bool)
        if exact or (isinstance(value, str) and EXPONENTIAL.fullmatch(value) and math.isfinite(float(value))):
            return float(value)
    if kind == Parameter.Type.INTEGER and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def check_kind(name: str, value: Any, kind: Parameter.Type, constraint: str) -> None:
    """Raise ValueError, naming ``name``, the value and the bound, unless the value has the parameter's type."""
    if not kind.check(value) or isinstance(value, bool) != (kind == Parameter.Type.BOOL):
        wanted = (
            constraint if constraint.startswith(KINDS[kind]) else ", ".join(filter(None, (KINDS[kind], constraint)))
        )
        raise ValueError(f"{name} must be {wanted}, got {value!r}")


def declare(
    node: Node, name: str, default: Any, text: str, *, unit: str = "", constraint: str = "", read_only: bool = False
) -> Any:
    """Declare a parameter with its default's type and return its value; ``text`` describes it."""
    return _declare(node, name, default, _describe(text, unit, constraint, read_only=read_only))


def _declare(
    node: Node,
    name: str,
    default: Any,
    descriptor: ParameterDescriptor,
    check: Callable[[str, Any], None] = lambda _name, _value: None,
) -> Any:
    """Declare a parameter as `declare` does, unless ``check`` refuses its value.

    The user's value is converted if that is exact. rclpy allows this only while a parameter's type is dynamic; it is
    fixed here.
    """
    kind = Parameter.Type.from_parameter_value(default)
    value = convert(node.declare_parameter(name, default, ParameterDescriptor(dynamic_typing=True)).value, kind)
    check_kind(name, value, kind, descriptor.additional_constraints)
    check(name, value)
    descriptor.type = kind.value
    node.set_descriptor(name, descriptor, Parameter(name, kind, value).get_parameter_value())
    return value


def declare_number(node: Node, name: str, default: float, described: Quantity, *, read_only: bool = True) -> Any:
    """Declare a parameter for a number and return it; ValueError names it if it is out of bounds."""
    descriptor = _describe(described.description, described.unit, described.bound, read_only=read_only)
    # For a tool's slider. The bound in words is the exact one, and is checked here.
    if isinstance(default, float):
        lower = described.lower + (_ABOVE if described.open_lower else 0.0)
        descriptor.floating_point_range = [FloatingPointRange(from_value=lower, to_value=described.upper)]
    else:
        descriptor.integer_range = [IntegerRange(from_value=int(described.lower), to_value=int(described.upper))]
    return _declare(node, name, default, descriptor, described.check)


def declare_quantities(node: Node, value: Validated, *, dynamic: tuple[str, ...]) -> dict[str, Any]:
    """Declare a parameter for each quantity of ``value``, which gives the defaults; return what the user set.

    Those whose names begin with one of ``dynamic`` may change later: `ALL`, `NONE`, or some prefixes.
    """
    declared = {}
    for name, described in quantities(type(value)).items():
        full = f"{value.section}.{name}" if value.section else name
        fixed = not full.startswith(dynamic)
        declared[full] = declare_number(node, full, getattr(value, name), described, read_only=fixed)
    return declared


def declare_drive(node: Node, dynamic: tuple[str, ...] = NONE) -> dict[str, Any]:
    """Declare the drive's parameters, by default the nominal drive's, and return what the user set.

    They are read-only, except those whose names begin with one of ``dynamic``.
    """
    values: dict[str, Any] = {}
    for part in (NOMINAL_DRIVE.motor, NOMINAL_DRIVE.gear, NOMINAL_DRIVE.load):
        values |= declare_quantities(node, part, dynamic=dynamic)
    fixed = not "contact.law".startswith(dynamic)
    name, usual, bound = "contact.law", law_name(NOMINAL_DRIVE.gear.contact), f"one of {list(CONTACTS)}"
    values[name] = declare(node, name, usual, "force law of the teeth", constraint=bound, read_only=fixed)
    for kind in CONTACTS.values():
        values |= declare_quantities(node, kind(), dynamic=dynamic)
    name, usual, bound = "command_interface", NOMINAL_DRIVE.command_interface, f"one of {list(COMMAND_INTERFACES)}"
    text = "what the command sets: the motor's voltage or its current"
    values[name] = declare(node, name, usual, text, constraint=bound, read_only=True)
    return values


def declare_sensors(node: Node) -> dict[str, Any]:
    """Declare the parameters of the sensors, dynamic and by default exact ones, and return what the user set."""
    values = declare_quantities(node, Sensors(), dynamic=ALL)
    text, bound = "signals that the drive measures", f"of {list(STATE_NAMES)}, at least one angle"
    values["sensors.measured"] = declare(node, "sensors.measured", list(STATE_NAMES), text, constraint=bound)
    text = "whether the drive derives its speeds from its encoder counts, over one sample period"
    values["sensors.speeds_from_positions"] = declare(node, "sensors.speeds_from_positions", False, text)
    return values


def sensors_of(values: dict[str, Any]) -> Sensors:
    """Return the sensors that a set of parameters defines; ValueError names a value that is out of bounds."""
    return take(
        Sensors,
        values,
        measured=tuple(values["sensors.measured"]),
        speeds_from_positions=values["sensors.speeds_from_positions"],
    )


def declare_joints(node: Node) -> tuple[str, str]:
    """Declare and return the names of the motor's and the load's joint."""
    names, bound = [], "motor_joint and load_joint are two different names"
    for side in ("motor", "load"):
        text = f"name of the {side}'s joint in joint_states"
        names.append(declare(node, f"{side}_joint", side, text, constraint=bound, read_only=True))
    motor, load = names
    if not motor or not load or motor == load:
        raise ValueError(f"motor_joint and load_joint must be two different names, got {motor!r} and {load!r}")
    return motor, load


def declare_autostart(node: Node) -> bool:
    """Declare ``autostart`` and return it."""
    text = "configure and activate at the start; if false, wait for lifecycle requests"
    return bool(declare(node, "autostart", True, text, read_only=True))


def declare_rate(node: Node) -> float:
    """Declare ``rate`` and return it, Hz: of the samples, the same for drive and controller."""
    return float(
        declare_number(
            node, "rate", 250.0, Quantity("sample rate, the same for drive and controller", "Hz", 0.0, 2000.0, True)
        )
    )


def declare_timeout(node: Node, name: str, text: str, period: float) -> float:
    """Declare the read-only time of a watchdog and return it, two periods of the samples (s) to 10 s."""
    timeout = float(declare_number(node, name, 0.1, Quantity(f"{text}; at least two periods", "s", 0.0, 10.0, True)))
    if timeout < 2 * period:
        raise ValueError(f"{name} must be at least two sample periods, {2 * period:g} s, got {timeout:g}")
    return timeout


def in_use(node: Node, version: int, values: Mapping[str, Any]) -> ParameterEvent:
    """Return all parameters of a node, including the fixed ones, and their version; ``values`` are those in use."""
    declared = {name: parameter.value for name, parameter in node.get_parameters_by_prefix("").items()}
    listed = {"version": version, **declared, **values}
    return ParameterEvent(
        stamp=node.get_clock().now().to_msg(),
        node=node.get_fully_qualified_name(),
        new_parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in listed.items()],
    )


class Declarations:
    """Replaces a node to collect the parameters that it would declare, with their defaults."""

    def __init__(self) -> None:
        self.declared: dict[str, tuple[ParameterDescriptor, Any]] = {}

    def declare_parameter(self, name: str, default: Any, descriptor: ParameterDescriptor) -> Parameter:
        """Note a parameter and return its default."""
        self.declared[name] = descriptor, default
        return Parameter(name, value=default)

    def set_descriptor(self, name: str, descriptor: ParameterDescriptor, _value: ParameterValue) -> None:
        """Note a parameter's final descriptor."""
        self.declared[name] = descriptor, self.declared[name][1]

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter's default."""
        return Parameter(name, value=self.declared[name][1])
