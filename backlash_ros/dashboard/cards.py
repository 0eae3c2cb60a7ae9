"""The cards of the page: move, law and gains, experiments, drive, simulator, record."""

import asyncio
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from lifecycle_msgs.msg import Transition
from nicegui import context, ui
from nicegui.events import GenericEventArguments

from backlash_ros.control import AUTO, EXPERIMENTS, LAWS
from backlash_ros.control.design.gain_sets import CUSTOM
from backlash_ros.control.telemetry import TELEMETRY
from backlash_ros.dashboard.axis import EXPERIMENT, Answer, Axis
from backlash_ros.dashboard.motion import Wave
from backlash_ros.dashboard.station import Mover, Refresh, Station, finite, megabytes
from backlash_ros.gates.faults import FAULTS, Fault
from backlash_ros.ros.client import stop_node

_FIELD = "dense outlined"
_BUTTON = "dense unelevated no-caps"
_LEAST, _MOST = -2.0, 6.0
"""Range of the sliders for weights, in powers of ten; at the lower end a weight is 0."""
_LET_GO = 0.7
"""Time without motion after which a slider shows the value in use again, s."""
_ALL_SIGNALS = ["theta_m", "omega_m", "theta_l", "omega_l", "current"]
_JUMP = 0.5
"""Shift of an encoder's zero that makes it jump, rad."""


class Shown(Mover, Protocol):
    """The page that a card is on."""

    station: Station
    read_only: bool
    title: str

    @property
    def axis(self) -> Axis | None:
        """The axis that is shown, or None."""


def _card(title: str) -> ui.element:
    card = ui.element("section").classes("card")
    with card:
        ui.html(f"<h2>{title}</h2>", sanitize=False)
    return card


def _line() -> ui.element:
    return ui.element("div").classes("line")


def _button(text: str, act: Callable[..., Any], name: str = "") -> ui.button:
    button = ui.button(text, on_click=act).props(_BUTTON)
    return button.props(f"data-name={name}") if name else button


def _tell(label: ui.label, answer: Answer) -> None:
    label.set_text(answer.text)
    label.classes(remove="bad good", add="" if answer.success else "bad")


def _show_link(link: ui.link, station: Station, axis: Axis, kind: str) -> None:
    link.set_visibility(station.page(axis.title, kind) is not None)
    link.props(f'href="/pages/{kind}?axis={axis.title}"')


def _refusal(field: ui.number) -> str:
    """Return why the value of a field cannot be used; empty if it can."""
    value, least = field.value, field.min
    if value is not None and math.isfinite(value) and (least is None or value >= least):
        return ""
    bound = "" if least in (None, -math.inf) else f" >= {least:g}"
    return f"{field.props['label']} must be a number{bound}, got {value}"


def _goal(axis: Axis) -> float:
    """Return the reference of an axis, rad, or without one where its load is."""
    state = axis.last_state
    return finite(state.get("reference", math.nan), finite(state.get("load_angle", math.nan)))


def move_card(page: Shown) -> Refresh:
    """Step, back and forth, sine, a typed value."""
    station = page.station
    ended = ""

    def usable(*fields: ui.number) -> bool:
        if why := next(filter(None, map(_refusal, fields)), ""):
            _tell(said, Answer(False, why))
            return False
        if page.axis is not None and not page.axis.last_state.get("holding", math.nan):
            _tell(said, Answer(False, "nothing was sent: the controller holds no position and refuses references"))
            return False
        said.set_text("")
        return page.axis is not None

    def go() -> None:
        if usable(target) and page.axis is not None:
            station.end(page.title)
            page.axis.move(target.value)

    def step(sign: float) -> None:
        if usable(amplitude) and page.axis is not None:
            station.end(page.title)
            page.axis.move(_goal(page.axis) + sign * amplitude.value)

    def begin(smooth: bool) -> None:
        if usable(amplitude, period) and page.axis is not None:
            station.begin(page.title, Wave(_goal(page.axis), amplitude.value, period.value, smooth), page)

    with _card("Move"):
        with _line():
            target = ui.number("angle, rad", value=1.0, step=0.1, format="%g").props(_FIELD).props("data-name=target")
            _button("Go there", go, "go")
        with _line():
            amplitude = (
                ui.number("way, rad", value=0.5, min=0.0, step=0.1, format="%g").props(_FIELD).props("data-name=way")
            )
            period = ui.number("period, s", value=4.0, min=0.1, step=0.5, format="%g").props(_FIELD)
        with _line():
            _button("Step forward", lambda: step(1.0), "step")
            _button("Step back", lambda: step(-1.0))
            _button("Back and forth", lambda: begin(False), "to-and-fro")
            _button("Sine", lambda: begin(True), "sine")
            _button("Stay", lambda: station.end(page.title), "stay")
        said = ui.label("").classes("answer").props("data-name=move-answer")

    def refresh(axis: Axis) -> None:
        nonlocal ended
        before, ended = ended, station.of(axis.title).ended
        if ended != before:
            _tell(said, Answer(False, ended))

    context.client.on_disconnect(lambda: station.left(page))
    return refresh


def _power(value: float) -> float:
    return math.log10(value) if value > 10**_LEAST else _LEAST


def law_card(page: Shown) -> Refresh:
    """Choose law and gain set."""
    shown: dict[str, int] = {}
    with _card("Law"):
        with _line():
            law = ui.select(sorted([AUTO, *LAWS]), label="law").props(f"{_FIELD} options-dense data-name=law")
            gain_set = ui.select([], label="gain set").props(f"{_FIELD} options-dense data-name=gain-set")
        said = ui.label("").classes("answer").props('aria-live="polite"')

    async def ask(name: str, value: Any) -> None:
        axis = page.axis
        if axis is None or value is None or axis.told.values.get(name) == value:
            return
        answer = await axis.set({name: value})
        _tell(said, answer if not answer.success else Answer(True, ""))
        shown.clear()  # what was refused goes back to what is in use

    law.on_value_change(lambda event: ask("law", event.value))
    gain_set.on_value_change(lambda event: ask("gain_set", event.value))

    def refresh(axis: Axis) -> None:
        values = axis.told.values
        if values and shown.get(axis.title) != axis.told.version:
            shown.clear()
            shown[axis.title] = axis.told.version
            law.set_value(values.get("law"))
            gain_set.set_options([*values.get("gain_set_names", []), CUSTOM], value=values.get("gain_set"))

    return refresh


def gains_card(page: Shown) -> Refresh:
    """Tune the weights of the gains; show the gains and their margins."""
    sliders: dict[tuple[str, int], ui.slider] = {}
    lines: dict[str, ui.label] = {}
    touched = -math.inf

    def touch() -> None:
        nonlocal touched
        touched = time.monotonic()

    async def ask(region: str, place: int, power: float) -> None:
        powers = [slider.value for (of, _), slider in sliders.items() if of == region]
        powers[place] = power
        q = [0.0 if each <= _LEAST else 10.0**each for each in powers]
        if page.axis is not None:
            answer = await page.axis.set({f"gains.{region}.q": q})
            _tell(said, answer if not answer.success else Answer(True, ""))

    async def changed(region: str, place: int, event: GenericEventArguments) -> None:
        await ask(region, place, float(event.args))

    with _card("Gains"):
        for region, words in (("fast", "Fast gains"), ("overdamped", "Over-damped gains")):
            ui.label(words)
            for place, what in enumerate(("angle", "speed")):
                with _line():
                    ui.label(f"weight on {what}").classes("muted").style("width: 8rem")
                    slider = ui.slider(min=_LEAST, max=_MOST, step=0.05, value=0.0).style("flex: 1")
                    slider.props(f'data-name={region}-{place} aria-label="{words}: weight on {what}, power of ten"')
                    slider.on_value_change(touch)
                    slider.on("change", partial(changed, region, place))
                    sliders[region, place] = slider
            lines[region] = ui.label("").classes("muted").props(f"data-name={region}-gains")
        said = ui.label("").classes("answer").props('aria-live="polite" data-name=law-answer')

    def refresh(axis: Axis) -> None:
        values = axis.told.values
        if not values:
            return
        if time.monotonic() > touched + _LET_GO:
            for (region, place), slider in sliders.items():
                power = min(_MOST, max(_LEAST, _power(values[f"gains.{region}.q"][place])))
                if abs(slider.value - power) > 1e-6:
                    slider.set_value(power)
        for region, line in lines.items():
            k = ", ".join(f"{each:.3g}" for each in values[f"gains.{region}.k"])
            margins = axis.margins.get(region)
            line.set_text(f"k = [{k}]" + (f"; margins: {margins.in_words()}" if margins else ""))

    return refresh


def experiment_card(page: Shown) -> Refresh:
    """Learn, identify and the other experiments: progress, result, apply, cancel; measure with a certificate."""
    station = page.station

    async def call(service: str, seconds: float = 5.0) -> None:
        if page.axis is not None:
            _tell(said, await page.axis.call(service, seconds))

    async def run(service: str) -> None:
        station.end(page.title)
        said.set_text("")
        await call(service, EXPERIMENT)

    async def choose(name: str) -> None:
        axis = page.axis
        if axis is not None and name is not None and axis.told.values.get("learning.experiment") != name:
            answer = await axis.set({"learning.experiment": name})
            _tell(said, answer if not answer.success else Answer(True, ""))
            if not answer.success:
                kind.set_value(axis.told.values.get("learning.experiment"))

    def measure() -> None:
        work = station.of(page.title).measurement
        if page.axis is not None and (work is None or not work.running):
            station.end(page.title)
            try:
                station.measure(page.title)
            except OSError as error:
                _tell(said, Answer(False, f"folder: {error}"))

    with _card("Learn and identify"):
        kind = ui.select([AUTO, *sorted(EXPERIMENTS)], label="experiment of Learn").props(f"{_FIELD} options-dense")
        kind.props("data-name=experiment")
        with _line():
            _button("Learn the backlash", lambda: run("learn"), "learn")
            _button("Identify the drive", lambda: run("identify"), "identify")
            _button("Cancel", lambda: call("cancel"), "cancel")
            _button("Apply the estimate", lambda: call("apply_estimate"), "apply")
        progress = ui.linear_progress(0.0, show_value=False).props('aria-label="progress of the experiment"')
        known = ui.label("").classes("muted").props("data-name=backlash")
        said = ui.label("").classes("answer").props('aria-live="polite"').props("data-name=experiment-answer")
        with _line():
            _button("Measure with a certificate", measure, "measure")
            link = ui.link("open the certificate", "", new_tab=True).props("data-name=certificate")
        measured = ui.label("").classes("muted")

    kind.on_value_change(lambda event: choose(event.value))

    def refresh(axis: Axis) -> None:
        state = axis.last_state
        progress.set_value(finite(state.get("progress", 0.0)) if state.get("experiment") else 0.0)
        kind.set_value(axis.told.values.get("learning.experiment"))
        known.set_text(f"backlash in use: {1e3 * axis.b:.3g} mrad" if axis.b else "the backlash is not learned yet")
        work = station.of(axis.title).measurement
        _show_link(link, station, axis, "certificate")
        if work is not None:
            measured.set_text("measuring ..." if work.running else work.last_line())

    return refresh


def drive_card(page: Shown) -> Refresh:
    """Lifecycle, fault with its meaning and remedy, rate, age, connections."""
    station, facts = page.station, {}
    names = ("controller", "drive", "fault", "what to do", "law acts", "rate", "late samples", "age", "connections")

    async def change() -> None:
        if page.axis is not None:
            if page.axis.lifecycle == "unconfigured":
                await page.axis.change(Transition.TRANSITION_CONFIGURE)
            answer = await page.axis.change(Transition.TRANSITION_ACTIVATE)
            _tell(said, answer if not answer.success else Answer(True, "active"))

    async def reset() -> None:
        if page.axis is not None:
            _tell(said, await page.axis.reset())

    with _card("Drive and controller"):
        with ui.element("div").classes("facts"):
            for name in names:
                ui.label(name)
                facts[name] = ui.label("").props(f"data-name=fact-{name.replace(' ', '-')}")
        if not page.read_only:
            with _line():
                _button("Activate", change, "activate")
                _button("Reset the fault", reset, "reset")
            said = ui.label("").classes("answer")

    def word(axis: Axis, name: str) -> str:
        value = axis.last_state.get(name, math.nan)
        return TELEMETRY[name].words.get(int(value), "") if math.isfinite(value) else ""

    def refresh(axis: Axis) -> None:
        servo, timing = axis.diagnoses.get("controller: servo"), axis.diagnoses.get("controller: timing")
        drive = axis.diagnoses.get("simulator: drive") if axis.simulated else None
        said = servo.values if servo else {}
        facts["controller"].set_text(f"{axis.names.controller}, {axis.lifecycle}")
        here = "simulated by " + axis.names.simulator if axis.simulated else "a real one"
        gone = axis.silent > 1.0
        facts["drive"].set_text("no joint states" if gone else here)
        latched = said.get("fault_name", "") or (drive.values.get("fault_name", "") if drive else "")
        meaning = FAULTS.get(Fault[latched]) if latched in Fault.__members__ else None
        facts["fault"].set_text(f"{latched}: {meaning.meaning}" if meaning else latched or "none")
        facts["what to do"].set_text(f"{meaning.remedy} Then reset the fault." if meaning else "")
        acts = [word(axis, "region"), word(axis, "phase")]
        facts["law acts"].set_text(
            ", ".join(each for each in acts if each not in ("", "none")) or "no position is held"
        )
        paced = timing.values if timing else {}
        facts["rate"].set_text(f"{paced.get('rate_Hz', '')} of {paced.get('nominal_rate_Hz', '')} Hz" if paced else "")
        facts["late samples"].set_text(paced.get("late_samples", ""))
        age = paced.get("state_age", "")
        facts["age"].set_text("" if "nan" in age else age)
        heard, drives = station.graph.listeners(axis)
        facts["connections"].set_text(f"subscribers of command: {heard}, publishers of joint states: {drives}")

    return refresh


def simulator_card(page: Shown) -> Refresh:
    """Load torque and faults to inject, for a simulated drive."""
    before: dict[str, dict[str, Any]] = {}

    def gap() -> float:
        axis = page.axis
        return float(axis.told_by_simulator.values.get("gear.backlash_angle", 0.02)) if axis else 0.02

    async def inject(values: dict[str, Any]) -> None:
        axis = page.axis
        if axis is None:
            return
        now = axis.told_by_simulator.values
        kept = before.setdefault(axis.title, {})
        for name in values:
            kept.setdefault(name, now.get(name))
        _tell(said, await axis.set(values, simulator=True))

    async def jump() -> None:
        axis = page.axis
        if axis is not None:
            offset = float(axis.told_by_simulator.values.get("sensors.load_offset", 0.0))
            await inject({"sensors.load_offset": offset + _JUMP})

    async def restore() -> None:
        axis = page.axis
        if axis is None:
            return
        torque.set_value(0.0)
        axis.load(0.0)
        if kept := before.pop(axis.title, {}):
            _tell(said, await axis.set(kept, simulator=True))

    def load(value: float) -> None:
        if page.axis is not None and page.axis.simulated:
            page.axis.load(value)

    card = _card("Simulated drive")
    with card:
        ui.label("load torque, N m").classes("muted")
        torque = ui.slider(min=-0.5, max=0.5, step=0.01, value=0.0).props('label aria-label="load torque, N m"')
        torque.props("data-name=load-torque")
        with _line():
            _button("Load encoder jumps", jump, "jump")
            _button("Load encoder lost", lambda: inject({"sensors.measured": _ALL_SIGNALS[:2] + _ALL_SIGNALS[4:]}))
            _button("Motor encoder lost", lambda: inject({"sensors.measured": _ALL_SIGNALS[2:]}))
            _button("Noise", lambda: inject({"sensors.load_noise": 0.1 * gap()}))
            _button("As it was", restore, "as-it-was")
        said = ui.label("").classes("answer")

    torque.on("change", lambda event: load(float(event.args)))

    def refresh(axis: Axis) -> None:
        card.set_visibility(axis.simulated)

    return refresh


def record_card(page: Shown) -> Refresh:
    """Start and end a recording, and show its size."""
    station = page.station

    async def toggle() -> None:
        running = station.of(page.title)
        work = running.recorder
        if work is not None and work.running:
            button.disable()
            await asyncio.to_thread(stop_node, work.process)
            button.enable()
        elif page.axis is not None:
            try:
                station.record(page.title)
            except OSError as error:
                said.set_text(f"folder: {error}")

    def report() -> None:
        work = station.of(page.title).report
        if work is None or not work.running:
            station.report(page.title)

    with _card("Record"):
        button = _button("Record", toggle, "record")
        said = ui.label("").classes("muted").props("data-name=recording")
        write = _button("Write its report", report)
        told = ui.label("").classes("muted").props("data-name=report")
        link = ui.link("open the report", "", new_tab=True).props("data-name=report-link")

    def refresh(axis: Axis) -> None:
        running = station.of(axis.title)
        work = running.recorder
        write.set_visibility(work is not None and not work.running)
        _show_link(link, station, axis, "report")
        if running.report is not None:
            told.set_text("writing ..." if running.report.running else running.report.last_line())
        if work is None:
            return
        button.set_text("End the recording" if work.running else "Record")
        state = "recording" if work.running else "recorded"
        said.set_text(f"{state} {megabytes(work.size)} in {work.result}")

    return refresh
