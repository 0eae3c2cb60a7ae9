"""Turns the values of a controller's tunable parameters into drive, gains, settings and limits, validated together.

Without ROS: used by the node and by readers of a bag's parameters in use.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from backlash_ros.control import (
    AUTO,
    DEFAULT_WEIGHTS,
    EXPERIMENTS,
    LAWS,
    FaultThresholds,
    Gains,
    GainSet,
    Limits,
    ServoSettings,
    design_law,
)
from backlash_ros.control.design.gain_sets import (
    CUSTOM,
    NO_WEIGHTS,
    REGIONS,
    expand,
    gain_set_of,
    resolve_set,
    what_stays,
)
from backlash_ros.control.design.stability import LONGEST_DELAY
from backlash_ros.control.design.start import CannotStartError, default_weights, emulated, explained
from backlash_ros.control.estimates import APPLY
from backlash_ros.control.homing import HOMING
from backlash_ros.control.motion.profile_parameters import STEP, ProfileParameters
from backlash_ros.control.settings import STOP, ZERO
from backlash_ros.drivetrain import CONTACTS, Drive
from backlash_ros.drivetrain.parameters import FOUND, drive_of, values_of
from backlash_ros.foundation.quantity import Quantity, Validated, quantities, take

_ROOMS: tuple[Mapping[str, Any], ...] = LAWS, EXPERIMENTS, HOMING
"""What has parameters of its own."""

APPLY_BOUND = f"one of {list(APPLY)}"

Sets = dict[str, dict[str, list[float]]]
"""The values of ``gains.*`` that each named set stands for."""

GivenSets = Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]]
"""How each region of each named set is given: by ``k`` or ``q``."""


class Choice(NamedTuple):
    """All relevant parameters by name, and what they stand for; ``drive`` has the winding that is emulated."""

    values: dict[str, Any]
    drive: Drive
    sets: Sets
    settings: ServoSettings
    limits: Limits


def delay_bound(rate: float) -> Quantity:
    """Return what ``loop_delay`` is, and its bound, at a rate of the samples, Hz."""
    text = "delay of the drive, from the measurement to when its command acts; gains are checked with it"
    return Quantity(text, "s", 0.0, LONGEST_DELAY / rate)


def dynamic_names(drive: Drive) -> set[str]:
    """Return the names of the parameters that may change while the controller of ``drive`` runs."""
    kinds: list[type[Validated]] = [ServoSettings, ProfileParameters, Limits, FaultThresholds]
    kinds += [*CONTACTS.values(), *(type(entry.parameters) for room in _ROOMS for entry in room.values())]
    return {
        *(f"{kind.section}.{name}" if kind.section else name for kind in kinds for name in quantities(kind)),
        *(name for name in values_of(drive) if name.startswith(FOUND)),
        *(f"gains.{region}.{kind}" for region in REGIONS for kind in ("k", "q")),
        *("gain_set", "identified", "law", "loop_delay"),
        *("learning.apply", "learning.experiment", "learning.renew"),
        *("faults.on_lost_encoder", "profile.mode", "zero", "homing.switch"),
    }


def _parameters_of(registry: Mapping[str, Any], values: Mapping[str, Any]) -> tuple[tuple[str, Validated], ...]:
    """Return, from all values, the parameters of each law or experiment by its name."""
    return tuple((name, take(type(registry[name].parameters), values)) for name in sorted(registry))


def check_set_names(names: Any) -> None:
    """Raise ValueError unless there are names of gain sets, all different and none of them `CUSTOM`."""
    listed("gain_set_names", names)
    if CUSTOM in names or len(set(names)) < len(names):
        raise ValueError(f"gain_set_names must be different from each other and from {CUSTOM!r}, got {list(names)}")


def given_sets(given: Mapping[str, Any]) -> dict[str, dict[str, dict[str, list[float]]]]:
    """Return how each region of each gain set is given by parameters by name, with the defaults of a controller.

    Raises
    ------
    ValueError
        If names of gain sets are missing, taken or given twice.
    """
    names = given.get("gain_set_names", ["nominal"])
    check_set_names(names)
    sets: dict[str, dict[str, dict[str, list[float]]]] = {}
    for name in names:
        sets[name] = {}
        for region in REGIONS:
            where = f"gain_sets.{name}.{region}"
            k = listed(f"{where}.k", given.get(f"{where}.k", [0.0, 0.0, 0.0]))
            q = NO_WEIGHTS if name != "nominal" or any(k) else DEFAULT_WEIGHTS[region]
            sets[name][region] = {"k": k, "q": listed(f"{where}.q", given.get(f"{where}.q", q))}
    return sets


def listed(name: str, value: Any) -> list[Any]:
    """Return a parameter's list; ValueError, which calls it ``name``, if it is none or empty."""
    if not isinstance(value, (list, tuple)) or not value:
        raise ValueError(f"{name} must be a list with something in it, got {value!r}")
    return list(value)


def chosen_for_rate(choice: Choice) -> list[str]:
    """Return in words what was chosen for rate and delay: another winding than the motor's, weights below the default.

    Nothing where the drive is controlled as it is described.
    """
    said, described, drive = [], drive_of(choice.values).motor, choice.drive
    rate, motor = 1.0 / choice.settings.period, drive.motor
    if motor.resistance != described.resistance:
        line = (
            f"a winding of {motor.resistance:g} ohm is emulated, since that of motor.resistance = "
            f"{described.resistance:g} ohm would brake the motor too late inside the gap at {rate:g} Hz"
        )
        through = motor.voltage_limit / motor.resistance
        if through < motor.current_limit:
            full = math.ceil(rate * motor.current_limit / through)
            line += f"; it lets {through:.3g} A of {motor.current_limit:g} A through, all from {full:g} Hz on"
        said.append(line)
    lowered = default_weights(choice.drive, choice.settings.period, choice.settings.loop_delay)
    for region, default in DEFAULT_WEIGHTS.items():
        weights = list(choice.values[f"gains.{region}.q"])
        if weights == lowered[region] != default:
            said.append(
                f"gains.{region}.q is [{', '.join(f'{weight:g}' for weight in weights)}], since the default "
                f"[{', '.join(f'{weight:g}' for weight in default)}] would be unstable at {rate:g} Hz"
                + (f" with a delay of {1e3 * choice.settings.loop_delay:g} ms" if choice.settings.loop_delay else "")
            )
    return said


class Tuning:
    """The rules that turn values into a `Choice`, and so decide whether a controller starts.

    Weights that are the default ones are lowered as `default_weights` says. Drives are as described; the winding of one
    whose current is imposed is replaced by that which the controller emulates.

    Parameters
    ----------
    given_sets : the named gain sets
    rate : of the samples, Hz
    """

    def __init__(self, given_sets: GivenSets, rate: float) -> None:
        self._given_sets, self._rate = given_sets, rate

    def sets(self, drive: Drive, delay: float) -> Sets:
        """Return the named sets for a drive; ValueError if one cannot be designed or is unstable."""
        period = 1.0 / self._rate
        drive = emulated(drive, period, delay)
        defaults = default_weights(drive, period, delay)
        sets = {}
        for name, given in self._given_sets.items():
            regions = dict(given)
            for region, default in DEFAULT_WEIGHTS.items():
                if list(given[region]["q"]) == default:
                    regions[region] = {**given[region], "q": defaults[region]}
            sets[name] = resolve_set(name, regions, drive, period, delay)
        return sets

    def gains_at_start(self, given: Mapping[str, Any], drive: Drive, delay: float) -> dict[str, Any]:
        """Return ``gain_set`` and ``gains.*`` at the start, from those of them that are ``given``.

        Gains given beside a set make the set custom, as they do later.
        """
        sets = self.sets(drive, delay)
        first = next(iter(sets))
        start = sets[first]
        changed = {name: listed(name, given[name]) for name in start if given.get(name, start[name]) != start[name]}
        asked = given.get("gain_set", first)
        full = {"gain_set": CUSTOM if changed else asked, **changed}
        return sets.get(asked, start) | expand(full, sets, emulated(drive, 1.0 / self._rate, delay))

    def choice(self, values: dict[str, Any]) -> Choice:
        """Return what parameters stand for; ValueError names what is out of bounds, unstable or cannot be designed."""
        described, delay, period = drive_of(values), values["loop_delay"], 1.0 / self._rate
        delay_bound(self._rate).check("loop_delay", delay)
        sets, drive = self.sets(described, delay), emulated(described, period, delay)
        limits = take(Limits, values)
        settings = take(
            ServoSettings,
            values,
            largest_command=limits.command,
            gains=gain_set_of(values, sets, drive, period, delay),
            law=values["law"],
            period=period,
            loop_delay=delay,
            experiment=values["learning.experiment"],
            renew=values["learning.renew"],
            on_lost_encoder=values["faults.on_lost_encoder"],
            identified=values["identified"],
            experiment_parameters=_parameters_of({**EXPERIMENTS, **HOMING}, values),
            thresholds=take(FaultThresholds, values),
            profile=take(ProfileParameters, values, mode=values["profile.mode"]),
            law_parameters=_parameters_of(LAWS, values),
        )
        if values["learning.apply"] not in APPLY:
            raise ValueError(f"learning.apply must be {APPLY_BOUND}, got {values['learning.apply']!r}")
        ZERO.check("zero", values["zero"])
        if settings.experiment != AUTO:
            EXPERIMENTS.choose("learning.experiment", settings.experiment, AUTO)
        if settings.law != AUTO:
            LAWS.choose("law", settings.law, AUTO)
        try:
            design_law(drive, settings)
        except ValueError as error:
            raise CannotStartError(str(error)) from error
        return Choice(values, drive, sets, settings, limits)

    def completed(self, changes: Mapping[str, Any], before: Choice) -> dict[str, Any]:
        """Return a request with its consequences: a set's gains, gains from weights, values that another drive changes.

        Raises
        ------
        ValueError, TypeError
            If the request cannot be accepted, so that its consequences are unknown.
        """
        values = {**before.values, **changes}
        delay = values["loop_delay"]
        drive, sets, full = emulated(drive_of(values), 1.0 / self._rate, delay), before.sets, dict(changes)
        if drive != before.drive or delay != before.settings.loop_delay:
            sets = self.sets(drive, delay)
        if drive != before.drive or sets != before.sets:
            full = {**_for_another(drive, changes, before), **changes}
        return expand(full, sets, drive)

    def start(self, given: Mapping[str, Any], drive: Drive) -> Choice:
        """Return what a controller of ``drive`` starts with from the parameters that are ``given``, by name.

        Raises
        ------
        CannotStartError
            If gains are unstable, with what would be stable, or if the law cannot be designed.
        ValueError
            For any other value with which it does not start.
        """
        period, delay = 1.0 / self._rate, given.get("loop_delay", 0.0)
        delay_bound(self._rate).check("loop_delay", delay)
        defaults = _defaults(emulated(drive, period, delay)) | values_of(drive)
        values = defaults | {name: given[name] for name in defaults if name in given}
        with explained(drive, period, delay):
            return self.choice(values | self.gains_at_start(given, drive, delay))


def _defaults(drive: Drive) -> dict[str, Any]:
    """Return the defaults of the parameters that may change while a controller runs, beside gains and drive."""
    no_gains = Gains(1.0, 0.0, 0.0)
    settings = ServoSettings(GainSet(no_gains, no_gains))
    parts: list[Validated] = [Limits.of(drive), FaultThresholds.of(drive), settings, settings.profile]
    parts += [entry.parameters for room in _ROOMS for entry in room.values()]
    values = {
        f"{part.section}.{name}" if part.section else name: getattr(part, name)
        for part in parts
        for name in quantities(type(part))
    }
    fixed = {"law": AUTO, "loop_delay": 0.0, "identified": False, "learning.apply": APPLY[0]}
    fixed |= {"learning.experiment": AUTO, "learning.renew": False, "faults.on_lost_encoder": STOP}
    fixed |= {"profile.mode": STEP, "zero": 0.0, "homing.switch": False}
    return values | fixed


def _for_another(drive: Drive, changes: Mapping[str, Any], before: Choice) -> dict[str, Any]:
    """Return what stays for another drive, and its default thresholds if the old drive's were in use."""
    values, old, new = before.values, FaultThresholds.of(before.drive), FaultThresholds.of(drive)
    follow = {
        f"faults.{name}": getattr(new, name)
        for name in quantities(FaultThresholds)
        if values[f"faults.{name}"] == getattr(old, name) != getattr(new, name)
    }
    return {**what_stays(changes, values), **follow}
