"""The card that moves the load: to an angle, by a step, back and forth, along a sine."""

import math
from collections.abc import Callable, Mapping
from functools import partial

from nicegui import context, ui

from backlash_ros.dashboard.axis import Answer, Axis
from backlash_ros.dashboard.cards.card import FIELD, Refresh, Said, Shown, button, fill, line
from backlash_ros.dashboard.jog import SHARES, abilities
from backlash_ros.dashboard.motion import Wave
from backlash_ros.dashboard.state import ANGLES, beyond, refusal, travel_text
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


def _hindrance(page: Shown, axis: Axis, *targets: float) -> str:
    """Return why the load may not go to one of these targets, rad; empty if it may."""
    return refusal(axis) or next(filter(None, (beyond(axis, target, page.angle) for target in targets)), "")


def _go(page: Shown, axis: Axis, target: float) -> str:
    """Send a reference, rad, in place of any continuous motion, or return why not."""
    why = _hindrance(page, axis, target)
    if not why:
        page.station.end(page.title)
        axis.move(target)
    return why


def step(page: Shown, axis: Axis, way: float) -> str:
    """Send a reference that is ``way`` (rad) from the last one, or return why not."""
    return _go(page, axis, _goal(axis) + way)


class _Angle:
    """A field for an angle: one in each unit, of which the chosen one is seen.

    So a number is always in the unit that was beside it when it was typed, whenever it arrives.
    """

    def __init__(self, page: Shown, name: str, angle: float, least: float | None = None) -> None:
        self._page = page
        self._fields = {}
        for unit in ANGLES.values():
            label, value = f"{name}, {unit.large.name}", angle * unit.large.factor
            made = ui.number(label, value=value, min=least, step=unit.step, format="%g")
            self._fields[unit] = made.props(f"{FIELD} data-name={name}-{unit.large.name}")
            made.set_visibility(False)
        self._seen = page.angle

    @property
    def field(self) -> ui.number:
        """The field that is seen."""
        return self._fields[self._seen]

    @property
    def angle(self) -> float:
        """Its angle, rad; only for a field with a usable value."""
        return float(self.field.value) / self._seen.large.factor

    def refresh(self) -> None:
        """Show the field in the chosen unit, with the same angle."""
        chosen = self._page.angle
        if chosen != self._seen:
            value = None if _refusal(self.field) else self.angle * chosen.large.factor
            self._seen = chosen
            self.field.set_value(value)
        for unit, field in self._fields.items():
            field.set_visibility(unit == chosen)


class _Jog:
    """Two buttons that move the load for as long as they are held, and the speed.

    The browser alone knows that a button is held, and with what speed: see ``static/jog.js``.
    """

    def __init__(self, page: Shown) -> None:
        self._page, self._version, self._able = page, -1, 0.0
        options = "".join(f'<option value="{share}">{100.0 * share:g} %</option>' for share in SHARES)
        with line().classes("jog"):
            self._button("Jog \N{MINUS SIGN}", -1)
            ui.html(f'<select id="jog-share" aria-label="speed while held">{options}</select>', sanitize=False)
            self._speed = ui.label("").classes("muted").props("data-name=jog-speed")
            self._button("Jog +", 1)
        ui.html('<output id="jog-text" class="answer" aria-live="polite"></output>', sanitize=False)

    @staticmethod
    def _button(text: str, way: int) -> None:
        does = f"move {'forward' if way > 0 else 'back'} while held"
        made = ui.button(text).props(f'dense no-caps outline :ripple="false" data-jog="{way}"')
        made.props(f'title="{does}: pointer, space, or arrow keys"')

    def refresh(self, axis: Axis) -> None:
        """Show the speed of which the shares are."""
        if axis.told.version != self._version:
            self._version = axis.told.version
            try:
                self._able = abilities(axis.told.values).velocity
            except (KeyError, ValueError, TypeError):  # another version's controller
                self._able = 0.0
        large = self._page.angle.large
        speed = large.factor * self._able
        self._speed.set_text(f"of {speed:.{3 if speed < 1e3 else 5}g} {large.name}/s")


def _mark(buttons: Mapping[bool, ui.button], runs: Wave | None) -> None:
    """Show which wave runs, by whether it is smooth."""
    for smooth, each in buttons.items():
        pressed = runs is not None and runs.smooth == smooth
        fill(each, pressed)
        each.props(f'aria-pressed="{str(pressed).lower()}"')


def move_card(page: Shown) -> Refresh:
    """Make the card."""
    station = page.station
    ended = ""

    def act(does: Callable[[Axis], str], *fields: ui.number) -> None:
        """Do it if these fields are usable, and say why not."""
        if (axis := page.axis) is not None:
            why = next(filter(None, map(_refusal, fields)), "") or does(axis)
            said.tell(axis, Answer(not why, why))

    def make_step(sign: float) -> None:
        act(lambda axis: step(page, axis, sign * way.angle), way.field)

    def begin(smooth: bool) -> None:
        def wave(axis: Axis) -> str:
            middle, far = _goal(axis), way.angle
            why = _hindrance(page, axis, middle - far, middle + far)
            if not why:
                station.begin(page.title, Wave(middle, far, period.value, smooth), page)
            return why

        act(wave, way.field, period)

    with ui.element("section").classes("card"):
        with line():
            ui.html("<h2>Move</h2>", sanitize=False)
            travel = ui.label("").classes("muted").props("data-name=travel")
        with line():
            target = _Angle(page, "angle", 1.0)
            go = partial(act, lambda axis: _go(page, axis, target.angle), target.field)
            button("Go there", go, "go", primary=True)
            way = _Angle(page, "step", 0.5, least=0.0)
            period = ui.number("period, s", value=4.0, min=0.1, step=0.5, format="%g").props(FIELD)
        with line():
            button("Step forward", lambda: make_step(1.0), "step")
            button("Step back", lambda: make_step(-1.0))
            waves = {
                smooth: button(text, partial(begin, smooth), name)
                for smooth, text, name in ((False, "Back and forth", "to-and-fro"), (True, "Sine", "sine"))
            }
            button("Stay", lambda: station.end(page.title), "stay")
        jogs = _Jog(page)
        said = Said("move-answer")

    def refresh(axis: Axis) -> None:
        nonlocal ended
        target.refresh()
        way.refresh()
        jogs.refresh(axis)
        said.refresh(axis)
        ends = travel_text(axis, page.angle)
        travel.set_text(f"travel {ends}" if ends else "")
        _mark(waves, station.of(axis.title).wave)
        before, ended = ended, station.of(axis.title).ended
        if ended != before:
            said.tell(axis, Answer(not ended, ended))

    context.client.on_disconnect(lambda: station.left(page))
    return refresh
