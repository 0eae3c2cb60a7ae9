"""Reads YAML as ROS reads its parameter files, but refuses what ROS decides in silence: the same key twice."""

import re
from typing import Any

import yaml

from backlash_ros.drivetrain.quantity import EXPONENTIAL


class _Loader(yaml.SafeLoader):
    """Reads numbers as ROS does: 2e-05, too."""

    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        seen: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if (first := seen.setdefault((key.tag, key.value), line)) != line:
                    raise ValueError(f"line {line}: the key {key.value!r} appears twice, first in line {first}")
        return node


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(f"{EXPONENTIAL.pattern}$"), list("-+.0123456789"))


def values_in(text: str) -> Any:
    """Return what YAML text contains; ValueError or `yaml.YAMLError` if it cannot be read."""
    return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader
