"""`backlash evaluate`: from the arguments to the files, the table and the pictures."""

import hashlib
import shlex
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from backlash_ros.commands.output import json_text, print_json, say, staged
from backlash_ros.simulation.batch import Journal, code_digest, run_batch
from backlash_ros.studies.evaluation.failures import group_failures, worst_drives
from backlash_ros.studies.evaluation.summary import Collected, failed, summarize
from backlash_ros.studies.evaluation.table import rows_of, write_table
from backlash_ros.studies.evaluation.task import Task, evaluate_drive, perform


def evaluate(
    task: Task, drives: int, target: Path, out: Path | None, console: Console, *, scheduler: str = "", drive: str = ""
) -> None:
    """Evaluate the first ``drives`` drives of a population and write ``target``, JSON; tables and pictures to ``out``.

    A journal beside ``target`` lists each finished run: the same command continues from there. A journal of other
    arguments or other code has another name and is not touched.

    Parameters
    ----------
    scheduler : address of a Dask scheduler; this machine's cores by default
    drive : name of the file that ``task.around`` was read from

    Raises
    ------
    OSError
        If ``target`` or ``out`` cannot be written, or the scheduler cannot be reached.
    ImportError
        If an extra that ``out`` or ``scheduler`` needs is not installed.
    """
    if out is not None and find_spec("pyarrow") is None:
        raise ImportError("--out needs pyarrow: pip install 'backlash_ros[tables]'")
    if scheduler and find_spec("distributed") is None:
        raise ImportError("--scheduler needs Dask distributed: pip install 'backlash_ros[cluster]'")
    beside = [out / name for name in ("runs.parquet", "shares.png", "settling.png")] if out is not None else []
    with open_journal(task, target) as journal:
        run_drives(task, drives, journal, scheduler, console)
        with staged(*beside, target) as files:  # the report comes last
            collected, failures = Collected(task.laws), list[dict[str, Any]]()
            rows = rows_in(task, drives, journal, collected, failures)
            if beside:
                from backlash_ros.studies.evaluation.pictures import draw_settling, draw_shares  # noqa: PLC0415 - matplotlib takes a second

                table, shares, settling = (files[place] for place in beside)
                write_table(rows, table)
                draw_shares(collected, shares)
                draw_settling(collected, settling)
            else:
                for _ in rows:
                    pass
            content = report_of(task, drives, collected, failures, drive)
            files[target].write_text(json_text(content))
        journal.remove()
    show(content, console)
    written = [str(target)] + ([f"runs.parquet, shares.png and settling.png in {out}"] if out else [])
    say(console, f"written: {'; '.join(written)}")


def replay(task: Task, number: int, plot: Path | None, console: Console) -> None:
    """Evaluate one drive of a population, print everything about it as JSON, and draw its runs."""
    learned, verdicts, runs = perform(task, number, task.laws)
    member = task.member(number)
    content = {
        "parameters": member.parameters(),
        "learned": asdict(learned),
        "laws": {law: asdict(verdict) for law, verdict in verdicts.items()},
    }
    if plot is not None:
        from backlash_ros.studies.evaluation.pictures import draw_runs  # noqa: PLC0415 - matplotlib takes a second

        with staged(plot) as files:
            draw_runs(member, runs, files[plot])
    print_json(console, content)


def open_journal(task: Task, target: Path, suite: str = "") -> Journal:
    """Return the journal of a task, beside its result; its name depends on the arguments and on the code."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256(f"{suite}{task!r} {code_digest()}".encode()).hexdigest()
    return Journal(target.with_name(f".{target.name}.{digest[:12]}.journal"))


def run_drives(
    task: Task,
    drives: int,
    journal: Journal,
    scheduler: str,
    console: Console,
    job: Callable[[Task, int], dict[str, Any]] = evaluate_drive,
) -> None:
    """Evaluate the drives that the journal does not have yet, each by ``job``, and show the progress."""
    done = sum(number in journal for number in range(drives))
    if done:
        say(console, f"{done} of {drives} drives are in {journal.path} already")
    columns = (
        TextColumn("{task.description}"),
        *(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left:"), TimeRemainingColumn()),
    )
    with Progress(*columns, console=console, speed_estimate_period=600) as bar:
        shown = bar.add_task("drives", total=drives, completed=done)
        run_batch(
            partial(job, task), range(drives), journal, scheduler=scheduler, ended=lambda _entry: bar.advance(shown)
        )


def rows_in(
    task: Task, drives: int, journal: Journal, collected: Collected, failures: list[dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table by drive; add each drive to ``collected`` and failed runs to ``failures``."""
    for entry in journal.entries():
        if entry.number >= drives:  # of a command that asked for more
            break
        member = task.member(entry.number)
        parameters, value = member.parameters(), entry.value
        if entry.failure:
            failures.append({"failure": entry.failure, "parameters": parameters})
            value = failed(task.played, entry.failure)
        collected.add(member, value)
        yield from rows_of(parameters, value)


def report_of(
    task: Task, drives: int, collected: Collected, failures: list[dict[str, Any]], drive: str
) -> dict[str, Any]:
    """Return the content of the report: the arguments, the summary, the worst drives, and what failed and why."""
    judged = task.laws[-1]
    worst = worst_drives(collected, judged)
    for each in worst:
        each["command"] = _replay_command(task, each["number"], drive)
    return {
        **{name: getattr(task, name) for name in ("seed", "population", "model", "encoders")},
        "effects": list(task.effects),
        "drives": drives,
        "drive": drive or None,
        "experiments": list(task.experiments),
        "laws": list(task.laws),
        "summary": summarize(collected, task.default_law, identified=task.model == "identified"),
        "judged_law": judged,
        "worst": worst,
        "failures": group_failures(collected, judged),
        "failed_runs": failures,
    }


def _replay_command(task: Task, number: int, drive: str) -> str:
    default = Task(task.seed)
    words = ["backlash", "evaluate", "--seed", str(task.seed)]
    for name in ("population", "model", "encoders"):
        if getattr(task, name) != getattr(default, name):
            words += [f"--{name}", getattr(task, name)]
    if task.experiments != default.experiments:
        words += ["--experiments", *task.experiments]
    if task.laws != replace(task, laws=()).laws:
        words += ["--laws", *task.laws]
    if task.effects:
        words += ["--effects", *task.effects]
    if drive:
        words += ["--drive", drive]
    return shlex.join([*words, "--only", str(number), "--plot", f"drive_{number}.png"])


def _percent(share: float | None, interval: list[float] | None) -> str:
    if share is None or interval is None:
        return "-"
    return f"{100 * share:.1f} ({100 * interval[0]:.1f} to {100 * interval[1]:.1f})"


def number_text(value: float | None) -> str:
    """Return a figure as text, "-" if there is none."""
    return "-" if value is None else f"{value:.3g}"


_SHARES = {"quiet": "quiet", "precise": "precise", "overshoot_ok": "overshoot ok", "faulted": "faulted"}
_FIGURES = {
    "settle_median": "settled, median, s",
    "settle_p95": "settled, 95 %, s",
    "settle_p95_free": "settled, 95 %, free loads, s",
    "rise_ratio": "rise against fast, median",
    "rise_ratio_p95": "rise against fast, 95 %",
    "peak_force_ratio": "tooth force against fast, median",
    "peak_force_ratio_p95": "tooth force against fast, 95 %",
    "recover_p95": "recovered, 95 %, s",
}


def table_of(summary: dict[str, Any]) -> list[list[str]]:
    """Return the summary of the laws as rows of text, the first with their names."""
    laws = summary["laws"]
    rows = [["", *laws]]
    for name, title in _SHARES.items():
        rows.append([f"{title}, %", *(_percent(law[name], law[f"{name}_interval"]) for law in laws.values())])
    for name, title in _FIGURES.items():
        rows.append([title, *(number_text(law[name]) for law in laws.values())])
    return rows


def printable(rows: list[list[str]], title: str) -> Table:
    """Return a table for the terminal; the first row has the names of the columns."""
    head, *others = rows
    table = Table(title=title)
    for name in head:
        table.add_column(name, overflow="fold")
    for row in others:
        table.add_row(*row)
    return table


def learning_of(summary: dict[str, Any]) -> list[str]:
    """Return what learning achieved as lines of text."""
    return [
        f"learned, of the drives whose load the motor can outrun: "
        f"{_percent(summary['learned'], summary['learned_interval'])} %",
        f"within 5 %, of the learned: {_percent(summary['learned_within_5'], summary['learned_within_5_interval'])} %",
        f"within two standard uncertainties, of the learned: "
        f"{_percent(summary['covered'], summary['covered_interval'])} %",
        f"said to be valid, but wrong: {summary['wrong_valid']}",
        *(
            [
                f"identified well enough to plan moves, of the learned: "
                f"{_percent(summary['identified'], summary['identified_interval'])} %",
                f"load, friction, gap and delay close to the truth: "
                f"{_percent(summary['all_close'], summary['all_close_interval'])} %",
                f"J_l/J_r within 5 %, of the learned: "
                f"{_percent(summary['ratio_close'], summary['ratio_close_interval'])} %",
            ]
            if summary["all_close"] is not None
            else []
        ),
    ]


def show(content: dict[str, Any], console: Console) -> None:
    """Print the table, the ten worst drives and what failures have in common."""
    title = f"{content['drives']} drives of seed {content['seed']}; 95 % intervals in brackets"
    console.print(printable(table_of(content["summary"]), title))
    for line in learning_of(content["summary"]):
        say(console, line)
    if content["failures"]:
        say(console, "\nFailures, and what is more frequent among them than among all drives:")
    for group in content["failures"]:
        common = ", ".join(
            f"{each['condition']} {100 * each['share']:.0f} % ({100 * each['share_of_all']:.0f} % of all)"
            for each in group["in_common"]
        )
        say(console, f"  {group['drives']:5d}  {group['what']}" + (f": {common}" if common else ""))
    if content["failed_runs"]:
        say(console, f"\n{len(content['failed_runs'])} drives could not be run; the file says which and why")
    if content["worst"]:
        say(console, f"\nThe worst drives for {content['judged_law']}, with how many times a threshold is passed:")
    for each in content["worst"]:
        say(console, f"  {each['times']:8.3g}  {each['command']}")
