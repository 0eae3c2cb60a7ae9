"""The pictures of an evaluation: shares over inertia and friction, settling times, and the runs of one drive."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter

from backlash_ros.control import LAWS
from backlash_ros.simulation import Run
from backlash_ros.studies.evaluation.population import Member
from backlash_ros.studies.evaluation.summary import Collected, wilson
from backlash_ros.studies.evaluation.task import CHANGE, STAND, STEP, scenario_of, true_reading
from backlash_ros.studies.judging import threshold
from backlash_ros.studies.metrics import SETTLED, Array

_SHARES = {"quiet": "quiet", "precise": "precise", "overshoot_ok": "overshoot ok"}
_INERTIA = np.geomspace(1 / 16, 1.0, 6)
_FRICTION = np.array([1e-3, 3e-3, 1e-2, 3e-2, 1e-1])


def _bins(values: Array, edges: Array) -> list[tuple[float, Array]]:
    """Return the middle and the members of each range of positive values; the first and the last are open."""
    place = np.digitize(values, edges[1:-1])
    middles = np.sqrt(edges[:-1] * edges[1:])
    return [(float(middle), (place == k) & (values > 0)) for k, middle in enumerate(middles)]


def draw_shares(collected: Collected, path: Path) -> None:
    """Draw the shares over the ratio of the inertias and over the dry friction, with their 95 % intervals."""
    figure, panels = plt.subplots(len(_SHARES), 2, figsize=(10, 9), sharex="col", sharey="row", constrained_layout=True)
    friction = collected.drives("friction_share")
    nothing = (float(_FRICTION[0]) / 3, friction == 0)
    ranges = (_bins(collected.drives("inertia_ratio"), _INERTIA), [nothing, *_bins(friction, _FRICTION)])
    for (share, title), row in zip(_SHARES.items(), panels, strict=True):
        for axes, bins in zip(row, ranges, strict=True):
            for offset, law in enumerate(collected.laws):
                rows = []
                for middle, members in bins:
                    counted = collected.law(law, share)[members]
                    interval = wilson(int(np.sum(counted)), counted.size)
                    if interval is not None:
                        rows.append((middle * 1.03**offset, float(np.mean(counted)), *interval))
                if rows:
                    x, y, low, high = np.array(rows).T
                    error = np.maximum(0.0, [y - low, high - y])
                    axes.errorbar(
                        x, y, yerr=error, marker="o", markersize=4, linewidth=1.0, capsize=2, label=_title(law)
                    )
            axes.set_xscale("log")
            axes.set_ylim(-0.02, 1.02)
            axes.grid(alpha=0.3)
        row[0].set_ylabel(f"share of drives, {title}")
    panels[0][0].legend(fontsize="small", loc="lower left")
    panels[-1][0].xaxis.set_minor_formatter(NullFormatter())
    panels[-1][0].set_xticks([1 / 16, 1 / 8, 1 / 4, 1 / 2, 1], labels=["1/16", "1/8", "1/4", "1/2", "1"])
    panels[-1][0].set_xlabel("load inertia over reflected motor inertia, J_l/J_r")
    panels[-1][1].set_xlabel("dry friction over stall torque, both sides (leftmost: none)")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_settling(collected: Collected, path: Path) -> None:
    """Draw the share of drives that have settled over time, for each law."""
    figure, axes = plt.subplots(figsize=(7, 4.2), constrained_layout=True)
    for law in collected.laws:
        settle = np.sort(collected.law(law, "settle"))
        settled = settle[settle < STEP * (1 - 1e-9)]
        share = np.arange(1, settled.size + 1) / settle.size
        axes.step(
            [0.0, *settled, STEP], [0.0, *share, share[-1] if share.size else 0.0], where="post", label=_title(law)
        )
    axes.set_xscale("log")
    axes.set(xlim=(0.05, STEP), ylim=(0, 1), xlabel="time after a step of 1 rad, s")
    axes.set_ylabel("share of drives within b/4 for good")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="lower right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_runs(member: Member, runs: dict[str, Run], path: Path) -> None:
    """Draw the runs of one drive: the load near its targets, in units of the backlash."""
    figure, panels = plt.subplots(1, 3, figsize=(13, 4.2), sharey=True, constrained_layout=True)
    b = member.drive.gear.backlash_angle
    band = threshold(SETTLED, b, member.load_count)
    references = scenario_of(member).reference
    spans = (
        (STAND, 2.0, "step of 1 rad"),
        (STAND + STEP, 2.0, "step of 5 b"),
        (CHANGE - 0.5, 3.0, "load torque changes"),
    )
    for law, done in runs.items():
        position = true_reading(member, done.load_angle)
        for axes, (begin, length, title) in zip(panels, spans, strict=True):
            shown = (done.time >= begin) & (done.time <= begin + length)
            target = references[round(begin * member.rate) + 1]
            axes.plot(done.time[shown] - begin, (position[shown] - target) / b, linewidth=1.0, label=_title(law))
            axes.set(title=title, xlabel="time, s", ylim=(-3, 3))
    for axes in panels:
        axes.axhspan(-band, band, color="0.9", zorder=0)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("error over backlash (grey: settled)")
    panels[0].legend(fontsize="small")
    figure.suptitle(f"drive {member.number}")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _title(law: str) -> Any:
    return LAWS[law].title if law in LAWS else law
