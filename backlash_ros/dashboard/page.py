"""The page itself: shows an axis and takes a person's commands."""

import json
import math
from contextlib import suppress
from html import escape
from importlib.resources import files
from typing import Any

from nicegui import context, ui

from backlash_ros.control.laws import BEST
from backlash_ros.control.telemetry import TELEMETRY
from backlash_ros.dashboard.axis import Axis
from backlash_ros.dashboard.cards.card import Refresh
from backlash_ros.dashboard.cards.facts import facts_card
from backlash_ros.dashboard.cards.files import files_card
from backlash_ros.dashboard.cards.law import law_card
from backlash_ros.dashboard.cards.move import move_card
from backlash_ros.dashboard.cards.results import results_card
from backlash_ros.dashboard.cards.simulated import simulated_card
from backlash_ros.dashboard.cards.steps import steps_card
from backlash_ros.dashboard.header import STATIC, header
from backlash_ros.dashboard.rows import JOINT_COLUMNS, STATE_COLUMNS
from backlash_ros.dashboard.state import ANGLES, AngleUnit, law_of, travel_of
from backlash_ros.dashboard.station import Station
from backlash_ros.simulation.colours import DARK, LIGHT

REFRESH = 0.25
"""Period of the updates of everything but the curves, s."""
WINDOWS = {10: "10 s", 30: "30 s", 60: "60 s"}
_ANSWERS = 6.0
"""Time limit for the answer of a browser, s."""
_LOOK = (
    ("Pause", "", "live.pause()"),
    ("Live", "", "live.live()"),
    ("Zoom in", "+", "live.zoom(0.5)"),
    ("Zoom out", "\N{MINUS SIGN}", "live.zoom(2)"),
    ("Earlier", "\N{LEFTWARDS ARROW}", "live.zoom(1, -0.5)"),
    ("Later", "\N{RIGHTWARDS ARROW}", "live.zoom(1, 0.5)"),
)
"""Buttons over the curves, the signs that stand for their words where there is little room, and what they do."""


def static_folder() -> str:
    """Return the folder of the page's own files."""
    return str(files("backlash_ros.dashboard") / "static")


def _variables(colours: dict[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


_COLOURS = (
    f"<style>:root {{ {_variables(LIGHT)} }} @media (prefers-color-scheme: dark) {{ :root {{ {_variables(DARK)} }} }}"
    f'</style><link rel="stylesheet" href="{STATIC}/style.css">'
)


class Page:
    """One open page.

    ``read_only`` leaves out everything that changes something.
    """

    def __init__(self, station: Station, read_only: bool) -> None:
        self.station, self.read_only = station, read_only
        self.title = next(iter(station.axes), "")
        self.angle = ANGLES["rad"]
        self._refreshers: list[Refresh] = []
        self._facts: dict[str, Any] = {}
        self._client = context.client
        ui.colors(primary=LIGHT["motor"], negative=LIGHT["bad"])
        ui.add_head_html(_COLOURS)
        self._header = header(self, self._watch)
        with ui.element("main").classes("page"):
            self._refreshers.append(steps_card(self))
            self._curves()
            with ui.element("div").classes("cards act"):
                self._tooth()
                if not read_only:
                    self._refreshers += [card(self) for card in (move_card, law_card, simulated_card)]
            with ui.element("div").classes("more"):
                self._refreshers += [results_card(self), facts_card(self)]
                if not read_only:
                    self._refreshers.append(files_card(self))
                self._parameters()
        ui.timer(REFRESH, self.refresh)

    @property
    def axis(self) -> Axis | None:
        """The axis that is shown, or None."""
        return self.station.axes.get(self.title)

    def _curves(self) -> None:
        with ui.element("section").classes("watch"):
            with ui.element("div").classes("line look"):
                window = ui.toggle(WINDOWS, value=10).props('dense unelevated no-caps aria-label="time shown"')
                window.on_value_change(lambda event: self._run(f"live.setWindow({int(event.value)})"))
                for text, short, code in _LOOK:
                    made = (
                        ui.button(text)
                        .props(f'dense flat no-caps data-look="{text}"')
                        .on("click", js_handler=f"() => window.{code}")
                    )
                    made.props(f'data-short="{short}" aria-label="{text}" title="{text}"' if short else "")
                self._units = ui.toggle(list(ANGLES), value="rad", on_change=lambda event: self._show_in(event.value))
                self._units.props('dense unelevated no-caps data-name=unit aria-label="unit of angles"')
            ui.html('<table id="steps" aria-label="the last two steps"></table>', sanitize=False)
            self._chart = ui.echart({"series": []}).classes("curves").props("data-name=curves")

    @staticmethod
    def _tooth() -> None:
        """Leave the place of the drawing, which the browser makes."""
        with ui.element("section").classes("card"):
            ui.html('<svg id="tooth" class="drawing" role="img"></svg>', sanitize=False).style("width: 100%")
            ui.html('<p id="tooth-text"></p>', sanitize=False)

    def _parameters(self) -> None:
        shown = ui.expansion("Parameters in use").classes("card fold").props("dense")
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

    def _show_in(self, unit: str) -> None:
        """Show angles in another unit, and let the browser remember it."""
        self.angle = ANGLES[unit]
        ui.run_javascript(f"localStorage.setItem('angle', '{unit}')")
        self.refresh()

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

    async def started(self) -> None:
        """Begin to draw, once the browser is connected, with the unit that it remembers."""
        with suppress(TimeoutError):  # it may keep nothing
            unit = await self._client.run_javascript("return localStorage.getItem('angle')", timeout=_ANSWERS)
            self._units.set_value(unit if unit in ANGLES else "rad")
        words = {name: TELEMETRY[name].words for name in ("region", "flank")}
        options = (
            f"joints: {list(JOINT_COLUMNS)}, state: {list(STATE_COLUMNS)}, words: {json.dumps(words)}, "
            f"facts: () => ({{angle: {json.dumps(_scales(ANGLES['rad']))}, ...window.facts}})"
        )
        # The chart is there a moment after its element.
        self._client.run_javascript(
            f"const draw = () => getElement({self._chart.id})?.chart ? import('{STATIC}/live.js').then(m => "
            f"m.start({{chart: getElement({self._chart.id}).chart, {options}}})) : setTimeout(draw, 50); draw();"
        )
        if not self.read_only:
            self._client.run_javascript(
                "document.addEventListener('keydown', e => { if (e.key === 'Escape') "
                f"import('{STATIC}/live.js').then(m => m.stop(window.facts?.axis)) }}); "
                f"import('{STATIC}/jog.js').then(m => m.watch())"
            )

    def refresh(self) -> None:
        """Show the present state of the axis."""
        self.title = self.title or next(iter(self.station.axes), "")
        axis = self.axis
        self._header(axis)
        if axis is None:
            return
        told = axis.told_by_simulator.values
        facts = {
            "axis": self.title,
            "stopped": self.station.of(self.title).stopped if axis.lifecycle == "inactive" else "",
            "unit": "A" if axis.told.values.get("command_interface") == "current" else "V",
            "gap": float(told.get("gear.backlash_angle", 0.0)) if axis.simulated else 0.0,
            "simulated": axis.simulated,
            "plans": law_of(axis) == BEST,
            "travel": [end for end in travel_of(axis) if math.isfinite(end)],
            "angle": _scales(self.angle),
        }
        if facts != self._facts:
            self._facts = facts
            ui.run_javascript(f"window.facts = {json.dumps(facts)}")
        for refresh in self._refreshers:
            refresh(axis)


def _scales(angle: AngleUnit) -> dict[str, Any]:
    """Return a unit of angles as the browser takes it."""
    return {**angle.large._asdict(), "small": angle.small._asdict()}


def _table(values: dict[str, Any]) -> str:
    rows = (
        f"<tr><td>{escape(name)}</td><td>{escape(_value(value))}</td></tr>" for name, value in sorted(values.items())
    )
    return f'<table class="parameters"><tbody>{"".join(rows)}</tbody></table>'


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        return f"[{', '.join(_value(each) for each in value)}]"
    return str(value)
