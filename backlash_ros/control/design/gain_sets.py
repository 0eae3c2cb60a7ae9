"""Gains as parameters: how a request for some of them changes the others.

``gains.<region>.k`` is always what is in use. ``gains.<region>.q`` are the LQR weights it was designed from, [0, 0]
if it was given as numbers. ``gain_set`` names the set that both came from, or ``custom`` if they were set one by one.
Choosing a set sets its gains; setting gains makes the set custom; setting weights designs the gains. For another drive
sets and weights stay, and the gains are designed again.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from backlash_ros.control import Gains, GainSet, check_stable, design_gains
from backlash_ros.drivetrain import Drive

CUSTOM = "custom"
REGIONS = ("fast", "overdamped")
NO_WEIGHTS = [0.0, 0.0]


def _given(weights: Sequence[float]) -> bool:
    return any(value != 0 for value in weights)


def resolve_set(
    name: str, chosen: Mapping[str, Mapping[str, Sequence[float]]], drive: Drive, period: float, delay: float
) -> dict[str, list[float]]:
    """Return the parameters that a named set stands for.

    Raises
    ------
    ValueError
        If it gives no or two kinds of gains, or gains that are out of bounds or unstable with the loop's ``delay`` (s).
    """
    values: dict[str, list[float]] = {}
    for region in REGIONS:
        q, k = chosen[region]["q"], chosen[region]["k"]
        where = f"gain_sets.{name}.{region}"
        if _given(q) == any(value != 0 for value in k):
            raise ValueError(f"{where}: give either k (gains) or q (LQR weights), got k = {list(k)} and q = {list(q)}")
        gains = design_gains(f"{where}.q", drive, q) if _given(q) else Gains.from_sequence(f"{where}.k", k)
        check_stable(f"{where}.k", drive, gains, period, delay, q if _given(q) else None)
        values[f"gains.{region}.k"] = gains.as_array().tolist()
        values[f"gains.{region}.q"] = list(q)
    return values


def what_stays(changes: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what stays of the gains in use, ``values``, for another drive, beside the requested ``changes``.

    That is the set, or the weights of each region, from which the gains follow.
    """
    if "gain_set" not in changes and not any(name.startswith("gains.") for name in changes):
        changes = {"gain_set": values["gain_set"]}
    if changes.get("gain_set", CUSTOM) != CUSTOM:
        return {"gain_set": changes["gain_set"]}
    pairs = ((f"gains.{region}.q", f"gains.{region}.k") for region in REGIONS)
    return {q: values[q] for q, k in pairs if _given(values[q]) and q not in changes and k not in changes}


def expand(changes: Mapping[str, Any], sets: Mapping[str, Mapping[str, list[float]]], drive: Drive) -> dict[str, Any]:
    """Return ``changes`` with what follows from them; ValueError if no gains can be designed from the weights."""
    full = dict(changes)
    chosen = sets.get(full.get("gain_set", ""))
    if chosen is not None:
        full = {**chosen, **full}
    for region in REGIONS:
        k, q = f"gains.{region}.k", f"gains.{region}.q"
        if q in full and _given(full[q]) and k not in full:
            full[k] = design_gains(q, drive, full[q]).as_array().tolist()
        elif k in full and q not in full:
            full[q] = list(NO_WEIGHTS)
        if (k in full or q in full) and "gain_set" not in full:
            full["gain_set"] = CUSTOM
    return full


def gain_set_of(
    values: Mapping[str, Any],
    sets: Mapping[str, Mapping[str, list[float]]],
    drive: Drive,
    period: float,
    delay: float,
) -> GainSet:
    """Return the gains that a complete candidate stands for.

    Raises
    ------
    ValueError
        Names the parameter: unknown set, gains that contradict the named set or the weights, gains out of bounds, or
        gains with which the sampled loop, with its ``delay`` (s), is unstable.
    """
    name = values["gain_set"]
    if name != CUSTOM and name not in sets:
        raise ValueError(f"gain_set must be one of {[*sets, CUSTOM]}, got {name!r}")
    gains = {}
    for region in REGIONS:
        k, q = f"gains.{region}.k", f"gains.{region}.q"
        gains[region] = Gains.from_sequence(k, values[k])
        designed = values[k]
        if len(values[q]) != 2 or _given(values[q]):
            designed = design_gains(q, drive, values[q]).as_array()
        for key in (k, q):
            given = list(values[key])
            if name != CUSTOM and given != sets[name][key]:
                raise ValueError(
                    f"{key} = {given} contradicts gain_set {name!r}, that has {sets[name][key]}; set only one of them"
                )
        if not np.allclose(designed, values[k], rtol=1e-6, atol=1e-9):
            raise ValueError(
                f"{k} = {list(values[k])} does not follow from {q} = {list(values[q])}; set only one of them"
            )
        check_stable(k, drive, gains[region], period, delay, values[q] if _given(values[q]) else None)
    return GainSet(gains["fast"], gains["overdamped"])
