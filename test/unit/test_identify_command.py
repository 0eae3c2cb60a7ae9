"""`backlash identify`: what it prints and writes, its exit codes, and the commands of docs/identification.md."""

import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from recorded import probed, stepped, write_bag, write_csv, write_drive

from backlash_ros.cli import main
from backlash_ros.commands import identification
from backlash_ros.drive_file.drive_file import Axis, read_axis
from backlash_ros.drive_file.drive_text import drive_text
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.identify import Identified
from backlash_ros.recordings.bag_topics import controller_of

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "identification.md").read_text()
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines() if line]
EXAMPLE = shlex.split(COMMANDS[0])[2:]
TRUE_GAP, TRUE_INERTIA, TRUE_DELAY = 0.004228, 5.854e-4, 0.002
"""Of the axis in docs/examples/axis.csv: drive 1 of the population `full`, under the gap probe."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the examples and a bag in it."""
    shutil.copytree(ROOT / "docs" / "examples", tmp_path / "docs" / "examples", ignore=shutil.ignore_patterns("*.pyc"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.grid
@pytest.mark.population  # five fits; those of the other tests are enough for the oldest dependencies
def test_every_command_of_the_page_works(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(COMMANDS) == 5
    (here / "results").mkdir()
    write_bag(here / "my_run", *probed(1, "full"))
    for command in COMMANDS:
        words = shlex.split(command)
        assert words[0] == "backlash"
        assert main(words[1:]) == 0, command
        printed = capsys.readouterr().out
        assert "written: results/" in printed or "kg m^2" in printed
    found = json.loads((here / "results" / "axis.json").read_text())
    told = {row["symbol"]: row for row in found["findings"]}
    assert told["b"]["value"] == pytest.approx(TRUE_GAP, rel=0.03)
    assert told["J_l"]["value"] == pytest.approx(TRUE_INERTIA, rel=0.05)
    assert told["delay"]["value"] == pytest.approx(TRUE_DELAY, abs=1e-3)
    assert found["valid"]
    assert found["held_out"]["error"] < 0.1 * found["held_out"]["told_error"]
    drive = Drive.read(here / "results" / "axis.yaml")
    assert drive.gear.backlash_angle == pytest.approx(told["b"]["value"], rel=1e-5)
    assert drive.load.inertia == pytest.approx(told["J_l"]["value"], rel=1e-5)
    assert drive.motor.inertia == 6.924e-05
    assert drive.motor.torque_constant == pytest.approx(0.09303, rel=0.01)
    file = yaml.safe_load((here / "results" / "axis.yaml").read_text())["/**"]["ros__parameters"]
    assert file["delay"]["command"] == file["loop_delay"] == pytest.approx(told["delay"]["value"], rel=1e-5)
    assert (file["rate"], file["sensors"]["motor_counts"], file["sensors"]["load_counts"]) == (250.0, 4096.0, 262144.0)
    assert file["backlash_angle"] == file["gear"]["backlash_angle"]
    assert file["identified"] is True
    assert file["expected_load_torque"] == pytest.approx(told["tau_l"]["value"], rel=1e-5, abs=1e-9)
    assert file["unexplained_motor_torque"] >= 0.0
    assert file["unexplained_load_torque"] >= 0.0
    floats = [value for section in ("motor", "gear", "load") for value in file[section].values()]
    assert not any(isinstance(value, str) for value in floats)


@pytest.mark.grid
def test_what_cannot_be_told_is_not_in_the_drive_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    member, recording = stepped(2, "core")
    table = write_csv(tmp_path / "a.csv", member, recording)
    sheet, out = write_drive(tmp_path / "a.yaml", member), tmp_path / "deep" / "out.yaml"
    assert main(["identify", str(table), "--drive", str(sheet), "--drive-file", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "The recording cannot tell:\n  b, offset" in printed
    assert "far flank was not seen" in printed
    assert f"motor and gear ratio as told by {sheet}" in printed
    assert Drive.read(out).gear == Drive.read(sheet).gear
    assert Drive.read(out).load.inertia == pytest.approx(member.drive.load.inertia, rel=0.05)
    text = out.read_text()
    assert re.search(r"backlash_angle: 0.02 +# as told: the recording cannot tell \[rad\]", text)
    assert re.search(r"inertia: \S+ +# found, \+- \S+ \[kg m\^2\]", text)
    assert "    backlash_angle:" not in text.replace("      backlash_angle", "")


@pytest.mark.parametrize("law", sorted(CONTACTS))
def test_a_drive_that_was_found_reads_back(tmp_path: Path, law: str) -> None:
    drive = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, contact=CONTACTS[law]()))
    unseen = tuple(
        Finding(key, key, "", "", why="not seen") for key in ("sensors.load_offset", "delay.command", "tau_l")
    )
    found = Identified("", drive, unseen, period=0.004, replaced=frozenset({"contact", "gear.backlash_angle"}))
    given = Axis(drive, position_lower=-3.0, position_upper=2.5, zero=0.75)
    (tmp_path / "found.yaml").write_text(drive_text(found, given, (0.0, 0.0), "axis.csv"))
    assert "identified" not in (tmp_path / "found.yaml").read_text().partition("/**")[2]  # nothing was told of the load
    assert read_axis(tmp_path / "found.yaml") == given  # with the ends of its travel


def test_a_recording_that_tells_nothing_ends_with_1_and_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    member, recording = stepped(3, "core", length=1.0)
    table = write_csv(tmp_path / "a.csv", member, recording._replace(load=-recording.load))
    out, numbers = tmp_path / "out.yaml", tmp_path / "out.json"
    assert main(["identify", str(table), "--drive-file", str(out), "--json", str(numbers)]) == 1
    assert "Nothing can be told: " in (printed := capsys.readouterr().out)
    assert "the encoders count in opposite directions" in printed
    assert "the nominal drive: give yours with --drive" in printed
    assert not out.exists()
    content = json.loads(numbers.read_text())
    assert (content["valid"], content["findings"]) == (False, [])
    assert "the encoders count in opposite directions" in content["reason"]


def test_the_drive_is_that_of_the_controller_in_the_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not that of another node."""
    member, recording = stepped(2, "core", length=0.5)
    drives = list[Drive]()

    def look(drive: Drive, recording: Recording) -> Identified:
        drives.append(drive)
        return Identified("not looked for", drive)

    monkeypatch.setattr(identification, "identify", look)
    parts = {part.section: part for part in (member.drive.motor, member.drive.gear, member.drive.load)}
    told = {
        f"{name}.{key}": getattr(p, key)
        for name, p in parts.items()
        for key in ("inertia", "torque_constant", "reduction")
        if hasattr(p, key)
    }
    others = {
        f"{node}": {"motor.inertia": 1.0, "gear.reduction": 2.0} for node in ("/plant_simulator", "/b/controller")
    }
    path = write_bag(tmp_path / "bag", member, recording, in_use={"/controller": told, **others})
    assert main(["identify", str(path)]) == 1
    assert f"motor and gear ratio as told by /controller in {path}" in capsys.readouterr().out
    (drive,) = drives
    assert {name: getattr(getattr(drive, part), key) for name in told for part, key in [name.split(".")]} == told
    wrong = write_bag(tmp_path / "wrong", member, recording, in_use={"/controller": {"motor.inertia": -1.0}})
    with pytest.raises(SystemExit, match="2"):
        main(["identify", str(wrong)])
    assert "the parameters in use describe no drive (motor.inertia must be" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("controllers", "command", "axes", "found"),
    [
        (["/a", "/b"], "/a/command", 2, "/a/controller"),
        ([""], "/command", 1, "/controller"),
        (["/a"], "/forward/commands", 1, "/a/controller"),
        (["/a"], "/b/command", 2, ""),
        (["/a", "/b"], "/forward/commands", 1, ""),
        ([], "/command", 1, ""),
    ],
)
def test_a_controller_of_another_axis_tells_nothing(
    controllers: list[str], command: str, axes: int, found: str
) -> None:
    topics = [
        command,
        "/a/plant_simulator/parameters_in_use",
        *(f"{c}/controller/parameters_in_use" for c in controllers),
    ]
    assert controller_of(topics, command, axes) == found


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["nosuch.csv"], 2, "backlash identify: nosuch.csv: No such file or directory"),
        (["a.csv", "--supply", "24"], 2, "argument --supply: is the voltage of a duty cycle"),
        ([EXAMPLE[0], "--stamps", "log"], 2, "argument --stamps: is for bags, and docs/examples/axis.csv is a table"),
        (["docs/examples", "--time-unit", "ms"], 2, "argument --time-unit: is for tables, and docs/examples is a bag"),
        (["docs"], 2, "docs: is no rosbag2 that can be read"),
        (
            [*EXAMPLE[:1]],
            2,
            "docs/examples/axis.csv, row 1: must have one column 'time', has 0; columns: ['t', 'ticks'",
        ),
        (["docs/examples"], 2, "docs/examples: is no rosbag2 that can be read"),
        (["a.csv", "--motor-unit", "counts"], 2, "argument --motor-counts: counts for each turn must be given"),
        (["a.csv", "--motor-counts", "0"], 2, "argument --motor-counts: must be a number > 0, got '0'"),
        (["a.csv", "--load-unit", "grad"], 2, "argument --load-unit: invalid choice: 'grad'"),
        (["a.csv", "--command-unit", "duty"], 2, "the supply must be > 0 V"),
        (["a.csv", "--from", "3", "--to", "2"], 2, "must end after it starts, got 3 to 2 s"),
        (["a.csv", "--command-index", "-1"], 2, "--command-index"),
        (["a.csv", "--json", "docs/examples/axis.csv"], 2, "'docs/examples/axis.csv' exists; --force overwrites it"),
        (["a.csv", "--drive-file", "docs"], 2, "argument --drive-file: 'docs' exists"),
        (["a.csv", "--drive-file", "docs", "--force"], 2, "must be writable, got 'docs'"),
        ([EXAMPLE[0], "--drive", "docs/examples/axis.csv"], 2, "docs/examples/axis.csv: must have ROS parameters"),
        ([], 2, "the following arguments are required: RECORDING"),
    ],
)
def test_arguments_that_cannot_be_used_end_with_a_line(
    arguments: list[str], code: int, said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        ended: object = main(["identify", *arguments])
    except SystemExit as error:
        ended = error.code
    printed = capsys.readouterr().err
    assert ended == code, printed
    assert said in printed
    assert printed.count("\n") == 1


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["identify", "--help"])
    printed = capsys.readouterr().out
    assert "backlash identify axis.csv --drive my_axis.yaml" in printed
    with pytest.raises(SystemExit):
        main(["measure", "--help"])
    printed += capsys.readouterr().out
    for option in re.findall(r"`(--[a-z-]+)", PAGE):
        assert option in printed
