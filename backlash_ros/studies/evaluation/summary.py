"""Pure computation: the shares and percentiles of an evaluation, from the results of each drive."""

import math
from array import array
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backlash_ros.studies.evaluation.conditions import conditions_of
from backlash_ros.studies.evaluation.population import Member
from backlash_ros.studies.evaluation.task import Learned, Verdict
from backlash_ros.studies.judging import OVERSHOOT, PRECISE, QUIET, threshold
from backlash_ros.studies.metrics import Array

CLOSE, WRONG = 0.05, 0.2
"""Relative errors of a learned gap: good up to the first, wrong beyond the second."""
WRONG_COUNTS = 2.0
COVERAGE = 2.0
"""Standard uncertainties within which the true gap should be, for 95 % of the drives."""
SHARES = ("quiet", "precise", "overshoot_ok", "faulted")
_Z = 1.959963984540054
"""Of the normal distribution, for 95 %."""

_DRIVE = (
    *("number", "conditions", "can_outrun", "free", "learned", "close", "covered", "wrong"),
    *("identified", "all_close", "ratio_close", "inertia_ratio", "friction_share"),
)
_LAW = (*SHARES, "settle", "rise", "force", "recover", "severity")


class Collected:
    """The results of each drive under ``laws`` and the fast law.

    Only a few numbers are kept per drive, so that a million drives fit in memory.
    """

    def __init__(self, laws: Sequence[str]) -> None:
        self.laws = list(laws)
        self._drives = {name: array("d") for name in _DRIVE}
        self._laws = {law: {name: array("d") for name in _LAW} for law in ("fast", *laws)}

    def add(self, member: Member, value: dict[str, Any]) -> None:
        """Add the result of `task.evaluate_drive` for a drive."""
        learned, drive = value["learned"], member.drive
        gap = learned["gap"]
        error = abs(learned["angle"] - gap)
        valid = bool(learned["valid"])
        # An error that is not a number belongs to something that is valid, but no gap: it is not close.
        row = {
            "number": member.number,
            "conditions": conditions_of(member, valid),
            "can_outrun": member.can_outrun,
            "free": member.free,
            "learned": valid,
            "close": valid and error <= max(CLOSE * gap, member.load_count),
            "covered": valid and error <= COVERAGE * learned["uncertainty"],
            "wrong": valid and error > WRONG * gap and error > WRONG_COUNTS * member.load_count,
            **{name: learned[name] for name in ("identified", "all_close", "ratio_close")},
            "inertia_ratio": drive.load.inertia / drive.reflected_inertia,
            "friction_share": friction_share(member),
        }
        for name, column in self._drives.items():
            column.append(float(row[name]))
        for law, columns in self._laws.items():
            verdict = value["laws"][law]
            figures = {
                **{share: verdict[share] for share in SHARES},
                "settle": verdict["step"]["settle"],
                "rise": verdict["step"]["rise"],
                "force": verdict["peak_force"],
                "recover": verdict["recover"],
                "severity": severity(member, verdict),
            }
            for name, column in columns.items():
                column.append(float(figures[name]))

    def drives(self, name: str) -> Array:
        """Return a figure of each drive: one of ``_DRIVE``."""
        return np.array(self._drives[name])

    def law(self, law: str, name: str) -> Array:
        """Return a figure of a law on each drive: one of ``_LAW``."""
        return np.array(self._laws[law][name])


def failed(laws: Sequence[str], reason: str) -> dict[str, Any]:
    """Return, in the form of `task.evaluate_drive`, the verdict on a drive whose run failed."""
    verdict = asdict(Verdict(failure=reason))
    return {"learned": asdict(Learned(reason=reason)), "laws": dict.fromkeys(laws, verdict)}


def friction_share(member: Member) -> float:
    """Return the dry friction of both sides, at the output, divided by the stall torque."""
    drive = member.drive
    friction = drive.load.coulomb_friction + drive.motor.coulomb_friction / drive.gear.ratio
    return friction / drive.standstill_torque()


def severity(member: Member, verdict: dict[str, Any]) -> float:
    """Return the largest of swing, error and overshoot, each divided by its threshold; infinite for a failed run."""
    if verdict["faulted"]:
        return math.inf
    b, count = member.drive.gear.backlash_angle, member.load_count
    return max(
        float(move[name]) / threshold(share, b, count)
        for move in (verdict["step"], verdict["short"])
        for name, share in (("swing", QUIET), ("error", PRECISE), ("overshoot", OVERSHOOT))
    )


def wilson(count: int, of: int) -> list[float] | None:
    """Return the 95 % interval of a share (Wilson, J. Am. Stat. Assoc. 22, 1927), or None without any trials.

    Examples
    --------
    >>> [round(bound, 3) for bound in wilson(9, 10)]
    [0.596, 0.982]
    """
    if of == 0:
        return None
    share, spread = count / of, _Z**2 / of
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = math.sqrt(spread * (share * (1.0 - share) + 0.25 * spread)) / (1.0 + spread)
    return [max(0.0, middle - half), min(1.0, middle + half)]


def _share(name: str, among: NDArray[Any]) -> dict[str, Any]:
    """Return the share of ones, and its interval, by name."""
    count = int(np.count_nonzero(among))
    return {name: count / among.size if among.size else None, f"{name}_interval": wilson(count, among.size)}


def _percentile(values: Array, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if values.size else None


def summarize(collected: Collected, default_law: str, *, identified: bool = False) -> dict[str, Any]:
    """Return the summary as docs/evaluation.md describes it, with None for missing figures."""
    learned, can_outrun = collected.drives("learned") > 0, collected.drives("can_outrun") > 0
    free = collected.drives("free") > 0
    summary: dict[str, Any] = {
        **_share("learned", learned[can_outrun]),
        **_share("learned_within_5", collected.drives("close")[learned]),
        **_share("covered", collected.drives("covered")[learned]),
        "wrong_valid": int(np.count_nonzero(collected.drives("wrong"))),
        **_identified(collected, learned, identified=identified),
        "laws": {},
        "default_law": default_law,
    }
    for law in collected.laws:
        figures: dict[str, Any] = {}
        for name in SHARES[:-1]:
            figures |= _share(name, collected.law(law, name))
        settle = collected.law(law, "settle")
        figures["settle_median"] = _percentile(settle, 50)
        figures["settle_p95"] = _percentile(settle, 95)
        figures["settle_p95_free"] = _percentile(settle[free], 95)
        ratios = {"rise_ratio": _ratio(collected, law, "rise"), "peak_force_ratio": _ratio(collected, law, "force")}
        figures |= {name: _percentile(values, 50) for name, values in ratios.items()}
        figures |= {f"{name}_p95": _percentile(values, 95) for name, values in ratios.items()}
        figures["recover_p95"] = _percentile(collected.law(law, "recover"), 95)
        figures |= _share("faulted", collected.law(law, "faulted"))
        summary["laws"][law] = figures
    return summary


def _identified(collected: Collected, learned: NDArray[np.bool_], *, identified: bool) -> dict[str, Any]:
    """Return the shares of what was identified: of the learned, and of all; None where nothing was to be."""
    if not identified:
        names = "identified", "all_close", "ratio_close"
        return {key: None for name in names for key in (name, f"{name}_interval")}
    return {
        **_share("identified", collected.drives("identified")[learned]),
        **_share("all_close", collected.drives("all_close")),
        **_share("ratio_close", collected.drives("ratio_close")[learned]),
    }


def _ratio(collected: Collected, law: str, name: str) -> Array:
    """Return a figure divided by that of the fast law, for the drives on which neither failed."""
    fine: NDArray[np.bool_] = (collected.law(law, "faulted") == 0) & (collected.law("fast", "faulted") == 0)
    return collected.law(law, name)[fine] / collected.law("fast", name)[fine]
