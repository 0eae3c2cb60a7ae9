"""The paper's figures, drawn from what `paper` computes: labelled, in units, readable in grey."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from backlash_ros.analysis.paper import CASES, VARIATIONS, Case, Reproduction
from backlash_ros.control import LAWS
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.simulation import Run

B = NOMINAL_DRIVE.gear.backlash_angle
_STYLES: dict[str, Any] = {
    "fast": {"color": "0.6", "linestyle": "-", "linewidth": 0.9},
    "overdamped": {"color": "0.45", "linestyle": "-.", "linewidth": 1.4},
    "two_region": {"color": "black", "linestyle": "-", "linewidth": 1.4},
    "elastic_lqg": {"color": "C0", "linestyle": "--", "linewidth": 1.4},
    "switched_linear": {"color": "C1", "linestyle": "-", "linewidth": 0.9},
    "cascade": {"color": "C2", "linestyle": ":", "linewidth": 1.8},
}
_SEQUENCE: list[dict[str, Any]] = [
    {"color": "black", "linestyle": "-"},
    {"color": "0.4", "linestyle": "--"},
    {"color": "C0", "linestyle": "-."},
]


def _near_target(axes: Axes, result: Run, *, b: float = B, **style: Any) -> None:
    axes.plot(result.time, (result.load_angle - 1.0) / b, **style)


def _label_error(axes: Axes, seconds: float, low: float = -1.5, high: float = 1.5) -> None:
    axes.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
    axes.set(xlim=(0, seconds), ylim=(low, high), xlabel="time, s", ylabel="error over backlash")


def _ticks_at(axes: Axes, values: Sequence[float]) -> None:
    """Label a logarithmic axis at the values that were computed."""
    axes.set_xticks(list(values), labels=[f"{value:g}" for value in values])
    axes.xaxis.set_minor_locator(NullLocator())


def _steps(done: Reproduction, laws: list[str], title: str, seconds: float, high: float = 1.5) -> Figure:
    figure, (whole, near) = plt.subplots(1, 2, figsize=(10, 3.8), constrained_layout=True)
    for law in laws:
        whole.plot(done.steps[law].time, done.steps[law].load_angle, label=LAWS[law].title, **_STYLES[law])
        _near_target(near, done.steps[law], **_STYLES[law])
    whole.set(xlim=(0, seconds), xlabel="time, s", ylabel="load angle, rad", title=title)
    whole.legend(loc="lower right", fontsize="small")
    _label_error(near, seconds, high=high)
    near.set_title("near the target")
    return figure


def fig04(done: Reproduction) -> Figure:
    """State feedback and its limit cycle; amplitude over backlash."""
    figure, (cycle, sweep) = plt.subplots(1, 2, figsize=(10, 3.8), constrained_layout=True)
    _near_target(cycle, done.steps["fast"], color="black", linewidth=1.0, label=LAWS["fast"].title)
    _label_error(cycle, 1.0)
    cycle.set_title("Fig. 4: the fast regulator keeps oscillating")
    rows = done.numbers["backlash_sweep"]
    b = np.array([row["backlash_angle_rad"] for row in rows])
    amplitude = np.array([row["amplitude_b"] for row in rows]) * b
    sweep.loglog(b, b, color="0.6", label="amplitude = backlash (the paper)")
    sweep.loglog(b, NOMINAL_DRIVE.motor_share * b, color="0.6", linestyle="--", label="momentum share of it")
    sweep.loglog(b, amplitude, "ko", label="simulated")
    sweep.set(
        xlabel="backlash at the output, rad", ylabel="amplitude peak to peak, rad", title="Amplitude over backlash"
    )
    sweep.legend(fontsize="small")
    return figure


def fig05(done: Reproduction) -> Figure:
    """Fast against over-damped regulator."""
    return _steps(done, ["fast", "overdamped"], "Fig. 5: the over-damped regulator is quiet and slow", 2.0)


def fig07(done: Reproduction) -> Figure:
    """Open loop under a sinusoidal torque."""
    result = done.open_loop
    figure, panels = plt.subplots(3, 1, figsize=(8, 7), sharex=True, constrained_layout=True)
    half = 0.5 * NOMINAL_DRIVE.gear.backlash
    panels[0].plot(result.time, result.force, "k", linewidth=0.9)
    panels[0].set(ylabel="reaction force, N", title="Fig. 7: sinusoidal motor torque, constant load torque")
    panels[1].plot(result.time, 1e3 * result.gap, "k", linewidth=0.9)
    for edge in (-half, half):
        panels[1].axhline(1e3 * edge, color="0.6", linestyle="--", linewidth=0.9)
    panels[1].set(ylabel="gap, mm (dashed: d/2)")
    panels[2].plot(result.time, 1e3 * result.gap_rate, "k", linewidth=0.9)
    panels[2].set(ylabel="relative speed, mm/s", xlabel="time, s")
    return figure


def fig09(done: Reproduction) -> Figure:
    """Compare the three laws of the paper."""
    laws = ["fast", "overdamped", "two_region"]
    return _steps(done, laws, "Fig. 9: the adaptive law is fast and comes to rest", 2.0)


def fig10(done: Reproduction) -> Figure:
    """Compare the linear compensator and the adaptive law."""
    title = "Fig. 10: linear compensator and adaptive law"
    return _steps(done, ["elastic_lqg", "two_region"], title, 1.0, high=3.0)


def fig11(done: Reproduction) -> Figure:
    """Noise on the measured angle."""
    figure, (whole, near) = plt.subplots(1, 2, figsize=(10, 3.8), constrained_layout=True)
    curves: list[tuple[Run, str, dict[str, Any]]] = [
        (done.noisy, "with 1 % noise", {"color": "C0", "linewidth": 1.2}),
        (done.steps["two_region"], "without", {"color": "black", "linestyle": "--", "linewidth": 1.2}),
    ]
    for result, name, style in curves:
        whole.plot(result.time, result.load_angle, label=name, **style)
        _near_target(near, result, label=name, **style)
    whole.set(xlim=(0, 1), xlabel="time, s", ylabel="load angle, rad", title="Fig. 11: 1 % noise on the measured angle")
    whole.legend(loc="lower right")
    _label_error(near, 2.0)
    near.set_title("near the target")
    return figure


def fig12(done: Reproduction) -> Figure:
    """Variations of the drive, and where the law fails."""
    figure, panels = plt.subplots(2, 3, figsize=(12, 6.5), constrained_layout=True)
    for axes, (letter, (title, runs)) in zip(
        panels.flat, zip("abcde", done.variations.items(), strict=True), strict=False
    ):
        for style, (name, result) in zip(_SEQUENCE, runs.items(), strict=False):
            case: Case = VARIATIONS[title][name]
            _near_target(axes, result, b=case.drive.gear.backlash_angle, label=name, linewidth=1.2, **style)
        _label_error(axes, 3.0)
        axes.set_title(f"({letter}) {title}")
        axes.legend(loc="upper right", fontsize="small")
    panels.flat[-1].axis("off")
    figure.suptitle("Fig. 12: the two-region law, designed for the nominal drive, on other drives")
    return figure


def harmonic_balance(done: Reproduction) -> Figure:
    """Prediction against simulation."""
    figure, panels = plt.subplots(1, 2, figsize=(10, 3.8), constrained_layout=True)
    sweeps = (
        ("backlash_sweep", "backlash_m", 1e3, "backlash d, mm", "o"),
        ("damping_sweep", "tooth_damping", 1.0, "damping of the teeth, N s/m", "s"),
    )
    for axes, (name, key, scale, label, marker) in zip(panels, sweeps, strict=True):
        rows = [row for row in done.numbers[name] if row["predicted_period_s"]]
        for what, color in (("amplitude_b", "black"), ("period_s", "0.55")):
            ratio = [row[f"predicted_{what}"] / row[what] for row in rows]
            axes.semilogx(
                [scale * row[key] for row in rows], ratio, marker=marker, color=color, label=what.split("_")[0]
            )
        axes.axhspan(0.85, 1.15, color="0.92", label="within 15 %")
        axes.axhline(1.0, color="0.7", linewidth=0.8)
        axes.set(ylim=(0.4, 1.4), xlabel=label, ylabel="predicted over simulated")
        _ticks_at(axes, [scale * row[key] for row in rows])
        axes.legend(fontsize="small")
    panels[0].set_title("Harmonic balance, the paper's contact law")
    panels[1].set_title("Harmonic balance, elastic law")
    return figure


def momentum_share(done: Reproduction) -> Figure:
    """Amplitude over the ratio of the inertias."""
    figure, axes = plt.subplots(figsize=(6, 3.8), constrained_layout=True)
    rows = done.numbers["inertia_sweep"]
    ratio = np.geomspace(0.2, 30, 100)
    axes.semilogx(ratio, ratio / (1 + ratio), "k", linewidth=1.0, label="share of the gap, J_r/(J_r + J_l)")
    axes.axhline(1.0, color="0.6", linestyle="--", label="amplitude = backlash (the paper)")
    axes.semilogx([r["inertia_ratio"] for r in rows], [r["amplitude_b"] for r in rows], "ko", label="simulated cycle")
    axes.set(xlabel="reflected motor inertia over load inertia", ylabel="amplitude over backlash", ylim=(0, 1.15))
    axes.set_title("How much of the backlash the load's swing shows")
    axes.legend(fontsize="small", loc="center right")
    return figure


def friction_boundary(done: Reproduction) -> Figure:
    """Where Coulomb friction ends the cycle."""
    figure, axes = plt.subplots(figsize=(6, 3.8), constrained_layout=True)
    rows = done.numbers["friction_boundary"]
    gap = [1e3 * row["backlash_m"] for row in rows]
    least = [1e3 * row["coulomb_friction_Nm"] for row in rows]
    axes.semilogx(gap, least, "ko-")
    axes.fill_between(gap, least, color="0.9")
    axes.text(0.5, 0.35, "limit cycle", transform=axes.transAxes, ha="center")
    axes.text(0.15, 0.9, "rest", transform=axes.transAxes, ha="center")
    axes.set(xlabel="backlash d, mm", ylabel="Coulomb friction on the load, mN m", ylim=(0, 1.4 * max(least)))
    _ticks_at(axes, gap)
    axes.set_title("Friction that ends the cycle of the fast gains")
    return figure


def all_laws(done: Reproduction) -> Figure:
    """Every law, nominal drive."""
    rows = math.ceil(len(LAWS) / 3)
    figure, panels = plt.subplots(rows, 3, figsize=(12, 3 * rows), sharex=True, sharey=True, constrained_layout=True)
    for axes, (name, law) in zip(panels.flat, LAWS.items(), strict=False):
        _near_target(axes, done.steps[name], color="black", linewidth=1.0)
        _label_error(axes, 2.0, high=2.0)
        axes.set_title(law.title, fontsize="medium")
        axes.label_outer()
    for axes in panels.flat[len(LAWS) :]:
        axes.set_axis_off()
    figure.suptitle(f"All laws near the target, {next(iter(CASES))} drive")
    return figure


FIGURES: dict[str, Callable[[Reproduction], Figure]] = {
    "fig04_limit_cycle": fig04,
    "fig05_overdamped": fig05,
    "fig07_open_loop": fig07,
    "fig09_adaptive": fig09,
    "fig10_linear_compensator": fig10,
    "fig11_noise": fig11,
    "fig12_robustness": fig12,
    "all_laws": all_laws,
    "harmonic_balance": harmonic_balance,
    "momentum_share": momentum_share,
    "friction_boundary": friction_boundary,
}


def draw(done: Reproduction, folder: Path, progress: Callable[[str], None]) -> None:
    """Write every figure into ``folder`` as PNG and SVG."""
    with plt.rc_context({"svg.hashsalt": "backlash_ros", "axes.grid": True, "grid.alpha": 0.3}):
        for name, make in FIGURES.items():
            figure = make(done)
            figure.savefig(folder / f"{name}.png", dpi=110)
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)
            progress(name)
