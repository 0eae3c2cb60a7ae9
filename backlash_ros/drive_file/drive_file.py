"""What parameter files say in addition to the drive, without ROS: joints, ends, sensors, delay, rate, gains, law."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from backlash_ros.control import AUTO, LAWS
from backlash_ros.control.design.choice import Choice, Tuning, given_sets, listed
from backlash_ros.control.design.start import RATE, CannotStartError
from backlash_ros.control.limits import NO_LIMIT
from backlash_ros.control.settings import ZERO
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.parameters import drive_in
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.quantity import Validated, quantities
from backlash_ros.foundation.reading.parameter_files import by_name, named, own, read_files, section_of


@dataclass(frozen=True)
class Axis:
    """A drive, the names of its joints, and the ends of the load's travel, rad; infinite without ends.

    The ends count from ``zero``, the reading of the load's joint at which its position is 0, rad.
    """

    drive: Drive
    motor_joint: str = "motor"
    load_joint: str = "load"
    position_lower: float = -math.inf
    position_upper: float = math.inf
    zero: float = 0.0

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
        ZERO.check("zero", self.zero)

    @property
    def has_ends(self) -> bool:
        """Whether the load's travel ends on both sides."""
        return math.isfinite(self.position_lower) and math.isfinite(self.position_upper)

    @property
    def end_readings(self) -> tuple[float, float]:
        """Readings of the load's joint at both ends of its travel, rad, as ``joint_states`` has them."""
        return self.position_lower + self.zero, self.position_upper + self.zero


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
    parameters = read_parameters(*paths)
    try:
        return start_of(parameters, drive_in(parameters), surroundings_of(parameters))
    except CannotStartError:
        raise
    except (ValueError, TypeError) as error:
        raise ValueError(f"{named(paths)}: {error}") from error


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
    return read_files(paths, surroundings_of)


def surroundings_of(parameters: Mapping[str, Any]) -> Surroundings:
    """Return the surroundings of a drive from parameters in sections; ValueError or TypeError names the fault."""
    rate = parameters.get("rate", 250.0)
    RATE.check("rate", rate)
    given = dict(section_of(parameters, "sensors"))
    signals = {name: given.pop(name) for name in ("measured", "speeds_from_positions") if name in given}
    if "measured" in signals:
        signals["measured"] = tuple(listed("sensors.measured", signals["measured"]))
    delay = Delay(**own(Delay, section_of(parameters, "delay")))
    if not delay.mean:
        late = parameters.get("loop_delay", 0.0)
        quantities(Delay)["command"].check("loop_delay", late)
        delay = Delay(command=late)
    return Surroundings(rate, Sensors(**own(Sensors, given), **signals), delay)


def law_parameters_of(parameters: Mapping[str, Any], law: str) -> Validated:
    """Return the parameters of a law, ``laws.<law>``, from sections, with its defaults."""
    default = LAWS[law].parameters
    given = own(type(default), section_of(section_of(parameters, "laws"), law))
    return replace(default, **given)


def read_axis(*paths: Path) -> Axis:
    """Return the axis that parameter files describe; missing values are those of the nominal drive.

    Raises
    ------
    OSError, ValueError
        As `parameter_files.read_files`; the text names the parameter that is out of bounds.
    """
    return read_files(paths, axis_of)


def read_law(*paths: Path) -> str:
    """Return the law that parameter files name; OSError and ValueError as `read_axis`."""
    return read_files(paths, law_named)


def read_parameters(*paths: Path) -> Mapping[str, Any]:
    """Return the parameters of files, in sections; OSError and ValueError as `read_axis`."""
    return read_files(paths, lambda parameters: parameters)


def law_named(parameters: Mapping[str, Any]) -> str:
    """Return the law that parameters name, by default `AUTO`; ValueError if there is none of that name."""
    law = str(parameters.get("law", AUTO))
    if law != AUTO:
        LAWS.choose("law", law, AUTO)
    return law


def axis_of(parameters: Mapping[str, Any]) -> Axis:
    """Return the axis that parameters in sections describe; missing values are those of the nominal drive.

    Raises
    ------
    ValueError
        Names the parameter that is out of bounds.
    """
    lower, upper = (_end(parameters, name) for name in ("position_lower", "position_upper"))
    given = {name: parameters[name] for name in ("motor_joint", "load_joint", "zero") if name in parameters}
    return Axis(drive_in(parameters), **given, position_lower=lower, position_upper=upper)


def _end(parameters: Mapping[str, Any], name: str) -> Any:
    """Return an end of the travel, rad; infinite if it is not given, or too far away to matter."""
    none = -math.inf if name == "position_lower" else math.inf
    value = section_of(parameters, "limits").get(name, none)
    return none if isinstance(value, float) and abs(value) >= NO_LIMIT else value
