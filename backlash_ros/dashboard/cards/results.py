"""The card of results: what the last experiment found, each value with its standard uncertainty."""

from html import escape

from nicegui import ui

from backlash_ros.dashboard.axis import Axis
from backlash_ros.dashboard.cards.card import Refresh, Shown, card
from backlash_ros.dashboard.state import found_by, servo_says

_WORDS = {
    "b": "backlash",
    "J_l": "load: inertia",
    "B_l": "load: viscous friction",
    "c_l": "load: dry friction",
    "1 B_l + c_l": "load: friction at 1 rad/s",
    "10 B_l + c_l": "load: friction at 10 rad/s",
    "tau_l": "load torque",
    "dtau_l/dtheta_l": "its growth with the angle",
    "c_m": "motor: dry friction",
    "K_m": "motor: torque constant",
    "R": "motor: resistance",
    "loss": "gear: loss",
    "wind-up": "gear: wind-up of the teeth",
    "(db/dtheta_l)/b": "gear: growth of the gap with the angle",
    "delay": "delay of the loop",
    "offset": "load encoder: offset",
    "eccentricity": "load encoder: scale error at this angle",
}


def results_card(page: Shown) -> Refresh:
    """Make the card, hidden until there are results."""
    before = ""
    made = card("Found by the last experiment")
    with made:
        table = ui.html("", sanitize=True)
        rest = ui.label("").classes("muted")

    def refresh(axis: Axis) -> None:
        nonlocal before
        service, results = next(reversed(found_by(axis).items()), ("", []))
        made.set_visibility(bool(results))
        rows = "".join(
            f"<tr><td>{escape(_WORDS.get(each.symbol, ''))} <span>{escape(each.symbol)}</span></td>"
            f"<td>{escape(each.text(page.angle))}</td></tr>"
            for each in results
        )
        if rows != before:
            before = rows
            table.set_content(f'<table class="results"><tbody>{rows}</tbody></table>')
            rest.set_text(f"by {service}, {servo_says(axis).get('estimate_learned_at', '')}")

    return refresh
