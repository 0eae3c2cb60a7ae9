"""`backlash lost-motion`: what it prints and writes, its exit codes, and the commands of docs/lost_motion.md."""

import json
import math
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from locked import Array, example, locked, ramp
from pages import ROOT, commands
from plain_bag import PlainBag
from rosbags.rosbag2 import StoragePlugin

from backlash_ros.cli import main
from backlash_ros.drivetrain import NOMINAL_DRIVE

REAL = ROOT.parent / "shared" / "data" / "cycloidal"
RAMPS = ramp([4.0, -4.0] * 4)
LOST = 0.02 + 2.0 * 0.5 / 300.0
"""At zero torque, rad, of `locked` with its own numbers."""


def table(place: Path, **columns: Array) -> Path:
    rows = zip(*columns.values(), strict=True)
    text = "\n".join([",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in rows)])
    place.write_text(text + "\n")
    return place


def times(size: int = RAMPS.size) -> Array:
    return 0.004 * np.arange(size)


def measured(place: Path, *options: str) -> list[dict[str, object]]:
    """Return the sets of ramps in the JSON of a run that has a result."""
    out = place.with_name("found.json")
    assert main(["lost-motion", str(place), "--json", str(out), "--force", *options]) == 0
    found: list[dict[str, object]] = json.loads(out.read_text())["ramps"]
    return found


def lost(ramps: dict[str, object]) -> float:
    figure = ramps["at_zero"]
    assert isinstance(figure, dict)
    return float(figure["mean"])


def test_every_command_of_the_page_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ROOT / "docs" / "examples", tmp_path / "docs" / "examples", ignore=shutil.ignore_patterns("*.pyc"))
    (tmp_path / "results").mkdir()
    monkeypatch.chdir(tmp_path)
    for command in commands("test_lost_motion_command.py"):
        assert main(shlex.split(command)[1:]) == 0
    assert "deg are lost at zero torque; repeatability" in capsys.readouterr().out
    (ramps,) = json.loads(Path("results/locked.json").read_text())["ramps"]
    assert ramps["at_zero"]["mean"] == pytest.approx(0.012 + 1.6 / 900.0, rel=0.02)
    assert abs(ramps["at_zero"]["first"]) > 3e-4
    assert ramps["at"] == pytest.approx(0.6)
    page = Path("results/locked.html").read_text()
    for text in ("Lost motion of a locked output", "<svg", "repeatability", "arcmin", "Make it again"):
        assert text in page


def test_the_example_of_the_page_is_the_one_that_is_made() -> None:
    assert (ROOT / "docs" / "examples" / "locked_output.csv").read_text() == example()


def test_an_angle_on_either_side_or_on_both_gives_the_same(tmp_path: Path) -> None:
    angle, still = locked(RAMPS), np.zeros(RAMPS.size)
    motor = table(tmp_path / "motor.csv", time=times(), motor=10.0 * angle, torque=RAMPS)
    load = table(tmp_path / "load.csv", load=angle, torque=RAMPS)
    both = table(tmp_path / "both.csv", time=times(), motor=10.0 * angle, load=still, torque=RAMPS)
    held = table(tmp_path / "held.csv", time=times(), motor=still, load=angle, torque=RAMPS)
    for place, options in (
        (motor, ["--reduction=10"]),
        (load, []),
        (both, ["--reduction=10"]),
        (held, ["--reduction=10"]),
    ):
        (ramps,) = measured(place, *options)
        assert lost(ramps) == pytest.approx(LOST, rel=0.01)


def test_a_coarse_clock_a_reversed_torque_and_missing_numbers(tmp_path: Path) -> None:
    angle, coarse = np.degrees(locked(RAMPS)), np.floor(times() / 0.016) * 0.016
    angle[::50] = math.nan
    place = table(tmp_path / "a.csv", time=coarse, load=angle, torque=-RAMPS, other=RAMPS)
    (ramps,) = measured(place, "--load-unit=deg", "--reversed", "--from=0.5")
    assert lost(ramps) == pytest.approx(LOST, rel=0.01)


def test_a_current_and_the_command_in_a_bag_become_a_torque(tmp_path: Path) -> None:
    current = RAMPS * NOMINAL_DRIVE.gear.ratio / NOMINAL_DRIVE.motor.torque_constant
    motor, drive = locked(RAMPS) / NOMINAL_DRIVE.gear.ratio, str(ROOT / "config" / "nominal_drive.yaml")
    place = table(tmp_path / "a.csv", time=times(), motor=motor, torque=current)
    (ramps,) = measured(place, "--torque-unit=A", "--drive", drive)
    assert lost(ramps) == pytest.approx(LOST, rel=0.01)
    bag = PlainBag()
    for time, angle, command in zip(times(), motor, current, strict=True):
        bag.sample("/joint_states", float(time), ("motor",), (float(angle),))
        bag.numbers("/command", float(time), [float(command)], answers=float(time))
    place = bag.write(tmp_path / "bag", StoragePlugin.MCAP)
    (ramps,) = measured(place, "--torque-unit=A", "--drive", drive, "--load-joint=")
    assert lost(ramps) == pytest.approx(LOST, rel=0.01)


@pytest.mark.parametrize(
    ("columns", "options", "code", "says"),
    [
        ({"load": locked(RAMPS)}, [], 2, "must have one column 'torque', has 0"),
        ({"load": locked(RAMPS)}, [], 2, "--torque-column names another"),
        ({"torque": RAMPS}, [], 2, "there must be column 'motor' or column 'load'"),
        ({"load": locked(RAMPS), "torque": RAMPS}, ["--load-column=x"], 2, "must have one column 'x', has 0"),
        ({"motor": locked(RAMPS), "torque": RAMPS}, [], 2, "argument --reduction: must be given, or --drive"),
        ({"load": locked(RAMPS), "torque": RAMPS}, ["--torque-unit=A"], 2, "argument --drive: must be given"),
        ({"load": locked(RAMPS), "torque": RAMPS}, ["--to=3"], 2, "there must be column 'time'"),
        ({"load": locked(RAMPS), "torque": RAMPS}, ["--stamps=log"], 2, "argument --stamps: is for bags"),
        ({"load": locked(RAMPS), "torque": RAMPS}, ["--rated-torque=0"], 2, "must be a number > 0, got '0'"),
        ({"load": locked(RAMPS), "torque": np.abs(RAMPS)}, [], 1, "must go to both sides of zero"),
        ({"load": -locked(RAMPS), "torque": RAMPS}, [], 1, "the angle falls while the torque rises"),
        (
            {"motor": locked(RAMPS), "load": 0.4 * locked(RAMPS), "torque": RAMPS},
            ["--motor-at=output"],
            1,
            "load moved",
        ),
    ],
)
def test_what_cannot_be_used_is_said(
    columns: dict[str, Array],
    options: list[str],
    code: int,
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    place = table(tmp_path / "a.csv", **columns)
    try:
        ended: object = main(["lost-motion", str(place), *options])
    except SystemExit as error:
        ended = error.code
    printed = capsys.readouterr()
    assert ended == code
    assert says in printed.out + printed.err


@pytest.mark.skipif(not REAL.is_dir(), reason="needs recordings that are not part of the project")
@pytest.mark.parametrize("torque", ["TORQUE", "CONTROL_TORQUE"])
@pytest.mark.parametrize(
    ("name", "degrees"), [("base_init5", 2.51), ("conic_init5", 0.81), ("base910_unr_runin5", 1.22)]
)
def test_real_gears(name: str, degrees: float, torque: str, tmp_path: Path) -> None:
    place = tmp_path / f"{name}.csv"
    place.symlink_to(REAL / f"{name}.csv")
    options = ["--time-column=TIME", "--motor-column=POSITION", "--motor-unit=turns", "--motor-at=output"]
    found = measured(place, *options, f"--torque-column={torque}", "--rated-torque=40")
    small, large = found
    assert small["number"] == 5
    assert large["number"] in {2, 3}
    assert math.degrees(lost(small)) == pytest.approx(degrees, rel=0.03)
    figure = small["at_zero"]
    assert isinstance(figure, dict)
    assert 0.0 < math.degrees(figure["uncertainty"]) < 0.03 * degrees
    assert 0.0 < math.degrees(figure["spread"]) < 0.1 * degrees
