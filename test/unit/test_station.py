"""What runs on behalf of a page: the pages that its work leaves behind."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from backlash_ros.dashboard.station import Station, Work
from backlash_ros.measure import CERTIFICATE
from backlash_ros.ros.aside import InTurn

WAITS = [sys.executable, "-c", "input()"]


def work_of(folder: Path, result: Path) -> Work:
    """Return work that is done once its process is let go."""
    return Work(subprocess.Popen(WAITS, stdin=subprocess.PIPE), result, folder / "log")


@pytest.mark.parametrize("kind", ["certificate", "report"])
def test_a_page_is_there_once_the_work_is_done_and_has_left_it(tmp_path: Path, kind: str) -> None:
    station = Station(cast("Any", SimpleNamespace(axes={})), tmp_path, InTurn())
    assert station.page("/", kind) is None
    result = tmp_path / "result"
    work = work_of(tmp_path, result)
    if kind == "certificate":
        station.of("/").measurement, left = work, result / CERTIFICATE
        result.mkdir()
    else:
        station.of("/").report, left = work, result
    left.write_text("")
    assert station.page("/", kind) is None  # may be half of it
    work.process.communicate(b"\n", timeout=60)
    assert station.page("/", kind) == left
    assert station.page("/other", kind) is None
    assert station.page("/", "log") is None
    left.unlink()
    assert station.page("/", kind) is None  # it failed
