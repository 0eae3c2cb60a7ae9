"""What an axis is doing, in words: its state, its fault, the law that acts, and the next step of a newcomer."""

import json
import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from backlash_ros.control.laws import BEST
from backlash_ros.control.limits import NO_LIMIT
from backlash_ros.control.monitoring.wear import HEAVY
from backlash_ros.control.motion.profile_parameters import STEP
from backlash_ros.control.telemetry import TELEMETRY
from backlash_ros.dashboard.axis import SILENCE, Axis
from backlash_ros.drivetrain.parameters import drive_of
from backlash_ros.gates.faults import FAULTS, Fault
from backlash_ros.recordings.rounding import shown, unit_text

STEPS = ("connect", "learn", "identify", "move")
EXPERIMENTS = {"learning": "learn", "identifying": "identify", "homing": "home"}
"""The service of an experiment, by its word."""
_NEEDED = {"J_l": "its inertia", "c_l": "its dry friction"}
"""What must be found before a drive counts as identified, by symbol."""
_REMEDY = r"([:;]) (?=(?:allow|check|if the machine|set|take|try) )"
"""What stands before the remedy in an answer."""
_SCALES = {"s": (1e3, "ms"), "kg m^2": (1e4, "kg cm^2")}
"""Factor of a unit to that of small numbers, and its name."""


class Scale(NamedTuple):
    """A unit of angles: its name, and how many of it make 1 rad."""

    name: str
    factor: float


class AngleUnit(NamedTuple):
    """How a page shows angles: those of the load, those as small as the gap, and by how much a field's arrows step."""

    large: Scale
    small: Scale
    step: float


_DEG, _ARCMIN = (Scale(name, per_turn / math.tau) for name, per_turn in (("deg", 360.0), ("arcmin", 21600.0)))
ANGLES = {
    "rad": AngleUnit(Scale("rad", 1.0), Scale("mrad", 1e3), 0.1),
    "deg": AngleUnit(_DEG, _DEG, 5.0),
    "arcmin": AngleUnit(_ARCMIN, _ARCMIN, 100.0),
}
"""The units of angles that people choose from; the first is shown until they do."""


class Result(NamedTuple):
    """A quantity that an experiment found: symbol, value and standard uncertainty, and their unit, of the SI."""

    symbol: str
    value: float
    uncertainty: float
    unit: str

    def text(self, angle: AngleUnit) -> str:
        """Return it in units that suit people."""
        return quantity(self.value, self.uncertainty, self.unit, angle)


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

    def look(self, axis: Axis) -> None:
        """Notice that the motion has begun or ended."""
        if axis.last_state.get("experiment"):
            self.moved = True
        elif self.moved and math.isnan(self.computing_since):
            self.computing_since = time.monotonic()


def quantity(value: float, uncertainty: float, unit: str, angle: AngleUnit) -> str:
    """Return a value with as many digits as its standard uncertainty bears, in a unit that suits people.

    >>> quantity(0.0199902, 2.6e-05, "rad", ANGLES["rad"])
    '19.990 ± 0.026 mrad'
    """
    factor, name = _SCALES.get(unit, (1.0, unit))
    if unit.partition("/")[0] == "rad":
        factor, name = angle.small.factor, unit.replace("rad", angle.small.name, 1)
    if not uncertainty > 0.0:  # it is not known
        return f"{factor * value:.4g} {unit_text(name)}".rstrip()
    return shown(factor * value, factor * uncertainty, name)


def servo_says(axis: Axis) -> Mapping[str, str]:
    """Return what the controller says of itself once a second, by name; nothing if it is not there."""
    servo = axis.diagnoses.get("controller: servo")
    return servo.values if servo and axis.present else {}


def found_by(axis: Axis) -> dict[str, Sequence[Result]]:
    """Return what the last run of each service found, the newest last; nothing if the controller does not tell it."""
    try:
        told = json.loads(servo_says(axis).get("found") or "{}")
        return {service: [Result(*each) for each in rows] for service, rows in told.items()}
    except (ValueError, TypeError, AttributeError):  # another version's controller
        return {}


def of_learning(axis: Axis, angle: AngleUnit) -> tuple[str, str]:
    """Return what is known of the backlash, and what that gains or would gain."""
    if not axis.b:
        swing, small = axis.last_state.get("rattle", 0.0), angle.small
        rattle = f"of {small.factor * swing:#.3g} {small.name}" if swing else "after a move"
        return "backlash b is not known", f"would calm the rattle {rattle}"
    law, share = law_of(axis), _share_of_inertia(axis)
    gain = f"in use by law {law}" if law else "in use"
    if law == "fast":
        gain = "law fast does not use it"
    elif law != BEST and share > HEAVY:
        gain += f"; a load with {share:.2g} of the motor's inertia may rattle: identify, too"
    return f"backlash b = {quantity(axis.b, _uncertainty_of_b(axis), 'rad', angle)}", gain


def _uncertainty_of_b(axis: Axis) -> float:
    """Return the standard uncertainty of the backlash in use, rad; 0 if no experiment found this value."""
    rows = [(each.value, each.uncertainty) for found in found_by(axis).values() for each in found if each.symbol == "b"]
    kept = servo_says(axis)
    if sure := kept.get("estimate_uncertainty_rad", ""):  # of a file, too
        rows.append((float(kept["estimate_rad"]), float(sure)))
    return next((sure for value, sure in rows if math.isclose(value, axis.b)), 0.0)


def of_identification(axis: Axis, angle: AngleUnit) -> tuple[str, str]:
    """Return what is known of the load, and what that gains or would gain; what is missing, and what to do."""
    found = {each.symbol: each for each in found_by(axis).get("identify", [])}
    told, law = axis.told.values, law_of(axis)
    if told.get("identified"):
        used, inertia = told["load.inertia"], found.get("J_l")
        ours = inertia is not None and math.isclose(inertia.value, used)
        text = inertia.text(angle) if ours and inertia else quantity(used, 0.0, "kg m^2", angle)
        return f"load inertia {text}", f"in use by law {law}"
    if not found:
        return "the load is not known", f"would let law {BEST} act: faster and calmer"
    if not (lacking := [word for symbol, word in _NEEDED.items() if symbol not in found]):
        return "load found, but not in use", f"law {law} still acts"
    result = "the load was not found" if len(lacking) == len(_NEEDED) else f"load found, {lacking[0]} not"
    return result, f"try again, then at another angle; law {law} still acts"


def _share_of_inertia(axis: Axis) -> float:
    """Return the load's inertia as a share of the motor's, both at the output; 0 if it is not told."""
    try:
        drive = drive_of(axis.told.values)
    except (KeyError, ValueError, TypeError):  # another version's controller
        return 0.0
    return drive.load.inertia / drive.reflected_inertia


def remedy_first(text: str) -> str:
    """Return an answer that ends with what to do in another order: that first.

    >>> remedy_first("no gap measured: a flank is 0.1 rad off; check both couplings")
    'Check both couplings. Why: no gap measured: a flank is 0.1 rad off'
    """
    why, sign, what = re.split(_REMEDY, text, maxsplit=1) if re.search(_REMEDY, text) else (text, "", "")
    return f"{what[0].upper()}{what[1:]}. Why: {why}" if sign else text


def law_of(axis: Axis) -> str:
    """Return the law that acts; empty if it is not known."""
    return servo_says(axis).get("law_in_use", "")


def _word(axis: Axis, name: str) -> str:
    value = axis.last_state.get(name, math.nan)
    return TELEMETRY[name].words.get(int(value), "") if math.isfinite(value) else ""


def acts(axis: Axis) -> str:
    """Return the law that acts and what it does; empty while no position is held."""
    law = law_of(axis)
    if not law or axis.lifecycle != "active" or not axis.last_state.get("holding"):
        return ""
    does = _word(axis, "phase" if law == BEST else "region")  # with phases of its own, regions mean nothing
    return f"law {law}: {does}" if does not in ("", "none") else f"law {law}"


def silence(axis: Axis) -> str:
    """Return that no joint states come, or none that the controller can use; empty if it uses them."""
    if axis.silent >= SILENCE:
        if axis.simulated and axis.lifecycle == "inactive":  # in lockstep
            return "the simulation waits"
        since = f" for {axis.silent:.0f} s" if math.isfinite(axis.silent) else ""
        return f"no joint states from the drive{since}"
    every = 1.0 / float(axis.told.values.get("telemetry_rate", 1.0))
    if axis.lifecycle != "active" or not axis.unused >= SILENCE + 2.0 * every:
        return ""
    why = servo_says(axis).get("last_dropped", "").removeprefix("unusable joint_states: ")
    return "no usable joint states" + (f": {why}" if why else "")


def refusal(axis: Axis) -> str:
    """Return why an axis takes no reference; empty if it does."""
    if not axis.last_state.get("holding", 0.0):
        return "nothing was sent: the controller holds no position and refuses references"
    why = silence(axis)
    return f"nothing was sent: {why}" if why else ""


def travel_of(axis: Axis) -> tuple[float, float]:
    """Return the ends of the load's travel, rad; infinite where there is none."""
    values = axis.told.values
    ends = (float(values.get(f"limits.position_{end}", NO_LIMIT)) for end in ("lower", "upper"))
    lower, upper = (math.inf if abs(end) >= NO_LIMIT else end for end in ends)
    return -math.inf if math.isinf(lower) else lower, upper


def _plain(value: float) -> str:
    """Return a number with four digits or more, and no exponent."""
    return f"{value:.4g}" if not 1e4 <= abs(value) < math.inf else f"{value:.0f}"


def travel_text(axis: Axis, angle: AngleUnit) -> str:
    """Return the ends of the travel in words; empty if there is none.

    >>> from types import SimpleNamespace as Axis
    >>> ends = {"limits.position_lower": -1.0, "limits.position_upper": 2.96706}
    >>> travel_text(Axis(told=Axis(values=ends)), ANGLES["rad"])
    '-1 to 2.967 rad'
    """
    lower, upper = (_plain(angle.large.factor * end) for end in travel_of(axis))
    if (lower, upper) == ("-inf", "inf"):
        return ""
    span = f"±{upper}" if lower == f"-{upper}" else f"{lower} to {upper}"
    return f"{span.replace('-inf to', 'up to').replace(' to inf', ' and more')} {angle.large.name}"


def beyond(axis: Axis, target: float, angle: AngleUnit) -> str:
    """Return why the controller would refuse a target, rad; empty if it would not."""
    lower, upper = travel_of(axis)
    unit = angle.large
    shown = f"{_plain(unit.factor * target)} {unit.name}"
    if not lower <= target <= upper:
        return f"nothing was sent: {shown} is beyond the travel, {travel_text(axis, angle)}"
    most, present = float(axis.told.values.get("limits.step", math.inf)), axis.last_state.get("reference", target)
    leaps = axis.told.values.get("profile.mode", STEP) == STEP
    if leaps and abs(target - present) > most:
        return f"nothing was sent: {shown} is more than limits.step = {_plain(unit.factor * most)} {unit.name} away"
    return ""


def outside(axis: Axis, angle: AngleUnit) -> str:
    """Return that the load is beyond its travel, and what to do; empty if it is not."""
    (lower, upper), zone = travel_of(axis), float(axis.told.values.get("limits.soft_zone", 0.0))
    load = axis.last_state.get("load_angle", math.nan)
    if not axis.last_state.get("holding") or not (load < lower - zone or load > upper + zone):
        return ""
    return f"the load is beyond its travel, {travel_text(axis, angle)}: go back to an angle within it"


def fault_of(axis: Axis) -> tuple[str, str]:
    """Return name and text of the fault that is latched, by the controller or else by a simulated drive, or nothing."""
    if not axis.present:
        return "", ""
    said = servo_says(axis)
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
        (silence(axis), "no samples", "bad"),
        (experiment not in ("", "none"), experiment, "busy"),
        (run is not None and math.isfinite(run.computing_since), "computing", "busy"),
        (not axis.last_state.get("holding"), "ready", "idle"),
    ):
        if holds:
            return State(word, kind)
    return State("active", "good")


def step_of(axis: Axis) -> str:
    """Return the step of `STEPS` that runs, else the first one that is not done."""
    if fault_of(axis)[0] or axis.lifecycle != "active" or silence(axis):
        return "connect"
    if (runs := EXPERIMENTS.get(_word(axis, "experiment"))) in STEPS:
        return runs
    if not axis.b:
        return "learn"
    return "move" if axis.told.values.get("identified") else "identify"


def situation(axis: Axis) -> tuple[Any, ...]:
    """Return what an answer may speak of, at last holding and experiment; it is stale once this has changed."""
    state = axis.last_state
    return (
        axis.title,
        axis.lifecycle,
        fault_of(axis)[0],
        axis.told.version,
        state.get("holding"),
        state.get("experiment"),
    )
