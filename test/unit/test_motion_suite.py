"""`backlash evaluate --suite motion`: its paths, its figures, and its files."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from backlash_ros.cli import main
from backlash_ros.control.motion.setpoint import DURATION, evaluate, extent, positions_at
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.signals import Setpoint
from backlash_ros.studies.evaluation import motion
from backlash_ros.studies.evaluation.motion import LEAD, PATHS, motion_table
from backlash_ros.studies.evaluation.motion import Path as Way
from backlash_ros.studies.evaluation.task import Task, prepare, settings_for

MEMBER = Task(3, "core", "identified").member(0)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.name)
def test_a_plan_is_the_path_from_where_the_load_is_held(path: Way) -> None:
    """Between its nodes, too; position, speed and acceleration go on."""
    rows, out = path.rows(0.3), Setpoint(np.zeros(3))
    times = np.linspace(0.0, path.nodes[-1], 777)[:-1]
    wanted = path.states(times)
    largest = np.max(np.abs(wanted), axis=0)
    for time, state in zip(times, wanted, strict=True):
        evaluate(rows, LEAD + time, out)
        assert np.all(np.abs(out - state - [0.3, 0.0, 0.0]) <= 2e-3 * largest)
    evaluate(rows, 0.5 * LEAD, out)
    np.testing.assert_array_equal(out, [0.3, 0.0, 0.0])
    assert np.all(rows[:, DURATION] > 0.0)
    assert extent(rows)[0] == 0.3


def test_figures_are_those_of_the_error() -> None:
    """A load that is off by a tenth of a gap, and by a gap more for half a second after the end of its move."""
    member, path = replace(MEMBER, sensors=Sensors(motor_counts=2**20, load_counts=2**20)), PATHS[-1]
    b = member.drive.gear.backlash_angle
    time = np.arange(0.0, LEAD + path.length, 1e-3)
    late = (time >= LEAD + path.ends) & (time < LEAD + path.ends + 0.5)
    off = np.where(late, 1.1, 0.1)
    load = positions_at(path.rows(0.0), time) + b * off
    force = np.full(round((LEAD + path.length) * member.rate), 7.0)
    done = SimpleNamespace(time=time, load_angle=load, peak_force=force, fault="")
    judged = motion.judge(member, path, done)  # type: ignore[arg-type]
    assert judged.rms == pytest.approx(np.sqrt(np.mean(off[time >= LEAD] ** 2)))
    assert judged.largest == pytest.approx(1.1)
    assert judged.settle == pytest.approx(0.5, abs=2e-3)
    assert judged.peak_force == 7.0


def test_our_law_follows_closer_than_the_papers() -> None:
    """On one drive that it has learned and identified; the suite's populations say how often."""
    ready, path = prepare(Task(3, "core", "identified"), MEMBER), PATHS[0]
    ours, papers = (
        motion.follow(MEMBER, path, ready.settings.with_law(law), ready.known) for law in ("planned", "two_region")
    )
    assert ours.fault == papers.fault == ours.failure == ""
    assert ours.rms < 0.1
    assert ours.rms < 0.5 * papers.rms


def test_teeth_that_beat_from_flank_to_flank_come_to_rest_again() -> None:
    """An elastic pair of teeth without damping; the torque of each strike was taken for one that lasts: 2.8 b rms."""
    task = Task(271136, "full", "true")
    member = task.member(82)
    settings = replace(
        settings_for(member.drive, member), identified=True, backlash_angle=member.drive.gear.backlash_angle
    )
    fast = next(path for path in PATHS if path.name == "sine 0.05 rad 8 Hz")
    assert motion.follow(member, fast, settings.with_law("planned"), member.drive).rms < 0.6


def test_a_run_that_is_impossible_is_a_row_with_its_reason() -> None:
    unknown = settings_for(MEMBER.drive, MEMBER).with_law("none")
    failed = motion.follow(MEMBER, PATHS[0], unknown, MEMBER.drive)
    assert "law must be one of" in failed.failure
    assert failed.rms == np.inf
    results = [{"laws": {"none": {path.name: failed.__dict__ for path in PATHS}}}]
    rows = motion_table(results, ("none",))
    assert [row[-1] for row in rows] == ["faults", "1", "1", "1", "1"]


def test_the_suite_is_written_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "motion.json"
    words = "evaluate --suite motion --seed 3 --drives 1 --population core --laws fast --experiments limit_cycle --json"
    assert main([*words.split(), str(target)]) == 0
    written = json.loads(target.read_text())
    assert written["suite"] == "motion"
    assert written["laws"] == ["fast"]
    assert {*written["results"]["0"]["laws"]["fast"]} == {path.name for path in PATHS} == {*written["paths"]}
    assert "median / 90 % / worst" in capsys.readouterr().out
    assert [file.name for file in tmp_path.iterdir()] == ["motion.json"]


@pytest.mark.parametrize("option", ["--effects cogging", "--out results"])
def test_options_without_use_are_refused(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = f"evaluate --suite motion --seed 3 --drives 1 --json {tmp_path / 'motion.json'} {option}"
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    assert f"argument {option.split(maxsplit=1)[0]}: has no use with --suite motion" in capsys.readouterr().err
