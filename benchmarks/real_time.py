"""Does the pair of processes keep up with real time? Plain counts from their own diagnostics and from /proc.

    real_time.py soak       one axis for minutes: samples lost, answers late, memory grown; exit code 0 if it held
    real_time.py axes       six axes in one pair of processes, beside one axis alone: answered within the period
    real_time.py lockstep   how many times faster than real time a simulated minute runs
    real_time.py identify   one axis while it identifies its drive, fit and all, beside the same axis while it holds
    real_time.py dashboard  one axis at 1 kHz, by itself and while ten pages read every sample, in turns
    real_time.py step       the controller's step, sample to answer published, beside a plain node that only publishes

Run with `make soak` and `make bench`. What else the machine does counts here, so how late a bare sleep wakes up stands
beside the figures: nothing on this machine does better.
"""

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from backlash_ros.ros.isolation import isolated
from backlash_ros.ros.messages import answer, stamp_label
from backlash_ros.ros.topics import RECEIVE, SEND

SIX_AXES = Path(__file__).parents[1] / "config" / "six_axes.yaml"
AXES = [f"axis{k}" for k in range(1, 7)]
TARGETS = (1.0, -0.5, 0.25, 2.0)
PATIENCE = 60.0
PERIOD = 0.004
TURNS = 4
NOTHING_LOST = [
    *("-p", "qos_overrides./joint_states.publisher.depth:=100"),
    *("-p", "qos_overrides./joint_states.subscription.reliability:=reliable"),
    *("-p", "qos_overrides./joint_states.subscription.depth:=100"),
]
"""What makes the controller see every sample, however late: by default it takes the newest and leaves out the rest."""
PATIENT = ["-p", "command_timeout:=0.5", "-p", "state_timeout:=0.5"]
"""Watchdogs of the soak: a shared machine stops a process for more than the 0.1 s of the defaults now and then."""
WARM_UP = 5.0
"""After the start discovery goes on and the interpreter settles, s."""
GROWTH = 1024
"""Growth of a process's memory after the first minute that still counts as none, kB."""


class Nodes:
    """A process of this package's nodes, and what /proc says of it."""

    def __init__(self, name: str, log: Path, words: Sequence[str]) -> None:
        self.name, self._log = name, log
        command = [sys.executable, "-m", f"backlash_ros.nodes.{name}", *words]
        with log.open("wb") as output:
            self._process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        self._proc = Path("/proc") / str(self._process.pid)

    def memory(self) -> int:
        """Return the resident memory, kB; RuntimeError where the process has ended."""
        if self._process.poll() is not None:
            raise RuntimeError(f"{self.name} has ended\n{self._log.read_text(errors='replace')}")
        status = (self._proc / "status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])

    def processor_time(self) -> float:
        """Return the time spent on processors so far, s."""
        user, system = (self._proc / "stat").read_text().rsplit(")", 1)[1].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """End as Ctrl-C does; RuntimeError with the log where that is not a clean end."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            code: int | str = self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = "not ending"
        if code != 0:
            raise RuntimeError(f"{self.name}: {code}\n{self._log.read_text(errors='replace')}")


class Graph:
    """Where the benchmark listens: the diagnostics as they were last said, and the references."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("benchmark", context=self.context)
        self.said: dict[str, dict[str, Any]] = {}
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        at = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        for status in message.status:
            self.said[status.name] = {"at": at} | {pair.key: pair.value for pair in status.values}

    def wait(self, what: str, condition: Callable[[], Any], seconds: float = PATIENCE) -> None:
        """Spin until ``condition`` holds."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"waited {seconds:g} s for {what}")
            self._executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def move(self, axes: Sequence[str], seconds: float) -> None:
        """Listen, and give each axis a new reference every two seconds."""
        references = [self.node.create_publisher(Float64, f"{axis}/reference", 1) for axis in axes]
        end, k = time.monotonic() + seconds, 0
        while (left := end - time.monotonic()) > 0:
            for reference in references:
                reference.publish(Float64(data=TARGETS[k % len(TARGETS)]))
            self.spin(min(2.0, left))
            k += 1
        for reference in references:
            self.node.destroy_publisher(reference)

    def change(self, node: str, transition: int) -> None:
        """Take a managed node through a transition."""
        client = self.node.create_client(ChangeState, f"{node}/change_state")
        self.wait(f"the lifecycle service of {node}", client.service_is_ready)
        future = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        self.wait(f"transition {transition} of {node}", future.done)
        if not future.result().success:
            raise RuntimeError(f"transition {transition} of {node} was refused")

    def fresh(self, *names: str) -> list[dict[str, Any]]:
        """Return what the diagnostics named say next."""
        old = {name: self.said.get(name, {}).get("at") for name in names}
        self.wait("diagnostics", lambda: all(self.said.get(name, {}).get("at") != old[name] for name in names))
        return [self.said[name] for name in names]

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def stolen() -> tuple[int, int]:
    """Return the ticks in which others on the same hardware ran instead of this machine, and all ticks that it ran."""
    ticks = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return ticks[7], sum(ticks) - ticks[3] - ticks[4]


class BareSleep:
    """A thread that only sleeps, a period at a time: what this machine loses without any of us."""

    def __init__(self) -> None:
        self._began = stolen()
        self._late = self._count = 0
        self._longest = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._sleep)
        self._thread.start()

    def _sleep(self) -> None:
        while not self._ended.is_set():
            began = time.monotonic()
            time.sleep(PERIOD)
            late = time.monotonic() - began - PERIOD
            self._count += 1
            self._late += late > PERIOD
            self._longest = max(self._longest, late)

    def stop(self) -> dict[str, float]:
        """End and say what was seen."""
        self._ended.set()
        self._thread.join()
        steal, ran = (b - a for a, b in zip(self._began, stolen(), strict=True))
        return {
            "processor time stolen by other machines, %": round(100 * steal / ran, 1),
            "bare sleep late by more than a period, %": round(100 * self._late / self._count, 2),
            "bare sleep late at most, ms": round(1e3 * self._longest, 1),
        }


class Plain:
    """A plain node that publishes an answer to each sample, while it is its turn."""

    def __init__(self, graph: Graph) -> None:
        self.times: list[float] = []
        self.turn = False
        self._publisher = graph.node.create_publisher(Float64MultiArray, "command", SEND)
        graph.node.create_subscription(JointState, "joint_states", self._on_sample, RECEIVE)

    def _on_sample(self, sample: JointState) -> None:
        if self.turn:
            message = answer(0.0, stamp_label(sample.header.stamp))
            began = time.perf_counter()
            self._publisher.publish(message)
            self.times.append(time.perf_counter() - began)


@contextlib.contextmanager
def pair(simulator: Sequence[str], controller: Sequence[str]) -> Iterator[tuple[Graph, Nodes, Nodes]]:
    """Run simulator and controller with these arguments on a domain of their own."""
    with isolated(), tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        graph = Graph()
        stack.callback(graph.close)
        made = []
        for name, words in (("controller", controller), ("plant_simulator", simulator)):
            made.append(Nodes(name, Path(folder) / name, words))
            stack.callback(made[-1].stop)
        yield graph, made[1], made[0]


def soak(minutes: float, extra: Sequence[str]) -> tuple[dict[str, Any], bool]:
    """Run one axis for minutes; nothing may be lost and memory must not grow."""
    words = ["--ros-args", "-p", "backlash_angle:=0.02", *PATIENT, *extra]
    with pair([*words, "-p", "autostart:=false"], words) as (graph, simulator, controller):
        # Counting begins with the first sample, once everybody has found everybody.
        graph.change("/plant_simulator", Transition.TRANSITION_CONFIGURE)
        graph.fresh("/controller: timing")
        graph.spin(WARM_UP)
        graph.change("/plant_simulator", Transition.TRANSITION_ACTIVATE)
        first = min(60.0, 30.0 * minutes)
        graph.move([""], first)
        before = simulator.memory(), controller.memory()
        graph.move([""], 60.0 * minutes - first)
        after = simulator.memory(), controller.memory()
        faults = [said["fault"] for said in graph.fresh("/plant_simulator: drive", "/controller: servo")]
        graph.change("/plant_simulator", Transition.TRANSITION_DEACTIVATE)  # so that both have counted the same
        graph.fresh("/plant_simulator: timing")
        sent, received = graph.fresh("/plant_simulator: timing", "/controller: servo")
    samples, answered = int(sent["samples"]), int(received["samples_answered"])
    figures = {
        "minutes": minutes,
        "samples published": samples,
        "samples received": answered,
        "samples lost": samples - answered,
        "answered within the period": int(sent["answered_in_period"]),
        "answered late": int(sent["answered_late"]),
        "late samples": int(sent["late_samples"]),
        "faults": ", ".join(filter(None, faults)) or "none",
    }
    held = figures["samples lost"] == 0 and not any(faults)
    for process, one, two in zip(("simulator", "controller"), before, after, strict=True):
        figures[f"memory of the {process} after {first:g} s, kB"] = one
        figures[f"memory of the {process} at the end, kB"] = two
        held = held and two - one <= GROWTH
    return figures, held


def answered(axes: Sequence[str], seconds: float, extra: Sequence[str]) -> tuple[dict[str, Any], float]:
    """Run axes in one pair of processes; return figures and the share of samples answered by the worst, %."""
    words = ["--axes", *axes, "--ros-args", "--params-file", str(SIX_AXES), *extra]
    names = [f"/{axis}/plant_simulator: timing" for axis in axes]
    with pair(words, words) as (graph, simulator, controller):
        graph.wait("answers", lambda: all(int(graph.said.get(n, {}).get("answered_in_period", 0)) for n in names))
        graph.move(axes, WARM_UP)
        began = time.monotonic(), simulator.processor_time(), controller.processor_time()
        before = graph.fresh(*names)
        graph.move(axes, seconds)
        after = graph.fresh(*names)
        ended = time.monotonic(), simulator.processor_time(), controller.processor_time()
        memory = simulator.memory(), controller.memory()
    passed, *spent = (b - a for a, b in zip(began, ended, strict=True))
    figures: dict[str, Any] = {}
    shares = []
    for axis, one, two in zip(axes, before, after, strict=True):
        samples, in_period, late = (
            int(two[key]) - int(one[key]) for key in ("samples", "answered_in_period", "late_samples")
        )
        shares.append(100 * in_period / samples)
        figures[f"{axis} answered within the period, %"] = round(shares[-1], 2)
        figures[f"{axis} late samples"] = late
    for process, used, size in zip(("simulator", "controller"), spent, memory, strict=True):
        figures[f"processor time of the {process}, %"] = round(100 * used / passed, 1)
        figures[f"memory of the {process}, kB"] = size
    return figures, min(shares)


def axes(seconds: float, extra: Sequence[str]) -> tuple[dict[str, Any], bool]:
    """Run six axes in one pair of processes, and, before and after them, one for half the time each."""
    alone = [answered(AXES[:1], 0.5 * seconds, extra)[1]]
    figures, worst = answered(AXES, seconds, extra)
    alone.append(answered(AXES[:1], 0.5 * seconds, extra)[1])
    one = sum(alone) / len(alone)
    return {
        "seconds": seconds,
        **figures,
        "one axis alone, before and after, %": ", ".join(f"{share:.2f}" for share in alone),
        "worst of six over one alone": round(worst / one, 4),
    }, True


def lockstep(seconds: float, extra: Sequence[str]) -> tuple[dict[str, Any], bool]:
    """Simulate a time in lockstep with nobody listening to the samples but the pair."""
    simulator = ["--ros-args", "-p", "lockstep:=true", "-p", "real_time_factor:=0.0", *extra]
    controller = ["--ros-args", "-p", "state_timeout:=10.0", "-p", "use_sim_time:=true", *extra]
    name = "/plant_simulator: timing"
    with pair(simulator, controller) as (graph, *_):
        graph.wait("samples", lambda: int(graph.said.get(name, {}).get("samples", 0)) > 1)
        (first,) = graph.fresh(name)
        wanted = int(first["samples"]) + seconds / PERIOD
        graph.wait("simulated time", lambda: int(graph.said[name]["samples"]) >= wanted, 10 * seconds)
        last = graph.said[name]
    simulated = (int(last["samples"]) - int(first["samples"])) * PERIOD
    return {"seconds simulated": simulated, "times real time": round(simulated / (last["at"] - first["at"]), 2)}, True


def identify(seconds: float, extra: Sequence[str]) -> tuple[dict[str, Any], bool]:
    """Let one axis identify its drive, with what moves it and with the fit beside it, and hold still, in turns."""
    words, name, servo = ["--ros-args", *PATIENT, *extra], "/plant_simulator: timing", "/controller: servo"
    counts = {doing: [0, 0, 0] for doing in ("moves", "fits", "holds")}
    runs = valid = 0
    with pair(words, words) as (graph, *_):
        graph.wait("answers", lambda: int(graph.said.get(name, {}).get("answered_in_period", 0)))
        client = graph.node.create_client(Trigger, "controller/identify")
        graph.wait("the service", client.service_is_ready)
        graph.spin(WARM_UP)
        said, end = graph.fresh(name)[0], time.monotonic() + seconds
        while time.monotonic() < end:
            asked, began = client.call_async(Trigger.Request()), time.monotonic()
            graph.wait("the experiment", lambda by=asked: by.done() or graph.said[servo]["learning"] == "True")
            for doing, seen in counts.items():
                if doing == "moves":
                    graph.wait("its end", lambda: graph.said[servo]["learning"] == "False")
                elif doing == "fits":
                    graph.wait("an answer", asked.done, 5 * PATIENCE)
                else:
                    graph.spin(time.monotonic() - began)
                before, said = said, graph.fresh(name)[0]
                for k, key in enumerate(("samples", "answered_in_period", "late_samples")):
                    seen[k] += int(said[key]) - int(before[key])
            runs, valid = runs + 1, valid + asked.result().success
    figures = {"runs": runs, "of them valid": valid}
    for doing, (samples, in_period, late) in counts.items():
        figures[f"samples while it {doing}"] = samples
        figures[f"answered within the period while it {doing}, %"] = round(100 * in_period / samples, 2)
        figures[f"late samples while it {doing}"] = late
    return figures, True


_PAGES = 10
_READ = """
import asyncio, os, sys
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

async def read(host):
    async with connect(f"ws://{host}/samples?axis=/", origin=f"http://{host}", max_size=None) as page:
        try:
            async for _ in page:
                pass
        except ConnectionClosed:  # the dashboard ended
            pass

async def main(host, pages):
    await asyncio.gather(*(read(host) for _ in range(pages)))

os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
asyncio.run(main(sys.argv[1], int(sys.argv[2])))
"""
"""What ten pages read, without what a browser draws; only where nothing else runs, as they are on other machines."""


@contextlib.contextmanager
def pages(count: int) -> Iterator[tuple[str, float]]:
    """Run the dashboard with the connections of pages; give its address, and the time until it served the page, s."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        log = Path(folder, "log")
        words = ["--ros-args", "-p", "port:=0", "-p", f"folder:={folder}"]
        began = time.monotonic()
        with log.open("w") as output:
            command = [sys.executable, "-m", "backlash_ros.dashboard.command", *words]
            serving = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        stack.callback(serving.wait)
        stack.callback(serving.send_signal, signal.SIGINT)
        while not (found := re.search(r"^http://(\S+)$", log.read_text(), re.MULTILINE)):
            if serving.poll() is not None:
                raise RuntimeError(log.read_text())
            time.sleep(0.05)
        with urllib.request.urlopen(found[0]) as page:  # noqa: S310 - our own page
            page.read()
        served = time.monotonic() - began
        reading = subprocess.Popen([sys.executable, "-c", _READ, found[1], str(count)])
        stack.callback(reading.wait)
        stack.callback(reading.terminate)
        yield found[0], served


def drawn(address: str) -> Any:
    """Return the time from asking for the page until its first curve is drawn, s; why not, without a browser."""
    chromium, driver = (shutil.which(name) for name in ("chromium", "chromedriver"))
    if not chromium or not driver:
        return "Chromium is not installed"
    from selenium.webdriver import Chrome, ChromeOptions  # noqa: PLC0415 - of the tests
    from selenium.webdriver.chrome.service import Service  # noqa: PLC0415

    options = ChromeOptions()
    options.binary_location = chromium
    for word in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(word)
    browser = Chrome(options=options, service=Service(driver))
    try:
        browser.get(address)
        first = (
            "return window.live?.chart.getOption().series.some((s) => s.data.length > 1) && performance.now() / 1000"
        )
        while not (took := browser.execute_script(first)):  # type: ignore[no-untyped-call]
            time.sleep(0.01)
        return round(float(took), 1)
    finally:
        browser.quit()


def dashboard(seconds: float, extra: Sequence[str]) -> tuple[dict[str, Any], bool]:
    """Run one axis at 1 kHz in five blocks by itself and five with ten pages, in turns."""
    words, name = ["--ros-args", *PATIENT, "-p", "rate:=1000.0", *extra], "/plant_simulator: timing"
    shares: dict[str, list[float]] = {"alone": [], "with ten pages": []}
    served = []
    with pair(words, words) as (graph, *_):
        graph.wait("answers", lambda: int(graph.said.get(name, {}).get("answered_in_period", 0)))
        for block in range(10):
            which = ("alone", "with ten pages")[block % 2]
            with pages(_PAGES) if block % 2 else contextlib.nullcontext(("", 0.0)) as (_, took):
                served += [took] if took else []
                graph.move([""], WARM_UP)
                (before,) = graph.fresh(name)
                graph.move([""], seconds)
                (after,) = graph.fresh(name)
            samples, in_period = (int(after[key]) - int(before[key]) for key in ("samples", "answered_in_period"))
            shares[which].append(100 * in_period / samples)
        with pages(0) as (address, _):
            until_drawn = drawn(address)
    figures: dict[str, Any] = {"seconds of a block": seconds}
    for which, of in shares.items():
        figures[f"{which}, answered within the period, %"] = ", ".join(f"{share:.2f}" for share in of)
    medians = {which: statistics.median(of) for which, of in shares.items()}
    figures["medians, %"] = ", ".join(f"{median:.2f}" for median in medians.values())
    figures["median with ten pages over alone"] = round(medians["with ten pages"] / medians["alone"], 4)
    figures["start of the dashboard until its page is served, s"] = round(statistics.median(served), 1)
    figures["from asking for the page until it is drawn, s"] = until_drawn
    spread = max(max(of) - min(of) for of in shares.values())
    return figures, medians["with ten pages"] >= medians["alone"] - max(0.5, spread)


def step(seconds: float, extra: Sequence[str]) -> tuple[dict[str, Any], bool]:
    """Let controller and plain node answer one simulator in turns: same message, same subscribers."""
    figures: dict[str, Any] = {"seconds": seconds, "turns": TURNS}
    for rate in (250, 1000):
        words = ["--ros-args", "-p", f"rate:={rate}", *PATIENT, *extra]
        with pair(words, words) as (graph, *_):
            plain, ours = Plain(graph), []
            graph.wait("answers", lambda: int(graph.said.get("/controller: servo", {}).get("samples_answered", 0)))
            for _ in range(TURNS):
                graph.fresh("/controller: timing")
                for _ in range(max(1, round(seconds / TURNS))):
                    (said,) = graph.fresh("/controller: timing")  # of the second that has just passed
                    ours.append(float(said["step_time"].split()[1].rstrip(",")))
                graph.change("/controller", Transition.TRANSITION_DEACTIVATE)
                plain.turn = True
                graph.spin(seconds / TURNS)
                plain.turn = False
                graph.change("/controller", Transition.TRANSITION_ACTIVATE)
        mean = statistics.median(ours), 1e3 * statistics.fmean(plain.times)
        figures[f"{rate} Hz: step of the controller, mean, ms"] = round(mean[0], 4)
        figures[f"{rate} Hz: bare publish of a plain node, mean, ms"] = round(mean[1], 4)
        figures[f"{rate} Hz: step over bare publish"] = round(mean[0] / mean[1], 2)
    return figures, True


def main() -> int:
    """Measure, print, and write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["soak", "axes", "lockstep", "identify", "dashboard", "step"])
    parser.add_argument("--minutes", type=float, default=10.0, help="of the soak")
    parser.add_argument("--seconds", type=float, default=60.0, help="of six axes, and simulated in lockstep")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    parser.add_argument(
        "--newest", action="store_true", help="soak with the default quality of service, which may lose"
    )
    parser.add_argument("--ros", default="", help="further ROS arguments of both processes")
    asked = parser.parse_args()
    extra = asked.ros.split()
    bare = BareSleep()
    try:
        if asked.what == "soak":
            figures, held = soak(asked.minutes, extra if asked.newest else [*NOTHING_LOST, *extra])
        else:
            measures = {"axes": axes, "lockstep": lockstep, "identify": identify, "dashboard": dashboard, "step": step}
            figures, held = measures[asked.what](asked.seconds, extra)
    finally:
        seen = bare.stop()
    figures |= seen | {"load average": os.getloadavg()[0]}
    print(asked.what)
    for key, value in figures.items():
        print(f"  {key:45s} {value}")
    if asked.json:
        asked.json.write_text(json.dumps({asked.what: figures}, indent=2) + "\n")
    return 0 if held else 1


if __name__ == "__main__":
    raise SystemExit(main())
