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
from markupsafe import Markup

from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.foundation.record import Array
from backlash_ros.simulation.colours import DARK, LIGHT, PRINT

LIBRARY = "echarts/echarts.common.min.js"
"""Apache ECharts; its version and licences are in the ``README.md`` beside it."""
MOST, FEW, BUDGET = 4000, 1000, 500_000
"""Largest number of points of a curve, which keeps the least and the largest of every few; the same on a page that
already has the third number of points, so that it stays small enough to be sent."""
_HOLE = 10.0
"""Time without a point, in median periods, that interrupts a curve."""
_DIGITS = 6


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


@dataclass(frozen=True)
class Place:
    """The place of a chart in a page: id, title, what it shows in words, and whether it was thinned, in words."""

    identity: str
    title: str
    told: str
    thinned: str = ""


@dataclass(frozen=True)
class Drawn:
    """What draws the charts of a page: library and data, compressed, and the script."""

    library: Markup
    data: Markup
    script: Markup


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
    """All charts of a page: collects them one by one, and packs their data."""

    _charts: list[dict[str, Any]] = field(default_factory=list)
    _points: int = 0

    def add(self, chart: Chart) -> Place:
        """Add a chart; return its place in the page."""
        times = _Times()
        panels = [self._panel(panel, times) for panel in chart.panels]
        first = min((row[0] for row in times.rows if row), default=0.0)
        last = max((row[-1] for row in times.rows if row), default=1.0)
        identity = f"chart-{len(self._charts) + 1}"
        self._charts.append(
            {
                "id": identity,
                "axis": chart.axis,
                "from": first,
                "to": max(last, first + 1e-3),
                "times": times.rows,
                "panels": panels,
                "marks": [list(mark) for mark in chart.marks],
                "spans": [list(span) for span in chart.spans],
            }
        )
        full, sent = times.full, times.sent
        thin = f" Thinned: {sent} of {full} points, the least and the largest of every few." if sent < full else ""
        return Place(identity, chart.title, f"{chart.title}. {chart.told}".strip(), thin)

    def _panel(self, panel: Panel, times: "_Times") -> dict[str, Any]:
        return {
            "label": panel.label,
            "series": [self._series(line, times) for line in panel.lines],
            "bands": [list(band) for band in panel.bands],
            "lines": list(panel.at),
            "low": panel.low,
            "high": panel.high,
        }

    def _series(self, line: Line, times: "_Times") -> dict[str, Any]:
        time, values = thinned(*_interrupted(line.time, line.values), MOST if self._points < BUDGET else FEW)
        self._points += time.size
        times.full, times.sent = times.full + line.time.size, times.sent + min(time.size, line.time.size)
        return {
            "name": line.name,
            "colour": line.colour,
            "dashed": line.dashed,
            "step": line.step,
            "times": times.index_of(time),
            "values": [float(f"{v:.{_DIGITS}g}") for v in values],
        }

    def drawn(self) -> Drawn | None:
        """Return library, data and script for the end of the page; None without charts."""
        if not self._charts:
            return None
        content = {"palettes": {"light": LIGHT, "dark": DARK, "print": PRINT}, "charts": self._charts}
        library, script = (files(__package__).joinpath(name).read_text("utf-8") for name in (LIBRARY, "charts.js"))
        data = json.dumps(jsonable(content), allow_nan=False, separators=(",", ":"))
        return Drawn(_packed(library), _packed(data), Markup(script))  # noqa: S704 - a file of this package


@dataclass
class _Times:
    """The times of a chart's curves, each kept once; number of points before and after thinning."""

    rows: list[list[float]] = field(default_factory=list)
    full: int = 0
    sent: int = 0
    _known: dict[bytes, int] = field(default_factory=dict)

    def index_of(self, time: Array) -> int:
        """Return the index of the row with these times."""
        key = time.tobytes()
        if key not in self._known:
            self._known[key] = len(self.rows)
            self.rows.append([round(float(t), _DIGITS) for t in time])
        return self._known[key]


def _packed(text: str) -> Markup:
    """Return a text, compressed and in characters without meaning in HTML."""
    packed = base64.b64encode(gzip.compress(text.encode("utf-8"), 9, mtime=0))
    return Markup(packed.decode("ascii"))  # noqa: S704 - letters and digits
