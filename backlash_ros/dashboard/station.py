"""Shared by all pages: the axes, their samples for the browsers, and what runs on behalf of a page."""

import asyncio
import math
import re
import subprocess
import sys
import time
from collections import deque
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from lifecycle_msgs.msg import Transition

from backlash_ros.dashboard.axis import EXPERIMENT, Answer, Axis
from backlash_ros.dashboard.graph import Graph
from backlash_ros.dashboard.jog import Hand, jog
from backlash_ros.dashboard.motion import Wave, wave
from backlash_ros.dashboard.rows import frame
from backlash_ros.dashboard.state import Run
from backlash_ros.measure import CERTIFICATE
from backlash_ros.ros.client import start_node, stop_node

PICTURE = 0.05
"""Time between two frames, s."""
_BEHIND = 40
"""Largest number of frames that wait for a browser; older ones are dropped."""
_LOOK = 1.0
"""Period of the checks that the browser of a motion is still connected, s."""
_LEFT = "the motion has ended: the page that began it was closed, or did not answer"


class Mover(Protocol):
    """The page that began a motion, which ends with it."""

    async def answers(self) -> bool:
        """Return whether its browser still answers."""


class Watcher:
    """The frames that wait for a browser that watches an axis."""

    def __init__(self) -> None:
        self._waiting: deque[bytes] = deque(maxlen=_BEHIND)
        self._there = asyncio.Event()

    def put(self, one: bytes) -> None:
        """Add a frame; if too many wait, drop the oldest."""
        self._waiting.append(one)
        self._there.set()

    async def get(self) -> bytes:
        """Return the next frame."""
        while not self._waiting:
            self._there.clear()
            await self._there.wait()
        return self._waiting.popleft()


@dataclass
class Work:
    """A process on behalf of a page, such as a recorder, with the folder or file that it writes, and its output."""

    process: "subprocess.Popen[bytes]"
    result: Path
    log: Path

    @property
    def running(self) -> bool:
        """Whether it still runs."""
        return self.process.poll() is None

    @property
    def size(self) -> int:
        """Bytes in the folder that it writes."""
        with suppress(OSError):
            return sum(file.stat().st_size for file in self.result.rglob("*") if file.is_file())
        return 0

    def last_line(self) -> str:
        """Return the last line of its output."""
        with suppress(OSError):
            lines = self.log.read_text(errors="replace").split("\n")
            return next((line.strip() for line in reversed(lines) if line.strip()), "")
        return ""


def _run(result: Path, *words: str) -> Work:
    """Start `backlash` with these arguments."""
    log = result.with_suffix(".log")
    with log.open("wb") as output:
        command = [sys.executable, "-m", "backlash_ros.cli", *words]
        return Work(subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT), result, log)


@dataclass
class OfAxis:
    """What runs on behalf of one axis."""

    watchers: set[Watcher] = field(default_factory=set)
    motion: "tuple[asyncio.Task[Any], ...]" = ()
    mover: Mover | None = None
    wave: Wave | None = None
    ended: str = ""
    stopped: str = ""
    run: Run | None = None
    recorder: Work | None = None
    measurement: Work | None = None
    report: Work | None = None


class Station:
    """The axes, and what runs on their behalf, all in the event loop of the server.

    ``starting`` starts processes that must keep up with the drive: they inherit the priority of its threads.
    """

    def __init__(self, graph: Graph, folder: Path, starting: Executor) -> None:
        self.graph, self.folder, self._starting = graph, folder, starting
        self._of: dict[str, OfAxis] = {}

    @property
    def axes(self) -> dict[str, Axis]:
        """The axes by title."""
        return self.graph.axes

    def of(self, title: str) -> OfAxis:
        """Return what runs on behalf of an axis."""
        return self._of.setdefault(title, OfAxis())

    async def run(self) -> None:
        """Send new samples to all browsers, until cancelled."""
        while True:
            for title, axis in list(self.axes.items()):
                watchers = self.of(title).watchers
                if not watchers:
                    continue
                samples, states = axis.take()
                if len(samples) or len(states):
                    one = frame(samples, states)
                    for watcher in watchers:
                        watcher.put(one)
            await asyncio.sleep(PICTURE)

    # Motion.

    def begin(self, title: str, what: Wave, mover: Mover) -> None:
        """Send the references of a wave from now on, in place of any other, on behalf of the page ``mover``."""
        self.end(title)
        axis = self.of(title)
        axis.mover, axis.wave = mover, what
        axis.motion = tuple(map(asyncio.create_task, (wave(what, self.axes[title].move), self._attend(title, mover))))

    async def _attend(self, title: str, mover: Mover) -> None:
        try:
            while await mover.answers():
                await asyncio.sleep(_LOOK)
        finally:  # whatever went wrong
            if asyncio.current_task() in self.of(title).motion:
                self.left(mover)

    async def jog(self, title: str, way: int, share: float, hand: Hand) -> str:
        """Move the load while the hand holds, in place of any other motion; return why it moves no more.

        Empty if it was let go, or another motion took its place.
        """
        if title not in self.axes:
            return f"there is no axis {title}"
        self.end(title)
        axis, moving = self.of(title), asyncio.create_task(jog(self.axes[title], way, share, hand))
        axis.motion, axis.mover = (moving,), None
        try:
            await asyncio.wait(axis.motion)
        finally:
            moving.cancel()
            if axis.motion == (moving,):
                axis.motion = ()
        return "" if moving.cancelled() else moving.result()

    def end(self, title: str) -> None:
        """Stop sending references or setpoints: the last reference stays, a jog comes to rest."""
        axis = self.of(title)
        motion, axis.motion, axis.wave, axis.ended = axis.motion, (), None, ""
        for task in motion:
            task.cancel()

    def left(self, mover: Mover) -> None:
        """End the motions of a page whose browser is gone, and tell all pages."""
        for title, axis in self._of.items():
            if axis.motion and axis.mover is mover:
                self.end(title)
                axis.ended = _LEFT

    async def stop(self, title: str) -> Answer:
        """Take the power off: deactivate the controller, whose last command is 0."""
        axis = self.axes.get(title)
        if axis is None:
            return Answer(False, f"there is no axis {title}")
        self.end(title)
        answer = await axis.change(Transition.TRANSITION_DEACTIVATE)
        if answer.success:
            self.of(title).stopped = "stopped: 0 V; activate to go on"
            return Answer(True, self.of(title).stopped)
        if axis.lifecycle in {"inactive", "unconfigured", "finalized"}:
            return Answer(True, f"the controller is {axis.lifecycle}: it sends no commands")
        return answer

    # Experiments.

    async def experiment(self, title: str, service: str) -> Answer:
        """Let the controller ``learn`` or ``identify``; all pages see that it runs."""
        self.end(title)
        axis = self.of(title)
        if axis.run is not None:
            return Answer(False, f"cannot {service}: a run is already in progress")
        axis.run = Run(service)
        try:
            return await self.axes[title].call(service, EXPERIMENT)
        finally:
            axis.run = None

    # Processes.

    def _new_folder(self, title: str, what: str) -> Path:
        self.folder.mkdir(parents=True, exist_ok=True)
        axis = re.sub(r"\W+", "_", title).strip("_")
        name = "_".join(filter(None, (what, axis, time.strftime("%Y-%m-%d_%H-%M-%S"))))
        return self.folder / name

    def record(self, title: str) -> None:
        """Start a recorder for an axis."""
        folder = self._new_folder(title, "recording")
        log = folder.with_suffix(".log")
        namespace = self.axes[title].names.controller.rpartition("/")[0] or "/"
        words = ["-p", f"output:={folder}", "-r", f"__ns:={namespace}"]
        process = self._starting.submit(start_node, "recorder", log, *words).result()
        self.of(title).recorder = Work(process, folder, log)

    def measure(self, title: str) -> None:
        """Start `backlash measure` for an axis."""
        folder = self._new_folder(title, "measurement")
        namespace = self.axes[title].names.controller.rpartition("/")[0] or "/"
        words = ["measure", "--out", str(folder), "--namespace", namespace]
        self.of(title).measurement = self._starting.submit(_run, folder, *words).result()

    def report(self, title: str) -> None:
        """Start `backlash report` for the last recording of an axis."""
        running = self.of(title)
        if running.recorder is not None:
            bag = running.recorder.result
            page = bag.with_name(f"{bag.name}.html")
            running.report = _run(page, "report", str(bag), "--out", str(page), "--force")

    def page(self, title: str, kind: str) -> Path | None:
        """Return the page of the last measurement or report of an axis, or None."""
        running = self.of(title)
        work = {"certificate": running.measurement, "report": running.report}.get(kind)
        if work is None or work.running:
            return None
        place = work.result / CERTIFICATE if kind == "certificate" else work.result
        return place if place.is_file() else None

    async def close(self) -> None:
        """End everything: recordings are completed, motions end, experiments that a page started are cancelled."""
        for title, running in self._of.items():
            self.end(title)
            for work in (running.measurement, running.recorder, running.report):
                if work is not None and work.running:
                    await asyncio.to_thread(stop_node, work.process)


def megabytes(size: int) -> str:
    """Return a size in words."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.0f} kB"


def finite(value: float, otherwise: float = 0.0) -> float:
    """Return ``value`` if it is finite."""
    return value if math.isfinite(value) else otherwise
