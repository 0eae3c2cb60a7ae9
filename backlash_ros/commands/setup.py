"""`backlash setup`: its arguments; asks what a drive is, writes its file, checks it, and says what comes next."""

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from shutil import which
from typing import Any

from rich.console import Console

from backlash_ros.commands.check import tell
from backlash_ros.commands.command import Command
from backlash_ros.commands.motors import RPM, DataSheet, data_sheets
from backlash_ros.commands.output import say, staged
from backlash_ros.commands.questions import ANGLES, INERTIAS, LENGTHS, Answers, Asker, Choice, Number, Terminal, Units
from backlash_ros.control.design.start import RATE
from backlash_ros.control.limits import NO_LIMIT
from backlash_ros.drive_file.drive_text import yaml_number
from backlash_ros.drivetrain.parameters import Gear, Load, Motor
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.quantity import Quantity, quantities
from backlash_ros.foundation.reading.yaml_text import values_in
from backlash_ros.studies.check import check_drive

DESCRIPTION = (
    "Asks in the terminal what your drive is: motor, gear, load, supply, encoders, limits, rate. Each question has a "
    "default, which an empty line takes; ? explains it, < goes back to the one before. Writes a parameter file for the "
    "controller, checks it as `backlash check` does, and says what comes next. Nothing moves."
)
EXAMPLE = "examples: backlash setup; backlash setup --out my_drive.yaml --answers answers.yaml"
OTHER = "another motor"
_SPEEDS_UP = 0.015
"""Mechanical time constant of a small motor, s, where no data sheet has its inertia."""
_WINDING = 5e-4
"""Time constant of its winding, s, where none has its inductance."""
_IDLE = 0.05
"""Current without load, as a share of that at standstill, where none has it."""
_COASTS = 0.5
"""Time in which a load comes to rest by itself, s: nobody knows it beforehand."""
_LIGHT = 0.25
"""Inertia of a load over that of the motor, seen from the output: that of the nominal drive."""
_BEARS = 0.25
"""Share of the current at standstill that a small motor bears for seconds."""
_FIRST = 0.25
"""Share of the voltage with which a first start is made: enough to learn. A largest current is little by itself."""
_G = 9.81
"""m/s^2."""
_CURRENT, _WEIGHT = Quantity("", "A", 0.0, 1e5), Quantity("", "N m", 0.0, 1e5)
_MASS, _LONGEST = Quantity("", "kg", 0.0, 1e6, open_lower=True), 1e3
_SHEET, _TOLD, _GUESS = "data sheet", "as told", "assumed"
_FOLLOWS = "follows from voltage, speed and standstill of the data sheet"
_DEGREES = {"deg": ANGLES["deg"], **ANGLES}


@dataclass(frozen=True)
class _Body:
    """What turns: its inertia is ``inertia`` m l^2 and the torque of its weight ``weight`` m g l."""

    inertia: float
    weight: float
    size: str

    def __str__(self) -> str:
        return f"inertia {self.inertia:.3g} m l^2, where l is {self.size}"


_BODIES = {
    "disc": _Body(1 / 2, 0.0, "its radius"),
    "point": _Body(1.0, 1.0, "its distance from the shaft"),
    "rod": _Body(1 / 3, 1 / 2, "its length from the shaft"),
}
_KNOWN = "known"


@dataclass
class Described:
    """The parameters by name as they are told: value, where it is from, and unit."""

    values: dict[str, tuple[Any, str, str]] = field(default_factory=dict)
    motor: str = ""
    """The motor and where its data sheet is, in words."""

    def put(self, key: str, value: Any, source: str, unit: str = "") -> None:
        """Take a parameter: a number or text; what is assumed has two digits."""
        self.values[key] = _roughly(value) if source == _GUESS else value, source, unit

    def number(self, key: str) -> float:
        """Return a number that was taken."""
        return float(self.values[key][0])

    def text(self) -> str:
        """Return the file: what is in no section first."""
        lines = ["# A drive as `backlash setup` was told. SI units, angles in rad."]
        lines += [f"# {self.motor}"] if self.motor else []
        lines += ["/**:", "  ros__parameters:"]
        section = ""
        for key in sorted(self.values, key=lambda name: "." in name):
            (value, source, unit), (within, _, name) = self.values[key], key.rpartition(".")
            if within != section:
                section = within
                lines.append(f"    {section}:")
            shown = yaml_number(float(f"{value:.6g}")) if isinstance(value, float) else value
            line = f"{'      ' if within else '    '}{name}: {shown}"
            lines.append(f"{line:42s}  # {source}{f' [{unit}]' if unit else ''}")
        return "\n".join(lines) + "\n"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    add = parser.add_argument
    add("--out", type=Path, default=Path("my_drive.yaml"), metavar="FILE", help="by default my_drive.yaml")
    text = "YAML with answers by the keys of the questions, such as gear.reduction: 10, instead of the terminal"
    add("--answers", type=Path, metavar="FILE", help=text)
    add("--force", action="store_true", help="overwrite an existing file")


def _roughly(value: float) -> float:
    return float(f"{value:.2g}")


def _within(bound: Quantity, value: float) -> float:
    return min(max(value, bound.lower), bound.upper)


def _unless_known(ask: Asker, to: Described, known: float, question: Number) -> None:
    """Take a value of a data sheet, or ask for it where that has none; its default is a guess."""
    if not math.isnan(known):
        to.put(question.key, known, _SHEET, question.bound.unit)
        return
    assert question.default is not None
    question = replace(question, default=_roughly(question.default), assumed=True)
    told = ask(question)
    to.put(question.key, told, _GUESS if told == question.default else _TOLD, question.bound.unit)


def _motor(ask: Asker, to: Described) -> DataSheet | None:
    """Ask for the motor; return its data sheet if it is a known one."""
    sheets, bounds = {sheet.name: sheet for sheet in data_sheets()}, quantities(Motor)
    options = {OTHER: "its data sheet is asked for"} | {name: f"{each.voltage:g} V" for name, each in sheets.items()}
    why = "a number or a part of a name; what its data sheet does not say is asked for, and marked in the file"
    unknown = ", which is not known: 1 asks for its data sheet"
    sheet = sheets.get(ask(Choice("motor", "motor", options, OTHER, why, unknown)))
    why = "what the supply gives the motor at most"
    default = 24.0 if sheet is None else sheet.voltage
    volts = ask(Number("motor.voltage_limit", "largest voltage", bounds["voltage_limit"], default, explained=why))
    inductance = inertia = idle = math.nan
    if sheet is None:
        resistance, constant, source = *_winding(ask), _TOLD
        why = "of the motor alone, without gear; its friction follows from it"
        units, default = {"A": 1.0, "mA": 1e-3}, _roughly(_within(_CURRENT, _IDLE * volts / resistance))
        idle = ask(Number("no_load_current", "current without load", _CURRENT, default, units, why, assumed=True))
        speed = max(volts - resistance * idle, 0.1 * volts) / constant
    else:
        (resistance, constant), source = sheet.winding, _SHEET if sheet.has_winding else _FOLLOWS
        to.motor = f"Motor: {sheet.name}: {sheet.source}"
        inductance, inertia, idle = sheet.inductance, sheet.inertia, sheet.no_load_current
        speed = sheet.ratio * sheet.no_load_speed
    to.put("motor.resistance", resistance, source, "ohm")
    to.put("motor.torque_constant", constant, source, "N m/A")
    bound, why = bounds["inductance"], "a data sheet calls it terminal inductance; it hardly matters for small motors"
    units, default = {"mH": 1e-3, "H": 1.0, "uH": 1e-6}, _within(bound, _WINDING * resistance)
    _unless_known(ask, to, inductance, Number("motor.inductance", "inductance", bound, default, units, why))
    bound, why = (
        bounds["inertia"],
        "with all on its shaft before the gear; by default with a mechanical time constant of 15 ms",
    )
    units = {"g cm^2": INERTIAS["g cm^2"], **INERTIAS}
    default = _within(bound, _SPEEDS_UP * constant**2 / resistance)
    _unless_known(ask, to, inertia, Number("motor.inertia", "inertia of the rotor", bound, default, units, why))
    guessed = math.isnan(idle)
    friction = constant * (_IDLE * volts / resistance if guessed else idle) / speed
    source = _GUESS if guessed else "from the current without load"
    to.put("motor.viscous_friction", _within(bounds["viscous_friction"], friction), source, "N m s/rad")
    to.put("motor.voltage_limit", volts, _TOLD, "V")
    return sheet


def _winding(ask: Asker) -> tuple[float, float]:
    """Ask for resistance, ohm, and torque constant, N m/A."""
    bounds = quantities(Motor)
    why = "between the terminals: voltage divided by the current at standstill"
    resistance = ask(Number("motor.resistance", "resistance of the winding", bounds["resistance"], 2.0, explained=why))
    units: Units = {"N m/A": 1.0, "mN m/A": 1e-3, "rpm/V": lambda value: 1.0 / (value * RPM)}
    why = "also the back-EMF constant, V s/rad; the speed constant, in rpm/V, will do as well"
    question = Number("motor.torque_constant", "torque constant", bounds["torque_constant"], 0.05, units, why)
    return float(resistance), float(ask(question))


def _gear(ask: Asker, sheet: DataSheet | None, to: Described) -> None:
    bounds = quantities(Gear)
    turns = 10.0 if sheet is None or math.isnan(sheet.reduction) else sheet.reduction
    play = math.radians(1.0) if sheet is None or math.isnan(sheet.backlash_angle) else sheet.backlash_angle
    why = "10 for 10:1; all stages together, also a belt"
    turns = ask(Number("gear.reduction", "turns of the motor for one of the load", bounds["reduction"], turns, {}, why))
    to.put("gear.reduction", turns, _TOLD)
    why = "hold the motor and turn the load to and fro; an upper guess is enough: the controller measures it"
    bound = bounds["backlash_angle"]
    play = ask(Number("gear.backlash_angle", "lost motion at the gear's output", bound, play, _DEGREES, why))
    to.put("gear.backlash_angle", play, f"{_TOLD}: an upper guess, learn measures it", "rad")


def _load(ask: Asker, to: Described) -> None:
    """Ask for the load: its inertia, or what gives it, and its weight."""
    bound = quantities(Load)["inertia"]
    why = "known: you have its inertia; else it is found from mass and size"
    options = {_KNOWN: "its inertia is asked for", **{name: str(body) for name, body in _BODIES.items()}}
    shape, weight = ask(Choice("load.body", "what turns behind the gear", options, _KNOWN, why)), 0.0
    if shape == _KNOWN:
        rotor = to.number("motor.inertia") * to.number("gear.reduction") ** 2
        why = "of all behind the gear, about the output shaft; by default a quarter of the rotor's, seen from there"
        question = Number("load.inertia", "inertia of the load", bound, _within(bound, _LIGHT * rotor), INERTIAS, why)
        _unless_known(ask, to, math.nan, question)
    else:
        body = _BODIES[shape]
        why = "of all that turns behind the gear"
        mass = ask(Number("load.mass", "its mass m", _MASS, 0.5, {"kg": 1.0, "g": 1e-3}, why))
        least, most = (math.sqrt(end / (body.inertia * mass)) for end in (bound.lower, bound.upper))
        length = Quantity("", "m", least, min(most, _LONGEST))
        size = ask(Number("load.size", f"{body.size} l", length, _within(length, 0.05), LENGTHS, str(body)))
        inertia, weight = body.inertia * mass * size**2, body.weight * mass * _G * size
        to.put("load.inertia", _within(bound, inertia), f"{shape}: m = {mass:g} kg, l = {size:g} m", bound.unit)
    _friction(ask, to)
    why = "m g l of a load that hangs or leans; 0 if the shaft is vertical, or the load balanced"
    weight = ask(Number("load.gravity_torque", "largest torque of its weight", _WEIGHT, weight, explained=why))
    to.put("load.gravity_torque", weight, _TOLD, "N m")


def _friction(ask: Asker, to: Described) -> None:
    """Ask for the friction of the load."""
    bounds, inertia = quantities(Load), to.number("load.inertia")
    why = "it grows with the speed: about the load's inertia divided by the time in which it comes to rest by itself, "
    why += f"by default {_COASTS:g} s; identify measures it"
    bound, units = bounds["viscous_friction"], {"N m s/rad": 1.0}
    default = _within(bound, inertia / _COASTS)
    viscous = Number("load.viscous_friction", "viscous friction of the load", bound, default, units, why)
    _unless_known(ask, to, math.nan, viscous)
    why = "the smallest torque that turns the load in the gap: a weight on a lever finds it; identify measures it"
    bound, units = bounds["coulomb_friction"], {"N m": 1.0, "mN m": 1e-3}
    dry = Number("load.coulomb_friction", "dry friction of the load", bound, 0.0, units, why)
    _unless_known(ask, to, math.nan, dry)


def _sensors(ask: Asker, sheet: DataSheet | None, to: Described) -> None:
    """Ask which encoders there are."""
    built_in = {} if sheet is None else {"motor": sheet.motor_counts, "load": sheet.load_counts}
    built_in = {side: counts for side, counts in built_in.items() if not math.isnan(counts)}
    options = {"both": "before and behind the gear", "motor": "before the gear", "load": "behind the gear"}
    why = "with both, gap and load are measured directly; with one, less well"
    which = ask(Choice("encoders", "encoders", options, next(iter(built_in), "both"), why))
    sides = ("motor", "load") if which == "both" else (which,)
    to.put("sensors.measured", f"[{', '.join(f'theta_{side[0]}' for side in sides)}]", _TOLD)
    for side in sides:
        key = f"{side}_counts"
        units: Units = {"": 1.0, "bit": lambda bits: 2.0 ** min(bits, 64.0)}
        why = "all edges: four times the lines of an incremental encoder; 12 bit are 4096; 0: not known"
        text, bound = f"counts of the {side}'s encoder, per turn of its shaft", quantities(Sensors)[key]
        counts = ask(Number(f"sensors.{key}", text, bound, built_in.get(side, 4096.0), units, why))
        to.put(f"sensors.{key}", counts, _TOLD)


def _limits(ask: Asker, largest: float, unit: str, to: Described) -> None:
    """Ask for the ends of the travel and a first command, of which the ``largest`` is possible."""
    least, why = -NO_LIMIT, "where the load would strike something, as its encoder reads; none if it may turn freely"
    for side in ("lower", "upper"):
        key, bound = f"limits.position_{side}", Quantity("", "rad", least, NO_LIMIT, open_lower=side == "upper")
        end = ask(Number(key, f"{side} end of the load's travel", bound, None, _DEGREES, why))
        if end is not None:
            to.put(key, end, _TOLD, "rad")
            least = end
    bound, why = Quantity("", unit, 0.0, largest, open_lower=True), "little is enough to learn; raise it in the file"
    first = _FIRST * largest if unit == "V" else largest
    command = ask(Number("limits.command", "largest command to begin with", bound, first, explained=why))
    to.put("limits.command", command, f"{_TOLD}: to begin with; {largest:.6g} when all works", unit)


def describe(ask: Asker) -> Described:
    """Ask all questions; return the parameters."""
    to = Described()
    sheet = _motor(ask, to)
    largest, unit = to.number("motor.voltage_limit"), "V"
    options = {"voltage": "a duty cycle: most amplifiers", "current": "it has a current loop of its own"}
    interface = ask(Choice("command_interface", "what the amplifier takes", options, "voltage"))
    to.put("command_interface", interface, _TOLD)
    if interface == "current":
        bound, unit = quantities(Motor)["current_limit"], "A"
        default = _within(bound, _BEARS * largest / to.number("motor.resistance"))
        why = "that motor and gear bear for seconds; by default a quarter of that at standstill"
        units = {"A": 1.0, "mA": 1e-3}
        question = Number("motor.current_limit", "largest current", bound, default, units, why)
        _unless_known(ask, to, math.nan, question)
        largest = to.number(question.key)
    _gear(ask, sheet, to)
    _load(ask, to)
    _sensors(ask, sheet, to)
    _limits(ask, largest, unit, to)
    why = "that the drive sends and the controller answers: the same for both, 100 to 1000"
    to.put("rate", ask(Number("rate", "samples a second", RATE, 250.0, explained=why)), _TOLD, "Hz")
    return to


def _answered(path: Path) -> Described:
    """Return the parameters by a file of answers; ValueError names the file and what is wrong with it."""
    try:
        content = values_in(path.read_bytes())
        if not isinstance(content, Mapping):
            raise ValueError("must have answers by the keys of the questions, such as gear.reduction: 10")
        answers = Answers(content)
        to = describe(answers)
        answers.refuse_unused()
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return to


def _next(file: Path, to: Described, *, ros2: bool) -> str:
    """Return what comes next, by the ``ros2`` command where there is one."""
    node = "ros2 run backlash_ros controller" if ros2 else "controller"
    by_hand = "python docs/examples/learn_and_step.py"
    calls = [f"ros2 service call /controller/{each} std_srvs/srv/Trigger" for each in ("learn", "identify")]
    lines = [
        f"backlash simulate {file} --plot step.png    a step of it, simulated",
        f"backlash live --drive {file}    it and its controller, simulated, on a page: learn, identify, move",
        f"{node} --ros-args --params-file {file}    for the machine; then, in another terminal:",
        *(calls if ros2 else [f"dashboard    the same page, for the machine; or {by_hand}"]),
    ]
    largest, unit = ("motor.current_limit", "A") if "motor.current_limit" in to.values else ("motor.voltage_limit", "V")
    if to.number("limits.command") < (most := to.number(largest)):
        lines.append(f"raise limits.command in {file}, up to {most:.4g} {unit}, once the drive is identified")
    return "\n  ".join(["next:", *lines]) + f"\n{_BEFORE}"


_BEFORE = "Before the motor has power, read docs/real_drive.md: what to connect, and how to check signs and units."


def setup(given: argparse.Namespace, console: Console) -> int:
    """Ask, write and check; return what `backlash check` does.

    Raises
    ------
    OSError, ValueError
        If there is no answer or one cannot be used, or the file cannot be written: then nothing is.
    """
    if given.answers is None:
        say(console, "An empty line takes what is in brackets, ? explains, < goes back, Ctrl-C ends. Nothing moves.")
        to = Terminal(partial(say, console)).ask(describe)
    else:
        to = _answered(given.answers)
    with staged(given.out) as written:
        written[given.out].write_text(to.text(), encoding="utf-8")
        found = check_drive(written[given.out])
    say(console, f"written: {given.out}")
    code = tell(console, found, str(given.out))
    say(console, _next(given.out, to, ros2=which("ros2") is not None))
    return code


COMMAND = Command(setup, add_arguments, written=("out",))
