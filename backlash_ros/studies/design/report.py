"""A design as text for people, as JSON for programs, and as a parameter file for the controller."""

import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from backlash_ros.control import Gains, stability_margins
from backlash_ros.drivetrain import command_from_voltage, discretize_from_command, rigid_model
from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.studies.design.search import Design, predicted_cycle
from backlash_ros.studies.design.trial import Choice, Loop, Outcome
from backlash_ros.studies.design.uncertainty import Case

_FIGURES = {
    "rise": "rise, 10 to 90 % of 1 rad, s",
    "settle": "within b/4 for good, s",
    "precise": "within b/10 for good, s",
    "overshoot": "overshoot, b",
    "swing": "swing at the end, b",
    "error": "off the target at the end, b",
}
"""Fields of `Outcome`, in words."""


def closed_loop_poles(loop: Loop, gains: Gains) -> list[complex]:
    """Return the poles of the sampled loop in contact, log(z)/T, 1/s, slowest first, without those of the delay."""
    a, b = rigid_model(loop.drive)
    b, period = b[:, :1], 1.0 / loop.rate
    from_states, from_voltage = command_from_voltage(loop.drive, a, b)
    following, effect = discretize_from_command(loop.drive, a, b, period, loop.delay.mean)
    answer = np.zeros((1, len(following)))
    answer[:, :3] = from_voltage @ gains.as_array()[None, :] - from_states
    z = np.linalg.eigvals(following - effect @ answer).astype(complex)
    poles = np.log(z[np.abs(z) > 1e-3]) / period
    return [complex(pole) for pole in sorted(poles, key=abs)]


def _margins(loop: Loop, gains: Gains) -> dict[str, float]:
    margins = stability_margins(loop.drive, gains, 1.0 / loop.rate, loop.delay.mean)
    return {
        "gain": margins.gain,
        "phase_degrees": math.degrees(margins.phase),
        "delay": margins.delay,
        "crossover": margins.crossover,
    }


def _range_of(loop: Loop, choice: Choice, outcomes: Iterable[tuple[Case, Outcome]]) -> dict[str, Any]:
    """Return each figure for the drive as described, and the worst over the range with the drive it belongs to.

    Runs that did not reach their end have no figures: ``failures`` lists them with their reason.
    """
    outcomes = list(outcomes)
    ended = [each for each in outcomes if not each[1].failure]
    figures: dict[str, Any] = {}
    for name in _FIGURES:
        case, worst = max(ended, key=lambda each: getattr(each[1], name), default=outcomes[0])
        figures[name] = {"nominal": getattr(outcomes[0][1], name), "worst": getattr(worst, name), "where": case.label}
    cycles = [(case, predicted_cycle(loop, case.drive, choice)) for case, _ in outcomes if not case.load_torque]
    found = [(cycle.amplitude / case.drive.gear.backlash_angle, case.label) for case, cycle in cycles if cycle]
    figures["predicted_cycle"] = {"drives": len(found), "of": len(cycles)}
    if found:
        amplitude, label = max(found)
        figures["predicted_cycle"] |= {"worst": amplitude, "where": label}
    figures["failures"] = {case.label: outcome.failure for case, outcome in outcomes if outcome.failure}
    return figures


def content_of(design: Design, source: str) -> dict[str, Any]:
    """Return the whole design, ready for JSON; ``source`` is the name of the drive file. Lengths are in b."""
    loop, b = design.loop, design.loop.drive.gear.backlash_angle
    poles = closed_loop_poles(loop, design.choice.gains)
    uncertainty = design.uncertainty
    content = {
        "drive": source,
        "rate": loop.rate,
        "delay": loop.delay.mean,
        "range": {
            **{
                name: list(getattr(uncertainty, name))
                for name in ("inertia", "viscous_friction", "dry_friction", "gap")
            },
            "load_torque": uncertainty.load_torque * loop.drive.standstill_torque(),
            "drives": len(design.outcomes),
        },
        "gains": {"fast": loop.fast.as_array().tolist(), "overdamped": design.choice.gains.as_array().tolist()},
        "not_quiet": design.refusal,
        "width": design.choice.width,
        "width_angle": design.choice.width * b,
        "poles": [[pole.real, pole.imag] for pole in poles],
        "margins": {"fast": _margins(loop, loop.fast), "overdamped": _margins(loop, design.choice.gains)},
        "designed": _range_of(loop, design.choice, design.outcomes),
        "default": {
            "gains": design.default.gains.as_array().tolist(),
            "width": design.default.width,
            **_range_of(loop, design.default, design.default_outcomes),
        },
    }
    result: dict[str, Any] = jsonable(content)
    return result


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def show(content: dict[str, Any], console: Console) -> None:
    """Print a design."""

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    say(f"{content['drive']}, {content['rate']:g} Hz, {1e3 * content['delay']:.3g} ms late")
    for region, k in content["gains"].items():
        margins = content["margins"][region]
        gain = "any" if margins["gain"] is None else f"{margins['gain']:.3g}"
        phase = "any" if margins["phase_degrees"] is None else f"{margins['phase_degrees']:.3g}"
        late = "any" if margins["delay"] is None else f"{1e3 * margins['delay']:.3g} ms"
        say(
            f"{region + ' gains':17s} k1 {k[0]:.5g} V/rad, k2 {k[1]:.5g} V s/rad, k3 {k[2]:.5g} V/A; "
            f"margins in contact: gain {gain}, phase {phase} deg, delay {late}"
        )
    say(f"over-damped within {content['width']:.3g} b = {content['width_angle']:.3g} rad of the target")
    say(f"poles in contact, over-damped, 1/s: {', '.join(_pole(*pole) for pole in content['poles'])}")
    say(f"\nSimulated on {content['range']['drives']} drives of the range, steps of 1 rad and of 5 b:")
    table = Table(box=None, pad_edge=False, header_style="")
    table.add_column("")
    for name in ("default", "designed"):
        table.add_column(name, justify="right")
        table.add_column("worst", justify="right")
    for key, words in _FIGURES.items():
        pairs = [content[name][key] for name in ("default", "designed")]
        table.add_row(words, *(_figure(pair[each]) for pair in pairs for each in ("nominal", "worst")))
    console.print(table, highlight=False, markup=False)
    for name in ("default", "designed"):
        found = content[name]
        where = ", ".join(f"{key} with {found[key]['where']}" for key in ("settle", "overshoot", "swing"))
        say(f"{name}: worst in {where}")
        cycle = found["predicted_cycle"]
        worst = f", up to {cycle['worst']:.2f} b with {cycle['where']}" if cycle["drives"] else ""
        say(f"  harmonic balance finds a limit cycle on {cycle['drives']} of {cycle['of']} drives{worst}")
        for label, reason in found["failures"].items():
            say(f"  with {label}: {reason}")


def _pole(real: float, imaginary: float) -> str:
    return f"{real:.3g}" if abs(imaginary) < 1e-6 * abs(real) else f"{real:.3g} {imaginary:+.3g}j"


def gain_text(loop: Loop, choice: Choice, source: str, refusal: str = "") -> str:
    """Return the parameter file with the gains and the width, for a controller's start or while it runs.

    Parameters
    ----------
    source : the drive that it was designed for, in words
    refusal : why it is not quiet, if it is not
    """
    mark = (f"# NOT QUIET: {_printable(refusal)}",) if refusal else ()

    def row(gains: Gains) -> str:
        return f"[{', '.join(_number(value) for value in gains.as_array())}]"

    return "\n".join(
        (
            f"# Gains of the two-region law by `backlash design` for {_printable(source)}. SI units.",
            *mark,
            "/**:",
            "  ros__parameters:",
            "    law: two_region",
            "    gains:",
            f"      fast: {{k: {row(loop.fast)}}}  # [V/rad, V s/rad, V/A]",
            f"      overdamped: {{k: {row(choice.gains)}}}",
            "    laws:",
            f"      two_region: {{width: {_number(choice.width)}}}  # of backlash_angle, which is learned",
            "",
        )
    )


def _printable(text: str) -> str:
    return re.sub(r"[^ -~]", "?", text)


def _number(value: float) -> str:
    """Return a number as YAML 1.1 and ROS read it: a float has a point."""
    text = repr(float(f"{value:.6g}"))
    digits, exponent, power = text.partition("e")
    return f"{digits if '.' in digits else f'{digits}.0'}{exponent}{power}"
