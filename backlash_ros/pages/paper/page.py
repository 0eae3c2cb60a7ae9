"""The page that judges the paper: every figure in it is computed."""

import math
from collections.abc import Mapping
from typing import Any

from backlash_ros.control import LAWS
from backlash_ros.pages.paper.sections import Numbers, sections_of, varied_rows
from backlash_ros.pages.template import render

_COLUMNS = {
    "rise_time_s": ("rise, s", "{:.3f}"),
    "settling_time_s": ("settling, s", "{:.2f}"),
    "overshoot_b": ("overshoot/b", "{:.2f}"),
    "residual_b": ("residual/b", "{:.2f}"),
    "impacts_after_switch": ("impacts", "{:d}"),
    "peak_force_N": ("peak force, N", "{:.0f}"),
    "control_energy_V2s": ("control energy, V²s", "{:.1f}"),
}


def _format(pattern: str, value: float | int | None) -> str:
    if value is None or not math.isfinite(value):
        return "never"
    return pattern.format(value).replace("-0.00", "0.00")


def _cells(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return the cells of a table by the name of the row."""
    return {name: [_format(form, row[key]) for key, (_, form) in _COLUMNS.items()] for name, row in rows.items()}


def write_page(numbers: Numbers) -> str:
    """Return docs/paper.md for the numbers that `paper.reproduce` computed (as figures.json holds them)."""
    table = numbers["table"]
    cases = next(iter(table.values()))
    cycles = {
        law: [f"{row['amplitude_b']:.3f}", f"{row['gap_travel_d']:.3f}", _format("{:.4f}", row["period_s"])]
        for law, row in numbers["contact_laws"].items()
    }
    return render(
        "paper/paper.md.j2",
        sections=sections_of(numbers),
        heads=[title for title, _ in _COLUMNS.values()],
        varied=_cells(varied_rows(numbers)),
        cases={case: _cells({law.title: table[name][case] for name, law in LAWS.items()}) for case in cases},
        cycles=cycles,
    )
