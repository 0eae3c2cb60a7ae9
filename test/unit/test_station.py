"""What runs on behalf of a page: motions, and the pages that its work leaves behind."""

import asyncio
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from backlash_ros.dashboard import station as module
from backlash_ros.dashboard.graph import Graph
from backlash_ros.dashboard.motion import Wave
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


class Browser:
    """Answers a few times, then no more, or fails; or for ever."""

    def __init__(self, times: float = float("inf"), fails: bool = False) -> None:
        self.times, self.fails = times, fails

    async def answers(self) -> bool:
        self.times -= 1
        await asyncio.sleep(0)
        if self.fails and self.times < 0:
            raise RuntimeError("as a library may")
        return self.times >= 0


async def until(condition: Any) -> None:
    async def look() -> None:
        while not condition():
            await asyncio.sleep(0.01)

    await asyncio.wait_for(look(), 60)


@pytest.mark.parametrize("how", ["no answer", "error", "closed", "asked", "another one"])
def test_a_motion_ends_with_its_page_and_says_so(tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_LOOK", 0.05)
    sent: list[float] = []
    axes = {"/": SimpleNamespace(move=sent.append)}
    station = Station(cast("Any", SimpleNamespace(axes=axes)), tmp_path, InTurn())
    sine = Wave(middle=0.0, amplitude=1.0, period=1.0, smooth=True)

    async def scene() -> None:
        browser = Browser(3 if how in {"no answer", "error"} else float("inf"), how == "error")
        station.begin("/", sine, browser)
        await until(lambda: len(sent) > 2)
        assert station.of("/").ended == ""
        tasks = station.of("/").motion
        station.left(Browser())  # of a page that moves nothing
        await asyncio.sleep(0)
        assert not any(task.done() for task in tasks)
        if how == "closed":
            station.left(browser)
        elif how == "asked":
            station.end("/")
        elif how == "another one":
            station.begin("/", Wave(5.0, 1.0, 1.0, smooth=False), browser)
        await until(lambda: all(task.done() for task in tasks))
        count = len(sent)
        await asyncio.sleep(0.1)
        if how == "another one":
            assert set(sent[count:]) <= {4.0, 6.0}
            station.end("/")
        else:
            assert len(sent) == count
        assert ("the page" in station.of("/").ended) == (how in {"no answer", "error", "closed"})

    asyncio.run(scene())


def test_a_node_whose_name_has_not_come_yet_has_no_topics() -> None:
    """A publisher may be known before its node is; asking for such a node ended the dashboard."""

    def ask(_name: str, namespace: str) -> list[tuple[str, list[str]]]:
        raise ValueError(namespace)

    assert Graph._topics(ask, "_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_") == {}
    assert Graph._topics(lambda *_: [("/command", ["kind"])], "drive", "/") == {"kind": "/command"}
