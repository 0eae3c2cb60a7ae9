"""The drawer of a simulated drive: load torque, noise, and what breaks it."""

from typing import Any

from nicegui import ui

from backlash_ros.dashboard.axis import Axis
from backlash_ros.dashboard.cards.card import Refresh, Said, Shown, button, line

_ALL_SIGNALS = ["theta_m", "omega_m", "theta_l", "omega_l", "current"]
_JUMP = 0.5
"""Shift of an encoder's zero that makes it jump, rad."""


def simulated_card(page: Shown) -> Refresh:
    """Make the card, folded at first; it is there for simulated drives alone."""
    before: dict[str, dict[str, Any]] = {}

    async def inject(values: dict[str, Any]) -> None:
        axis = page.axis
        if axis is None:
            return
        now = axis.told_by_simulator.values
        kept = before.setdefault(axis.title, {})
        for name in values:
            kept.setdefault(name, now.get(name))
        said.tell(axis, await axis.set(values, simulator=True))

    async def jump() -> None:
        if page.axis is not None:
            offset = float(page.axis.told_by_simulator.values.get("sensors.load_offset", 0.0))
            await inject({"sensors.load_offset": offset + _JUMP})

    async def noise() -> None:
        if page.axis is not None:
            gap = float(page.axis.told_by_simulator.values.get("gear.backlash_angle", 0.02))
            await inject({"sensors.load_noise": 0.1 * gap})

    async def restore() -> None:
        axis = page.axis
        if axis is None:
            return
        torque.set_value(0.0)
        axis.load(0.0)
        if kept := before.pop(axis.title, {}):
            said.tell(axis, await axis.set(kept, simulator=True))

    def load(value: float) -> None:
        if page.axis is not None and page.axis.simulated:
            page.axis.load(value)

    drawer = ui.expansion("Simulated drive", group="act").classes("card fold").props("dense data-name=simulated")
    with drawer:
        with line():
            amount = ui.label("").classes("muted amount")
            torque = ui.slider(min=-0.5, max=0.5, step=0.01, value=0.0).props('aria-label="load torque, N m"')
            torque.props("data-name=load-torque")
            amount.bind_text_from(torque, "value", lambda value: f"load torque {value:.2f} N m")
        with line():
            button("Load encoder jumps", jump, "jump")
            button("Load encoder lost", lambda: inject({"sensors.measured": _ALL_SIGNALS[:2] + _ALL_SIGNALS[4:]}))
            button("Motor encoder lost", lambda: inject({"sensors.measured": _ALL_SIGNALS[2:]}))
            button("Noise", noise)
            button("As it was", restore, "as-it-was", primary=True)
        said = Said("simulated-answer")

    torque.on("change", lambda event: load(float(event.args)))

    def refresh(axis: Axis) -> None:
        drawer.set_visibility(axis.simulated)
        said.refresh(axis)

    return refresh
