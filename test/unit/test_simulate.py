"""`backlash simulate`: a step of a drive of one's own, its figures, table and picture, and what is refused."""

import csv
import json
import re
import runpy
import shlex
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from pages import ROOT, commands

from backlash_ros.cli import main
from backlash_ros.control import LAWS
from backlash_ros.drivetrain import NOMINAL_DRIVE

DRIVE = str(Path(__file__).parents[2] / "config" / "nominal_drive.yaml")


def figures_of(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    assert main(["simulate", *words]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_condition_of_the_paper_is_run(capsys: pytest.CaptureFixture[str]) -> None:
    figures = figures_of(capsys, "--law", "fast")
    assert figures["case"] == "nominal"
    assert figures["residual_b"] > 0.5


@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_law_takes_the_load_of_a_file_to_its_target(law: str, capsys: pytest.CaptureFixture[str]) -> None:
    figures = figures_of(capsys, DRIVE, "--law", law, "--reference", "-0.5", "--seconds", "4")
    assert abs(figures["final_error_b"]) < 1.0
    assert figures["fault"] == ""


def test_parameters_are_set_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    words = DRIVE, "--law", "two_region", "--set", "rate=1000"
    quiet = figures_of(capsys, *words)
    heavy = figures_of(capsys, *words, "--set", "load.inertia=0.002")
    wide = figures_of(capsys, *words, "--set", "laws.two_region.width=10")
    pushed = figures_of(capsys, *words, "--load-torque", "0.1")
    assert quiet["residual_b"] < 0.01
    assert heavy["residual_b"] > 0.3
    assert wide["rise_time_s"] > 1.1 * quiet["rise_time_s"]  # its end is over-damped
    assert len({figures["peak_force_N"] for figures in (quiet, heavy, pushed)}) == 3


@pytest.mark.parametrize("command", [12.0, 6.0])
def test_a_lower_limit_of_the_command_makes_a_step_longer_and_no_worse(
    command: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """A plan that does not know the limit brakes later than the motor can."""
    free = figures_of(capsys, DRIVE)
    found = figures_of(capsys, DRIVE, "--set", f"limits.command={command}")
    assert found["peak_command"] <= command
    assert found["rise_time_s"] > free["rise_time_s"]
    assert found["overshoot_b"] < 0.1
    assert found["settling_time_s"] < 0.4


def test_law_and_gains_of_files_are_those_of_a_controller(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``gains`` before a set's, ``gain_set`` before the first set, zeros for none; later files before earlier ones."""
    gentle, slow, cascade = (tmp_path / f"{name}.yaml" for name in ("gentle", "slow", "cascade"))
    gentle.write_text("gain_set: gentle")
    slow.write_text("/**: {ros__parameters: {gains: {fast: {q: [0.0, 0.0], k: [8.0, 0.4, 0.1]}}}}")
    cascade.write_text("law: cascade")
    rise = {
        names: figures_of(capsys, DRIVE, *map(str, names), "--law", "two_region")["rise_time_s"]
        for names in ((), (gentle,), (slow,), (gentle, slow))
    }
    assert rise[()] < 0.7 * min(rise[gentle,], rise[slow,])
    assert rise[slow,] == rise[gentle, slow] != rise[gentle,]
    assert figures_of(capsys, DRIVE, str(cascade))["law"] == "cascade"
    assert figures_of(capsys, DRIVE, str(cascade), "--law", "fast")["law"] == "fast"
    same = figures_of(capsys, DRIVE, "--law", "two_region", "--set", "gains.fast.k=[8.0, 0.4, 0.1]")
    assert same["rise_time_s"] == rise[slow,]


@pytest.mark.parametrize(
    ("words", "law"),
    [
        ((), "planned"),
        (("--law", "auto", "--set", "laws.planned.push_time=0.05"), "planned"),
        (("--set", "sensors.measured=[theta_m]"), "planned"),
        (("--law", "two_region", "--set", "sensors.measured=[theta_l]"), "two_region"),
    ],
)
def test_the_law_is_by_default_what_auto_stands_for_on_the_drive(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], law: str
) -> None:
    assert figures_of(capsys, DRIVE, *words)["law"] == law
    assert figures_of(capsys, "--law", "auto")["law"] == "two_region"  # the paper's conditions are of its law


def test_a_path_is_followed_alike_from_a_table_and_from_a_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the message, the load's joint, whose place and name others have elsewhere; its stamp is that of the start."""
    table, message, picture = (tmp_path / name for name in ("path.csv", "path.yaml", "path.png"))
    points = [(0.5, 0.4, 0.5), (1.0, 0.5, 0.0), (2.25, -0.25, 0.0)]
    table.write_text("time;position;velocity\ns;rad;rad/s\n" + "".join(f"{t};{p};{v}\n" for t, p, v in points))
    header = "header: {stamp: {sec: 1700000000, nanosec: 7}, frame_id: ''}\njoint_names: [other, axis]\npoints:\n"
    lines = [
        f"- {{positions: [9.0, {p}], velocities: [0.0, {v}], time_from_start: {{sec: {t // 1:.0f}, "
        f"nanosec: {1e9 * (t % 1):.0f}}}}}\n"
        for t, p, v in points
    ]
    message.write_text(header + "".join(lines) + "---\n")
    named = tmp_path / "axis.yaml"
    named.write_text("/**: {ros__parameters: {load_joint: axis}}")
    found = figures_of(capsys, DRIVE, "--trajectory", str(table), "--plot", str(picture))
    assert figures_of(capsys, DRIVE, str(named), "--trajectory", str(message)) == {
        **found,
        "drive": f"{DRIVE} with {named}",
        "trajectory": str(message),
        "notes": [],
    }
    assert (found["joined_by"], found["reversals"], found["fault"], found["end_s"]) == ("cubics", 1, "", 2.25)
    assert found["rms_error_b"] < found["largest_error_b"] < 0.3
    assert picture.read_bytes().startswith(b"\x89PNG")
    late = figures_of(capsys, DRIVE, "--law", "cascade", "--trajectory", str(table))
    assert late["lag_s"] > 10.0 * abs(found["lag_s"])
    assert late["rms_error_rad"] > 10.0 * found["rms_error_rad"]
    named.write_text("limits: {command: 0.4}")
    limited = figures_of(capsys, DRIVE, str(named), "--law", "cascade", "--trajectory", str(table))
    assert limited["peak_command"] == 0.4 < late["peak_command"]


def test_a_path_is_refused_as_on_the_topic_and_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused = {
        ("a.csv", "time,position\n0.5,0.1\n0.4,0.2"): "row 3: time_from_start of point 1 must be > 0.5 s, .*: sort",
        ("a.csv", "time,position,velocity\n0.5,0.1,0\n0.9,0.3,1"): "row 3: velocities of the last point .*: add a",
        ("a.csv", "time,position,velocity\n0.5,,0\n0.9,0.3,0"): "row 2: positions of point 0 must be finite, .*: give",
        ("a.csv", "time,position,velocity,velocity\n0.5,1,0,0"): "row 1: must have one column 'velocity', has 2",
        ("a.csv", "time,angle\n0.5,1"): "row 1: must have one column 'position', has 0; .* rename it",
        ("a.csv", "time,position\n0,1\n0.9,0.3"): "within 0.05 rad of the setpoint, 0 rad, got 1; give the point",
        ("a.csv", "time,position\n0.9,57"): "reference must be within limits.position_lower = -1 rad and .* got 57",
        ("a.csv", "time,position\n0.001,0.9"): "path must be slower than the drive's no-load speed = 48 rad/s, got 900",
        ("a.csv", "time,position\n601,0.9"): "time to the end of the path must be >= 0 and <= 600 s",
        ("a.yaml", "joint_names: [a]\npoints:\n- positions: [1.0]\n"): "line 3: time_from_start of point 0 must be",
        ("a.yaml", "joint_names: [a]\npoints:\n- {positions: [1.0], time_from_start: 1}"): "must contain 'load'",
        ("a.yaml", "joint_names: [load]\npoints:\n- {velocity: [1.0]}"): "line 3: velocity is nothing that point 0",
    }
    limited = tmp_path / "limited.yaml"
    limited.write_text("limits: {position_lower: -1.0, position_upper: 1.0}\nfaults: {velocity: 100.0}")
    for (name, text), says in refused.items():
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(SystemExit, match="2"):
            main(["simulate", DRIVE, str(limited), "--trajectory", str(path), "--csv", str(tmp_path / "out.csv")])
        error = capsys.readouterr().err
        assert re.fullmatch(f"backlash simulate: {re.escape(str(path))}[:,].*{says}.*\n", error), error
    assert not (tmp_path / "out.csv").exists()
    with pytest.raises(SystemExit, match="2"):
        main(["simulate", DRIVE, "--trajectory", str(path), "--reference", "1"])
    assert "--reference has no use with --trajectory" in capsys.readouterr().err


def test_table_and_picture_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, picture = tmp_path / "step.csv", tmp_path / "step.png"
    words = (DRIVE, "--law", "two_region", "--seconds", "1", "--csv", str(table), "--plot", str(picture))
    figures_of(capsys, *words)
    assert picture.read_bytes().startswith(b"\x89PNG")
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 250
    assert {name: float(value) for name, value in rows[0].items()} == {
        "time": 0.0,
        "reference": 1.0,
        "load": 0.0,
        "load_velocity": 0.0,
        "motor": 0.0,
        "motor_velocity": 0.0,
        "current": 0.0,
        "gap": 0.0,
        "command": 24.0,
        "region": 1.0,
        "load_torque_estimate": 0.0,
        "peak_force": pytest.approx(252.0, rel=0.01),
        "measured_load": 0.0,
    }
    before = table.read_bytes()
    with pytest.raises(SystemExit, match="2"):
        main(["simulate", *words])
    assert "exists; --force" in capsys.readouterr().err
    assert table.read_bytes() == before


@pytest.mark.grid
def test_identify_reads_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, file = tmp_path / "step.csv", tmp_path / "found.json"
    figures_of(capsys, DRIVE, "--law", "fast", "--reference", "0.5", "--seconds", "12", "--csv", str(table))
    assert main(["identify", str(table), "--drive", DRIVE, "--json", str(file)]) == 0
    found = {finding["key"]: finding for finding in json.loads(file.read_text())["findings"]}
    for key, true in (
        ("gear.backlash_angle", NOMINAL_DRIVE.gear.backlash_angle),
        ("load.inertia", NOMINAL_DRIVE.load.inertia),
    ):
        assert found[key]["value"] == pytest.approx(true, abs=2.0 * found[key]["uncertainty"])
        assert found[key]["uncertainty"] < 0.02 * true


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--plot", "x.png"], "--plot needs DRIVE"),
        (["--reference", "0.5"], "--reference needs DRIVE"),
        (["--seconds", "2"], "--seconds needs DRIVE"),
        (["--load-torque", "0"], "--load-torque needs DRIVE"),
        ([DRIVE, "--load-torque", "1e9"], "N m, either way, ten times what the motor holds, got 1000000000.0"),
        ([DRIVE, "--set", "load=3", "--set", "load.inertia=1"], "load must have parameters by name, got 3"),
        ([DRIVE, "--case", "nominal"], "--case is of the nominal drive"),
        ([DRIVE, "--set", "load.inertai=1"], "load.inertai is no parameter"),
        ([DRIVE, "--set", "lod.inertia=1"], "--set must be a parameter that a simulation goes by"),
        ([DRIVE, "--set", "laws.cascade.dead_band=1"], "laws.two_region.*), got laws.cascade.dead_band=1"),
        ([DRIVE, "--set", "load.inertia=-1"], "load.inertia must be >= 1e-09 kg m^2"),
        ([DRIVE, "--set", "load.inertia=heavy"], "load.inertia must be"),
        ([DRIVE, "--set", "load.inertia=.nan"], "load.inertia must be a finite number, >= 1e-09 kg m^2"),
        ([DRIVE, "--set", "loop_delay=late"], "loop_delay must be a finite number, >= 0 s and <= 1 s, got 'late'"),
        (
            [DRIVE, "--set", "sensors.measured=theta_l"],
            "sensors.measured must be a list with something in it, got 'theta_l'",
        ),
        (
            [DRIVE, "--set", "gain_sets.nominal.fast.q=3"],
            "gain_sets.nominal.fast.q must be a list with something in it, got 3",
        ),
        ([DRIVE, "--set", "gain_set=swift"], "gain_set must be one of ['nominal', 'gentle', 'custom'], got 'swift'"),
        ([DRIVE, "--set", "gains.fast.k=3"], "gains.fast.k must be a list with something in it, got 3"),
        ([DRIVE, "--set", "load"], "must be name=value, got 'load'"),
        ([DRIVE, "--set", "rate=0"], "rate must be > 0 Hz"),
        ([DRIVE, "--seconds", "nan"], "--seconds must be >= 0.1 and <= 600 s, got nan"),
        ([DRIVE, "--reference", "0"], "--reference must be"),
        ([DRIVE, "--reference", "7"], "--reference: reference must be within limits.step = 6.28319 rad of 0 rad"),
        ([DRIVE, "--load-torque", "inf"], "--load-torque must be >= 0 and <= "),
        (["nosuch.yaml"], "nosuch.yaml"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        code = main(["simulate", *words])
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.grid  # another processor may round the last digit otherwise
@pytest.mark.parametrize("name", ["why_not_pid", "following"])
def test_a_page_says_what_its_command_prints(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """To the digit where the load comes to rest; a swing that never ends may be another one elsewhere."""
    command = next(each for each in commands("test_simulate.py") if each.startswith(f"python docs/examples/{name}"))
    monkeypatch.chdir(tmp_path)
    Path("docs/images").mkdir(parents=True)
    words = shlex.split(command)[1:]
    monkeypatch.setattr(sys, "argv", words)
    runpy.run_path(str(ROOT / words[0]), run_name="__main__")
    assert Path(words[-1]).read_bytes().startswith(b"\x89PNG")
    page = re.search("```text\n(.*?)```", (ROOT / "docs" / f"{name}.md").read_text(), re.DOTALL)[1]
    printed = capsys.readouterr().out
    assert [line for line in printed.splitlines() if "never" not in line] == [
        line for line in page.splitlines() if "never" not in line
    ]
    assert [line[:24] for line in printed.splitlines()] == [line[:24] for line in page.splitlines()]


def test_a_profile_is_followed_as_a_controller_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Given in a word, in numbers, or by a file; what the controller refuses is refused."""
    words, table = (DRIVE, "--reference", "0.5", "--seconds", "2"), tmp_path / "way.csv"
    step, auto = figures_of(capsys, *words), figures_of(capsys, *words, "--profile", "auto")
    slow = figures_of(capsys, *words, "--profile", "1,10,200", "--csv", str(table))
    with table.open() as file:
        setpoint = [float(row["reference"]) for row in csv.DictReader(file)]
    assert max(abs(b - a) for a, b in pairwise(setpoint)) <= 1.0 * 0.004 + 1e-9
    assert setpoint[-1] == 0.5
    assert "profile" not in step
    assert auto["peak_force_N"] < step["peak_force_N"]
    assert slow["profile"] == {"velocity": 1.0, "acceleration": 10.0, "jerk": 200.0}
    assert 0.5 < slow["settling_time_s"] < 0.5 / 1.0 + 1.0 / 10.0 + 20.0 / 200.0 + 0.1
    assert max(auto["largest_error_b"], slow["largest_error_b"]) < 1.0
    said = tmp_path / "said.yaml"
    said.write_text("profile: {mode: limited, velocity: 1.0, acceleration: 10.0, jerk: 200.0}\nlimits: {step: 0.4}")
    for more, says in (
        ((), "--reference: reference must be within limits.step = 0.4 rad of 0 rad, got 0.5"),
        (("--profile", "fast"), "--profile must be step, auto or V,A,J in rad/s, rad/s^2, rad/s^3, got 'fast'"),
        (
            ("--profile", "1,0,2"),
            "profile.acceleration must be >= 1e-06 rad/s^2 with profile.mode = 'limited', got 0.0",
        ),
    ):
        with pytest.raises(SystemExit, match="2"):
            main(["simulate", DRIVE, str(said), "--reference", "0.5", *more])
        assert says in capsys.readouterr().err
    said.write_text(said.read_text().replace("0.4", "0.6"))
    by_file = figures_of(capsys, DRIVE, str(said), *words[1:])
    assert by_file == {**slow, "drive": by_file["drive"]}
    assert figures_of(capsys, DRIVE, str(said), *words[1:], "--profile", "step")["rise_time_s"] == step["rise_time_s"]
