"""Finds what the drives on which a law or the learning fails have in common, and the worst of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from backlash_ros.studies.evaluation.conditions import CONDITION_NAMES, CONDITIONS
from backlash_ros.studies.evaluation.summary import Collected, wilson

_CAUSES, _WORST = 4, 10
"""Conditions that are named for a group, and drives that are named as the worst."""


def _in_common(conditions: NDArray[np.int64], group: NDArray[np.bool_], names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return the conditions that are more frequent in a group than among all drives, the clearest first.

    The 95 % interval of the share in the group must lie above the share of all.
    """
    found = []
    for bit, name in enumerate(names):
        holds = (conditions >> bit) & 1 > 0
        interval, overall = wilson(int(np.count_nonzero(holds[group])), int(np.count_nonzero(group))), np.mean(holds)
        if interval is not None and interval[0] > overall:
            found.append({"condition": name, "share": float(np.mean(holds[group])), "share_of_all": float(overall)})
    return sorted(found, key=_telling)[:_CAUSES]


def _telling(found: dict[str, Any]) -> float:
    return float(found["share_of_all"] - found["share"])


def group_failures(collected: Collected, law: str) -> list[dict[str, Any]]:
    """Return the groups of drives on which ``law`` or the learning fails in the same way, the largest first.

    Each is ``what`` failed, on how many ``drives``, ``numbers`` of the first ten, and what they have ``in_common``.
    """
    number = collected.drives("number").astype(np.int64)
    conditions = collected.drives("conditions").astype(np.int64)
    faulted = collected.law(law, "faulted") > 0
    kinds = {
        f"{law}: faulted or failed": faulted,
        **_combinations(
            law,
            {
                "swings": ~faulted & (collected.law(law, "quiet") == 0),
                "ends off target": ~faulted & (collected.law(law, "precise") == 0),
                "overshoots": ~faulted & (collected.law(law, "overshoot_ok") == 0),
            },
        ),
        "learning: refused, though the motor can outrun the load": (collected.drives("learned") == 0)
        & (collected.drives("can_outrun") > 0),
        "learning: valid, but wrong": collected.drives("wrong") > 0,
    }
    groups = [
        {
            "what": what,
            "drives": int(np.count_nonzero(group)),
            "numbers": number[group][:10].tolist(),
            "in_common": _in_common(conditions, group, tuple(CONDITIONS) if "learning" in what else CONDITION_NAMES),
        }
        for what, group in kinds.items()
        if np.any(group)
    ]
    return sorted(groups, key=lambda each: -each["drives"])


def _combinations(law: str, kinds: dict[str, NDArray[np.bool_]]) -> dict[str, NDArray[np.bool_]]:
    """Return the groups of drives that fail in exactly the same ways."""
    ways = list(kinds)
    code = np.sum([kinds[way].astype(np.int64) << bit for bit, way in enumerate(ways)], axis=0)
    return {
        f"{law}: " + ", ".join(way for bit, way in enumerate(ways) if pattern >> bit & 1): code == pattern
        for pattern in range(1, 1 << len(ways))
    }


def worst_drives(collected: Collected, law: str) -> list[dict[str, Any]]:
    """Return the drives on which ``law`` fails most: their ``number`` and ``times`` beyond the threshold.

    ``times`` is infinite for a faulted or failed run; drives on which nothing fails are left out.
    """
    number, beyond = collected.drives("number"), collected.law(law, "severity")
    order = np.lexsort((number, -beyond))[:_WORST]
    return [{"number": int(number[k]), "times": float(beyond[k])} for k in order if beyond[k] > 1.0]
