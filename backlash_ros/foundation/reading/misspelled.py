"""Refuses misspelled parameters, and names those that were probably meant."""

import difflib
from collections.abc import Callable, Collection, Mapping
from typing import Any

_FROM_ROS = "qos_overrides."
_CLOSE = 0.85
"""Similarity above which an unknown name counts as misspelled."""


def _nearest(name: str, known: Collection[str], least: float) -> str:
    folded = {other.lower(): other for other in known}
    near = difflib.get_close_matches(name.lower(), folded, 1, least)
    return folded[near[0]] if near else ""


def _meant(name: str, known: Collection[str]) -> str:
    """Return the parameter that ``name`` probably means; empty if it belongs to another node."""
    sections = {other.partition(".")[0] for other in known if "." in other}
    return _nearest(name, known, 0.0 if name.partition(".")[0] in sections else _CLOSE)


def check_known(given: Mapping[str, Any], declared: Collection[str], elsewhere: Callable[[], Collection[str]]) -> None:
    """Refuse misspelled overrides.

    Parameter files are shared with other nodes: names unlike ours are ignored.

    Parameters
    ----------
    given : value of each override by its name; an empty section, {}, names none
    declared : names of the node's parameters
    elsewhere : the parameter names of all nodes of the package, used only if a name is not among ``declared``

    Raises
    ------
    ValueError
        Names each such parameter, its value and the nearest name.
    """
    unknown = [name for name in given if name not in declared and not name.startswith(_FROM_ROS) and given[name] != {}]
    ours = [name for name in declared if not name.startswith(_FROM_ROS)]
    known = {*ours, *elsewhere()} if unknown else set()
    wrong = [(name, near) for name in unknown if name not in known and (near := _meant(name, known))]
    if wrong:
        raise ValueError(
            "; ".join(
                f"there is no parameter {name!r}, got {given[name]!r}: did you mean {near!r}?" for name, near in wrong
            )
        )
