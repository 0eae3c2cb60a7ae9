"""A drive from a file of ROS parameters, such as config/nominal_drive.yaml, without ROS."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive, Gear, Load, Motor, Validated, quantities


def read_drive(path: Path) -> Drive:
    """Return the drive that a parameter file describes; what it does not say is the nominal drive's.

    The parameters stand under ``/**: ros__parameters:``, or at the top.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        Names the file and the parameter that is out of bounds, or says what is no parameter file.
    """
    try:
        parameters = _parameters(yaml.safe_load(path.read_text()))
        nominal = NOMINAL_DRIVE
        contact = _section(parameters, "contact")
        law = CONTACTS.choose("contact.law", str(contact.get("law", "power")))
        teeth = law(**_own(law, _section(contact, law.section.removeprefix("contact."))))
        return Drive(
            Motor(**_values(nominal.motor) | _own(Motor, _section(parameters, "motor"))),
            Gear(**_values(nominal.gear) | _own(Gear, _section(parameters, "gear")), contact=teeth),
            Load(**_values(nominal.load) | _own(Load, _section(parameters, "load"))),
            str(parameters.get("command_interface", nominal.command_interface)),
        )
    except (ValueError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: {reason}") from error


def _parameters(content: Any) -> Mapping[str, Any]:
    """Return the parameters in a file's content."""
    for key in ("/**", "ros__parameters"):
        if isinstance(content, Mapping) and key in content:
            content = content[key]
    if not isinstance(content, Mapping) or not set(content) & {"motor", "gear", "load"}:
        raise ValueError("must have ROS parameters of motor, gear or load")
    return content


def _section(parameters: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = parameters.get(name, {})
    if not isinstance(section, Mapping):
        raise ValueError(f"{name} must have parameters by name, got {section!r}")
    return section


def _values(part: Validated) -> dict[str, Any]:
    return {name: getattr(part, name) for name in quantities(type(part))}


def _own(kind: type[Validated], section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the quantities of ``kind`` in a section of the file; a name that is none of them is refused."""
    unknown = sorted(set(section) - set(quantities(kind)))
    if unknown:
        raise ValueError(f"{kind.section}.{unknown[0]} is no parameter; there are {sorted(quantities(kind))}")
    return dict(section)
