"""Turns the values of a controller's tunable parameters into drive, gains, settings and limits, validated together.

Without ROS: used by the node and by readers of a bag's parameters in use.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from backlash_ros.control import AUTO, EXPERIMENTS, LAWS, FaultThresholds, Limits, ServoSettings, design_law
from backlash_ros.control.design.gain_sets import REGIONS, expand, gain_set_of, resolve_set, what_stays
from backlash_ros.control.design.stability import LONGEST_DELAY
from backlash_ros.control.estimates import APPLY
from backlash_ros.drivetrain import CONTACTS, Drive, Quantity, Validated, quantities
from backlash_ros.drivetrain.parameters import FOUND, drive_of, values_of
from backlash_ros.drivetrain.quantity import take

APPLY_BOUND = f"one of {list(APPLY)}"

Sets = dict[str, dict[str, list[float]]]
"""The values of ``gains.*`` that each named set stands for."""

GivenSets = Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]]
"""How each region of each named set is given: by ``k`` or ``q``."""


class Choice(NamedTuple):
    """All relevant parameters by name, and what they stand for."""

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
    kinds: list[type[Validated]] = [ServoSettings, Limits, FaultThresholds]
    kinds += [*CONTACTS.values(), *(type(entry.parameters) for room in (LAWS, EXPERIMENTS) for entry in room.values())]
    return {
        *(f"{kind.section}.{name}" if kind.section else name for kind in kinds for name in quantities(kind)),
        *(name for name in values_of(drive) if name.startswith(FOUND)),
        *(f"gains.{region}.{kind}" for region in REGIONS for kind in ("k", "q")),
        *("gain_set", "identified", "law", "loop_delay"),
        *("learning.apply", "learning.experiment", "learning.renew"),
    }


def _parameters_of(registry: Mapping[str, Any], values: Mapping[str, Any]) -> tuple[tuple[str, Validated], ...]:
    """Return, from all values, the parameters of each law or experiment by its name."""
    return tuple((name, take(type(registry[name].parameters), values)) for name in sorted(registry))


class Tuning:
    """The rules that turn values into a `Choice`.

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
        return {name: resolve_set(name, given, drive, period, delay) for name, given in self._given_sets.items()}

    def choice(self, values: dict[str, Any]) -> Choice:
        """Return what parameters stand for; ValueError names what is out of bounds, unstable or cannot be designed."""
        drive, delay, period = drive_of(values), values["loop_delay"], 1.0 / self._rate
        delay_bound(self._rate).check("loop_delay", delay)
        sets = self.sets(drive, delay)
        settings = take(
            ServoSettings,
            values,
            gains=gain_set_of(values, sets, drive, period, delay),
            law=values["law"],
            period=period,
            loop_delay=delay,
            experiment=values["learning.experiment"],
            renew=values["learning.renew"],
            identified=values["identified"],
            experiment_parameters=_parameters_of(EXPERIMENTS, values),
            thresholds=take(FaultThresholds, values),
            law_parameters=_parameters_of(LAWS, values),
        )
        if values["learning.apply"] not in APPLY:
            raise ValueError(f"learning.apply must be {APPLY_BOUND}, got {values['learning.apply']!r}")
        if settings.experiment != AUTO:
            EXPERIMENTS.choose("learning.experiment", settings.experiment, AUTO)
        design_law(drive, settings)  # refuses what cannot be designed
        return Choice(values, drive, sets, settings, take(Limits, values))

    def completed(self, changes: Mapping[str, Any], before: Choice) -> dict[str, Any]:
        """Return a request with its consequences: a set's gains, gains from weights, values that another drive changes.

        Raises
        ------
        ValueError, TypeError
            If the request cannot be accepted, so that its consequences are unknown.
        """
        values = {**before.values, **changes}
        drive, sets, full = drive_of(values), before.sets, dict(changes)
        if drive != before.drive:
            sets = self.sets(drive, values["loop_delay"])
            full = {**_for_another(drive, changes, before), **changes}
        return expand(full, sets, drive)


def _for_another(drive: Drive, changes: Mapping[str, Any], before: Choice) -> dict[str, Any]:
    """Return what stays for another drive, and its default thresholds if the old drive's were in use."""
    values, old, new = before.values, FaultThresholds.of(before.drive), FaultThresholds.of(drive)
    follow = {
        f"faults.{name}": getattr(new, name)
        for name in quantities(FaultThresholds)
        if values[f"faults.{name}"] == getattr(old, name) != getattr(new, name)
    }
    return {**what_stays(changes, values), **follow}
