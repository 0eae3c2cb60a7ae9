"""Other values for recorded parameters: read from text, and checked like a request to the controller, all or none."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from backlash_ros.control.design.choice import Choice, Tuning, dynamic_names
from backlash_ros.control.design.gain_sets import REGIONS
from backlash_ros.drivetrain.parameters import drive_of
from backlash_ros.foundation.reading.yaml_text import values_in


def tuning_of(values: Mapping[str, Any]) -> Tuning:
    """Return the rules of a controller with these values of all its parameters."""
    sets = {
        name: {region: {kind: values[f"gain_sets.{name}.{region}.{kind}"] for kind in ("k", "q")} for region in REGIONS}
        for name in values["gain_set_names"]
    }
    return Tuning(sets, values["rate"])


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "true or false"
    if isinstance(value, list):
        return "a list of numbers"
    return {str: "a text", int: "a whole number"}.get(type(value), "a number")


def _converted(name: str, value: Any, like: Any) -> Any:
    """Return a value in the type of the recorded one, if that loses nothing."""
    if isinstance(like, list) and isinstance(value, list):
        return [_converted(name, each, 0.0) for each in value]
    if type(like) is float and type(value) is int:
        return float(value)
    if type(like) is int and type(value) is float and value.is_integer():
        return int(value)
    if type(value) is not type(like):
        raise ValueError(f"{name} must be {_kind(like)}, got {value!r}")
    return value


@dataclass(frozen=True)
class Changes:
    """Requested values by the names of parameters; empty for a replay as recorded."""

    given: Mapping[str, Any]

    @classmethod
    def parsed(cls, words: Sequence[str]) -> "Changes":
        """Read texts ``name=value``, with values as in a parameter file; ValueError if one cannot be read."""
        given: dict[str, Any] = {}
        for word in words:
            name, equals, text = word.partition("=")
            if not (name and equals):
                raise ValueError(f"must be name=value, got {word!r}")
            if name in given:
                raise ValueError(f"{name} must be given once, got {given[name]!r} and {text}")
            try:
                given[name] = values_in(text)
            except ValueError as error:
                raise ValueError(f"{name} must be a value as in a parameter file, got {text!r}") from error
        return cls(given)

    def applied_to(self, tuning: Tuning, values: Mapping[str, Any]) -> Choice:
        """Return the tuning that recorded parameters and these changes describe; ValueError names a refused one."""
        before = tuning.choice(dict(values))
        if not self.given:
            return before
        may = dynamic_names(drive_of(values))
        for name, value in self.given.items():
            if name not in values:
                near = difflib.get_close_matches(name, may, 1, 0.0)
                raise ValueError(f"there is no parameter {name!r}, got {value!r}: did you mean {near[0]!r}?")
            if name not in may:
                raise ValueError(
                    f"{name} cannot change while the controller runs: it was {values[name]!r}, got {value!r}"
                )
        changes = {name: _converted(name, value, values[name]) for name, value in self.given.items()}
        return tuning.choice({**values, **tuning.completed(changes, before)})
