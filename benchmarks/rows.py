"""Rows of `make bench`: each benchmark adds its own to `results/bench.json`; `docs/performance.md` is made of that."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE = ROOT / "results" / "bench.json"
PAGE = ROOT / "docs" / "performance.md"

_HEAD = """# Performance

This page is about the speed of the simulator and of the nodes; how well the laws control is in
[evaluation.md](evaluation.md). `make bench` makes these measurements, and writes this page and `results/bench.json`.
Each ratio compares two figures of the same run, so it means something on other machines, too. More is better where the
goal is `>=`, less where it is `<=`. The spread gives the smallest and the largest ratio among the whole measurement and
its parts. Figures of the plant are multiples of real time, and their error is that of the angles, rad; the other rows
name their unit. The first lines of each file in `benchmarks` say what it plays and how it measures.

"""


@dataclass(frozen=True)
class Row:
    """One figure: ours, what it is measured against, and their ratio with its spread.

    ``goal`` is text, ``>= X`` or ``<= X``, for ``ratio``, or empty; ``limit`` says in words why it is out of reach or
    was not measured. ``error`` is that of ours, in the unit that ``what`` names. Figures that could not be had are
    None.
    """

    what: str
    value: float | None
    against: str
    reference: float | None
    ratio: float | None
    spread: tuple[float, float] | None
    error: float | None
    goal: str
    limit: str | None = None

    @property
    def verdict(self) -> str:
        """Return whether the goal is met."""
        if self.ratio is None:
            return "not measured"
        if not self.goal:
            return ""
        sense, wanted = self.goal.split()
        met = self.ratio >= float(wanted) if sense == ">=" else self.ratio <= float(wanted)
        return "met" if met else "missed"


def _figure(value: float | None, digits: int = 3) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.{digits}g}"


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a table in Markdown, and below it what stands in the way of goals."""
    lines = [
        "| what | ours | against | theirs | ratio | spread | error | goal | |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        spread = "" if row.spread is None else " to ".join(_figure(bound) for bound in row.spread)
        error = "" if row.error is None else f"{row.error:.1e}"
        cells = (row.what, _figure(row.value), row.against, _figure(row.reference), _figure(row.ratio), spread, error)
        lines.append(f"| {' | '.join((*cells, row.goal, row.verdict))} |")
    notes = [f"- {row.what}, against {row.against}: {row.limit}" for row in rows if row.limit]
    return "\n".join([*lines, *(["", *notes] if notes else [])]) + "\n"


def record(rows: Sequence[Row]) -> None:
    """Print rows, add them to the file in place of older ones of the same name, and write the page."""
    print(table(rows))
    fresh = {(row.what, row.against): row for row in rows}
    if FILE.exists():
        for old in json.loads(FILE.read_text())["rows"]:
            name = old["what"], old["against"]
            if name not in fresh:
                fresh[name] = Row(**old)
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps({"rows": [asdict(row) for row in fresh.values()]}, indent=2) + "\n")
    PAGE.write_text(_HEAD + table(list(fresh.values())))
