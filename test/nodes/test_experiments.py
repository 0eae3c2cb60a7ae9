"""Experiments over DDS, on drives drawn at random: what is found is right, and a cancelled one ends at rest."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from data_sheet import NAMES, Rig

from backlash_ros.control import GapMapSettings
from backlash_ros.studies.evaluation.population import Member, draw_member
from backlash_ros.studies.evaluation.task import GAP_NEAR

SEED = 20261122
MAP = GapMapSettings(places=6, turn=2.0)
FEW = {"learning__gap_map__places": MAP.places, "learning__gap_map__turn": MAP.turn}
QUICK = {"learning__hysteresis__cycles": 2}


def braked(member: Member) -> Member:
    """Return a drive with its output braked: more than the motor can turn."""
    torque = 2.0 * member.drive.standstill_torque()
    return replace(member, drive=replace(member.drive, load=replace(member.drive.load, coulomb_friction=torque)))


@pytest.mark.grid  # test_hysteresis.py has the experiment
def test_the_gap_of_an_output_that_is_braked_is_found(rig: Callable[..., Rig]) -> None:
    member = braked(draw_member(SEED, 16, "full"))
    made = rig(member, learning__experiment="hysteresis", **QUICK)
    told = made.in_use()
    answer = made.drive.call("learn")
    assert answer.success, answer.message
    assert "lost motion" in answer.message
    found, gap = made.in_use(), member.drive.gear.backlash_at(0.0)
    assert found["backlash_angle"] == pytest.approx(gap, abs=max(GAP_NEAR * gap, member.load_count))
    assert {name for name in NAMES if told[name] != found[name]} == {"backlash_angle"}
    assert abs(made.drive.load_angle) < 0.01 * gap


@pytest.mark.grid
@pytest.mark.parametrize(
    ("experiment", "number", "longest"),
    [
        ("identify", 14, 3.0),
        ("gap_map", 30, 15.0),
        ("hysteresis", 16, 10.0),
    ],
)
def test_cancelled_at_any_sample_it_ends_at_rest_and_changes_nothing(
    rig: Callable[..., Rig], experiment: str, number: int, longest: float
) -> None:
    """While it moves the drive: at its first sample, and at others; a map is left where it is.

    The backlash is known, so that the law which takes over is quiet.
    """
    member = draw_member(SEED, number, "full")
    member = braked(member) if experiment == "hysteresis" else member
    service = "identify" if experiment == "identify" else "learn"
    b = member.drive.gear.backlash_angle * (1.0 + member.drive.gear.backlash_variation)
    made = rig(member, backlash_angle=b, learning__experiment=experiment, **FEW, **QUICK)
    told, random = made.in_use(), np.random.default_rng(number)
    away = 0.5 * MAP.turn + MAP.swing if experiment == "gap_map" else 2.0 * b
    for samples in (0, *random.integers(1, round(longest * member.rate), 2)):
        start, asked = made.reading, made.begin(service)
        made.drive.run(int(samples))
        assert not asked.done()
        assert made.drive.call("cancel").success
        answer = made.answer(asked)
        assert not answer.success
        assert answer.message.endswith("cancelled on request")
        assert made.in_use() == told
        made.drive.run(round(1.5 * member.rate))
        assert np.ptp(made.drive.run(round(0.5 * member.rate))) < b
        assert abs(made.reading - start) < away
    refused = made.drive.call("cancel")
    assert (refused.success, refused.message) == (False, "there is no experiment to cancel")


@pytest.mark.grid
def test_cancelled_while_the_fit_runs_it_changes_nothing_and_the_next_one_is_answered(rig: Callable[..., Rig]) -> None:
    member = draw_member(SEED, 4, "core")
    made = rig(member)
    told, swing = made.in_use(), math.inf
    asked = made.begin("identify")
    while swing > 1e-3 * member.drive.gear.backlash_angle:  # until it rests: its way is over
        swing = float(np.ptp(made.drive.run(round(0.6 * member.rate))))
    assert not asked.done()
    assert made.drive.call("cancel").success
    answer = made.answer(asked)
    assert (answer.success, answer.message) == (False, "cannot identify: cancelled on request")
    assert made.in_use() == told
    assert made.drive.call("identify").success
