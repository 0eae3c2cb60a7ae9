"""The card of the law: which is chosen, and the gains where they act."""

import math
import time
from functools import partial
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from backlash_ros.control import AUTO, LAWS
from backlash_ros.control.design.gain_sets import CUSTOM
from backlash_ros.control.laws import BEST
from backlash_ros.dashboard.axis import Axis
from backlash_ros.dashboard.cards.card import OPTIONS, Refresh, Said, Shown, line
from backlash_ros.dashboard.state import law_of

ABOUT = {
    AUTO: "law planned once backlash and load are known, else two_region",
    "cascade": "position loop around a speed loop, as usual in industry",
    "dual_loop": "the motor's encoder, corrected slowly by the load's",
    "elastic_lqg": "one linear compensator, as if the gap were a spring",
    "fast": "the fast gains alone: the load rattles",
    "overdamped": "the over-damped gains alone: slow",
    "switched_linear": "two linear compensators, chosen by the error",
    BEST: "plans each move through the gap",
    "two_region": "fast gains far from the target, over-damped ones near it",
}
"""What the laws do, by name; others have no words here."""
_LEAST, _MOST = -2.0, 6.0
"""Range of the sliders for weights, in powers of ten; at the lower end a weight is 0."""
_LET_GO = 0.7
"""Time without motion after which a slider shows the value in use again, s."""
REGIONS = {"fast": "Fast gains", "overdamped": "Over-damped gains"}
ACT = {"two_region": tuple(REGIONS), "fast": ("fast",), "overdamped": ("overdamped",)}
"""Which gains act, by law; none with the others."""


def _power(value: float) -> float:
    return min(_MOST, math.log10(value)) if value > 10**_LEAST else _LEAST


def law_card(page: Shown) -> Refresh:
    """Make the card, to be unfolded."""
    with ui.expansion("Law and gains", value=True, group="act").classes("card fold").props("dense"):
        refreshers = [_choice(page), _gains(page)]

    def refresh(axis: Axis) -> None:
        for each in refreshers:
            each(axis)

    return refresh


def _choice(page: Shown) -> Refresh:
    """Choose law and gain set."""
    shown: dict[str, int] = {}
    with line():
        laws = {name: f"{name}: {ABOUT[name]}" if name in ABOUT else name for name in sorted([AUTO, *LAWS])}
        law = ui.select(laws, label="law").props(f"{OPTIONS} data-name=law")
        gain_set = ui.select([], label="gain set").props(f"{OPTIONS} data-name=gain-set")
    said = Said("choice-answer")

    async def ask(name: str, value: Any) -> None:
        axis = page.axis
        if axis is None or value is None or axis.told.values.get(name) == value:
            return
        said.tell(axis, await axis.set({name: value}))
        shown.clear()  # what was refused goes back to what is in use

    law.on_value_change(lambda event: ask("law", event.value))
    gain_set.on_value_change(lambda event: ask("gain_set", event.value))

    def refresh(axis: Axis) -> None:
        said.refresh(axis)
        gain_set.set_visibility(law_of(axis) in ACT)
        values = axis.told.values
        if values and shown.get(axis.title) != axis.told.version:
            shown.clear()
            shown[axis.title] = axis.told.version
            law.set_value(values.get("law"))
            law.props(f'display-value="{values.get("law")}"')
            gain_set.set_options([*values.get("gain_set_names", []), CUSTOM], value=values.get("gain_set"))

    return refresh


def _gains(page: Shown) -> Refresh:
    """Tune the weights of the gains that act; show the gains and their margins."""
    sliders: dict[tuple[str, int], ui.slider] = {}
    lines: dict[str, tuple[ui.element, ui.label]] = {}
    touched = -math.inf

    def touch() -> None:
        nonlocal touched
        touched = time.monotonic()

    async def changed(region: str, place: int, event: GenericEventArguments) -> None:
        powers = [slider.value for (of, _), slider in sliders.items() if of == region]
        powers[place] = float(event.args)
        q = [0.0 if each <= _LEAST else 10.0**each for each in powers]
        if page.axis is not None:
            said.tell(page.axis, await page.axis.set({f"gains.{region}.q": q}))

    for region, words in REGIONS.items():
        with ui.element("div").classes("region") as part:
            ui.label(words)
            with line():
                for place, what in enumerate(("angle", "speed")):
                    ui.label(f"weight on {what}").classes("muted")
                    slider = ui.slider(min=_LEAST, max=_MOST, step=0.05, value=0.0)
                    slider.props(f'data-name={region}-{place} aria-label="{words}: weight on {what}, power of ten"')
                    slider.on_value_change(touch)
                    slider.on("change", partial(changed, region, place))
                    sliders[region, place] = slider
            lines[region] = part, ui.label("").classes("muted").props(f"data-name={region}-gains")
    none = ui.label("").classes("muted").props("data-name=no-gains")
    said = Said("law-answer")

    def refresh(axis: Axis) -> None:
        said.refresh(axis)
        values, law = axis.told.values, law_of(axis)
        act = ACT.get(law, ())
        none.set_text(f"Law {law} acts. It does not use the fast and the over-damped gains." if law and not act else "")
        for region, (part, label) in lines.items():
            part.set_visibility(bool(values) and region in act)
            if values:
                k = ", ".join(f"{each:.3g}" for each in values[f"gains.{region}.k"])
                margins = axis.margins.get(region)
                label.set_text(f"k = [{k}]" + (f"; margins: {margins.in_words()}" if margins else ""))
        if values and time.monotonic() > touched + _LET_GO:
            for (region, place), slider in sliders.items():
                power = max(_LEAST, _power(values[f"gains.{region}.q"][place]))
                if abs(slider.value - power) > 1e-6:
                    slider.set_value(power)

    return refresh
