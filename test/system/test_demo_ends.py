"""What the demo does beside its run: how it ends on a signal, and where it puts its results."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from backlash_ros.demo.__main__ import main, put_in_place
from backlash_ros.foundation.staging import staging

ROOT = Path(__file__).parents[2]
DEMO = [sys.executable, "-m", "backlash_ros.demo"]


@pytest.mark.grid
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_everything_and_leaves_nothing(tmp_path: Path, number: signal.Signals) -> None:
    process = subprocess.Popen(
        [*DEMO, "--out", str(tmp_path / "out")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if "learning the backlash" in line:
            break
    children = children_of(process.pid)
    assert len(children) >= 3, lines
    process.send_signal(number)
    assert process.wait(timeout=60) == 130
    assert "stopped; nothing was written" in process.stdout.read()
    deadline = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in children):
        assert time.monotonic() < deadline, "a node outlived the demo"
        time.sleep(0.05)
    assert list(tmp_path.iterdir()) == []


def children_of(pid: int) -> list[int]:
    return [
        int(word) for task in Path(f"/proc/{pid}/task").iterdir() for word in (task / "children").read_text().split()
    ]


def test_new_results_replace_the_old_ones_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, finished = tmp_path / "out", tmp_path / "finished"
    for folder, text in ((out, "old"), (finished, "new")):
        folder.mkdir()
        (folder / "summary.json").write_text(text)
    original = Path.rename

    def interrupted(self: Path, target: Path) -> Path:
        if self == finished:
            raise KeyboardInterrupt
        return original(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", interrupted)
        with pytest.raises(KeyboardInterrupt):
            put_in_place(finished, out)
    assert (out / "summary.json").read_text() == "old"
    put_in_place(finished, out)
    assert (out / "summary.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.fixture
def signals() -> Iterator[None]:
    """Put back the handlers that the command takes."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_folder_of_somebody_else_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], signals: None
) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(SystemExit, match="2"):
        main(["--out", str(tmp_path)])
    assert "argument --out: must be a new or empty folder" in capsys.readouterr().err
    assert (tmp_path / "thesis.tex").read_text() == "precious"


@pytest.mark.parametrize(
    ("out", "reason"),
    [("file", "must be a new or empty folder"), ("file/out", "File exists"), ("new/" + "x" * 300, "too long")],
    ids=["a_file", "no_folder", "long_name"],
)
def test_place_that_cannot_be_written_is_told_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], signals: None, out: str, reason: str
) -> None:
    (tmp_path / "file").write_text("precious")
    with pytest.raises(SystemExit, match="2"):
        main(["--out", str(tmp_path / out)])
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert line.startswith("backlash demo: argument --out: ")
    assert reason in line
    assert said.out == ""
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"file": "precious"}


def test_longest_name_is_replaced_too(tmp_path: Path) -> None:
    out = tmp_path / ("x" * 255)
    for text in ("old", "new"):
        with staging(out) as folder:
            (folder / "summary.json").write_text(text)
            put_in_place(folder, out)
    assert (out / "summary.json").read_text() == "new"
    assert list(tmp_path.iterdir()) == [out]
