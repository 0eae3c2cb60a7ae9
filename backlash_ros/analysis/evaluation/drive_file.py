"""A drive from files of ROS parameters, such as config/nominal_drive.yaml, without ROS."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from backlash_ros.control import AUTO, DEFAULT_WEIGHTS, LAWS, Gains, design_gains
from backlash_ros.control.design.gain_sets import CUSTOM
from backlash_ros.control.limits import NO_LIMIT
from backlash_ros.drivetrain import (
    CONTACTS,
    NOMINAL_DRIVE,
    Drive,
    Gear,
    Load,
    Motor,
    Quantity,
    Validated,
    quantities,
)
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.reading.yaml_text import values_in
from backlash_ros.drivetrain.sensors import Sensors

T = TypeVar("T")

RATE = Quantity("samples per second", "Hz", 0.0, 2000.0, True)
"""Of a controller."""


@dataclass(frozen=True)
class Axis:
    """A drive, the names of its joints, and the ends of the load's travel, rad; infinite without ends."""

    drive: Drive
    motor_joint: str = "motor"
    load_joint: str = "load"
    position_lower: float = -math.inf
    position_upper: float = math.inf

    def __post_init__(self) -> None:
        for name in ("motor_joint", "load_joint"):
            value = getattr(self, name)
            if not isinstance(value, str) or not value or not value.isprintable():
                raise ValueError(f"{name} must be a name in printable letters, got {value!r}")
        if self.motor_joint == self.load_joint:
            raise ValueError(f"motor_joint and load_joint must differ, got {self.load_joint!r} for both")
        for name in ("position_lower", "position_upper"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
                raise ValueError(f"limits.{name} must be a number, in rad, got {value!r}")
        if not self.position_lower < self.position_upper:
            raise ValueError(
                f"limits.position_lower must be < limits.position_upper, got {self.position_lower!r} and "
                f"{self.position_upper!r} rad"
            )

    @property
    def has_ends(self) -> bool:
        """Whether the load's travel ends on both sides."""
        return math.isfinite(self.position_lower) and math.isfinite(self.position_upper)


@dataclass(frozen=True)
class Surroundings:
    """What a drive file says in addition to the drive: rate, Hz, sensors, delay, and the first gains."""

    rate: float
    sensors: Sensors
    delay: Delay
    fast: Gains
    overdamped: Gains


def read_surroundings(drive: Drive, *paths: Path) -> Surroundings:
    """Return the surroundings of ``drive`` from its parameter files, with the nodes' defaults.

    The delay is that of the simulated drive, ``delay``, or if it has none, ``loop_delay``.

    Raises
    ------
    OSError, ValueError
        As `read_axis`.
    """
    return _read(paths, lambda parameters: surroundings_of(parameters, drive))


def surroundings_of(parameters: Mapping[str, Any], drive: Drive) -> Surroundings:
    """Return the surroundings of ``drive`` from parameters in sections; ValueError or TypeError names the fault."""
    rate = parameters.get("rate", 250.0)
    RATE.check("rate", rate)
    given = dict(_section(parameters, "sensors"))
    signals = {name: given.pop(name) for name in ("measured", "speeds_from_positions") if name in given}
    if "measured" in signals:
        signals["measured"] = tuple(_list("sensors.measured", signals["measured"]))
    delay = Delay(**_own(Delay, _section(parameters, "delay")))
    if not delay.mean:
        late = parameters.get("loop_delay", 0.0)
        quantities(Delay)["command"].check("loop_delay", late)
        delay = Delay(command=late)
    gains = {region: _gains(parameters, drive, region) for region in DEFAULT_WEIGHTS}
    return Surroundings(rate, Sensors(**_own(Sensors, given), **signals), delay, **gains)


def law_parameters_of(parameters: Mapping[str, Any], law: str) -> Validated:
    """Return the parameters of a law, ``laws.<law>``, from sections, with its defaults."""
    default = LAWS[law].parameters
    given = _own(type(default), _section(_section(parameters, "laws"), law))
    return replace(default, **given)


def _gains(parameters: Mapping[str, Any], drive: Drive, region: str) -> Gains:
    """Return the gains a controller starts with: ``gains``, or those of its gain set, or of the default weights."""
    names = _list("gain_set_names", parameters.get("gain_set_names", ["nominal"]))
    chosen = parameters.get("gain_set", names[0])
    if chosen not in (*names, CUSTOM):
        raise ValueError(f"gain_set must be one of {[*names, CUSTOM]}, got {chosen!r}")
    start = chosen if chosen in names else names[0]
    of_set = _section(_section(parameters, "gain_sets"), start)
    for section, place in (("gains", _section(parameters, "gains")), (f"gain_sets.{start}", of_set)):
        given = _section(place, region)
        for kind in ("k", "q"):
            where = f"{section}.{region}.{kind}"
            if kind in given and any(values := _list(where, given[kind])):  # zeros: not given
                return Gains.from_sequence(where, values) if kind == "k" else design_gains(where, drive, values)
    return design_gains(f"gain_sets.{start}.{region}.q", drive, DEFAULT_WEIGHTS[region])


def read_drive(*paths: Path) -> Drive:
    """Return the drive that parameter files describe; see `read_axis`."""
    return read_axis(*paths).drive


def read_axis(*paths: Path) -> Axis:
    """Return the axis that parameter files describe; missing values are those of the nominal drive.

    The parameters are under ``/**: ros__parameters:``, or at the top; later files override earlier ones, as in ROS.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        Names the file and the parameter that is out of bounds, or says why this is no parameter file.
    """
    return _read(paths, axis_of)


def read_law(*paths: Path) -> str:
    """Return the law that parameter files name; OSError and ValueError as `read_axis`."""
    return _read(paths, law_named)


def read_parameters(*paths: Path) -> Mapping[str, Any]:
    """Return the parameters of files, in sections; OSError and ValueError as `read_axis`."""
    return _read(paths, lambda parameters: parameters)


def law_named(parameters: Mapping[str, Any]) -> str:
    """Return the law that parameters name, by default `AUTO`; ValueError if there is none of that name."""
    law = str(parameters.get("law", AUTO))
    if law != AUTO:
        LAWS.choose("law", law, AUTO)
    return law


def named(paths: Iterable[Path]) -> str:
    """Return the names of files that are read together."""
    return " with ".join(map(str, paths))


def merged(parameters: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters in sections with those of ``changes``, also in sections, in place of theirs."""
    result = dict(parameters)
    for name, value in changes.items():
        below = result.get(name)
        result[name] = merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return result


def _read(paths: Sequence[Path], take: Callable[[Mapping[str, Any]], T]) -> T:
    parameters: Mapping[str, Any] = {}
    at: Any = ""
    try:
        for at in paths:
            parameters = merged(parameters, in_sections(_flat(_parameters(values_in(at.read_bytes())))))
        at = named(paths)
        if not set(parameters) & {"motor", "gear", "load"}:
            raise ValueError("must have ROS parameters of motor, gear or load")
        return take(parameters)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{at}: {error}") from error


def axis_of(parameters: Mapping[str, Any]) -> Axis:
    """Return the axis that parameters in sections describe; missing values are those of the nominal drive.

    Raises
    ------
    ValueError
        Names the parameter that is out of bounds.
    """
    nominal = NOMINAL_DRIVE
    contact = _section(parameters, "contact")
    law = CONTACTS.choose("contact.law", str(contact.get("law", "power")))
    teeth = law(**_own(law, _section(contact, law.section.removeprefix("contact."))))
    drive = Drive(
        Motor(**_values(nominal.motor) | _own(Motor, _section(parameters, "motor"))),
        Gear(**_values(nominal.gear) | _own(Gear, _section(parameters, "gear")), contact=teeth),
        Load(**_values(nominal.load) | _own(Load, _section(parameters, "load"))),
        str(parameters.get("command_interface", nominal.command_interface)),
    )
    lower, upper = (_end(parameters, name) for name in ("position_lower", "position_upper"))
    names = {name: parameters[name] for name in ("motor_joint", "load_joint") if name in parameters}
    return Axis(drive, **names, position_lower=lower, position_upper=upper)


def in_sections(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters with the names of a running node, such as ``motor.inertia``, in sections as in a file.

    Raises
    ------
    ValueError
        If a name is both a parameter and a section.
    """
    content: dict[str, Any] = {}
    for name, value in parameters.items():
        *sections, last = name.split(".")
        place = content
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                raise ValueError(f"{name.partition(f'.{last}')[0]} must have parameters by name, got {place!r}")
        if last in place:
            raise ValueError(f"{name} must be given once")
        place[last] = value
    return content


def _flat(section: Mapping[Any, Any], within: str = "") -> dict[str, Any]:
    """Return the parameters of sections by the names that ROS gives them, such as ``motor.inertia``."""
    flat: dict[str, Any] = {}
    for key, value in section.items():
        name = f"{within}{key}"
        if not isinstance(key, str) or value is None:
            raise ValueError(f"{name} must be a name, with a value" + (", got none" if value is None else ""))
        below = _flat(value, f"{name}.") if isinstance(value, Mapping) and value else {name: value}
        if twice := sorted(set(below) & set(flat)):
            raise ValueError(f"{twice[0]} must be given once, in its section or with its whole name")
        flat |= below
    return flat


def _parameters(content: Any) -> Mapping[str, Any]:
    """Return the parameters in a file's content."""
    for key in ("/**", "ros__parameters"):
        if isinstance(content, Mapping) and key in content:
            content = content[key]
    if not isinstance(content, Mapping):
        raise ValueError("must have ROS parameters of motor, gear or load")
    return content


def _section(parameters: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = parameters.get(name, {})
    if not isinstance(section, Mapping):
        raise ValueError(f"{name} must have parameters by name, got {section!r}")
    return section


def _list(name: str, value: Any) -> Sequence[Any]:
    if not isinstance(value, (list, tuple)) or not value:
        raise ValueError(f"{name} must be a list with something in it, got {value!r}")
    return value


def _end(parameters: Mapping[str, Any], name: str) -> Any:
    """Return an end of the travel, rad; infinite if it is not given, or too far away to matter."""
    none = -math.inf if name == "position_lower" else math.inf
    value = _section(parameters, "limits").get(name, none)
    return none if isinstance(value, float) and abs(value) >= NO_LIMIT else value


def _values(part: Validated) -> dict[str, Any]:
    return {name: getattr(part, name) for name in quantities(type(part))}


def _own(kind: type[Validated], section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the quantities of ``kind`` in a section of the file; unknown names are refused."""
    unknown = sorted(set(section) - set(quantities(kind)))
    if unknown:
        raise ValueError(f"{kind.section}.{unknown[0]} is no parameter; there are {sorted(quantities(kind))}")
    return dict(section)
