"""The charts of a report as data for the script that draws them, thinned if there is too much."""

import base64
import gzip
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

import numpy as np

from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.foundation.markup import text_of
from backlash_ros.foundation.record import Array
from backlash_ros.pages.report.library import chart_library
from backlash_ros.recordings.bag import Series
from backlash_ros.simulation.colours import DARK, LIGHT, PRINT

MOST, FEW, BUDGET = 4000, 1000, 500_000
"""Largest number of points of a curve, which keeps the least and the largest of every few; the same on a page that
already has the third number of points, so that it stays small enough to be sent."""
_HOLE = 10.0
"""Time without a point, in median periods, that interrupts a curve."""
_DIGITS = 6
_BUTTONS = {
    "in": ("+", "zoom in"),
    "out": ("\u2212", "zoom out"),
    "left": ("\u25c0", "move left"),
    "right": ("\u25b6", "move right"),
    "all": ("all", "show all of it"),
}

STYLE = """
.chart { margin: 1rem 0 1.6rem; break-inside: avoid; }
.chart .plot { width: 100%; }
.chart .plot svg { max-width: 100%; display: block; }
.tools { display: flex; flex-wrap: wrap; gap: .3rem; align-items: center; font-size: .85rem; color: var(--faint); }
.tools button {
  font: inherit; color: var(--ink); background: var(--band); border: 1px solid var(--line); border-radius: .25rem;
  min-width: 2rem; padding: .1rem .5rem; cursor: pointer;
}
.tools button:focus-visible { outline: 2px solid var(--motor); outline-offset: 1px; }
.tools output { margin-left: .5rem; font-variant-numeric: tabular-nums; }
html:not([data-charts]) .tools { display: none; }
@media print { .tools { display: none; } .chart { margin: .6rem 0; } }
"""


@dataclass(frozen=True)
class Line:
    """One curve: its name, times (s) and values, and its colour in the style."""

    name: str
    time: Array
    values: Array
    colour: str
    dashed: bool = False
    step: bool = False


@dataclass(frozen=True)
class Panel:
    """Curves over one axis, with bands and lines at values; ``low`` and ``high`` limit the axis."""

    label: str
    lines: Sequence[Line]
    bands: Sequence[tuple[float, float]] = ()
    at: Sequence[float] = ()
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Chart:
    """Panels over one time axis, with marks and spans; ``told`` describes the chart in words."""

    title: str
    told: str
    panels: Sequence[Panel]
    marks: Sequence[tuple[float, str]] = ()
    spans: Sequence[tuple[float, float, str]] = ()
    axis: str = "time, s"


def identity_of(place: str) -> str:
    """Return the id of a chart's place in the page; empty if it has none."""
    return place.partition(' id="')[2].partition('"')[0]


def held(series: Series, time: Array) -> Array:
    """Return the values of a series of changes at other times, nan before the first."""
    at = np.searchsorted(series.time, time + 1e-9, side="right") - 1
    return np.where(at >= 0, series.values[np.maximum(at, 0)], math.nan) if series.time.size else time * math.nan


def thinned(time: Array, values: Array, most: int = MOST) -> tuple[Array, Array]:
    """Return a curve of at most ``most`` points, with the least and the largest value of every few."""
    if time.size <= most:
        return time, values
    parts = np.array_split(np.arange(time.size), most // 2)
    filled_low, filled_high = np.nan_to_num(values, nan=math.inf), np.nan_to_num(values, nan=-math.inf)
    chosen = {
        int(part[pick(of[part])]) for part in parts for pick, of in ((np.argmin, filled_low), (np.argmax, filled_high))
    }
    kept = np.array(sorted(chosen))
    return time[kept], values[kept]


def _interrupted(time: Array, values: Array) -> tuple[Array, Array]:
    """Return a curve with a point without a value in each long interruption."""
    steps = np.diff(time)
    if not steps.size:
        return time, values
    holes = np.flatnonzero(steps > _HOLE * np.median(steps)) + 1
    return np.insert(time, holes, time[holes - 1] + 1e-6), np.insert(values, holes, math.nan)


@dataclass
class ChartBook:
    """All charts of a page: collects them one by one, gives their HTML, and packs their data."""

    _charts: list[dict[str, Any]] = field(default_factory=list)
    _points: int = 0

    def add(self, chart: Chart) -> str:
        """Add a chart; return its place in the page."""
        number, full, sent = len(self._charts) + 1, 0, 0
        times: list[list[float]] = []
        known: dict[bytes, int] = {}
        panels: list[dict[str, Any]] = []
        for panel in chart.panels:
            series = []
            for line in panel.lines:
                most = MOST if self._points < BUDGET else FEW
                time, values = thinned(*_interrupted(line.time, line.values), most)
                self._points += time.size
                full, sent = full + line.time.size, sent + min(time.size, line.time.size)
                key = time.tobytes()
                if key not in known:
                    known[key] = len(times)
                    times.append([round(float(t), _DIGITS) for t in time])
                series.append(
                    {
                        "name": line.name,
                        "colour": line.colour,
                        "dashed": line.dashed,
                        "step": line.step,
                        "times": known[key],
                        "values": [float(f"{v:.{_DIGITS}g}") for v in values],
                    }
                )
            panels.append(
                {
                    "label": panel.label,
                    "series": series,
                    "bands": [list(band) for band in panel.bands],
                    "lines": list(panel.at),
                    "low": panel.low,
                    "high": panel.high,
                }
            )
        first = min((row[0] for row in times if row), default=0.0)
        last = max((row[-1] for row in times if row), default=1.0)
        identity = f"chart-{number}"
        self._charts.append(
            {
                "id": identity,
                "axis": chart.axis,
                "from": first,
                "to": max(last, first + 1e-3),
                "times": times,
                "panels": panels,
                "marks": [list(mark) for mark in chart.marks],
                "spans": [list(span) for span in chart.spans],
            }
        )
        thin = f" Thinned: {sent} of {full} points, the least and the largest of every few." if sent < full else ""
        said = f"{chart.title}. {chart.told}".strip()
        buttons = "".join(
            f'<button type="button" data-zoom="{move}" aria-label="{what}" title="{what}">{sign}</button>'
            for move, (sign, what) in _BUTTONS.items()
        )
        return (
            f'<figure class="chart" id="{identity}">'
            f'<div class="plot" role="img" aria-label="{text_of(said)}"></div>'
            f'<div class="tools">{buttons}<output aria-live="polite"></output></div>'
            f"<figcaption>{text_of(said + thin)}</figcaption></figure>"
        )

    def scripts(self) -> str:
        """Return library, data and script, as the end of the page."""
        if not self._charts:
            return ""
        library, name = chart_library()
        content = {
            "name": name,
            "palettes": {"light": LIGHT, "dark": DARK, "print": PRINT},
            "charts": self._charts,
        }
        script = files(__package__).joinpath("charts.js").read_text("utf-8")
        data = json.dumps(jsonable(content), allow_nan=False, separators=(",", ":"))
        return "\n".join(
            [
                "<noscript><p>The charts need JavaScript; all figures are in the tables.</p></noscript>",
                _packed("library", library),
                _packed("data", data),
                f'<script type="module">\n{script}</script>',
            ]
        )


def _packed(identity: str, text: str) -> str:
    """Return a text as an inert element, compressed and in characters without meaning in HTML."""
    packed = base64.b64encode(gzip.compress(text.encode("utf-8"), 9, mtime=0)).decode("ascii")
    return f'<script type="application/gzip" id="{identity}">{packed}</script>'
