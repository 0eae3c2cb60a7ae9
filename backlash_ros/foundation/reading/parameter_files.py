"""Parameters from files as ROS has them, in sections: files read one over the other, and what stands in a section."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from backlash_ros.foundation.quantity import Validated, quantities
from backlash_ros.foundation.reading.yaml_text import values_in

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


def by_name(section: Mapping[Any, Any], within: str = "") -> dict[str, Any]:
    """Return the parameters of sections by the names that ROS gives them, such as ``motor.inertia``."""
    flat: dict[str, Any] = {}
    for key, value in section.items():
        name = f"{within}{key}"
        if not isinstance(key, str) or value is None:
            raise ValueError(f"{name} must be a name, with a value" + (", got none" if value is None else ""))
        below = by_name(value, f"{name}.") if isinstance(value, Mapping) and value else {name: value}
        if twice := sorted(set(below) & set(flat)):
            raise ValueError(f"{twice[0]} must be given once, in its section or with its whole name")
        flat |= below
    return flat


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
            parameters = merged(parameters, in_sections(by_name(_parameters(values_in(at.read_bytes())))))
        at = named(paths)
        taken = take(parameters)  # first: it may know a section that is misspelled
        if not set(parameters) & {"motor", "gear", "load"}:
            raise ValueError("must have ROS parameters of motor, gear or load")
        return taken
    except (ValueError, TypeError) as error:
        raise ValueError(f"{at}: {error}") from error


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
