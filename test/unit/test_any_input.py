"""No input of any command ends in a traceback or in Python's words: files and options made from a seed."""

import re
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path

import any_input
import pytest

from backlash_ros import cli
from backlash_ros.commands import design as designer
from backlash_ros.commands import evaluate as evaluating
from backlash_ros.studies.design.search import NothingQuietError

QUICK, MANY, PART = 50, 2000, 100
"""Number of inputs here and in the grid, and of those in one of its tests."""
DRIVE = str(Path(__file__).parents[2] / "config" / "nominal_drive.yaml")
PYTHON = re.compile(
    r"Traceback|\[Errno|codec|NoneType|object is|object has|invalid literal|could not convert|argument must be|"
    r"unsupported operand|not iterable|subscriptable|unhashable type|datetime\.|PosixPath|<class|\bNone\b|Warning|"
    r"positional argument|unexpected keyword|<lambda>|list index|KeyError|out of range for|buffer|not supported between"
)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return any_input.bags(tmp_path_factory.mktemp("bags"))


def fault_of(words: Sequence[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return what is wrong with how a command ended; empty if nothing is."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", RuntimeWarning)
        try:
            code: object = cli.main(words)
        except SystemExit as ended:
            code = ended.code or 0
        except Exception as error:
            capsys.readouterr()
            return f"{type(error).__name__}: {error}"
    printed, said = capsys.readouterr()
    numeric = [str(each.message) for each in warned if issubclass(each.category, RuntimeWarning)]
    if numeric:
        return f"warned: {numeric[0]}"
    if found := PYTHON.search(said + (printed if code else "")):
        return f"says {found[0]!r}: {said or printed}"
    if code not in {0, 1, 2} or (code == 2 and (said.count("\n") != 1 or not said.startswith("backlash"))):
        return f"ended with {code}: {said}"
    return "" if code != 1 or said or printed else "ended with 1 and said nothing"


def faults_of(
    seeds: Sequence[int],
    bags: Sequence[Path],
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> list[str]:
    """Run a command for each seed; those that would take minutes end when their input has been judged."""

    def nothing_quiet(*_: object) -> None:
        raise NothingQuietError("not searched here")

    monkeypatch.setattr(designer, "design", nothing_quiet)
    monkeypatch.setattr(evaluating, "replay", lambda *_: None)
    found = []
    for seed in seeds:
        place = folder / str(seed)
        place.mkdir()
        monkeypatch.chdir(place)
        words = any_input.command(seed, place, bags)
        if why := fault_of(words, capsys):
            found.append(f"seed {seed}: backlash {' '.join(words)}\n    {why}")
        monkeypatch.chdir(folder)
        shutil.rmtree(place)
    return found


@pytest.mark.parametrize(
    "words",
    [
        *(["check"], ["design"], ["simulate"], ["export", "--format=sdf"], ["identify"], ["report"], ["replay"]),
        ["lost-motion"],
        *(["simulate", DRIVE, "--trajectory"], ["setup", "--answers"]),
        *(["evaluate", "--seed=1", "--only=0", "--drive"], ["identify", "nowhere", "--drive"]),
    ],
)
@pytest.mark.parametrize(
    ("place", "reason"),
    [("nowhere", "No such file or directory"), ("file/x", "Not a directory"), ("x" * 300, "too long")],
)
def test_every_command_says_alike_which_file_is_missing(
    words: list[str],
    place: str,
    reason: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit, match="2"):
        cli.main([*words, place])
    assert re.fullmatch(f"backlash {words[0]}: {place}: .*{reason}\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["check", "."], "check: .: Is a directory"),
        (["check", "noise"], "check: noise: byte 0 is no text in UTF-8"),
        (["identify", "noise"], "identify: noise, row 1: must be text in UTF-8, byte 0 is not"),
        (["report", "noise"], "report: noise: is a table, not a rosbag2"),
        (["measure", "--namespace", "bad name"], "measure: argument --namespace: must be a namespace of ROS such as"),
        (["measure", "--out", "."], "measure: argument --out: must be a new folder, got '.', which exists"),
        (["live", "--port", "80808080"], "live: argument --port: must be a whole number from 0 to 65535"),
        (["live", "--drive", "none"], "live: argument --drive: must be a file, got 'none'"),
        (["live", "--drive", "noise"], "live: noise: byte 0 is no text in UTF-8"),
        (["live", "--out", "noise"], "live: argument --out: must be a folder, got 'noise': File exists"),
        (["demo", "--out", "noise/x"], "demo: argument --out: must be writable, got 'noise/x': File exists"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    words: list[str],
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "noise").write_bytes(b"\xff\x00noise")
    with pytest.raises(SystemExit, match="2"):
        cli.main(words)
    printed, said = capsys.readouterr()
    assert said.startswith(f"backlash {says}")
    assert (printed, said.count("\n")) == ("", 1)


def test_no_input_ends_in_a_traceback_or_in_pythons_words(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    assert faults_of(range(QUICK), bags, tmp_path, capsys, monkeypatch) == []


@pytest.mark.grid
@pytest.mark.parametrize("first", range(0, MANY, PART))
def test_none_of_many_inputs_does(
    first: int, bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    assert faults_of(range(QUICK + first, QUICK + first + PART), bags, tmp_path, capsys, monkeypatch) == []
