"""Parameters at a start, without a node: what cannot be used is refused by name."""

import re
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from backlash_ros.nodes.fixed_parameters import declare_controller, declare_simulator
from backlash_ros.nodes.tunables import Tunables, declare_tunables
from backlash_ros.ros.parameters import Declarations


class Given(Declarations):
    """Replaces a node that was given values."""

    def __init__(self, given: dict[str, Any]) -> None:
        super().__init__()
        self._given = given

    def declare_parameter(self, name: str, default: Any, descriptor: Any) -> Any:
        return super().declare_parameter(name, self._given.get(name, default), descriptor)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"rate": -5.0}, "rate must be > 0 Hz and <= 2000 Hz, got -5.0"),
        ({"rate": "quick"}, "rate must be a number, > 0 Hz and <= 2000 Hz, got 'quick'"),
        ({"motor.resistance": 0.0}, "motor.resistance must be > 0 ohm and <= 1e+06 ohm, got 0.0"),
        ({"gear.backlash_angle": 0.0}, "gear.backlash_angle must be >= 1e-09 rad and <= 3.2 rad, got 0.0"),
        (
            {"contact.law": "soft"},
            "contact.law must be one of ['elastic', 'hunt_crossley', 'power', 'power_no_pull', 'restitution']",
        ),
        (
            {"contact.elastic.wind_up": 0.0},
            "contact.elastic.wind_up must be >= 1e-09 rad/(N m) and <= 1000 rad/(N m)",
        ),
        ({"motor_joint": "load"}, "motor_joint and load_joint must be two different names"),
        ({"load_joint": ""}, "motor_joint and load_joint must be two different names, got 'motor' and ''"),
        ({"rate": 15.0}, "state_timeout must be at least two sample periods, 0.133333 s, got 0.1"),
        ({"learning.use_estimate_file": True}, "must be false if learning.estimate_file is empty, got true"),
        ({"gain_sets.nominal.fast.k": [1.0, 2.0, 3.0]}, "gain_sets.nominal.fast.k"),
        (
            {"gain_set_names": ["nominal", "wild"], "gain_sets.wild.fast.k": [1e5, 0.0, 0.0]}
            | {"gain_sets.wild.overdamped.q": [4.0, 0.0]},
            "gain_sets.wild.fast.k = [100000, 0, 0] is unstable at 250 Hz",
        ),
    ],
    ids=str,
)
def test_a_parameter_that_the_controller_cannot_use_is_refused_by_name(given: dict[str, Any], says: str) -> None:
    node: Any = Given(given)

    def start() -> None:
        parameters = declare_controller(node)
        declare_tunables(node, parameters.drive, parameters.rate)

    with pytest.raises(ValueError, match=re.escape(says)):
        start()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"rate": 15.0}, "command_timeout must be at least two sample periods, 0.133333 s, got 0.1"),
        ({"real_time_factor": 0.0}, "real_time_factor must be > 0 without lockstep, got 0"),
        ({"lockstep": 1}, "lockstep must be true or false, got 1"),
        ({"gear.backlash_cycles": 3.5}, "gear.backlash_cycles must be a whole number >= 1 and <= 1000, got 3.5"),
    ],
    ids=str,
)
def test_a_parameter_that_the_simulator_cannot_use_is_refused_by_name(given: dict[str, Any], says: str) -> None:
    node: Any = Given(given)
    with pytest.raises(ValueError, match=re.escape(says)):
        declare_simulator(node)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["nominal", "gentle", "nominal"], "gain_set_names must be different from each other and from 'custom', got"),
        (["custom"], "gain_set_names must be different from each other and from 'custom', got"),
        ([], r"gain_set_names must be a list with something in it, got \[\]"),
    ],
)
def test_gain_sets_that_cannot_be_told_apart_are_refused(names: list[str], text: str) -> None:
    node: Any = SimpleNamespace(
        declare_parameter=lambda *_: SimpleNamespace(value=names),
        set_descriptor=lambda *_: None,
    )
    with pytest.raises(ValueError, match=text):
        Tunables(node, {}, 250.0)
