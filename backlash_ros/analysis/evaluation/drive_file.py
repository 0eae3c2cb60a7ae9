"""A drive from files of ROS parameters, such as config/nominal_drive.yaml, without ROS."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml

from backlash_ros.control import AUTO, LAWS
from backlash_ros.control.design.choice import Choice, Tuning, given_sets
from backlash_ros.control.design.start import RATE, CannotStartError
from backlash_ros.control.limits import NO_LIMIT
from backlash_ros.drivetrain import (
    CONTACTS,
    EXPONENTIAL,
    NOMINAL_DRIVE,
    Drive,
    Gear,
    Load,
    Motor,
    Validated,
    quantities,
)
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors

T = TypeVar("T")


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
    """What a drive file says in addition to the drive: rate, Hz, sensors and delay."""

    rate: float
    sensors: Sensors
    delay: Delay


def read_start(*paths: Path) -> Choice:
    """Return what a controller starts with that is given parameter files and knows the delay of the drive.

    Raises
    ------
    CannotStartError
        If gains are unstable, as the controller would say.
    OSError, ValueError
        As `read_axis`.
    """

    def take(parameters: Mapping[str, Any]) -> Choice:
        drive = axis_of(parameters).drive
        return start_of(parameters, drive, surroundings_of(parameters))

    return _read(paths, take)


def start_of(parameters: Mapping[str, Any], drive: Drive, around: Surroundings) -> Choice:
    """Return what a controller starts with that is given parameters in sections; raises as `read_start`."""
    given = {**by_name(parameters), "loop_delay": around.delay.mean}
    return Tuning(given_sets(given), around.rate).start(given, drive)


def read_surroundings(*paths: Path) -> Surroundings:
    """Return the surroundings of a drive from its parameter files, with the nodes' defaults.

    The delay is that of the simulated drive, ``delay``, or if it has none, ``loop_delay``.

    Raises
    ------
    OSError, ValueError
        As `read_axis`.
    """
    return _read(paths, surroundings_of)


def surroundings_of(parameters: Mapping[str, Any]) -> Surroundings:
    """Return the surroundings of a drive from parameters in sections; ValueError or TypeError names the fault."""
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
    return Surroundings(rate, Sensors(**_own(Sensors, given), **signals), delay)


def law_parameters_of(parameters: Mapping[str, Any], law: str) -> Validated:
    """Return the parameters of a law, ``laws.<law>``, from sections, with its defaults."""
    default = LAWS[law].parameters
    given = _own(type(default), _section(_section(parameters, "laws"), law))
    return replace(default, **given)


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


class _Loader(yaml.SafeLoader):
    """Reads numbers as ROS does: 2e-05, too."""


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(f"{EXPONENTIAL.pattern}$"), list("-+.0123456789"))


def values_in(text: str) -> Any:
    """Return what YAML text contains, as ROS would read it; `yaml.YAMLError` if it cannot be read."""
    return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader


def _read(paths: Sequence[Path], take: Callable[[Mapping[str, Any]], T]) -> T:
    parameters: Mapping[str, Any] = {}
    at: Any = ""
    try:
        for at in paths:
            parameters = merged(parameters, _parameters(values_in(at.read_text())))
        at = named(paths)
        if not set(parameters) & {"motor", "gear", "load"}:
            raise ValueError("must have ROS parameters of motor, gear or load")
        return take(parameters)
    except CannotStartError:
        raise
    except (ValueError, TypeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{at}: {reason}") from error


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
    """Return parameters with the names of a running node, such as ``motor.inertia``, in sections as in a file."""
    content: dict[str, Any] = {}
    for name, value in parameters.items():
        *sections, last = name.split(".")
        place = content
        for section in sections:
            place = place.setdefault(section, {})
        place[last] = value
    return content


def by_name(parameters: Mapping[str, Any], section: str = "") -> dict[str, Any]:
    """Return parameters in sections with the names that a running node gives them: the inverse of `in_sections`."""
    named: dict[str, Any] = {}
    for name, value in parameters.items():
        named |= by_name(value, f"{section}{name}.") if isinstance(value, Mapping) else {f"{section}{name}": value}
    return named


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
