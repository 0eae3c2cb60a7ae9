"""`backlash setup`: what is answered is in the file, and a controller starts with it; what cannot be is asked again."""

import io
import math
import re
import shlex
from pathlib import Path

import pytest
from pages import ROOT, commands

from backlash_ros.cli import main
from backlash_ros.commands.motors import data_sheets
from backlash_ros.commands.questions import Answers
from backlash_ros.commands.setup import describe
from backlash_ros.drive_file.drive_file import read_axis, read_start, read_surroundings
from backlash_ros.drivetrain import Drive
from backlash_ros.studies.check import check_drive

TYPED = {
    "motor": ["<", "pololu", "?", "99", "0", "Nobody's", "another"],
    "motor.voltage_limit": ["-3", "lots", "12 A", "12,0", "12 V"],
    "motor.resistance": ["0", "1.5"],
    "motor.torque_constant": ["0 rpm/V", "-1", "400 rpm/V"],
    "no_load_current": ["nan", "50 mA"],
    "motor.inductance": ["0.3", "0.3 mH"],
    "motor.inertia": ["20", "20 g cm^2"],
    "command_interface": ["torque", "2"],
    "motor.current_limit": ["3"],
    "gear.reduction": ["?", "inf", "14:2", "14:1"],
    "gear.backlash_angle": ["0.02", "<", "30:1", "<", "<", "<", "current", "3", "30:1", "0.9 degrees"],
    "load.body": ["rod"],
    "load.mass": ["1e9", "200 g"],
    "load.size": ["0", "30 cm"],
    "load.viscous_friction": [""],
    "load.coulomb_friction": ["20 mN m"],
    "load.gravity_torque": [""],
    "encoders": ["BOTH"],
    "sensors.motor_counts": ["-1", "2000"],
    "sensors.load_counts": ["14 bit"],
    "limits.position_lower": ["-1 rad"],
    "limits.position_upper": ["-2 rad", "none", ""],
    "limits.command": ["4", "2.5"],
    "rate": ["9999", "500"],
}


def typed(monkeypatch: pytest.MonkeyPatch, lines: list[str]) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_what_is_answered_is_in_the_file_and_what_cannot_be_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    answers = [line for lines in TYPED.values() for line in lines if line != "none"]
    typed(monkeypatch, answers)
    assert main(["setup"]) == 0
    printed = capsys.readouterr().out
    file = tmp_path / "my_drive.yaml"
    drive, axis, around = Drive.read(file), read_axis(file), read_surroundings(file)
    assert drive.command_interface == "current"
    motor, load = drive.motor, drive.load
    told = motor.voltage_limit, motor.resistance, motor.current_limit, motor.inductance, motor.inertia
    assert told == pytest.approx((12.0, 1.5, 3.0, 3e-4, 2e-6))
    assert motor.torque_constant == pytest.approx(60.0 / (2.0 * math.pi * 400.0), rel=1e-5)
    idle = motor.torque_constant * 0.05
    assert motor.viscous_friction == pytest.approx(idle / ((12.0 - 1.5 * 0.05) / motor.torque_constant), rel=1e-5)
    assert (drive.gear.reduction, drive.gear.backlash_angle) == pytest.approx((30.0, math.radians(0.9)), rel=1e-5)
    assert (load.inertia, load.gravity_torque) == pytest.approx((0.2 * 0.3**2 / 3.0, 0.2 * 9.81 * 0.15), rel=1e-5)
    assert (load.viscous_friction, load.coulomb_friction) == (0.012, 0.02)  # 6e-3 kg m^2 in 0.5 s
    assert (axis.position_lower, axis.position_upper, around.rate) == (-1.0, math.inf, 500.0)
    assert around.sensors.measured == ("theta_m", "theta_l")
    assert (around.sensors.motor_counts, around.sensors.load_counts) == (2000.0, 16384.0)
    assert read_start(file).limits.command == 2.5
    for says in (
        "motor must be a number from 1 to 17 or a part of one name, got 'pololu', which 5 names have; ? explains",
        "motor.voltage_limit must be > 0 V and <= 10000 V, got -3.0",
        "motor.voltage_limit must be a number in V, with a point, got '12,0'",
        "motor.torque_constant must be > 0 rpm/V, got '0 rpm/V'",
        "gear.backlash_angle must have a unit, deg or rad or mrad or arcmin, got '0.02'",
        "limits.position_upper must be > -1 rad",
        'part of one name, got "Nobody\'s", which is not known: 1 asks for its data sheet; ? explains',
        "this is the first question",
        "gear.reduction must be a number, got '14:2'",
        "inductance (mH, H, uH) [0.75 mH, assumed]: ",
        "viscous friction of the load (N m s/rad) [0.012 N m s/rad, assumed]: ",
        "  gear.reduction: 10 for 10:1",  # explained, with the key for a file of answers
        "my_drive.yaml: the loop is stable",
        "next:\n  backlash simulate my_drive.yaml",
        "  backlash live --drive my_drive.yaml  ",
        "  raise limits.command in my_drive.yaml, up to 3 A, once the drive is identified\n",
    ):
        assert says in printed
    assert main(["check", str(file)]) == 0
    before = file.read_bytes()
    with pytest.raises(SystemExit, match="2"):
        main(["setup"])
    assert "'my_drive.yaml' exists; --force overwrites it" in capsys.readouterr().err
    assert file.read_bytes() == before


@pytest.mark.parametrize("end", [0, 3, 30])
def test_input_that_ends_too_early_writes_nothing(
    end: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    typed(monkeypatch, [line for lines in TYPED.values() for line in lines][:end])
    with pytest.raises(SystemExit, match="2"):
        main(["setup"])
    error = capsys.readouterr().err
    assert re.fullmatch(r"backlash setup: the input ended before the answer to \S+: nothing is written; .*\n", error)
    assert list(tmp_path.iterdir()) == []


def test_answers_that_cannot_be_used_are_named_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused = {
        "gear.reduction: ten": "gear.reduction must be a number, got 'ten'",
        "gear.reduction: true": "gear.reduction must be a number or text, got True",
        "gear.backlash_angle: 0.02": "gear.backlash_angle must have a unit, deg or rad",
        "load.mass: 1": "load.mass was not asked for; the questions were motor, ",
        "load: {mass: 1}": "load was not asked for",
        "- 1": "must have answers by the keys of the questions",
        "motor: nobody": "motor must be a number from 1 to 17 or a part of one name, got 'nobody'",
        "sensors.measured: motor": "sensors.measured was not asked for; the questions were motor, ",
    }
    answers = tmp_path / "answers.yaml"
    for text, says in refused.items():
        answers.write_text(text)
        with pytest.raises(SystemExit, match="2"):
            main(["setup", "--answers", str(answers), "--out", str(tmp_path / "drive.yaml")])
        error = capsys.readouterr().err
        assert error.startswith(f"backlash setup: {answers}: ")
        assert says in error
        assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == [answers]


@pytest.mark.parametrize(("found", "named"), [(None, False), ("/opt/ros/jazzy/bin/ros2", True)])
def test_commands_of_ros2_are_named_where_there_are_some(
    found: str | None, named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("backlash_ros.commands.setup.which", lambda _: found)
    answers = tmp_path / "answers.yaml"
    answers.write_text("motor: RE 25")
    assert main(["setup", "--answers", str(answers), "--out", str(tmp_path / "drive.yaml")]) == 0
    printed = capsys.readouterr().out.partition("next:")[2]
    assert ("ros2 " in printed) == ("/controller/identify" in printed) == named
    assert ("  dashboard  " in printed) == ("\n  controller --ros-args" in printed) == (not named)


@pytest.mark.parametrize(("side", "signal"), [("motor", "theta_m"), ("load", "theta_l")])
def test_an_answer_names_the_only_encoder(side: str, signal: str, tmp_path: Path) -> None:
    place = tmp_path / "drive.yaml"
    place.write_text(describe(Answers({"encoders": side})).text())
    assert read_surroundings(place).sensors.measured == (signal,)


def test_every_known_motor_has_a_source_and_runs_as_its_sheet_says(tmp_path: Path) -> None:
    """And a controller starts with the first of each maker."""
    makers = set[str]()
    for sheet in data_sheets():
        told = describe(Answers({"motor": sheet.name}))
        place = tmp_path / "drive.yaml"
        place.write_text(told.text())
        assert sheet.source in place.read_text()
        assert len(sheet.source) > 20
        maker = sheet.name.partition(" ")[0]
        assert maker in makers or check_drive(place).fails == "", sheet.name
        makers.add(maker)
        motor, turns = Drive.read(place).motor, sheet.ratio
        lost = motor.resistance * motor.viscous_friction / motor.torque_constant
        speed = motor.voltage_limit / (motor.torque_constant + lost) / turns
        assert speed == pytest.approx(sheet.no_load_speed, rel=0.06), sheet.name
        assert 0.003 < motor.inertia * motor.resistance / motor.torque_constant**2 < 0.02, sheet.name
        stall = motor.torque_constant * motor.voltage_limit / motor.resistance * turns
        if not math.isnan(sheet.stall_torque):  # gears lose some of it
            assert 0.97 * sheet.stall_torque < stall < 2.0 * sheet.stall_torque, sheet.name


def test_the_guides_answers_are_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "real_drive.md").read_text()
    (tmp_path / "answers.yaml").write_text(re.findall(r"```yaml\n(motor: .*?)```", page, re.DOTALL)[0])
    for command in commands("test_setup.py"):
        typed(monkeypatch, 40 * [""])
        assert main([*shlex.split(command)[1:], "--force"]) == 0
        assert "the loop is stable" in capsys.readouterr().out
    assert Drive.read(tmp_path / "my_drive.yaml").motor.torque_constant == 0.0235
