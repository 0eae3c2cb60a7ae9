"""`backlash evaluate --suite motion`: how laws follow paths on the drives of a population, in a table."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.evaluation import open_journal, printable, run_drives
from backlash_ros.commands.output import json_text, say
from backlash_ros.foundation.staging import write_text
from backlash_ros.studies.evaluation.motion import PATHS, evaluate_motion, motion_table
from backlash_ros.studies.evaluation.task import Task

LAWS_BESIDE = "cascade", "dual_loop", "two_region"
"""Laws that are judged beside the default one: two as drives have them, and the paper's."""


def evaluate_motions(
    task: Task, drives: int, target: Path, console: Console, *, scheduler: str = "", drive: str = ""
) -> None:
    """Let the first ``drives`` drives follow the suite's paths, and write ``target``, JSON; the table to the console.

    A task without laws of its own judges `LAWS_BESIDE` and the default law. The same command continues after an
    interruption.

    Raises
    ------
    OSError
        If ``target`` cannot be written, or the scheduler cannot be reached.
    """
    if task.laws == replace(task, laws=()).laws:
        task = replace(task, laws=(*LAWS_BESIDE, task.default_law))
    with ExitStack() as stack:
        journal = stack.enter_context(open_journal(task, target, "motion"))
        run_drives(task, drives, journal, scheduler, console, evaluate_motion)
        entries = [entry for entry in journal.entries() if entry.number < drives]
        results = [entry.value for entry in entries if not entry.failure]
        table = motion_table(results, task.laws)
        content = {
            **{name: getattr(task, name) for name in ("seed", "population", "model", "encoders")},
            "suite": "motion",
            "effects": list(task.effects),
            "drives": drives,
            "drive": drive or None,
            "laws": list(task.laws),
            "paths": [path.name for path in PATHS],
            "learned": sum(bool(result["learned"]["valid"]) for result in results),
            "results": {str(entry.number): entry.value for entry in entries if not entry.failure},
            "failed_runs": {str(entry.number): entry.failure for entry in entries if entry.failure},
        }
        write_text(target, json_text(content), overwrite=True)
        journal.remove()
    title = f"{drives} drives of seed {task.seed}, {content['learned']} learned: median / 90 % / worst"
    console.print(printable(table, title))
    say(console, f"written: {target}")
