"""The text of an estimate file: the estimates of one drive as YAML, and read back, or refused with the reason.

The reader is strict: what it does not understand to the last key it refuses, so that no half file turns the motor.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from datetime import datetime, timezone
from reprlib import repr as shortened
from typing import Any

import yaml

from backlash_ros.control.experiment import Method
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Gear, Quantity, quantities

FORMAT, VERSION = "backlash_ros/backlash_estimates", 1
MOST = 100
"""Estimates that a file keeps: the newest ones, and the newest of those that were applied."""

_LARGEST = quantities(ServoSettings)["backlash_angle"].upper
_ANGLE = Quantity("backlash at the output", "rad", 0.0, _LARGEST, open_lower=True)
_UNCERTAINTY = Quantity("its standard uncertainty", "rad", 0.0, _LARGEST)
_REDUCTION = quantities(Gear)["reduction"]
_SAME_GEAR = 1e-6
"""Relative difference of gear reductions that are the same one, written differently."""

_KEYS = ("format", "version", "drive", "count", "estimates")
_ENTRY = ("learned_at", "method", "backlash_angle_rad", "standard_uncertainty_rad", "applied")
_TIME = "%Y-%m-%dT%H:%M:%SZ"


@dataclass(frozen=True)
class DriveIdentity:
    """Whose estimates they are: the controller's full name, its joints, and the gear's reduction."""

    controller: str
    motor_joint: str
    load_joint: str
    gear_reduction: float


@dataclass(frozen=True)
class KeptEstimate:
    """A valid estimate: when it was learned (UTC, whole seconds), how, and whether it was put in use.

    ``angle`` and standard ``uncertainty``: rad at the output; the latter is 0 where the method has none.

    Raises
    ------
    ValueError
        If an angle is not finite or beyond the bounds of ``backlash_angle``.
    """

    learned_at: datetime
    method: Method
    angle: float
    uncertainty: float
    applied: bool

    def __post_init__(self) -> None:
        _ANGLE.check("backlash_angle_rad", self.angle)
        _UNCERTAINTY.check("standard_uncertainty_rad", self.uncertainty)

    @property
    def date(self) -> str:
        """When it was learned, ISO 8601."""
        moment = self.learned_at.astimezone(timezone.utc).replace(tzinfo=None)
        return f"{moment.isoformat(timespec='seconds')}Z"


@dataclass(frozen=True)
class History:
    """The estimates of one drive, the newest last."""

    drive: DriveIdentity
    estimates: tuple[KeptEstimate, ...] = ()

    @property
    def applied(self) -> KeptEstimate | None:
        """The newest estimate that was applied."""
        return next((each for each in reversed(self.estimates) if each.applied), None)

    def with_newest(self, estimate: KeptEstimate) -> "History":
        """Return the history with one more, without the oldest where there are too many."""
        every = replace(self, estimates=(*self.estimates, estimate))
        kept, applied = every.estimates[-MOST:], every.applied
        if applied is not None and not any(each.applied for each in kept):
            kept = (applied, *kept[1:])
        return replace(self, estimates=kept)

    def with_newest_applied(self) -> "History":
        """Return the history in which the newest was applied."""
        return replace(self, estimates=(*self.estimates[:-1], replace(self.estimates[-1], applied=True)))


# Writing.


def _number(value: float) -> str:
    """Return a number that reads back equal; YAML 1.1 takes 5e-05 for a text, 5.0e-05 for a number."""
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _rendered(estimate: KeptEstimate) -> str:
    uncertainty = _number(estimate.uncertainty) if estimate.uncertainty > 0.0 else "null"
    values = (
        f'"{estimate.date}"',
        estimate.method.value,
        _number(estimate.angle),
        uncertainty,
        str(estimate.applied).lower(),
    )
    lines = [f"{key}: {value}" for key, value in zip(_ENTRY, values, strict=True)]
    return "- " + "\n  ".join(lines) + "\n"


def render(history: History) -> str:
    """Return the text of a file.

    ``count`` and an entry's last key, which is no number, let no part of a file pass for the whole.
    """
    drive = {"drive": {each.name: getattr(history.drive, each.name) for each in fields(DriveIdentity)}}
    entries = "\n" + "".join(map(_rendered, history.estimates)) if history.estimates else " []\n"
    return (
        "# Backlash estimates of one drive, the newest last: docs/learning.md of backlash_ros.\n"
        f"format: {FORMAT}\nversion: {VERSION}\n"
        f"{yaml.safe_dump(drive, sort_keys=False, default_flow_style=False)}"
        f"count: {len(history.estimates)}\n"
        f"estimates:{entries}"
    )


# Reading.


class _Loader(yaml.SafeLoader):
    """Plain YAML in which no key stands twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value]
        twice = next((key for key in keys if keys.count(key) > 1), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(None, None, f"the key {twice!r} stands twice", node.start_mark)
        return super().construct_mapping(node, deep)


def _load(text: str) -> Any:
    loader = _Loader(text)
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


def _mapping(where: str, value: Any, keys: tuple[str, ...]) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{where} must have the keys {list(keys)}, got {shortened(value)}")
    for key in value:
        if key not in keys:
            raise ValueError(f"{where} must have the keys {list(keys)} alone, got {shortened(key)} besides")
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
                f"drive.{key} must be {expected!r}, as this controller has it, got {shortened(value)}: "
                "these are another drive's estimates"
            )


def _estimate(where: str, value: Any) -> KeptEstimate:
    entry = _mapping(where, value, _ENTRY)
    date, method, applied = entry["learned_at"], entry["method"], entry["applied"]
    uncertainty = 0.0 if entry["standard_uncertainty_rad"] is None else entry["standard_uncertainty_rad"]
    _ANGLE.check(f"{where}.backlash_angle_rad", entry["backlash_angle_rad"])
    _UNCERTAINTY.check(f"{where}.standard_uncertainty_rad", uncertainty)
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
    return KeptEstimate(learned_at, Method(method), float(entry["backlash_angle_rad"]), float(uncertainty), applied)


def parse(content: bytes, drive: DriveIdentity) -> History:
    """Return what a file of ``drive`` says.

    Raises
    ------
    ValueError
        Names the key, the value, the bound and the unit where the file is no estimate file, not whole, of a version
        that is not known, of another drive, or has a value out of bounds.
    """
    try:
        loaded = _load(content.decode())
    except Exception as error:  # what is no YAML may raise anything
        raise ValueError(f"it is no YAML: {' '.join(str(error).split()) or type(error).__name__}") from error
    if not isinstance(loaded, Mapping) or loaded.get("format") != FORMAT:
        found = loaded.get("format") if isinstance(loaded, Mapping) else loaded
        raise ValueError(f"format must be {FORMAT!r}, got {shortened(found)}: it is no estimate file")
    version = loaded.get("version")
    if type(version) is not int or version != VERSION:
        raise ValueError(f"version must be {VERSION}, the only one known here, got {shortened(version)}")
    top = _mapping("the file", loaded, _KEYS)
    _is_ours(_mapping("drive", top["drive"], tuple(each.name for each in fields(DriveIdentity))), drive)
    listed, count = top["estimates"], top["count"]
    if not isinstance(listed, list) or type(count) is not int or count != len(listed):
        found = len(listed) if isinstance(listed, list) else shortened(listed)
        raise ValueError(
            f"count must be the number of estimates, {found}, got {shortened(count)}: part of it is missing"
        )
    return History(drive, tuple(_estimate(f"estimates[{k}]", value) for k, value in enumerate(listed)))
