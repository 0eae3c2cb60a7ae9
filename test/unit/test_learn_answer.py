"""A call of ~/learn is answered however learning ends, also where the experiment itself failed."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from backlash_ros.control.experiment import Refusal
from backlash_ros.nodes.controller import Controller


def test_an_experiment_that_failed_is_answered_with_its_reason() -> None:
    answers: list[tuple[bool, str]] = []
    node: Any = SimpleNamespace(
        _servo=SimpleNamespace(take_outcome=lambda: Refusal("it failed: OSError()")),
        _learn=SimpleNamespace(answer=lambda *answer: answers.append(answer)),
        get_logger=lambda: SimpleNamespace(info=lambda _text: None),
    )
    Controller._end_learning(node)
    assert answers == [(False, "it failed: OSError()")]
