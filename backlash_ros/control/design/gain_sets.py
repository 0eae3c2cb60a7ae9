"""Gains as parameters: what a request for some of them means for all of them.

``gains.<region>.k`` is always what is in use. ``gains.<region>.q`` are the LQR weights it was designed from, [0, 0]
where it was given as numbers. ``gain_set`` names the set that both came from, ``custom`` where they came one by one.
Choosing a set sets its gains; setting gains makes the set custom; setting weights designs the gains. For another drive
sets and weights are what stays, and gains are designed anew.
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
        Where it gives no or two kinds of gains, and gains that are out of bounds, or unstable with a loop that is so
        late, ``delay`` in s.
    """
    values: dict[str, list[float]] = {}
    for region in REGIONS:
        q, k = chosen[region]["q"], chosen[region]["k"]
        where = f"gain_sets.{name}.{region}"
        if _given(q) == any(value != 0 for value in k):
            raise ValueError(f"{where}: give either k (gains) or q (LQR weights), got k = {list(k)} and q = {list(q)}")
        gains = design_gains(f"{where}.q", drive, q) if _given(q) else Gains.from_sequence(f"{where}.k", k)
        check_stable(f"{where}.k", drive, gains, period, delay)
        values[f"gains.{region}.k"] = gains.as_array().tolist()
        values[f"gains.{region}.q"] = list(q)
    return values


def what_stays(changes: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what of the gains in use, ``values``, holds for another drive, beside what ``changes`` say of them.

    That is the set, or of each region the weights, from which the gains follow.
    """
    if "gain_set" not in changes and not any(name.startswith("gains.") for name in changes):
        changes = {"gain_set": values["gain_set"]}
    if changes.get("gain_set", CUSTOM) != CUSTOM:
        return {"gain_set": changes["gain_set"]}
    pairs = ((f"gains.{region}.q", f"gains.{region}.k") for region in REGIONS)
    return {q: values[q] for q, k in pairs if _given(values[q]) and q not in changes and k not in changes}


def expand(changes: Mapping[str, Any], sets: Mapping[str, Mapping[str, list[float]]], drive: Drive) -> dict[str, Any]:
    """Return ``changes`` with what follows from them; ValueError where weights cannot be designed for."""
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
        Names the parameter: unknown set, gains that are not those of the named set or not those of the weights,
        gains out of bounds, or gains that the sampled loop, so late (``delay``, s), is unstable with.
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
                    f"{key} = {given} is not that of gain_set {name!r}, {sets[name][key]}; set one of the two"
                )
        if not np.allclose(designed, values[k], rtol=1e-6, atol=1e-9):
            raise ValueError(
                f"{k} = {list(values[k])} does not follow from {q} = {list(values[q])}; set one of the two"
            )
        check_stable(k, drive, gains[region], period, delay)
    return GainSet(gains["fast"], gains["overdamped"])
