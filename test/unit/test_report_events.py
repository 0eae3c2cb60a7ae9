"""What happened in a recording, as `backlash report` tells it: load torques, changes of parameters, what it ended."""

import math
from pathlib import Path

import pytest
import reported
from made_report import report
from plain_bag import PlainBag

B = 0.02
"""Backlash of the axes here, rad."""


def held_bag(seconds: float, off: float = 0.0, start: float = math.inf, end: float = math.inf) -> PlainBag:
    """Return a step of 1 rad at 0.5 s; from ``start`` on the load is ``off`` its target, rad, and back at ``end``."""
    bag = PlainBag()
    bag.in_use("/controller/parameters_in_use", 0.0, 1, reported.in_use("two_encoder", B))
    for k in range(round(seconds / 0.004)):
        time = 0.004 * k
        load = float(time >= 0.5) + off * (start <= time < end)
        bag.sample("/joint_states", time, ("motor", "load"), (0.0, load))
        state = {"reference": float(time >= 0.5), "holding": 1.0, "backlash_angle": B, "fault": 0, "experiment": 0}
        bag.status("/controller/state", time, "servo", state)
    return bag


def test_a_load_torque_has_its_row_and_the_rest_after_it_is_a_hold(tmp_path: Path) -> None:
    bag = held_bag(10.0, off=0.8 * B, start=4.02, end=4.22)
    for time, torque in ((0.0, 0.0), (4.0, 0.1), (4.1, 0.1), (7.0, 0.0)):
        bag.number("/load_torque", time, torque)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    (step,) = made.axis["steps"]
    assert (step["end"], step["ended_by"]) == (pytest.approx(4.0), "a load torque of 0.1 N m")
    pushed, freed = made.axis["load_torques"]
    assert (pushed["start"], pushed["end"], pushed["torque"]) == (pytest.approx(4.0), pytest.approx(7.0), 0.1)
    assert pushed["largest"] == pytest.approx(0.8 * B)
    assert pushed["back"] == pytest.approx(0.22, abs=0.005)
    assert (freed["end"], freed["torque"], freed["largest"], freed["back"]) == (None, 0.0, 0.0, 0.0)
    holds = [(hold["start"], hold["end"], hold["remarks"]) for hold in made.axis["holds"]]
    near = pytest.approx
    assert holds == [
        (near(4.0, abs=0.01), near(7.0), ["after a load torque of 0.1 N m"]),
        (near(7.0, abs=0.01), near(10.0, abs=0.01), ["after a load torque of 0 N m"]),
    ]
    assert "Load torques (2)" in made.page.text


def test_a_load_that_never_comes_back_is_said_so_and_a_moving_one_is_not_judged(tmp_path: Path) -> None:
    bag = held_bag(6.0, off=0.5 * B, start=3.0)
    bag.number("/load_torque", 0.49, 0.2)  # just before the step, which moves the load
    bag.number("/load_torque", 3.0, 0.3)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    first, second = made.axis["load_torques"]
    assert first["largest"] == 0.0  # until the step began
    assert (second["largest"], second["back"]) == (pytest.approx(0.5 * B), None)
    assert "never" in made.page.text


@pytest.mark.parametrize("hole", [False, True])
def test_nothing_of_a_rest_is_left_unjudged_whatever_ended_it(hole: bool, tmp_path: Path) -> None:
    """After a change of the law, or samples that are missing, the rest is judged as a hold."""
    bag = PlainBag()
    bag.in_use("/controller/parameters_in_use", 0.0, 1, reported.in_use("fast", B))
    if not hole:
        bag.in_use("/controller/parameters_in_use", 4.0, 2, reported.in_use("overdamped", B))
    for k in (*range(1000), *range(1150 if hole else 1000, 2000)):
        time = 0.004 * k
        swing = 0.4 * B * math.sin(60.0 * time) if time > 4.0 else 0.0
        bag.sample("/joint_states", time, ("motor", "load"), (0.0, float(time >= 0.5) + swing))
        bag.status("/controller/state", time, "servo", {"reference": float(time >= 0.5), "backlash_angle": B})
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert "1 step: 1 settled" in made.page.text
    *_, hold = made.axis["holds"]
    assert hold["start"] == pytest.approx(4.6 if hole else 4.0, abs=0.01)
    assert hold["end"] == pytest.approx(8.0, abs=0.01)
    assert hold["amplitude"] == pytest.approx(0.8 * B, rel=0.01)
    assert "A limit cycle while the reference stood still at 1 rad" in made.page.text


def test_a_rest_that_a_learning_run_ended_says_which(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(1000):
        time = 0.004 * k
        bag.sample("/joint_states", time, ("motor", "load"), (0.0, float(time >= 0.5)))
        state = {"reference": float(time >= 0.5), "backlash_angle": B, "experiment": int(2.5 < time < 3.5)}
        bag.status("/controller/state", time, "servo", state)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert made.axis["steps"][0]["ended_by"] == "learning run 1"
    assert "judged until learning run 1, 2." in made.page.text
