"""`backlash evaluate --effects`: one effect at a time on a population, and a table with a row for each."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from backlash_ros.commands.evaluation import number_text, open_journal, printable, report_of, rows_in, run_drives
from backlash_ros.commands.output import json_text, say
from backlash_ros.foundation.staging import write_text
from backlash_ros.studies.evaluation.effects import EFFECTS
from backlash_ros.studies.evaluation.summary import Collected
from backlash_ros.studies.evaluation.task import Task

NO_EFFECT = "none"
"""The name of the row without an effect."""
EFFECT_NAMES = (NO_EFFECT, *EFFECTS)

_HEAD = (
    *("effect", "learned, %", "close, %", "covered, %", "wrong"),
    *("quiet, %", "precise, %", "overshoot ok, %", "settled, median / 95 %, s"),
)


def with_effect(task: Task, name: str) -> Task:
    """Return ``task`` with one effect on every drive; none for `NO_EFFECT`."""
    return replace(task, effects=() if name == NO_EFFECT else (name,))


def evaluate_effects(
    task: Task, names: list[str], drives: int, target: Path, console: Console, *, scheduler: str = "", drive: str = ""
) -> None:
    """Evaluate the first ``drives`` drives with each effect of ``names`` alone, and write ``target``, JSON.

    It has the report of each effect, as `evaluate` writes it. The same command continues after an interruption.

    Raises
    ------
    OSError
        If ``target`` cannot be written, or the scheduler cannot be reached.
    """
    reports: dict[str, Any] = {}
    with ExitStack() as stack:
        journals = []
        for name in names:
            console.print(f"effect {name}", highlight=False)
            alone = with_effect(task, name)
            journals.append(stack.enter_context(open_journal(alone, target)))
            run_drives(alone, drives, journals[-1], scheduler, console)
            collected, failures = Collected(alone.laws), list[dict[str, Any]]()
            for _ in rows_in(alone, drives, journals[-1], collected, failures):
                pass
            reports[name] = report_of(alone, drives, collected, failures, drive)
        content = {
            **{name: getattr(task, name) for name in ("seed", "population", "model", "encoders")},
            "drives": drives,
            "effects": reports,
        }
        write_text(target, json_text(content), overwrite=True)
        for journal in journals:
            journal.remove()
    show(content, console)
    say(console, f"written: {target}")


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f}"


def effects_table(content: dict[str, Any]) -> list[list[str]]:
    """Return the reports of `evaluate_effects` as rows of text, the first with the names of the columns.

    The law is the one that is judged, by default the default law.
    """
    rows = [list(_HEAD)]
    for name, report in content["effects"].items():
        summary = report["summary"]
        law = summary["laws"][report["judged_law"]]
        rows.append(
            [
                name,
                *(_percent(summary[key]) for key in ("learned", "learned_within_5", "covered")),
                str(summary["wrong_valid"]),
                *(_percent(law[key]) for key in ("quiet", "precise", "overshoot_ok")),
                f"{number_text(law['settle_median'])} / {number_text(law['settle_p95'])}",
            ]
        )
    return rows


def show(content: dict[str, Any], console: Console) -> None:
    """Print the table."""
    first = next(iter(content["effects"].values()))
    title = f"{content['drives']} drives of seed {content['seed']} an effect, law {first['judged_law']}"
    console.print(printable(effects_table(content), title))
