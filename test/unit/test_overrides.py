"""What was given for parameters, without a node: names that nobody knows, types that do not fit, the command line."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from rclpy.parameter import Parameter

from backlash_ros.foundation.reading.misspelled import check_known
from backlash_ros.nodes.fixed_parameters import all_names
from backlash_ros.ros.overrides import parameter_rules, refuse_repeated_keys
from backlash_ros.ros.parameters import check_kind, convert

KNOWN = all_names({})
Type = Parameter.Type


def none() -> Collection[str]:
    raise AssertionError("nobody need be asked")


MISSPELLED = [
    ("gear.ratio", "gear.reduction"),
    ("gear.torque_constant", "motor.torque_constant"),
    ("motor.torque_const", "motor.torque_constant"),
    ("motor.Resistance", "motor.resistance"),
    ("load.inertias", "load.inertia"),
    ("laws.cascade.dead_bend", "laws.cascade.dead_band"),
    ("learning.gap_probe.swings", "learning.gap_probe.swing"),
    ("limit.command", "limits.command"),
    ("gain_sets.gentle.fast.q", "gain_sets.nominal.fast.q"),
    ("gains.fast", "gains.fast.q"),
    ("Rate", "rate"),
    ("lock_step", "lockstep"),
    ("command_timout", "command_timeout"),
]


def test_a_name_that_looks_like_ours_is_refused_with_the_nearest() -> None:
    for name, meant in MISSPELLED:
        with pytest.raises(ValueError, match="there is no parameter") as refused:
            check_known({"rate": 250.0, name: 0.5}, ["rate"], lambda: KNOWN)
        assert str(refused.value) == f"there is no parameter {name!r}, got 0.5: did you mean {meant!r}?"


def test_each_wrong_name_is_told() -> None:
    with pytest.raises(ValueError, match=r"'gear\.ratio', got 1: .*; there is no parameter 'motor', got 2: "):
        check_known({"gear.ratio": 1, "motor": 2}, [], lambda: KNOWN)


OF_OTHERS = [
    "update_rate",
    "publish_rate",
    "frame_id",
    "robot_description",
    "joints",
    "interface_name",
    "real_time",
    "feedback.rate",
    "use_gear",
    "qos_overrides./joint_states.subscription.depth",
]


def test_names_of_others_are_left_alone() -> None:
    for name in OF_OTHERS:
        check_known({name: 1}, ["rate"], lambda: KNOWN)


def test_nobody_is_asked_where_every_name_is_the_nodes_own() -> None:
    check_known({"rate": 250.0, "qos_overrides./x.publisher.depth": 3}, ["rate"], none)


def test_gain_sets_that_are_named_are_known() -> None:
    given = {"gain_set_names": ["nominal", "gentle"], "gain_sets.gentle.fast.k": [1.0, 2.0, 3.0]}
    check_known(given, [], lambda: all_names(given))


EXACT: list[tuple[Any, Parameter.Type, Any]] = [
    (250, Type.DOUBLE, 250.0),
    (3.0, Type.INTEGER, 3),
    ([31, 1, 0], Type.DOUBLE_ARRAY, [31.0, 1.0, 0.0]),
    (None, Type.STRING_ARRAY, []),
    ("2e-05", Type.DOUBLE, 2e-5),
    (["-1E+3", 2], Type.DOUBLE_ARRAY, [-1000.0, 2.0]),
    ("2.5e5", Type.DOUBLE, 2.5e5),
    ("2e-05", Type.STRING, "2e-05"),
]


def test_what_loses_nothing_is_converted() -> None:
    for value, kind, converted in EXACT:
        result = convert(value, kind)
        assert (result, type(result)) == (converted, type(converted))
        check_kind("name", result, kind, "")


LOSSY: list[tuple[Any, Parameter.Type, str]] = [
    (True, Type.DOUBLE, "a number"),
    ("250", Type.DOUBLE, "a number"),
    ("1e400", Type.DOUBLE, "a number"),
    (3.5, Type.INTEGER, "a whole number"),
    (True, Type.INTEGER, "a whole number"),
    (float("inf"), Type.INTEGER, "a whole number"),
    (1, Type.BOOL, "true or false"),
    (1, Type.STRING, "a text"),
    (True, Type.STRING, "a text"),
    (["1", "2"], Type.DOUBLE_ARRAY, "a list of numbers"),
    ([1, 2], Type.STRING_ARRAY, "a list of texts"),
    (None, Type.DOUBLE, "a number"),
]


def test_what_would_lose_something_is_refused() -> None:
    for value, kind, says in LOSSY:
        with pytest.raises(ValueError, match=f"^name must be {says}, > 0, got"):
            check_kind("name", convert(value, kind), kind, "> 0")


COMMAND_LINES: list[tuple[list[str], list[str]]] = [
    (["--axes", "a", "-p", "no"], []),
    (["--ros-args", "-r", "__ns:=/a", "--params-file", "f"], []),
    (
        ["--ros-args", "-p", "law:=fast", "-r", "a:=b", "--param", "rate:=5"],
        ["-p", "law:=fast", "--param", "rate:=5"],
    ),
    (["--ros-args", "-p", "a:=1", "--", "-p", "b:=2", "--ros-args", "-p", "c:=3"], ["-p", "a:=1", "-p", "c:=3"]),
]


def test_parameters_of_the_command_line_are_found() -> None:
    for words, rules in COMMAND_LINES:
        assert parameter_rules(words) == (["--ros-args", *rules] if rules else [])


def test_a_parameter_file_with_a_key_twice_is_refused_before_rcl_takes_the_last(tmp_path: Path) -> None:
    once, twice, broken = (tmp_path / name for name in ("once.yaml", "twice.yaml", "broken.yaml"))
    once.write_text("/**:\n  ros__parameters: {rate: 250.0}\n")
    twice.write_text("/**:\n  ros__parameters:\n    rate: 250.0\n    rate: 25.0\n")
    broken.write_text("rate: [")
    files = [word for file in (once, broken, tmp_path / "none.yaml") for word in ("--params-file", str(file))]
    refuse_repeated_keys(["--ros-args", *files])
    with pytest.raises(ValueError, match=r"twice\.yaml: line 4: the key 'rate' appears twice, first in line 3"):
        refuse_repeated_keys(["--ros-args", *files, "--params-file", str(twice)])
