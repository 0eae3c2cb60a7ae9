"""The demo: a geared servo rattles, learns its backlash and stops rattling, on real DDS, recorded and judged.

Simulator, controller and recorder run as separate processes, on a domain of their own and on this machine only.
All figures come from the bag that was recorded.
"""

import argparse
import json
import math
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.analysis.bag import read_bag
from backlash_ros.analysis.jsonable import jsonable
from backlash_ros.analysis.metrics import StepResponse
from backlash_ros.analysis.session import (
    LABELS,
    Interval,
    in_time,
    judge_load_step,
    judge_step,
    late_answers,
    swap_delay,
)
from backlash_ros.analysis.session_picture import plot_session
from backlash_ros.analysis.staging import staging
from backlash_ros.control import design_gains
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.ros.client import Client, ClientError, start_node, stop_node
from backlash_ros.ros.isolation import isolated
from backlash_ros.ros.topics import RECEIVE, SEND, TOPICS

BRISK = {"fast": [1000.0, 1.0], "overdamped": [16.0, 0.0]}
"""LQR weights of the gain set that the demo swaps to: over-damped gains of twice the stiffness."""

LOAD_STEP = 0.1
_HOLD = 4.0
_RISING = 0.4
"""Time in which every sample has to be answered within its period, s: else the rise says more of the machine."""
_ATTEMPTS = 8
WATCH = QoSProfile(depth=5000)
_TIMEOUT = 0.5
"""Silence that both sides bear, s: a shared machine may stall for longer than the default of 0.1 s."""


class Session(Client):
    """The running system seen from outside: what a user does with topics, services and parameters."""

    def __init__(self, node: Node, children: dict[str, subprocess.Popen[bytes]], say: Callable[[str], None]) -> None:
        super().__init__(node, children)
        self._say = say
        self.angle = math.nan
        self.speed = math.nan
        self.reference = node.create_publisher(Float64, "reference", SEND)
        self.load_torque = node.create_publisher(Float64, "load_torque", SEND)
        self._closed = self._obeyed = False
        self._samples: list[float] = []
        self._answers: list[float] = []
        node.create_subscription(JointState, "joint_states", self._on_joint_states, WATCH)
        node.create_subscription(Float64MultiArray, "command", self._on_command, WATCH)
        node.create_subscription(DiagnosticArray, "controller/state", self._on_state, RECEIVE)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, WATCH)

    def _on_joint_states(self, message: JointState, info: dict[str, int]) -> None:
        k = message.name.index("load")
        self.angle, self.speed = message.position[k], message.velocity[k]
        self._samples.append(1e-9 * info["source_timestamp"])

    def _on_command(self, _message: Float64MultiArray, info: dict[str, int]) -> None:
        self._answers.append(1e-9 * info["source_timestamp"])

    def _on_state(self, message: DiagnosticArray) -> None:
        self._closed = any(entry.key == "holding" and entry.value == "1" for entry in message.status[0].values)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/plant_simulator: timing":
                self._obeyed = any(entry.key == "answered_in_period" and entry.value != "0" for entry in status.values)

    def ready(self) -> None:
        """Wait until every process takes part."""
        self.wait("the drive's joint states", lambda: not math.isnan(self.angle))
        self.wait("the controller to answer them", lambda: self._closed)
        self.wait("the drive to hear the answers", lambda: self._obeyed)
        self.wait_for_controller()
        self.wait_for_recorder(list(TOPICS)[:-2])

    def move(self, target: float) -> float:
        """Send a reference and return when, s since the epoch."""
        now = time.time()
        self.reference.publish(Float64(data=target))
        return now

    def settle_at(self, target: float) -> None:
        """Go to ``target`` with the two-region law and wait for rest."""
        self.must_set({"law": "two_region", "gain_set": "nominal"})
        self.move(target)
        b = NOMINAL_DRIVE.gear.backlash_angle
        self.wait("rest", lambda: abs(self.angle - target) < 0.5 * b and abs(self.speed) < 0.01)
        self.pause(0.5)

    def step(self, law: str, target: float = 1.0) -> Interval:
        """Step from 0 to ``target`` with ``law`` and hold; again where answers came late meanwhile."""
        for attempt in range(_ATTEMPTS):
            self.settle_at(0.0)
            self.must_set({"law": law})
            self._samples.clear()
            self._answers.clear()
            start = self.move(target)
            self.pause(_HOLD)
            late = late_answers(np.array(self._samples), np.array(self._answers))
            if not np.any(late - self._samples[0] < _RISING) or attempt == _ATTEMPTS - 1:
                break
            self._say("  this machine was too busy to answer in time: once more")
        return Interval(start, time.time(), target)


def _parameters(*assignments: str) -> list[str]:
    return [word for assignment in assignments for word in ("-p", assignment)]


def perform(session: Session, say: Callable[[str], None]) -> dict[str, Any]:
    """Do what the demo shows; return when each part was."""
    say("waiting for simulator, controller and recorder to find each other")
    session.ready()
    say("learning the backlash: the motor goes to and fro across the gap")
    for _ in range(_ATTEMPTS):
        valid, answer = session.call("learn")
        say(f"  {answer}")
        if valid:
            break
    else:
        raise ClientError(f"the backlash was not learned: {answer}")
    script: dict[str, Any] = {"learned": (valid, answer, session.get("backlash_angle")["backlash_angle"]), "steps": {}}
    for law in LABELS:
        say(f"step 0 to 1 rad: {LABELS[law]}")
        script["steps"][law] = session.step(law)
    say("swapping the gain set while the load moves")
    session.settle_at(0.0)
    session.must_set({"law": "overdamped"})
    start = session.move(1.0)
    session.wait("the load to move", lambda: session.angle > 0.3)
    accepted, reason = session.set({"gain_set": "brisk"})
    session.pause(1.0)
    script["swap"] = accepted, reason, Interval(start, time.time(), 1.0)
    say(f"putting {LOAD_STEP:g} N m on the load")
    session.settle_at(1.0)
    now = time.time()
    session.load_torque.publish(Float64(data=LOAD_STEP))
    session.pause(2.5)
    script["load"] = Interval(now, time.time(), 1.0)
    return script


def judge(script: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Read the bag and judge it; write the figure and return the summary."""
    drive = NOMINAL_DRIVE
    recording = read_bag(folder / "bag")
    valid, answer, angle = script["learned"]
    accepted, _, interval = script["swap"]
    swapped = next(
        (t for t, name, value in recording.parameters if (name, value.string_value) == ("gain_set", "brisk")), math.nan
    )
    before, after = (design_gains("q", drive, q) for q in ([4.0, 0.0], BRISK["overdamped"]))
    plot_session(recording, script["steps"], script["load"], drive, angle, folder / "step_response.png")
    return {
        "learned": {
            "backlash_angle": angle,
            "true_backlash_angle": drive.gear.backlash_angle,
            "method": answer.partition(" by ")[2].partition(",")[0],
            "valid": valid,
        },
        "in_time": {law: in_time(recording, part, _RISING) for law, part in script["steps"].items()},
        "responses": {law: asdict(judge_step(recording, part, drive)) for law, part in script["steps"].items()},
        "gain_swap": {
            "accepted": accepted,
            "applied_after": swap_delay(recording, swapped, before, after, interval, drive.motor.torque_constant),
        },
        "load_torque": asdict(judge_load_step(recording, script["load"], LOAD_STEP, drive)),
        "bag": "bag",
        "messages": recording.messages,
    }


def show(summary: dict[str, Any], console: Console) -> None:
    """Print the summary as a table."""
    table = Table(title="Step of 1 rad, nominal drive, 250 Hz")
    for heading in ("law", "rise time, s", "overshoot / b", "residual peak to peak / b", "impacts after the switch"):
        table.add_column(heading, justify="left" if heading == "law" else "right")
    for law, response in summary["responses"].items():
        figures = StepResponse(**response)
        table.add_row(
            LABELS[law],
            f"{figures.rise_time:.3f}",
            f"{figures.overshoot:.3f}",
            f"{figures.residual:.3f}",
            str(figures.impacts),
        )
    console.print(table)
    learned, swap, load = summary["learned"], summary["gain_swap"], summary["load_torque"]
    true = learned["true_backlash_angle"]
    for law, parts in summary["in_time"].items():
        if late := [part for part, undisturbed in parts.items() if not undisturbed]:
            console.print(f"{LABELS[law]}: this machine was too busy to answer in time ({', '.join(late)})")
    console.print(
        f"learned b = {learned['backlash_angle']:.5f} rad, true b = {true:.5f} rad "
        f"({100 * (learned['backlash_angle'] / true - 1):+.1f} %), by {learned['method']}"
    )
    console.print(f"gain set swapped while moving: in use {1e3 * swap['applied_after']:.2f} ms after it was accepted")
    console.print(
        f"load torque {load['torque']:g} N m: estimated {load['estimate']:.3f} N m, "
        f"largest error {load['largest_error']:.2f} b, final error {load['final_error']:.3f} b"
    )


def record(folder: Path, console: Console) -> dict[str, Any]:
    """Run the whole demo into ``folder`` and return the summary."""
    began = time.monotonic()

    def say(text: str) -> None:
        console.print(f"[{time.monotonic() - began:5.1f} s] {text}", markup=False, highlight=False)

    with ExitStack() as stack:
        domain = stack.enter_context(isolated())
        say(f"starting simulator, controller and recorder on ROS domain {domain}, this machine only")
        children: dict[str, subprocess.Popen[bytes]] = {}
        brisk = [f"gain_sets.brisk.{region}.q:={weights}" for region, weights in BRISK.items()]
        for name, parameters in (
            ("recorder", [f"output:={folder / 'bag'}"]),
            ("plant_simulator", [f"command_timeout:={_TIMEOUT}"]),
            ("controller", [f"state_timeout:={_TIMEOUT}", "gain_set_names:=[nominal, brisk]", *brisk]),
        ):
            child = start_node(name, folder / f"{name}.log", *_parameters(*parameters))
            children[name] = child
            stack.callback(stop_node, child)
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(context.try_shutdown)
        node = Node("demo", context=context)
        stack.callback(node.destroy_node)
        script = perform(Session(node, children, say), say)
        for name, child in reversed(children.items()):  # controller first: 0 V goes out while everybody listens
            if (code := stop_node(child)) != 0:
                raise ClientError(f"{name} ended with code {code}")
    say("reading the bag")
    return judge(script, folder)


def put_in_place(finished: Path, out: Path) -> None:
    """Put the finished results in place of older ones, all at once as far as folders go."""
    older = finished.with_name(f"{finished.name}.older")
    if out.exists():
        out.rename(older)
    try:
        finished.rename(out)
    except BaseException:
        if older.exists():
            older.rename(out)
        raise
    shutil.rmtree(older, ignore_errors=True)


def _is_replaceable(out: Path) -> bool:
    """Return whether results may be put there: where nothing is, in an empty folder, or in place of an earlier demo's.

    What is mounted cannot be replaced.
    """
    if not out.exists():
        return True
    ours = out.is_dir() and ((out / "summary.json").is_file() or not any(out.iterdir()))
    return ours and not out.is_mount()


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; results appear in the folder given with --out only when they are complete."""
    parser = argparse.ArgumentParser(
        prog="backlash demo", description=__doc__, epilog="example: backlash demo --out results/demo"
    )
    parser.add_argument("--out", type=Path, default=Path("results/demo"), help="folder for the results (replaced)")
    out = parser.parse_args(args).out
    console = Console(soft_wrap=True)
    told: list[int] = []

    def interrupt(number: int, _frame: object) -> None:
        told.append(number)
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):  # both end it as Ctrl-C does, in the background of a shell too
        signal.signal(number, interrupt)
    with ExitStack() as stack:
        try:
            folder = stack.enter_context(staging(out))
            if not _is_replaceable(out):
                console.print(f"--out must be a new or empty folder or an earlier demo's, got {out}", markup=False)
                return 2
        except OSError as error:
            console.print(f"--out cannot be written: {error.strerror}: {out}", markup=False)
            return 2
        try:
            summary = record(folder.resolve(), console)
            (folder / "summary.json").write_text(json.dumps(jsonable(summary), indent=2, allow_nan=False) + "\n")
            put_in_place(folder, out.absolute())
        except KeyboardInterrupt:
            console.print("stopped; nothing was written")
            return 130
        except (ClientError, OSError, RuntimeError) as error:
            if told:  # amid a message rclpy makes another error of the interruption
                console.print("stopped; nothing was written")
                return 130
            if not isinstance(error, (ClientError, OSError)):
                raise
            console.print(f"failed: {error}", markup=False)
            for log in sorted(folder.glob("*.log")):
                console.print(f"--- {log.stem}\n{log.read_text()[-2000:]}", markup=False, highlight=False)
            return 1
    show(summary, console)
    console.print(
        f"written: {out / 'summary.json'}, {out / 'step_response.png'}, bag in {out / 'bag'}", highlight=False
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
