"""Parameters from files as ROS has them, in sections: files read one over the other, and what stands in a section."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml

from backlash_ros.drivetrain.quantity import Validated, quantities
from backlash_ros.drivetrain.yaml_text import values_in

T = TypeVar("T")


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


def by_name(parameters: Mapping[str, Any], section: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and value of parameters in sections, such as ``motor.inertia``: the inverse of `in_sections`."""
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            yield from by_name(value, f"{section}{name}.")
        else:
            yield f"{section}{name}", value


def read_files(paths: Sequence[Path], take: Callable[[Mapping[str, Any]], T]) -> T:
    """Return what ``take`` makes of the parameters of files, in sections; later files override earlier ones, as in ROS.

    The parameters are under ``/**: ros__parameters:``, or at the top.

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        Names the files and what ``take`` refuses, or says why this is no parameter file of a drive.
    """
    parameters: Mapping[str, Any] = {}
    at: Any = ""
    try:
        for at in paths:
            parameters = merged(parameters, _parameters(values_in(at.read_text())))
        at = named(paths)
        taken = take(parameters)  # first: it may know a section that is misspelled
        if not set(parameters) & {"motor", "gear", "load"}:
            raise ValueError("must have ROS parameters of motor, gear or load")
        return taken
    except (ValueError, TypeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{at}: {reason}") from error


def _parameters(content: Any) -> Mapping[str, Any]:
    """Return the parameters in a file's content."""
    for key in ("/**", "ros__parameters"):
        if isinstance(content, Mapping) and key in content:
            content = content[key]
    if not isinstance(content, Mapping):
        raise ValueError("must have ROS parameters of motor, gear or load")
    return content


def section_of(parameters: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return the parameters in a section, none if it is missing; ValueError if there is something else."""
    section = parameters.get(name, {})
    if not isinstance(section, Mapping):
        raise ValueError(f"{name} must have parameters by name, got {section!r}")
    return section


def own(kind: type[Validated], section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the quantities of ``kind`` in a section of the file; unknown names are refused."""
    unknown = sorted(set(section) - set(quantities(kind)))
    if unknown:
        raise ValueError(f"{kind.section}.{unknown[0]} is no parameter; there are {sorted(quantities(kind))}")
    return dict(section)
