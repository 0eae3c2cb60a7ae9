"""What an axis is doing, in words: its state, its fault, the law that acts, and the next step of a newcomer."""

import math
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from backlash_ros.control.telemetry import TELEMETRY
from backlash_ros.dashboard.axis import SILENCE, Axis
from backlash_ros.gates.faults import FAULTS, Fault
from backlash_ros.recordings.rounding import shown

STEPS = ("connect", "learn", "identify", "move")
_PLANS = "two_encoder"
"""The law with phases of its own; the regions of the gains mean nothing there."""
_SCALES = {"rad": (1e3, "mrad"), "s": (1e3, "ms"), "kg m^2": (1e4, "kg cm^2")}
"""Factor of a unit to that of small numbers, and its name."""
_RESULT = re.compile(r"(?:^|, )(?P<symbol>\S[^=]*?)(?: =)? (?P<value>\S+) \+- (?P<sure>[^\s,]+)(?: (?P<unit>[^,]+))?")
"""One quantity in the answer of an experiment."""


class Result(NamedTuple):
    """A quantity that an experiment found: symbol, value in SI units, and as text with its standard uncertainty."""

    symbol: str
    value: float
    text: str


class State(NamedTuple):
    """A state: a word, and its kind, which gives the colour."""

    word: str
    kind: str


@dataclass
class Run:
    """An experiment that a page has asked for: ``service``, and since when its result is being computed, s."""

    service: str
    moved: bool = False
    computing_since: float = math.nan
    answer: str = ""
    results: Sequence[Result] = field(default=())

    def look(self, axis: Axis) -> None:
        """Notice that the motion has begun or ended."""
        if axis.last_state.get("experiment"):
            self.moved = True
        elif self.moved and math.isnan(self.computing_since):
            self.computing_since = time.monotonic()


def quantity(value: float, uncertainty: float, unit: str) -> str:
    """Return a value with as many digits as its standard uncertainty bears, in a unit that suits people.

    >>> quantity(0.0199902, 2.6e-05, "rad")
    '19.990 ± 0.026 mrad'
    """
    factor, name = _SCALES.get(unit, (1.0, unit))
    return shown(factor * value, factor * uncertainty, name)


def results_of(answer: str) -> list[Result]:
    """Return the quantities in the answer of ``~/learn`` or ``~/identify``.

    >>> results_of("b = 0.02002 +- 0.00017 rad, loss = 0 +- 0.0014, from 3.6 s of motion")
    [Result(symbol='b', value=0.02002, text='20.02 ± 0.17 mrad'), Result(symbol='loss', value=0.0, text='0 ± 0.0014')]
    """
    told = answer.partition(", from ")[0].replace(" at the output", "")
    found = []
    for symbol, value, sure, unit in _RESULT.findall(told):
        text = quantity(float(value), float(sure), unit)
        found.append(Result("b" if symbol == "backlash" else symbol, float(value), text))
    return found


def law_of(axis: Axis) -> str:
    """Return the law that acts; empty if it is not known."""
    servo = axis.diagnoses.get("controller: servo")
    return servo.values.get("law_in_use", "") if servo and axis.present else ""


def _word(axis: Axis, name: str) -> str:
    value = axis.last_state.get(name, math.nan)
    return TELEMETRY[name].words.get(int(value), "") if math.isfinite(value) else ""


def acts(axis: Axis) -> str:
    """Return the law that acts and what it does; empty while no position is held."""
    law = law_of(axis)
    if not law or axis.lifecycle != "active" or not axis.last_state.get("holding"):
        return ""
    does = _word(axis, "phase" if law == _PLANS else "region")
    return f"law {law}: {does}" if does not in ("", "none") else f"law {law}"


def fault_of(axis: Axis) -> tuple[str, str]:
    """Return name and text of the fault that is latched, by the controller or else by a simulated drive, or nothing."""
    if not axis.present:
        return "", ""
    own = axis.diagnoses.get("controller: servo")
    said = own.values if own else {}
    value = axis.last_state.get("fault", math.nan)  # comes sooner than the diagnostics
    name = said.get("fault_name", "") if math.isnan(value) else Fault(int(value)).name if value else ""
    if name:
        return name, said["fault"] if said.get("fault_name") == name else FAULTS[Fault[name]].meaning
    drive = axis.diagnoses.get("simulator: drive") if axis.simulated else None
    return (drive.values.get("fault_name", ""), drive.values.get("fault", "")) if drive else ("", "")


def remedy(name: str) -> str:
    """Return what to do about a fault."""
    return FAULTS[Fault[name]].remedy if name in Fault.__members__ else ""


def state_of(axis: Axis, run: Run | None) -> State:
    """Return the state of an axis, on which an experiment may run."""
    lifecycle = axis.lifecycle
    experiment = _word(axis, "experiment")
    for holds, word, kind in (
        (not axis.present, "not there", "bad"),
        (fault_of(axis)[0], "fault", "bad"),
        (lifecycle != "active", lifecycle, "idle"),
        (axis.silent >= SILENCE, "no samples", "bad"),
        (experiment not in ("", "none"), experiment, "busy"),
        (run is not None and math.isfinite(run.computing_since), "computing", "busy"),
        (not axis.last_state.get("holding"), "ready", "idle"),
    ):
        if holds:
            return State(word, kind)
    return State("active", "good")


def step_of(axis: Axis) -> str:
    """Return the first step of `STEPS` that is not done."""
    if fault_of(axis)[0] or axis.lifecycle != "active" or axis.silent >= SILENCE:
        return "connect"
    if not axis.b:
        return "learn"
    return "move" if axis.told.values.get("identified") else "identify"


def situation(axis: Axis) -> tuple[Any, ...]:
    """Return what an answer may speak of; it is stale once this has changed."""
    state = axis.last_state
    return (
        axis.title,
        axis.lifecycle,
        fault_of(axis)[0],
        axis.told.version,
        state.get("holding"),
        state.get("experiment"),
    )
