"""The text of an estimate file: writes the estimates of one drive as YAML and reads them back.

The reader is strict: it refuses a file unless it understands every key, so that no incomplete file moves the motor.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from datetime import datetime, timezone
from reprlib import repr as shortened
from typing import Any

import yaml

from backlash_ros.control.experiment import Method
from backlash_ros.control.settings import ZERO, ServoSettings
from backlash_ros.drivetrain import CONTACTS, Gear, Load, Motor
from backlash_ros.drivetrain.parameters import FOUND
from backlash_ros.foundation.quantity import Quantity, Validated, quantities
from backlash_ros.foundation.reading.yaml_text import values_in

FORMAT, VERSION = "backlash_ros/estimates", 2
MOST = 100
"""Number of estimates that a file stores: the newest ones, and the newest applied ones."""


def _bounds() -> dict[str, Quantity]:
    """Return the numbers that an estimate may have, by the names of parameters."""
    servo = quantities(ServoSettings)
    parts: tuple[type[Validated], ...] = (Motor, Gear, Load, *CONTACTS.values())
    numbers = {f"{part.section}.{name}": each for part in parts for name, each in quantities(part).items()}
    return {
        **{name: each for name, each in numbers.items() if name.startswith(FOUND)},
        "backlash_angle": replace(servo["backlash_angle"], open_lower=True),
        **{name: servo[name] for name in servo if name.startswith(("expected_load_torque", "unexplained_"))},
        "zero": ZERO,
        "loop_delay": Quantity("delay of the drive, from the measurement to when its command acts", "s", 0.0, 10.0),
    }


_LAW = "contact.law"
_DEVIATION = Quantity("a standard uncertainty", "", 0.0, 1e9, open_lower=True)
_STAYS = "backlash_angle", "load.inertia"
"""What a drive keeps from one estimate to the next."""
_SIGMAS = 3.0
"""Standard uncertainties of both by which two estimates of it differ at most."""
_REDUCTION = quantities(Gear)["reduction"]
_SAME_GEAR = 1e-6
"""Relative difference up to which two gear reductions count as equal."""

_KEYS = ("format", "version", "drive", "count", "estimates")
_ENTRY = ("learned_at", "method", "parameters", "standard_uncertainties", "applied")
_TIME = "%Y-%m-%dT%H:%M:%SZ"


@dataclass(frozen=True)
class DriveIdentity:
    """Whose estimates they are: the controller's full name, its joints, and the gear's reduction."""

    controller: str
    motor_joint: str
    load_joint: str
    gear_reduction: float


def _check(where: str, parameters: Mapping[str, Any], uncertainties: Mapping[str, Any]) -> None:
    """Raise ValueError unless these can be an estimate's parameters and standard uncertainties."""
    bounds = _bounds()
    if not parameters:
        raise ValueError(f"{where}parameters must have at least one value, got none")
    for name, value in parameters.items():
        if name == _LAW:
            CONTACTS.choose(f"{where}parameters.{_LAW}", value)
        elif name in bounds:
            bounds[name].check(f"{where}parameters.{name}", value)
        else:
            raise ValueError(f"{where}parameters must be of {[_LAW, *bounds]}, got {shortened(name)}")
    for name, value in uncertainties.items():
        if name not in parameters or name == _LAW:
            raise ValueError(f"{where}standard_uncertainties must be of numbers in parameters, got {shortened(name)}")
        _DEVIATION.check(f"{where}standard_uncertainties.{name}", value)


def in_words(parameters: Mapping[str, Any]) -> str:
    """Return values by name as text, numbers with their units."""
    bounds = _bounds()
    return ", ".join(
        f"{name} = {value}" if name == _LAW else f"{name} = {value:.6g} {bounds[name].unit}".rstrip()
        for name, value in parameters.items()
    )


@dataclass(frozen=True)
class KeptEstimate:
    """A valid estimate: when it was learned (UTC, whole seconds), how, and whether it was applied.

    ``parameters`` by name, in SI units, and their standard ``uncertainties`` as far as known.

    Raises
    ------
    ValueError
        If a value is out of bounds, or its parameter is never estimated.
    """

    learned_at: datetime
    method: Method
    parameters: Mapping[str, Any]
    uncertainties: Mapping[str, float]
    applied: bool

    def __post_init__(self) -> None:
        _check("", self.parameters, self.uncertainties)

    @property
    def date(self) -> str:
        """When it was learned, ISO 8601."""
        moment = self.learned_at.astimezone(timezone.utc).replace(tzinfo=None)
        return f"{moment.isoformat(timespec='seconds')}Z"

    def contradicts(self, before: "KeptEstimate") -> str:
        """Return in words what an estimate ``before`` says otherwise than the uncertainties allow; empty if nothing."""
        found = []
        for name in _STAYS:
            sure = math.hypot(*(each.uncertainties.get(name, math.inf) for each in (self, before)))
            apart = abs(self.parameters.get(name, 0.0) - before.parameters.get(name, 0.0)) / sure
            if apart > _SIGMAS:
                was = f"{before.parameters[name]:.6g} {_bounds()[name].unit} by {before.method.value} at {before.date}"
                found.append(f"{name} was {was}, {apart:.2g} standard uncertainties off")
        if not found:
            return ""
        return f"{', '.join(found)}: it differs along the turn, the drive has changed, or one of the estimates is wrong"


@dataclass(frozen=True)
class History:
    """The estimates of one drive, the newest last."""

    drive: DriveIdentity
    estimates: tuple[KeptEstimate, ...] = ()

    @property
    def applied(self) -> KeptEstimate | None:
        """The newest estimate that was applied."""
        return next((each for each in reversed(self.estimates) if each.applied), None)

    @property
    def parameters(self) -> dict[str, Any]:
        """The newest applied value of each parameter."""
        return {name: value for each in self.estimates if each.applied for name, value in each.parameters.items()}

    def with_newest(self, estimate: KeptEstimate) -> "History":
        """Return the history with one more estimate; if full, drop the oldest that `parameters` does not need."""
        every = (*self.estimates, estimate)
        holding = {name: k for k, each in enumerate(every) if each.applied for name in each.parameters}
        oldest = next(k for k in range(len(every)) if k not in holding.values()) if len(every) > MOST else -1
        return replace(self, estimates=tuple(each for k, each in enumerate(every) if k != oldest))

    def with_newest_applied(self) -> "History":
        """Return the history with the newest estimate marked as applied."""
        return replace(self, estimates=(*self.estimates[:-1], replace(self.estimates[-1], applied=True)))


# Writing.


def _scalar(value: Any) -> str:
    """Return a value that reads back equal; YAML 1.1 takes 5e-05 for a text, 5.0e-05 for a number."""
    if not isinstance(value, float):
        return str(value)
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _values(key: str, values: Mapping[str, Any]) -> list[str]:
    return (
        [f"{key}:", *(f"  {name}: {_scalar(value)}" for name, value in values.items())] if values else [f"{key}: {{}}"]
    )


def _rendered(estimate: KeptEstimate) -> str:
    learned_at, method, parameters, uncertainties, applied = _ENTRY
    lines = [
        f'{learned_at}: "{estimate.date}"',
        f"{method}: {estimate.method.value}",
        *_values(parameters, estimate.parameters),
        *_values(uncertainties, estimate.uncertainties),
        f"{applied}: {str(estimate.applied).lower()}",
    ]
    return "- " + "\n  ".join(lines) + "\n"


def render(history: History) -> str:
    """Return the text of a file.

    ``count``, and a last key per entry that is not a number, reveal a file of which a part is missing.
    """
    drive = {"drive": {each.name: getattr(history.drive, each.name) for each in fields(DriveIdentity)}}
    entries = "\n" + "".join(map(_rendered, history.estimates)) if history.estimates else " []\n"
    return (
        "# Estimates of one drive, the newest last: docs/learning.md of backlash_ros.\n"
        f"format: {FORMAT}\nversion: {VERSION}\n"
        f"{yaml.safe_dump(drive, sort_keys=False, default_flow_style=False)}"
        f"count: {len(history.estimates)}\n"
        f"estimates:{entries}"
    )


# Reading.


def _mapping(where: str, value: Any, keys: tuple[str, ...]) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{where} must have the keys {list(keys)}, got {shortened(value)}")
    for key in value:
        if key not in keys:
            raise ValueError(f"{where} must have only the keys {list(keys)}, got also {shortened(key)}")
    for key in keys:
        if key not in value:
            raise ValueError(f"{where} must have the key {key!r}, got {shortened(list(value))}")
    return value


def _is_ours(found: Mapping[str, Any], drive: DriveIdentity) -> None:
    """Raise ValueError unless a file's ``drive`` is this one."""
    for key, value in found.items():
        expected = getattr(drive, key)
        if key == "gear_reduction":
            _REDUCTION.check("drive.gear_reduction", value)
            same = math.isclose(value, expected, rel_tol=_SAME_GEAR)
        else:
            same = value == expected
        if not same:
            raise ValueError(
                f"drive.{key} must be {expected!r}, as in this controller, got {shortened(value)}: "
                "these are another drive's estimates"
            )


def _estimate(where: str, value: Any) -> KeptEstimate:
    entry = _mapping(where, value, _ENTRY)
    date, method, applied = entry["learned_at"], entry["method"], entry["applied"]
    numbers = [entry[key] for key in ("parameters", "standard_uncertainties")]
    for key, values in zip(("parameters", "standard_uncertainties"), numbers, strict=True):
        if not isinstance(values, dict):
            raise ValueError(f"{where}.{key} must be values by name, got {shortened(values)}")
    _check(f"{where}.", *numbers)
    try:
        learned_at = datetime.strptime(date, _TIME).replace(tzinfo=timezone.utc)
    except (TypeError, ValueError):
        wanted = 'a date in UTC between quotes such as "2026-01-31T23:59:59Z"'
        raise ValueError(f"{where}.learned_at must be {wanted}, got {shortened(date)}") from None
    methods = [each.value for each in Method]
    if method not in methods:
        raise ValueError(f"{where}.method must be one of {methods}, got {shortened(method)}")
    if not isinstance(applied, bool):
        raise ValueError(f"{where}.applied must be true or false, got {shortened(applied)}")
    parameters, uncertainties = map(_as_declared, numbers)
    return KeptEstimate(learned_at, Method(method), parameters, uncertainties, applied)


def _as_declared(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values in the types of their parameters: 1 becomes 1.0 unless the parameter is a whole number."""
    bounds = _bounds()
    return {name: value if name == _LAW or bounds[name].whole else float(value) for name, value in values.items()}


def parse(content: bytes, drive: DriveIdentity) -> History:
    """Return what a file of ``drive`` says.

    Raises
    ------
    ValueError
        Names the key, the value, the bound and the unit if the file is not an estimate file, is incomplete, has an
        unknown version, belongs to another drive, or has a value out of bounds.
    """
    try:
        loaded = values_in(content)
    except ValueError as error:
        raise ValueError(f"it is not YAML: {error}") from error
    if not isinstance(loaded, Mapping) or loaded.get("format") != FORMAT:
        found = loaded.get("format") if isinstance(loaded, Mapping) else loaded
        raise ValueError(f"format must be {FORMAT!r}, got {shortened(found)}: it is not an estimate file")
    version = loaded.get("version")
    if type(version) is not int or version != VERSION:
        raise ValueError(f"version must be {VERSION}, the only known one, got {shortened(version)}")
    top = _mapping("the file", loaded, _KEYS)
    _is_ours(_mapping("drive", top["drive"], tuple(each.name for each in fields(DriveIdentity))), drive)
    listed, count = top["estimates"], top["count"]
    if not isinstance(listed, list) or type(count) is not int or count != len(listed):
        found = len(listed) if isinstance(listed, list) else shortened(listed)
        raise ValueError(
            f"count must be the number of estimates, {found}, got {shortened(count)}: part of the file is missing"
        )
    return History(drive, tuple(_estimate(f"estimates[{k}]", value) for k, value in enumerate(listed)))
