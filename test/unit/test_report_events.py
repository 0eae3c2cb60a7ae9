"""What happened in a recording, as `backlash report` tells it: load torques, changes of parameters, what it ended."""

import math
import re
from html import unescape
from pathlib import Path

import pytest
import reported
from made_report import report
from plain_bag import START, PlainBag

from backlash_ros.pages.report.changes import Change
from backlash_ros.pages.report.words import milliseconds

B = 0.02
"""Backlash of the axes here, rad."""


def held_bag(seconds: float, off: float = 0.0, start: float = math.inf, end: float = math.inf) -> PlainBag:
    """Return a step of 1 rad at 0.5 s; from ``start`` on the load is ``off`` its target, rad, and back at ``end``."""
    bag = PlainBag()
    bag.in_use("/controller/parameters_in_use", 0.0, 1, reported.in_use("planned", B))
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


def folds(html: str) -> list[str]:
    """Return the titles of what unfolds, in the order of the page."""
    return [unescape(title) for title in re.findall(r"<summary>([^<]*)", html)]


def test_titles_say_the_outcome(tmp_path: Path) -> None:
    bag = held_bag(6.0)
    bag.status("/diagnostics", 1.0, "/controller: servo", level=1, text="it rattled")
    for time in (1.0, 2.0):
        bag.status("/diagnostics", time, "/controller: timing", level=2, text="a step takes long")
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    titles = folds(made.html)
    assert "Step 1: 0 to 1 rad, law planned: settled after 0 s" in titles
    assert "Timing: 250 Hz, none missing" in titles
    assert "Warnings and errors (1 + 2)" in titles
    assert '<p class="line">No faults.</p>' in made.html
    assert "Faults" not in " ".join(titles)
    assert "From 0.500 s on; rise" in made.page.text  # no gain set where the law has none
    assert not re.search(r"gain set\s*;", made.page.text)


def test_a_step_in_a_limit_cycle_says_so_in_its_title(tmp_path: Path) -> None:
    made = report(reported.axes_bag(["/axis1"]).write(tmp_path / "bag"), tmp_path)
    (title,) = [title for title in folds(made.html) if title.startswith("Step 1")]
    assert re.fullmatch(r"Step 1: 0 to 1 rad, law fast: ended in a limit cycle, \d+ impacts", title)
    assert "Learning runs (1)" in folds(made.html)
    assert "Changes of gains, laws and other parameters (1)" in folds(made.html)


def test_an_identification_is_one_line_that_unfolds(tmp_path: Path) -> None:
    """Values whose digits show no change are left out; the law that acts from then on is said."""
    before = reported.in_use("auto", B) | {"identified": False, "motor.cogging": 1.0}
    after = before | {name: 1.01 * value for name, value in before.items() if name.startswith("motor.")}
    after |= {"identified": True, "load.inertia": before["load.inertia"] * (1.0 + 1e-9)}
    bag = PlainBag()
    for time, version, values in ((0.0, 1, before), (3.0, 2, after), (5.0, 3, after | {"gear.reduction": 10.0 + 1e-9})):
        bag.in_use("/controller/parameters_in_use", time, version, values)
    for k in range(1500):
        time = 0.004 * k
        bag.sample("/joint_states", time, ("motor", "load"), (0.0, 0.0))
        bag.status("/controller/state", time, "servo", {"reference": 0.0, "phase": float(time > 3.0), "holding": 1.0})
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert "identified: 8 parameters (law planned acts)" in folds(made.html)
    assert "motor.cogging: 1 to 1.01" in made.page.text
    assert "load.inertia: " not in made.page.text
    assert "less than the digits show" in made.page.text
    first, second, *_ = made.axis["holds"]
    assert first["ended_by"] == "the drive was identified"
    assert second["remarks"] == ["after the drive was identified"]


def test_a_change_is_named_in_a_few_words() -> None:
    many = {f"gear.{k}": (0.0, 1.0) for k in range(5)}
    assert Change(0.0, many).named == "a change of gear.0, gear.1, gear.2 and 2 more"
    assert Change(0.0, {"gain_set": ("a", "b"), "gains.fast.k": ([1.0], [2.0])}).named == "a change of gain_set"
    assert Change(0.0, many | {"identified": (False, True)}).named == "the drive was identified"
    assert Change(0.0, {"identified": (True, False)}).named == "a change of identified"


def test_the_law_that_auto_chose_is_said(tmp_path: Path) -> None:
    bag = PlainBag()
    for version, law in enumerate(("fast", "auto", "fast"), 1):
        bag.in_use("/controller/parameters_in_use", 2.0 * (version - 1), version, reported.in_use(law, B))
    for k in range(1500):
        bag.sample("/joint_states", 0.004 * k, ("motor", "load"), (0.0, 0.0))
        bag.status("/controller/state", 0.004 * k, "servo", {"reference": 0.0, "phase": 0.0})
    text = report(bag.write(tmp_path / "bag"), tmp_path).page.text
    assert "law: fast to auto (law two_region acts)" in text
    assert "law: auto to fast" in text
    assert "law: auto to fast (" not in text


def test_delays_are_said_with_their_clock_and_rounding_is_no_jitter(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(600):
        stamp, received = 0.004 * k - START, 0.002 * k  # simulated time
        bag.sample("/joint_states", stamp, ("motor", "load"), (0.0, 0.0), received=received)
        bag.numbers("/command", received + 5e-4, (0.0,), answers=stamp)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    text = made.page.text
    assert "within their period, or followed by a late one, by the clock of the samples" in text
    assert "from sample to its command, as recorded, by the recorder's: median, 99 % below" in text
    assert milliseconds(2.8e-15, 1e-6, math.nan) == "0, 0.001, \u2013"
