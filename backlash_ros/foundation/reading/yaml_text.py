"""Reads YAML as ROS reads its parameter files, but refuses what ROS decides in silence: the same key twice."""

import re
from typing import Any

import yaml

from backlash_ros.foundation.quantity import EXPONENTIAL

_MOST = 2**63
"""Beyond it, either way, ROS has no whole numbers."""
_PLAIN = {"str", "int", "float", "bool", "null", "seq", "map"}


class RepeatedKeyError(ValueError):
    """A key appears twice in one section."""


class _Loader(yaml.SafeLoader):
    """Reads numbers as ROS does, 2e-05 too, and refuses aliases, which ROS does not have, and dates."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(problem="ROS has no aliases such as *name", problem_mark=mark)
        return super().compose_node(parent, index)

    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        seen: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if (first := seen.setdefault((key.tag, key.value), line)) != line:
                    raise RepeatedKeyError(f"line {line}: the key {key.value!r} appears twice, first in line {first}")
        return node

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        kind = node.tag.rpartition(":")[2]
        if kind not in _PLAIN:
            raise yaml.MarkedYAMLError(
                problem=f"must be a number, true, false or text between quotes, got a {kind}",
                problem_mark=node.start_mark,
            )
        try:
            value = super().construct_object(node, deep)
            if type(value) is int and not -_MOST <= value < _MOST:
                raise ValueError
            return value
        except (ValueError, KeyError):
            raise yaml.MarkedYAMLError(
                problem=f"{node.value[:40]!r} cannot be read as {kind}", problem_mark=node.start_mark
            ) from None


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(f"{EXPONENTIAL.pattern}$"), list("-+.0123456789"))


def values_in(text: str | bytes) -> Any:
    """Return what YAML text contains, or the bytes of a file.

    Raises
    ------
    RepeatedKeyError, ValueError
        Names the line and what cannot be read there.
    """
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader
    except yaml.MarkedYAMLError as error:
        mark, said = error.problem_mark, " ".join(filter(None, (error.context, error.problem)))
        raise ValueError(f"line {mark.line + 1}: {said}" if mark is not None else said) from None
    except yaml.reader.ReaderError as error:
        what = "is no text in UTF-8" if error.encoding.startswith("utf") else "may not be in YAML"
        raise ValueError(f"byte {error.position} {what}") from None
    except RecursionError:
        raise ValueError("there are too many levels in it") from None
