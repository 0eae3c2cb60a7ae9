"""The tunable parameters before there is a node: names of gain sets that cannot be told apart."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from backlash_ros.nodes.tunables import Tunables


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["nominal", "gentle", "nominal"], "gain_set_names must be different from each other and from 'custom', got"),
        (["custom"], "gain_set_names must be different from each other and from 'custom', got"),
        ([], "gain_set_names must name at least one gain set"),
    ],
)
def test_gain_sets_that_cannot_be_told_apart_are_refused(names: list[str], text: str) -> None:
    node: Any = SimpleNamespace(
        declare_parameter=lambda *_: SimpleNamespace(value=names),
        set_descriptor=lambda *_: None,
    )
    with pytest.raises(ValueError, match=text):
        Tunables(node, {}, 250.0)
