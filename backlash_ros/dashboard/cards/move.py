"""The card that moves the load: to an angle, by a step, back and forth, along a sine."""

import math

from nicegui import context, ui

from backlash_ros.dashboard.axis import Answer, Axis
from backlash_ros.dashboard.cards.card import FIELD, Refresh, Said, Shown, button, card, line
from backlash_ros.dashboard.motion import Wave
from backlash_ros.dashboard.station import finite


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


def refusal(axis: Axis) -> str:
    """Return why an axis takes no reference; empty if it does."""
    if axis.last_state.get("holding", 0.0):
        return ""
    return "nothing was sent: the controller holds no position and refuses references"


def step(page: Shown, way: float) -> None:
    """Send a reference that is ``way`` (rad) from the last one, in place of any continuous motion."""
    if page.axis is not None:
        page.station.end(page.title)
        page.axis.move(_goal(page.axis) + way)


def move_card(page: Shown) -> Refresh:
    """Make the card."""
    station = page.station
    ended = ""

    def usable(*fields: ui.number) -> bool:
        axis = page.axis
        why = next(filter(None, map(_refusal, fields)), "") or (refusal(axis) if axis else "there is no axis")
        said.tell(axis, Answer(not why, why))
        return not why

    def go() -> None:
        if usable(target) and page.axis is not None:
            station.end(page.title)
            page.axis.move(target.value)

    def make_step(sign: float) -> None:
        if usable(way):
            step(page, sign * way.value)

    def begin(smooth: bool) -> None:
        if usable(way, period) and page.axis is not None:
            station.begin(page.title, Wave(_goal(page.axis), way.value, period.value, smooth), page)

    with card("Move"):
        with line():
            target = ui.number("angle, rad", value=1.0, step=0.1, format="%g").props(FIELD).props("data-name=target")
            button("Go there", go, "go", primary=True)
            way = ui.number("way, rad", value=0.5, min=0.0, step=0.1, format="%g").props(FIELD).props("data-name=way")
            period = ui.number("period, s", value=4.0, min=0.1, step=0.5, format="%g").props(FIELD)
        with line():
            button("Step forward", lambda: make_step(1.0), "step")
            button("Step back", lambda: make_step(-1.0))
            button("Back and forth", lambda: begin(False), "to-and-fro")
            button("Sine", lambda: begin(True), "sine")
            button("Stay", lambda: station.end(page.title), "stay")
        said = Said("move-answer")

    def refresh(axis: Axis) -> None:
        nonlocal ended
        said.refresh(axis)
        before, ended = ended, station.of(axis.title).ended
        if ended != before:
            said.tell(axis, Answer(not ended, ended))

    context.client.on_disconnect(lambda: station.left(page))
    return refresh
