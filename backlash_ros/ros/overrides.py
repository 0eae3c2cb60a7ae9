"""The user's parameter overrides: which one wins, and which are misspelled."""

import difflib
from collections.abc import Callable, Collection, Mapping, Sequence
from contextvars import ContextVar
from itertools import pairwise
from pathlib import Path
from typing import Any

from rclpy.node import Node

from backlash_ros.drivetrain.reading.yaml_text import RepeatedKeyError, values_in

COMMAND_LINE: ContextVar[Sequence[str]] = ContextVar("the command line's rules for parameters", default=())
"""ROS arguments that are passed to each node of this process.

rcl treats a value given with ``-p`` like one under ``/**``, so that a more specific key in a parameter file overrides
it. A node's own arguments come later, so with them ``-p`` wins.
"""

_FROM_ROS = "qos_overrides."
_CLOSE = 0.85
"""Similarity above which an unknown name counts as misspelled."""


def parameter_rules(arguments: Sequence[str]) -> list[str]:
    """Return the ROS arguments among ``arguments`` that set single parameters; empty if there are none."""
    rules: list[str] = []
    ros = False
    words = iter(arguments)
    for word in words:
        if word == "--ros-args" or (ros and word == "--"):
            ros = word == "--ros-args"
        elif ros and word in ("-p", "--param"):
            rules += [word, next(words, "")]
    return ["--ros-args", *rules] if rules else []


def refuse_repeated_keys(arguments: Sequence[str]) -> None:
    """Refuse parameter files in which a key appears twice: rcl takes the last one. It judges all the rest.

    Raises
    ------
    RepeatedKeyError
        Names the file, the key and both lines.
    """
    for word, file in pairwise(arguments):
        if word == "--params-file":
            try:
                values_in(Path(file).read_bytes())
            except RepeatedKeyError as error:
                raise RepeatedKeyError(f"{file}: {error}") from error
            except (OSError, ValueError):  # rcl says so
                continue


def _nearest(name: str, known: Collection[str], least: float) -> str:
    folded = {other.lower(): other for other in known}
    near = difflib.get_close_matches(name.lower(), folded, 1, least)
    return folded[near[0]] if near else ""


def _meant(name: str, known: Collection[str]) -> str:
    """Return the parameter that ``name`` probably means; empty if it belongs to another node."""
    sections = {other.partition(".")[0] for other in known if "." in other}
    return _nearest(name, known, 0.0 if name.partition(".")[0] in sections else _CLOSE)


def check_known(given: Mapping[str, Any], declared: Collection[str], elsewhere: Callable[[], Collection[str]]) -> None:
    """Refuse misspelled overrides.

    Parameter files are shared with other nodes: names unlike ours are ignored.

    Parameters
    ----------
    given : value of each override by its name
    declared : names of the node's parameters
    elsewhere : the parameter names of all nodes of the package, used only if a name is not among ``declared``

    Raises
    ------
    ValueError
        Names each such parameter, its value and the nearest name.
    """
    unknown = [name for name in given if name not in declared and not name.startswith(_FROM_ROS)]
    ours = [name for name in declared if not name.startswith(_FROM_ROS)]
    known = {*ours, *elsewhere()} if unknown else set()
    wrong = [(name, near) for name in unknown if name not in known and (near := _meant(name, known))]
    if wrong:
        raise ValueError(
            "; ".join(
                f"there is no parameter {name!r}, got {given[name]!r}: did you mean {near!r}?" for name, near in wrong
            )
        )


def values_given(node: Node) -> dict[str, Any]:
    """Return the overrides for ``node``, by name."""
    return {name: parameter.value for name, parameter in node._parameter_overrides.items()}
