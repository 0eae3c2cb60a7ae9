"""The demo: a geared servo rattles, learns its backlash and stops rattling, on real DDS, recorded and judged.

Simulator, controller and recorder run as separate processes, on a domain of their own and on this machine only. What is
judged runs in lockstep, so that it does not depend on how busy the machine is, and all of its figures come from the bag
that was recorded. A simulator and a controller in real time then show which rate the machine keeps.
"""

import json
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from backlash_ros.demo.session import ALL, HOLD, LOAD_STEP, Session, running
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.foundation.parser import Parser
from backlash_ros.foundation.staging import staging
from backlash_ros.recordings.bag import read_bag
from backlash_ros.ros.client import ClientError, TimedOutError
from backlash_ros.ros.isolation import isolated
from backlash_ros.simulation.__main__ import compile_all
from backlash_ros.studies.session import (
    COMPARED,
    LABELS,
    PAPER,
    Interval,
    came_on,
    judge_load_step,
    judge_step,
    judge_swap,
)
from backlash_ros.studies.session_picture import plot_session

BRISK = {"fast": [1000.0, 1.0], "overdamped": [16.0, 0.0]}
"""LQR weights of the gain set that the demo swaps to: over-damped gains of twice the stiffness."""

HEAVY = 4.0
"""Load inertia of the second part relative to the nominal one: equal to that of the motor at the output."""
_TIMEOUT, _PATIENT = 0.5, 10.0
"""Timeouts of both sides in real time, since a shared machine may stall for longer than the default of 0.1 s, and of
the controller in lockstep, s."""


def _kept(*topics: str) -> list[str]:
    """Return parameters for queues that bridge the seconds for which a recorder on a busy machine may be late."""
    return [f"qos_overrides./{topic}.publisher.depth:={ALL.depth}" for topic in topics]


def perform(session: Session, say: Callable[[str], None]) -> dict[str, Any]:
    """Do the parts with the nominal drive; return when each was."""
    say("learning the backlash: the motor goes to and fro across the gap")
    learned = session.ask("learn", say), session.get("backlash_angle")["backlash_angle"]
    script: dict[str, Any] = {"learned": learned, "steps": {}, "loads": {}}

    def judged(law: str) -> None:
        loaded = law in COMPARED
        say(f"step 0 to 1 rad{f', then {LOAD_STEP:g} N m on the load' if loaded else ''}: {LABELS[law]}")
        script["steps"][law] = session.step(law)
        if loaded:
            script["loads"][law] = session.load_step()

    for law in PAPER:
        judged(law)
    say("swapping the gain set while the load moves")
    script["swap"] = session.swap()
    session.settle_at(0.0)
    say("identifying the drive: our law plans with its inertia and friction")
    session.ask("identify", say)
    judged("planned")
    return script


def perform_heavy(session: Session, say: Callable[[str], None]) -> dict[str, Interval]:
    """Learn the backlash with the heavy load and step with the paper's law and ours; return when."""
    session.ask("learn", say)
    steps = {}
    for law in COMPARED:
        say(f"step 0 to 1 rad: {LABELS[law]}")
        steps[law] = session.step(law)
    return steps


def judge(script: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Read the bags and judge them; write the figure and return the summary."""
    drive = NOMINAL_DRIVE
    nominal, heavy = (read_bag(bag) for bag in (folder / "bag", folder / "heavy" / "bag"))
    answer, angle = script["learned"]
    accepted, swap = script["swap"]
    loads = {law: came_on(nominal, each, drive) for law, each in script["loads"].items()}
    plot_session(
        [
            (nominal, script["steps"], "The load near its target after a step of 1 rad"),
            (heavy, script["heavy"], f"The same with {HEAVY:g} times the load inertia"),
        ],
        loads,
        drive,
        folder / "step_response.png",
    )
    return {
        "learned": {
            "backlash_angle": angle,
            "true_backlash_angle": drive.gear.backlash_angle,
            "method": answer.partition(" by ")[2].partition(",")[0],
        },
        "responses": {law: judge_step(nominal, each, drive) for law, each in script["steps"].items()},
        "heavy_responses": {law: judge_step(heavy, each, drive) for law, each in script["heavy"].items()},
        "gain_swap": {"accepted": accepted, **judge_swap(nominal, swap, drive)},
        "load_steps": {law: judge_load_step(nominal, each, LOAD_STEP, drive) for law, each in loads.items()},
        "bag": "bag",
        "messages": nominal.messages,
    }


def keep_the_rate(session: Session, learned: float) -> dict[str, int]:
    """Step in real time; return how many samples the drive sent, and how many were answered within their period."""
    session.must_set({"backlash_angle": learned})
    session.settle_at(0.0)
    sent, answered = session.sent, session.answered
    for target in (1.0, 0.0):
        session.move(target)
        session.run(0.5 * HOLD)
    return {"samples": session.sent - sent, "answered_in_period": session.answered - answered}


def show(summary: dict[str, Any], console: Console) -> None:
    """Print the summary as a table."""
    columns = {
        "rise, s": ("rise_time", ".3f"),
        "settled, s": ("settling_time", ".2f"),
        "over/b": ("overshoot", ".3f"),
        "rest/b": ("residual", ".3f"),
        "impacts": ("impacts", "d"),
    }
    table = Table(box=None)
    table.add_column("step of 1 rad", no_wrap=True)
    for heading in columns:
        table.add_column(heading, justify="right")
    for key, title in (("responses", "nominal drive"), ("heavy_responses", f"{HEAVY:g} times the load inertia")):
        table.add_row(f"{title}:")
        for law, response in summary[key].items():
            cells = [f"{response[name]:{form}}".replace("inf", "never") for name, form in columns.values()]
            table.add_row(f"  {LABELS[law]}", *cells)
    console.print(table)
    heads = "b: the backlash; settled: within b/4 for good; over: beyond the target; rest: swing in the last second"
    console.print(f"{heads}\n", highlight=False)
    learned, swap, rate = summary["learned"], summary["gain_swap"], summary["real_time"]
    true = learned["true_backlash_angle"]
    console.print(
        f"learned b = {learned['backlash_angle']:.5f} rad, true b = {true:.5f} rad "
        f"({100 * (learned['backlash_angle'] / true - 1):+.2f} %), by {learned['method']}"
    )
    console.print(
        f"gain set swapped while the load moved at {swap['speed']:.1f} rad/s: {swap['commands'] - swap['mixed']} of "
        f"{swap['commands']} commands around it are those of the gains in force"
    )
    for law, load in summary["load_steps"].items():
        console.print(
            f"load torque {load['torque']:g} N m, {LABELS[law]}: estimated {load['estimate']:.3f} N m, "
            f"largest error {load['largest_error']:.2f} b, final {load['final_error']:.3f} b"
        )
    share = 100 * rate["answered_in_period"] / rate["samples"]
    console.print(
        f"in real time, 250 Hz: {rate['answered_in_period']} of {rate['samples']} samples ({share:.1f} %) answered "
        "within their period"
    )


def record(folder: Path, console: Console) -> dict[str, Any]:
    """Run the whole demo into ``folder`` and return the summary."""
    began = time.monotonic()

    def say(text: str) -> None:
        console.print(f"[{time.monotonic() - began:5.1f} s] {text}", markup=False, highlight=False)

    brisk = [f"gain_sets.brisk.{region}.q:={weights}" for region, weights in BRISK.items()]
    clock = "use_sim_time:=true"
    controller = [
        *("autostart:=false", f"state_timeout:={_PATIENT}", clock, "gain_set_names:=[nominal, brisk]", *brisk),
        *_kept("command", "controller/state", "controller/parameters_in_use"),
    ]

    def in_lockstep(place: Path, *drive: str) -> dict[str, list[str]]:
        simulator = ["lockstep:=true", "real_time_factor:=0.0", *_kept("joint_states"), *drive]
        told = [*controller, *drive, f"identified:={bool(drive)}"]
        return {"recorder": [f"output:={place / 'bag'}"], "plant_simulator": simulator, "controller": told}

    in_real_time = {
        "plant_simulator": [f"command_timeout:={_TIMEOUT}"],
        "controller": ["autostart:=false", f"state_timeout:={_TIMEOUT}"],
    }
    heavy, real_time = folder / "heavy", folder / "real_time"
    for place in (heavy, real_time):
        place.mkdir()
    say("compiling what this version has not compiled yet: once, a minute or two")
    compile_all()
    with isolated() as domain:
        say(f"starting simulator, controller and recorder on ROS domain {domain}, this machine only, in lockstep")
        with running(folder, in_lockstep(folder)) as session:
            script = perform(session, say)
        say(f"starting again with {HEAVY:g} times the load inertia, which the controller is told")
        with running(heavy, in_lockstep(heavy, f"load.inertia:={HEAVY * NOMINAL_DRIVE.load.inertia}")) as session:
            script["heavy"] = perform_heavy(session, say)
        say("stepping to and fro in real time")
        with running(real_time, in_real_time) as session:
            rate = keep_the_rate(session, script["learned"][1])
    say("reading the bags")
    return {**judge(script, folder), "real_time": rate}


def put_in_place(finished: Path, out: Path) -> None:
    """Replace older results by the finished ones, all at once as far as folders allow."""
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
    """Return whether results may be put there: if nothing is there, or an empty folder, or an earlier demo's results.

    A mount point cannot be replaced.
    """
    if not out.exists():
        return True
    ours = out.is_dir() and ((out / "summary.json").is_file() or not any(out.iterdir()))
    return ours and not out.is_mount()


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; results appear in the folder given with --out only when they are complete."""
    parser = Parser(prog="backlash demo", description=__doc__, epilog="example: backlash demo --out results/demo")
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
                parser.error(f"argument --out: must be a new or empty folder or an earlier demo's, got '{out}'")
        except OSError as error:
            parser.error(f"argument --out: must be writable, got '{out}': {error.strerror}")
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
            if isinstance(error, TimedOutError):
                console.print("the machine may be too busy: close other programs and run it again")
            for log in sorted(folder.rglob("*.log")):
                console.print(f"--- {log.stem}\n{log.read_text()[-2000:]}", markup=False, highlight=False)
            return 1
    show(summary, console)
    console.print(
        f"written: {out / 'summary.json'}, {out / 'step_response.png'}, bag in {out / 'bag'}", highlight=False
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
