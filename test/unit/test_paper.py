"""The committed page and figures are what the command writes now; the command works."""

import errno
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backlash_ros.cli import main
from backlash_ros.commands import figures as command
from backlash_ros.control import LAWS
from backlash_ros.pages.paper.page import write_page
from backlash_ros.studies import figures
from backlash_ros.studies.figures import FIGURES
from backlash_ros.studies.paper import CASES, NOISY, respond

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    command = [
        sys.executable,
        "-m",
        "backlash_ros.cli",
        "figures",
        "--out",
        str(folder),
        "--page",
        str(folder / "page.md"),
    ]
    done = subprocess.run(command, cwd=DOCS.parent, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def flat(value: Any, path: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        return {k: v for name, item in value.items() for k, v in flat(item, f"{path}/{name}").items()}
    if isinstance(value, list):
        return {k: v for index, item in enumerate(value) for k, v in flat(item, f"{path}/{index}").items()}
    return {path: value}


@pytest.mark.grid  # half a minute: all of the paper, computed again
@pytest.mark.population
def test_committed_numbers_are_what_the_command_computes(fresh: Path) -> None:
    """Beyond numeric noise: limit cycles amplify rounding, so that sums over thousands of impacts differ a little."""
    committed = flat(json.loads((DOCS / "figures" / "figures.json").read_text()))
    computed = flat(json.loads((fresh / "figures.json").read_text()))
    assert committed.keys() == computed.keys()
    for path, value in computed.items():
        if isinstance(value, float):
            assert committed[path] == pytest.approx(value, rel=0.01, abs=2e-3), path
        elif path.endswith("impacts_after_switch"):
            assert committed[path] == pytest.approx(value, rel=0.01, abs=1), path
        else:
            assert committed[path] == value, path


def test_committed_page_is_written_from_the_committed_numbers() -> None:
    numbers = json.loads((DOCS / "figures" / "figures.json").read_text())
    assert (DOCS / "paper.md").read_text() == write_page(numbers)


def test_verdicts_follow_the_numbers() -> None:
    numbers = json.loads((DOCS / "figures" / "figures.json").read_text())
    rows = [line for line in write_page(numbers).splitlines() if line.startswith("| [Fig. 11]")]
    assert [row.split(" | ")[-1] for row in rows] == ["holds |"]
    numbers["table"]["two_region"]["1 % noise"]["residual_b"] = 1.0
    page = write_page(numbers)
    rows = [line for line in page.splitlines() if line.startswith("| [Fig. 11]")]
    assert [row.split(" | ")[-1] for row in rows] == ["does not hold |"]
    assert page.count("**Verdict: does not hold.**") == 1


def test_what_the_encoder_says_is_the_true_angle_and_the_noise() -> None:
    exact, noisy = (respond("two_region", CASES[name], 0.4) for name in ("nominal", "1 % noise"))
    assert np.array_equal(exact.measured_load_angle, exact.load_angle[:-1])
    noise = noisy.measured_load_angle - noisy.load_angle[:-1]
    assert np.max(np.abs(noise)) <= NOISY.load_noise
    assert np.std(noise) == pytest.approx(NOISY.load_noise / math.sqrt(3), rel=0.1)


@pytest.mark.grid
def test_every_figure_is_written_and_committed(fresh: Path) -> None:
    for name in FIGURES:
        for folder in (fresh, DOCS / "figures"):
            assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
            assert "<svg" in (folder / f"{name}.svg").read_text()
        assert f"figures/{name}.png" in (DOCS / "paper.md").read_text()


@pytest.mark.grid
def test_table_has_every_law_under_every_condition(fresh: Path) -> None:
    numbers = json.loads((fresh / "figures.json").read_text())
    assert set(numbers["table"]) == set(LAWS)
    for row in numbers["table"].values():
        assert set(row) == set(CASES)
        for cell in row.values():
            assert all(value is None or math.isfinite(value) for value in cell.values())


@pytest.mark.grid
def test_what_the_paper_claims_of_its_law_holds_here(fresh: Path) -> None:
    table = json.loads((fresh / "figures.json").read_text())["table"]
    fast, both = table["fast"]["nominal"], table["two_region"]["nominal"]
    assert both["rise_time_s"] <= 1.05 * fast["rise_time_s"]
    assert both["residual_b"] < 0.05
    assert fast["residual_b"] > 0.7
    assert both["impacts_after_switch"] <= 2
    assert table["two_region"]["load inertia x4"]["residual_b"] > 0.3  # and where it does not, that shows


def test_simulate_prints_one_run_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--law", "cascade", "--case", "backlash x5"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["law"] == "cascade"
    assert printed["residual_b"] < 0.05


@pytest.mark.parametrize("wrong", [["simulate", "--law", "magic"], ["figures"], []])
def test_wrong_arguments_end_with_code_2(wrong: list[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(wrong)
    assert end.value.code == 2


@pytest.mark.parametrize(
    ("out", "page", "reason"),
    [
        ("file/out", "page.md", "File exists"),
        ("new/" + "x" * 300, "page.md", "File name too long"),
        ("out", "new/folder/" + "x" * 300, "File name too long"),
        ("out", ".", "Is a directory"),
    ],
    ids=["no_folder", "long_out", "long_page", "page_is_a_folder"],
)
def test_place_that_cannot_be_written_is_told_before_anything_is_computed(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    out: str,
    page: str,
    reason: str,
) -> None:
    monkeypatch.setattr(command, "reproduce", lambda _: pytest.fail("computed for nothing"))
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit, match="2"):
        main(["figures", "--out", str(tmp_path / out), "--page", str(tmp_path / page)])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("backlash figures: ")
    assert reason in line
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_figures_that_fail_leave_the_old_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_done: object, folder: Path, _progress: object) -> None:
        (folder / "fig07_open_loop.png").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(command, "reproduce", lambda _: None)
    monkeypatch.setattr(figures, "draw", full)
    (tmp_path / "fig07_open_loop.png").write_text("old")
    with pytest.raises(SystemExit, match="2"):
        main(["figures", "--out", str(tmp_path)])
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"fig07_open_loop.png": "old"}
