"""`benchmarks/sensitivity.py` and `scaled.py`: the copy in which each tuned number is read from memory, and a table."""

import ast
import json
from pathlib import Path

import pytest
from scaled import Scale
from sensitivity import table
from tuned_copy import LAW, copy_package, numbers_in

import backlash_ros
from backlash_ros.control.monitoring.thresholds import mechanical_time_constant
from backlash_ros.drivetrain import NOMINAL_DRIVE

PACKAGE = Path(backlash_ros.__file__).parent


def test_no_function_of_the_copy_has_a_tuned_number_in_its_code(tmp_path: Path) -> None:
    copy_package(PACKAGE, tmp_path)
    base = json.loads((tmp_path / PACKAGE.name / LAW / "tuned.json").read_text())
    names = {name.partition(".")[2] for name in base}
    assert base["carry._LONGEST_BRAKE"] == 0.3
    for source in (PACKAGE / LAW).glob("*.py"):
        before, after = (
            ast.parse((folder / source.name).read_text()) for folder in (source.parent, tmp_path / PACKAGE.name / LAW)
        )
        assert numbers_in(after) == numbers_in(before)
        used = [
            [
                each.id
                for f in tree.body
                if isinstance(f, ast.FunctionDef)
                for each in ast.walk(f)
                if isinstance(each, ast.Name)
            ]
            for tree in (before, after)
        ]
        assert not names & set(used[1])
        assert used[1].count("tuned") == sum(name in names for name in used[0])


def test_a_drive_in_other_units_of_torque_and_time_has_the_same_shares() -> None:
    drive = Scale(torque=100.0, time=0.1).drive(NOMINAL_DRIVE)
    assert drive.standstill_torque() == pytest.approx(100.0 * NOMINAL_DRIVE.standstill_torque())
    assert drive.no_load_speed == pytest.approx(10.0 * NOMINAL_DRIVE.no_load_speed)
    assert mechanical_time_constant(drive) == pytest.approx(0.1 * mechanical_time_constant(NOMINAL_DRIVE))
    torque = NOMINAL_DRIVE.standstill_torque()
    assert drive.gear.wind_up(100.0 * torque) == pytest.approx(NOMINAL_DRIVE.gear.wind_up(torque))


def test_the_table_counts_verdicts_that_turn_and_drives_that_are_late() -> None:
    def line(kind: str, name: str, digest: str, **figures: object) -> dict[str, object]:
        run = {"population": "core", "number": 0, "kind": kind, "name": name, "factor": 1.2 if name else 1.0}
        return {**run, "figures": {"digest": digest, **figures}, "read": ["a.B", "c.D"]}

    verdicts = {"quiet": True, "precise": True, "overshoot_ok": False}
    lines = [
        line("steps", "", "0", **verdicts, step={"settle": 0.2}),
        line("sine", "", "0", rms=0.1),
        line("move", "", "0", rms=0.1),
        line("steps", "a.B", "1", **{**verdicts, "quiet": False, "overshoot_ok": True}, step={"settle": 0.5}),
        line("sine", "a.B", "1", rms=0.15),
        line("steps", "c.D", "0", **verdicts, step={"settle": 0.2}),
    ]
    _, changed, same, unread = table(lines, ["a.B", "c.D", "e.F"])
    assert changed[4:] == ["1 / 1", "1", "+150 / +50 / +0"]
    assert same[4:] == unread[4:] == ["-"] * 3
