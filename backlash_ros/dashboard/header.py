"""The header of the page: the axis, its state in colour and word, the law that acts, *Reset* at a fault, and *Stop*."""

from collections.abc import Callable

from nicegui import ui

from backlash_ros.dashboard.axis import Axis
from backlash_ros.dashboard.cards.card import Shown, button
from backlash_ros.dashboard.cards.law import ABOUT
from backlash_ros.dashboard.state import acts, fault_of, law_of, outside, silence, state_of

STATIC = "/static"


def header(page: Shown, watch: Callable[[str], None]) -> Callable[[Axis | None], None]:
    """Make the header; ``watch`` is called with the name of the axis that was chosen.

    Its height is fixed, and *Stop* has a column of its own: no text moves it.
    """

    async def reset() -> None:
        if page.axis is not None:
            await page.axis.reset()

    with ui.element("header").classes("bar"):
        with ui.element("div").classes("where"):
            with ui.element("div").classes("who"):
                ui.html("<h1>backlash_ros</h1>", sanitize=False)
                choice = ui.select([], on_change=lambda event: watch(event.value))
                choice.props('dense outlined options-dense data-name=axis aria-label="axis"')
                state = ui.label("").classes("state").props('data-name=state aria-live="polite"')
                again = button("Reset", reset, "reset")
            with ui.element("div").classes("what"):
                ui.html('<output id="stop-text" aria-live="assertive"></output>', sanitize=False)
                law = ui.label("").props("data-name=acts")
        if page.read_only:
            ui.label("read-only").classes("muted")
        else:
            stop = ui.button("Stop: 0 V").classes("stop").props("unelevated no-caps data-name=stop")
            stop.props('color=negative aria-keyshortcuts="Escape"')
            stop.on("click", js_handler=f"() => import('{STATIC}/live.js').then(m => m.stop(window.facts?.axis))")
    kinds = ("good", "busy", "bad", "idle")

    def refresh(axis: Axis | None) -> None:
        titles = list(page.station.axes)
        if titles != choice.options:
            choice.set_options(titles)
        if choice.value != (page.title or None):
            choice.set_value(page.title or None)
        choice.set_visibility(len(titles) > 1)
        again.set_visibility(axis is not None and bool(fault_of(axis)[0]) and not page.read_only)
        if axis is None:
            state.set_text("no controller")
            law.set_text("looking for a controller: none found yet")
            return
        word, kind = state_of(axis, page.station.of(axis.title).run)
        state.set_text(word)
        state.classes(add=kind, remove=" ".join(each for each in kinds if each != kind))
        law.props(f'title="{ABOUT.get(law_of(axis), "")}"')
        law.set_text(silence(axis) or outside(axis, page.angle) or acts(axis) or "no position is held")

    return refresh
