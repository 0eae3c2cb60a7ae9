"""The first screen of `backlash report`: what it says of a recording in a few lines."""

import math
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import reported
from made_report import Made, report
from plain_bag import START, PlainBag

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.pages.report.cures import cure
from backlash_ros.pages.report.outcome import CUT, NEVER, SETTLED, SWINGS, ending, rattled, trouble
from backlash_ros.pages.report.report import AxisReport
from backlash_ros.pages.report.steps import Step
from backlash_ros.pages.report.verdicts import verdicts_of
from backlash_ros.pages.report.yardstick import Yardstick, resolution_of
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.studies.metrics import count_crossings

B = 0.02
"""Backlash of the axes here, rad."""
NAN = math.nan


def verdicts(made: Made) -> list[str]:
    """Return the lines of the first screen, each after its tone."""
    return [unescape(said) for said in re.findall(r'<p class="(verdict[^<]*)', made.html)]


def stepping_bag(beats: int, law: str = "fast", learned: float = B) -> PlainBag:
    """Return a step of 1 rad at 1 s, after which the teeth beat so often from flank to flank before all is at rest."""
    bag = PlainBag()
    drive = reported.in_use(law, learned)
    bag.in_use("/controller/parameters_in_use", 0.0, 1, drive)
    ratio = NOMINAL_DRIVE.gear.ratio
    for k in range(1500):
        time = 0.004 * k
        load = 1.0 - math.exp(-max(time - 1.0, 0.0) / 0.02) if time >= 1.0 else 0.0
        beat = math.cos(math.pi * min(max(time - 1.2, 0.0) / 0.05, float(beats)))
        bag.sample("/joint_states", time, ("motor", "load"), ((load + 0.5 * B * beat) / ratio, load))
        state = {"reference": float(time >= 1.0), "holding": 1.0, "backlash_angle": learned}
        bag.status("/controller/state", time, "servo", state)
    return bag


@pytest.mark.parametrize("beats", [3, 4, 9])
def test_a_step_that_rattled_before_it_settled_is_not_all_green(beats: int, tmp_path: Path) -> None:
    """The line is amber and says what to do where the teeth beat; to brake and hold, they cross the gap twice."""
    made = report(stepping_bag(beats).write(tmp_path / "bag"), tmp_path)
    (step,) = made.axis["steps"]
    assert (step["impacts"], step["crossings"]) == (beats, beats)
    said = verdicts(made)[0]
    if beats < 4:
        assert said == 'verdict">1 step: 1 settled.'
    else:
        told = f"Step 1 with law fast rattled on its way: {beats} impacts. To end it, choose law auto."
        assert said == f'verdict doubt">1 step: 1 settled. {told}'


def test_teeth_that_touch_one_flank_many_times_do_not_rattle() -> None:
    """A reading at the edge of the contact flickers; a rattle goes from flank to flank."""
    gap = np.array([0.0, 0.5, 0.44, 0.5, 0.44, 0.5, 0.0, -0.46, 0.0, -0.5, 0.2, 0.46]) * B
    assert count_crossings(gap, B) == 2
    assert count_crossings(np.zeros(5), B) == count_crossings(gap[:0], B) == 0


SETTLES = Step(0.0, 4.0, 0.0, 1.0, settling=0.2, residual=0.0, error=0.0, band=0.25 * B, crossings=0, impacts=0)
SWINGING = replace(SETTLES, settling=math.inf, residual=0.28 * B, amplitude=0.28 * B, frequency=9.0)
UNSETTLED = replace(SETTLES, settling=math.inf, residual=4.1 * B, error=-0.5 * B)


def of_steps(*steps: Step) -> list[str]:
    """Return the lines about steps."""
    axis = SimpleNamespace(state={})
    events = SimpleNamespace(faults=[])
    axis_report = SimpleNamespace(
        axis=axis, steps=steps, holds=[], paths=[], events=events, timing=None, b=B, scale=B, unit="b"
    )
    return [text for _, text in verdicts_of(cast("AxisReport", axis_report))]


def test_a_step_ends_in_one_of_four_ways() -> None:
    assert [ending(step) for step in (SETTLES, SWINGING, UNSETTLED)] == [SETTLED, SWINGS, NEVER]
    assert ending(replace(UNSETTLED, end=1.0)) == CUT
    assert rattled(replace(SETTLES, crossings=4))
    assert not rattled(replace(SWINGING, crossings=40))  # it is said to swing


def test_the_worst_step_is_the_furthest_from_rest_however_it_ended() -> None:
    (said,) = of_steps(SWINGING, SETTLES, replace(UNSETTLED, law="planned"), SWINGING)
    assert said.startswith("4 steps: 1 settled, 2 ended in a limit cycle, 1 did not settle. Step 3 with law planned")
    assert "was the furthest from settled: 4.100 b peak to peak in its last second, 0.500 b off its target" in said
    assert said.endswith("To end it, learn and identify again: gap or load may have changed")
    (said,) = of_steps(SETTLES, replace(UNSETTLED, residual=0.1 * B), SWINGING)
    assert "Step 2 was the furthest from settled" in said  # it rests 0.5 b off
    assert "To end it" not in said
    (said,) = of_steps(SWINGING, replace(SWINGING, residual=0.3 * B, amplitude=0.3 * B))
    assert "Step 2 swung most: 0.300 b peak to peak, at 9\u00a0Hz" in said
    assert trouble(replace(UNSETTLED, residual=NAN, error=NAN)) == (0.0, 0)


@pytest.mark.parametrize(("law", "act"), [("fast", ""), ("two_region", "identify the drive")])
def test_a_law_that_did_worse_in_the_recording_is_not_advised(law: str, act: str) -> None:
    axis = cast("Axis", SimpleNamespace(state={}))
    step, worse = replace(SWINGING, law=law), replace(UNSETTLED, law="planned")
    assert cure(axis, step, [step, worse]) == act
    better = replace(worse, residual=0.0, error=0.0, settling=0.1)
    assert cure(axis, step, [step, better]).endswith("choose law auto")
    assert cure(axis, step, [step, replace(worse, law="fast")]).endswith("choose law auto")


def test_a_swing_of_one_count_of_the_encoder_is_no_limit_cycle(tmp_path: Path) -> None:
    """The load swings by one count about its goal, then by two; of the encoder only the recording tells."""
    count = 0.07 * B
    for counts in (1, 2):
        bag = PlainBag()
        for k in range(1000):
            swing = round(0.5 * counts * (1.0 + math.sin(0.1 * k)))
            bag.sample("/joint_states", 0.004 * k, ("motor", "load"), (0.0, 1.0 + count * swing))
            state = {"reference": 1.0, "holding": 1.0, "backlash_angle": B}
            bag.status("/controller/state", 0.004 * k, "servo", state)
        (hold,) = report(bag.write(tmp_path / f"bag{counts}"), tmp_path).axis["holds"]
        assert hold["residual"] == pytest.approx(counts * count)
        assert (hold["amplitude"] is None) is (counts == 1)


def test_the_count_of_an_encoder_is_the_smallest_step_between_positions() -> None:
    assert resolution_of(0.1 * np.array([3.0, 1.0, 7.0, 1.0 + 1e-13, NAN])) == pytest.approx(0.2)
    assert resolution_of(np.ones(3)) == resolution_of(np.empty(0)) == 0.0
    assert Yardstick(B, NAN, 0.0).least_swing(1.0) == pytest.approx(0.05 * B)
    assert Yardstick(0.0, NAN, 0.1).least_swing(0.01) == pytest.approx(0.15)


@pytest.mark.parametrize(("learned", "model", "said"), [(B, 0.01, True), (B, B, False), (0.0, 0.01, False)])
def test_the_backlash_stands_where_figures_are_read_in_it(
    learned: float, model: float, said: bool, tmp_path: Path
) -> None:
    bag = PlainBag()
    for version, b in enumerate((0.0, learned), 1):
        told = reported.in_use("fast", b) | {"gear.backlash_angle": model}
        bag.in_use("/controller/parameters_in_use", version - 1.0, version, told)
    for k in range(500):
        time = 0.004 * k
        bag.sample("/joint_states", time, ("motor", "load"), (0.0, 0.0))
        state = {"reference": 0.0, "backlash_angle": learned * (time > 1.0), "experiment": int(0.5 < time < 0.9)}
        bag.status("/controller/state", time, "servo", state)
    text = report(bag.write(tmp_path / "bag"), tmp_path).page.text
    told = "Backlash b = 1.146 deg (0.02 rad), learned at 0.50 s." if learned else "Backlash b is not known: lengths"
    assert told in text
    assert ("The model's gear.backlash_angle, 0.01 rad, differs from it." in text) is said


@pytest.mark.parametrize("pace", [1.0, 2.0])
def test_times_are_of_the_axis_and_so_are_those_of_warnings(pace: float, tmp_path: Path) -> None:
    """Simulated time that runs twice as fast as it is recorded: of the recording its own length is said as well."""
    bag = PlainBag()
    for k in range(1500):
        time = 0.004 * k
        load = float(time >= 1.0)
        bag.sample("/joint_states", time - START, ("motor", "load"), (0.0, load), received=time / pace)
    bag.number("/reference", 0.0, 0.0)
    bag.number("/reference", 1.0 / pace, 1.0)
    bag.status("/diagnostics", 3.0 / pace, "/controller: servo", level=1, text="it rattled by 0.1 rad")
    bag.status("/diagnostics", 5.0 / pace, "/controller: servo", level=1, text="it rattled by 0.2 rad")
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    (warned,) = made.content["diagnostics"]
    assert (warned["first"], warned["last"]) == (pytest.approx(3.0, abs=0.01), pytest.approx(5.0, abs=0.01))
    assert (warned["step"], warned["axis"], warned["times"]) == (1, "/", 2)
    own = "6.00 s long by its own clock (recorded in 3.00 s)" in made.page.text
    assert own is (pace == 2.0)
    assert made.content["own_length"] == (pytest.approx(5.996) if own else None)
