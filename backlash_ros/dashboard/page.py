"""The page itself: shows an axis and takes a person's commands."""

import json
import math
from collections.abc import Callable
from importlib.resources import files
from typing import Any

from nicegui import context, ui

from backlash_ros.dashboard.axis import SILENCE, Axis
from backlash_ros.dashboard.cards import (
    drive_card,
    experiment_card,
    gains_card,
    law_card,
    move_card,
    record_card,
    simulator_card,
)
from backlash_ros.dashboard.rows import JOINT_COLUMNS, STATE_COLUMNS
from backlash_ros.dashboard.station import Station

REFRESH = 0.25
"""Period of the updates of everything but the curves, s."""
WINDOWS = {10: "10 s", 30: "30 s", 60: "60 s"}
STATIC = "/static"
_ANSWERS = 6.0
"""Time limit for the answer of a browser, s."""

_TOOTH = """
<svg class="drawing" viewBox="0 0 460 170" role="img" aria-labelledby="tooth-title" id="tooth">
  <title id="tooth-title">The tooth of the motor's gear in the gap of the load's gear, magnified</title>
  <line class="target" x1="230" y1="4" x2="230" y2="150"/>
  <text x="236" y="134">target</text>
  <g id="gap">
    <path class="body" d="M-150 124 V88 H-95 L-77 30 H-150 Z"/>
    <path class="body" d="M150 124 V88 H95 L77 30 H150 Z"/>
    <path class="body" d="M-150 88 H150 V124 H-150 Z"/>
    <path class="flank" id="left" d="M-95 88 L-77 30"/>
    <path class="flank" id="right" d="M95 88 L77 30"/>
    <text x="-146" y="112">load</text>
  </g>
  <g id="pinion"><path class="tooth" d="M-32 6 L-50 84 H50 L32 6 Z"/><text x="-17" y="50">motor</text></g>
  <path id="force"/>
  <rect id="swing" x="228" y="136" width="4" height="7"/>
  <text x="8" y="164">bar: swing of the load in the last second</text>
</svg>
"""


def static_folder() -> str:
    """Return the folder of the page's own files."""
    return str(files("backlash_ros.dashboard") / "static")


class Page:
    """One open page.

    ``read_only`` leaves out everything that changes something.
    """

    def __init__(self, station: Station, read_only: bool) -> None:
        self.station, self.read_only = station, read_only
        self.title = next(iter(station.axes), "")
        self._refreshers: list[Callable[[Axis], None]] = []
        self._facts: dict[str, Any] = {}
        self._client = context.client
        ui.colors(primary="#0b5fa5")
        ui.add_head_html(f'<link rel="stylesheet" href="{STATIC}/style.css">')
        self._bar()
        with ui.element("main").classes("page"):
            with ui.element("div").classes("cards"):
                self._curves()
                with ui.element("div").classes("pair"):
                    self._refreshers.append(drive_card(self))
                    if not read_only:
                        self._refreshers.append(simulator_card(self))
                        self._refreshers.append(record_card(self))
                self._parameters()
            with ui.element("div").classes("cards"):
                self._drawing()
                if not read_only:
                    for card in (move_card, law_card, experiment_card, gains_card):
                        self._refreshers.append(card(self))
        ui.timer(REFRESH, self.refresh)

    @property
    def axis(self) -> Axis | None:
        """The axis that is shown, or None."""
        return self.station.axes.get(self.title)

    def _bar(self) -> None:
        with ui.element("header").classes("bar"):
            ui.html("<h1>backlash_ros</h1>", sanitize=False)
            self._choice = ui.select([], label="axis", on_change=lambda event: self._watch(event.value))
            self._choice.props("dense outlined options-dense").props("data-name=axis")
            self._lifecycle = ui.label("looking for a controller").props("data-name=lifecycle")
            self._fault = ui.label("").classes("bad").props("data-name=fault")
            ui.element("div").classes("grow")
            if self.read_only:
                ui.label("read-only").classes("muted")
                return
            ui.html('<output id="stop-text" aria-live="assertive"></output>', sanitize=False)
            stop = (
                ui.button("Stop: 0 V")
                .classes("stop")
                .props('color=negative unelevated no-caps aria-keyshortcuts="Escape"')
            )
            stop.on("click", js_handler=f"() => import('{STATIC}/live.js').then(m => m.stop(window.facts?.axis))")
            stop.props("data-name=stop")

    def _curves(self) -> None:
        with ui.element("div").classes("line"):
            window = ui.toggle(WINDOWS, value=10).props('dense unelevated no-caps aria-label="time shown"')
            window.on_value_change(lambda event: self._run(f"live.setWindow({int(event.value)})"))
            for text, code in (
                ("Pause", "live.pause()"),
                ("Live", "live.live()"),
                ("Zoom in", "live.zoom(0.5)"),
                ("Zoom out", "live.zoom(2)"),
                ("Earlier", "live.zoom(1, -0.5)"),
                ("Later", "live.zoom(1, 0.5)"),
            ):
                ui.button(text).props("dense flat no-caps").on("click", js_handler=f"() => window.{code}")
        self._chart = ui.echart({"series": []}).classes("curves").props("data-name=curves")

    def _drawing(self) -> None:
        with ui.element("section").classes("card"):
            ui.html("<h2>The tooth in its gap</h2>", sanitize=False)
            ui.html(_TOOTH, sanitize=False).style("width: 100%")
            ui.html('<output class="muted" id="swing-text"></output>', sanitize=False)

    def _parameters(self) -> None:
        shown = ui.expansion("Parameters in use").classes("card").props("dense")
        with shown:
            table = ui.html("", sanitize=True)
        version = [-1]

        def refresh(axis: Axis) -> None:
            told = axis.told
            if told.version != version[0]:
                version[0] = told.version
                shown.set_text(f"Parameters in use, version {told.version}")
                table.set_content(_table(told.values))

        self._refreshers.append(refresh)

    @staticmethod
    def _run(code: str) -> None:
        ui.run_javascript(f"window.{code}")

    def _watch(self, title: str) -> None:
        if title and title != self.title:
            self.title = title
            self.refresh()

    async def answers(self) -> bool:
        """Return whether its browser answers."""
        try:
            return bool(await self._client.run_javascript("return true", timeout=_ANSWERS))
        except TimeoutError:
            return False

    def started(self) -> None:
        """Begin to draw, once the browser is connected."""
        options = f"joints: {list(JOINT_COLUMNS)}, state: {list(STATE_COLUMNS)}, facts: () => window.facts ?? {{}}"
        # The chart is there a moment after its element.
        self._client.run_javascript(
            f"const draw = () => getElement({self._chart.id})?.chart ? import('{STATIC}/live.js').then(m => "
            f"m.start({{chart: getElement({self._chart.id}).chart, {options}}})) : setTimeout(draw, 50); draw();"
        )
        if not self.read_only:
            self._client.run_javascript(
                "document.addEventListener('keydown', e => { if (e.key === 'Escape') "
                f"import('{STATIC}/live.js').then(m => m.stop(window.facts?.axis)) }})"
            )

    def refresh(self) -> None:
        """Show the present state of the axis."""
        titles = list(self.station.axes)
        if titles != self._choice.options:
            self._choice.set_options(titles)
        if not self.title and titles:
            self.title = titles[0]
        if self._choice.value != (self.title or None):
            self._choice.set_value(self.title or None)
        axis = self.axis
        if axis is None:
            self._lifecycle.set_text("looking for a controller: none found yet")
            return
        silent = "" if axis.silent < SILENCE else "no joint states from the drive"
        if silent and math.isfinite(axis.silent):
            silent += f" since {axis.silent:.0f} s"
        self._lifecycle.set_text(", ".join(filter(None, (f"controller {axis.lifecycle}", silent))))
        servo = axis.diagnoses.get("controller: servo")
        self._fault.set_text(servo.values.get("fault", "") if servo and axis.present else "")
        told = axis.told_by_simulator.values
        facts = {
            "axis": self.title,
            "unit": "A" if axis.told.values.get("command_interface") == "current" else "V",
            "gap": float(told.get("gear.backlash_angle", 0.0)) if axis.simulated else 0.0,
            "simulated": axis.simulated,
        }
        if facts != self._facts:
            self._facts = facts
            ui.run_javascript(f"window.facts = {json.dumps(facts)}")
        for refresh in self._refreshers:
            refresh(axis)


def _table(values: dict[str, Any]) -> str:
    def cell(text: str) -> str:
        return text.replace("&", "&amp;").replace("<", "&lt;")

    rows = (f"<tr><td>{cell(name)}</td><td>{cell(_value(value))}</td></tr>" for name, value in sorted(values.items()))
    return f'<table class="parameters"><tbody>{"".join(rows)}</tbody></table>'


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        return f"[{', '.join(_value(each) for each in value)}]"
    return str(value)
