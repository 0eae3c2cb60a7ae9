"""The user's parameter overrides: which one wins, and which a node was given."""

from collections.abc import Sequence
from contextvars import ContextVar
from itertools import pairwise
from pathlib import Path
from typing import Any

from rclpy.node import Node

from backlash_ros.foundation.reading.yaml_text import RepeatedKeyError, values_in

COMMAND_LINE: ContextVar[Sequence[str]] = ContextVar("the command line's rules for parameters", default=())
"""ROS arguments that are passed to each node of this process.

rcl treats a value given with ``-p`` like one under ``/**``, so that a more specific key in a parameter file overrides
it. A node's own arguments come later, so with them ``-p`` wins.
"""


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


def values_given(node: Node) -> dict[str, Any]:
    """Return the overrides for ``node``, by name."""
    return {name: parameter.value for name, parameter in node._parameter_overrides.items()}
