"""What all cards share: their frame, buttons of two ranks, and answers that end with what they speak of."""

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from nicegui import ui

from backlash_ros.dashboard.axis import Answer, Axis
from backlash_ros.dashboard.state import AngleUnit, situation
from backlash_ros.dashboard.station import Mover, Station

FIELD = "dense outlined"
OPTIONS = f"{FIELD} options-dense"

_SETTLES = 1.0
"""Time after an answer in which telemetry may still say that its experiment ends and the position is held again, s."""

Refresh = Callable[[Axis], None]
"""Shows the present state of an axis."""


class Shown(Mover, Protocol):
    """The page that a card is on."""

    station: Station
    read_only: bool
    title: str
    angle: AngleUnit

    @property
    def axis(self) -> Axis | None:
        """The axis that is shown, or None."""


def card(title: str) -> ui.element:
    """Return a card with a title."""
    made = ui.element("section").classes("card")
    with made:
        ui.html(f"<h2>{title}</h2>", sanitize=False)
    return made


def line() -> ui.element:
    """Return a row of fields and buttons."""
    return ui.element("div").classes("line")


def button(text: str, act: Callable[..., Any], name: str = "", *, primary: bool = False) -> ui.button:
    """Return a button; a card has one ``primary`` one at most."""
    made = ui.button(text, on_click=act).props(f"dense no-caps {'unelevated' if primary else 'outline'}")
    return made.props(f"data-name={name}") if name else made


def fill(made: ui.button, filled: bool) -> None:
    """Show a button filled, or outlined."""
    made.props(remove="outline" if filled else "unelevated", add="unelevated" if filled else "outline")


class Said:
    """An answer in words, shown until the axis is in another state than when it came."""

    def __init__(self, name: str) -> None:
        self._label = ui.label("").classes("answer").props(f'data-name={name} aria-live="polite"')
        self._about: tuple[Any, ...] = ()
        self._at = -math.inf

    def tell(self, axis: Axis | None, answer: Answer) -> None:
        """Show why something failed; a success shows itself."""
        self._about, self._at = situation(axis) if axis else (), time.monotonic()
        self._label.set_text("" if answer.success else answer.text)

    def refresh(self, axis: Axis) -> None:
        """Forget what was said of another state."""
        now = situation(axis)
        if now[:-2] == self._about[:-2] and time.monotonic() < self._at + _SETTLES:
            self._about = now
        elif now != self._about:
            self._label.set_text("")
