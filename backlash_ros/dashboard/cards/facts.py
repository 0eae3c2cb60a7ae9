"""The card of facts: drive, controller, timing, connections."""

from nicegui import ui

from backlash_ros.dashboard.axis import SILENCE, Axis
from backlash_ros.dashboard.cards.card import Refresh, Shown, card
from backlash_ros.dashboard.state import fault_of
from backlash_ros.gates.faults import FAULTS, Fault


def facts_card(page: Shown) -> Refresh:
    """Make the card."""
    station, facts = page.station, {}
    with card("Drive and controller"), ui.element("div").classes("facts"):
        for name in ("controller", "drive", "fault", "rate", "late samples", "age", "connections"):
            ui.label(name)
            facts[name] = ui.label("").props(f"data-name=fact-{name.replace(' ', '-')}")

    def refresh(axis: Axis) -> None:
        timing = axis.diagnoses.get("controller: timing")
        paced = timing.values if timing and axis.present else {}
        here = f"simulated by {axis.names.simulator}" if axis.simulated else "a real one"
        age = paced.get("state_age", "")
        heard, drives = station.graph.listeners(axis)
        for fact, text in {
            "controller": f"{axis.names.controller}, {axis.lifecycle}",
            "drive": here if axis.silent < SILENCE else "no joint states",
            "fault": f"{name}: {FAULTS[Fault[name]].meaning}" if (name := fault_of(axis)[0]) else "none",
            "rate": f"{paced['rate_Hz']} of {paced['nominal_rate_Hz']} Hz" if "rate_Hz" in paced else "",
            "late samples": paced.get("late_samples", ""),
            "age": "" if "nan" in age or "mean -" in age else age,  # in lockstep, clocks differ by less than a period
            "connections": f"subscribers of command: {heard}, publishers of joint states: {drives}",
        }.items():
            facts[fact].set_text(text)

    return refresh
