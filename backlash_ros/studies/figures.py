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

from backlash_ros.control import LAWS
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.simulation import Run
from backlash_ros.studies.paper import CASES, NOISY, SECONDS, VARIATIONS, Case, Reproduction

B = NOMINAL_DRIVE.gear.backlash_angle
_STYLES: dict[str, Any] = {
    "fast": {"color": "C1", "linestyle": "-", "linewidth": 0.9},
    "overdamped": {"color": "C0", "linestyle": "-.", "linewidth": 1.6},
    "two_region": {"color": "black", "linestyle": "-", "linewidth": 1.8},
    "elastic_lqg": {"color": "C3", "linestyle": "--", "linewidth": 1.6},
}
_SEQUENCE: list[dict[str, Any]] = [
    {"color": "black", "linestyle": "-"},
    {"color": "C1", "linestyle": "--"},
    {"color": "C0", "linestyle": "-."},
]


def _near_target(axes: Axes, result: Run, *, b: float = B, **style: Any) -> None:
    axes.plot(result.time, (result.load_angle - 1.0) / b, **style)


def _label_error(axes: Axes, seconds: float, high: float = 1.0) -> None:
    """Label the error in b over the time, and draw the band that is as wide as the backlash."""
    axes.axhspan(-0.5, 0.5, color="0.9", zorder=0, label="±b/2")
    axes.axhline(0.0, color="0.7", linewidth=0.8, zorder=0)
    axes.set(xlim=(0, seconds), ylim=(-1.5, high), xlabel="time, s", ylabel="error over backlash")


def _ticks_at(axes: Axes, values: Sequence[float]) -> None:
    """Label a logarithmic axis at the values that were computed."""
    axes.set_xticks(list(values), labels=[f"{value:g}" for value in values])
    axes.xaxis.set_minor_locator(NullLocator())


def _whole_and_near() -> tuple[Figure, Axes, Axes]:
    figure, (whole, near) = plt.subplots(
        1, 2, figsize=(10, 4), constrained_layout=True, gridspec_kw={"width_ratios": [1, 1.6]}
    )
    whole.set(xlabel="time, s", ylabel="load angle, rad")
    whole.set_title("whole", fontsize="medium")
    near.set_title("near the target", fontsize="medium")
    return figure, whole, near


def _steps(
    done: Reproduction, laws: list[str], title: str, *, rising: float, seconds: float, high: float = 1.0
) -> Figure:
    figure, whole, near = _whole_and_near()
    for law in laws:
        whole.plot(done.steps[law].time, done.steps[law].load_angle, **_STYLES[law])
        _near_target(near, done.steps[law], label=LAWS[law].title, **_STYLES[law])
    whole.set_xlim(0, rising)
    _label_error(near, seconds, high=high)
    near.legend(loc="lower right", fontsize="small")
    figure.suptitle(title)
    return figure


def fig04(done: Reproduction) -> Figure:
    """State feedback and its limit cycle; amplitude over backlash."""
    figure, (cycle, sweep) = plt.subplots(1, 2, figsize=(10, 4), constrained_layout=True)
    _near_target(cycle, done.steps["fast"], color="black", linewidth=1.0, label=LAWS["fast"].title)
    _label_error(cycle, 1.0)
    cycle.set_title("it keeps oscillating around the target", fontsize="medium")
    cycle.legend(loc="lower right", fontsize="small")
    rows = done.numbers["backlash_sweep"]
    b = [1e3 * row["backlash_angle_rad"] for row in rows]
    sweep.axhline(1.0, color="C1", linestyle="--", label="amplitude = backlash (the paper)")
    sweep.axhline(NOMINAL_DRIVE.motor_share, color="0.4", linestyle=":", label="the load's share, J_r/(J_r + J_l)")
    sweep.semilogx(b, [row["amplitude_b"] for row in rows], "ko", label="simulated")
    _ticks_at(sweep, b)
    sweep.set(ylim=(0, 1.15), xlabel="backlash b at the output, mrad", ylabel="amplitude peak to peak over backlash")
    sweep.set_title("in proportion to the backlash, but less", fontsize="medium")
    sweep.legend(loc="lower left", fontsize="small")
    figure.suptitle("Fig. 4: the limit cycle of the fast regulator")
    return figure


def fig05(done: Reproduction) -> Figure:
    """Fast against over-damped regulator."""
    title = "Fig. 5: the over-damped regulator is quiet, but slow"
    return _steps(done, ["fast", "overdamped"], title, rising=1.5, seconds=2.5)


def fig07(done: Reproduction) -> Figure:
    """Open loop under a sinusoidal torque."""
    result, gear = done.open_loop, NOMINAL_DRIVE.gear
    figure, panels = plt.subplots(4, 1, figsize=(9, 9), sharex=True, constrained_layout=True)
    driving, force, gap, speed = panels
    driving.plot(result.time[:-1], result.motor_torque / gear.ratio, "k", label="motor torque over n")
    driving.axhline(result.load_torque, color="C1", linestyle="--", label="load torque")
    driving.set_ylabel("torque at the output, N m")
    driving.margins(y=0.3)
    driving.legend(loc="upper right", fontsize="small", ncol=2)
    force.plot(result.time, result.force, "k", linewidth=0.9)
    force.set_ylabel("reaction force, N")
    gap.plot(result.time, 1e3 * result.gap, "k", linewidth=0.9)
    for edge in (-500 * gear.backlash, 500 * gear.backlash):
        gap.axhline(edge, color="C1", linestyle="--", linewidth=0.9)
    gap.set(ylabel="gap, mm (dashed: ±d/2)", ylim=(-700 * gear.backlash, 700 * gear.backlash))
    speed.plot(result.time, 1e3 * result.gap_rate, "k", linewidth=0.9)
    speed.set(ylabel="relative speed, mm/s", xlabel="time, s", xlim=(0, result.time[-1]))
    figure.align_ylabels(panels)
    figure.suptitle("Fig. 7: sinusoidal motor torque against a constant load torque, open loop")
    return figure


def fig09(done: Reproduction) -> Figure:
    """Compare the three laws of the paper."""
    title = "Fig. 9: the adaptive law is as fast as the fast regulator, and comes to rest"
    return _steps(done, ["fast", "overdamped", "two_region"], title, rising=1.5, seconds=2.5)


def fig10(done: Reproduction) -> Figure:
    """Compare the linear compensator and the adaptive law."""
    title = "Fig. 10: the linear compensator comes to rest too, but overshoots"
    return _steps(done, ["elastic_lqg", "two_region"], title, rising=0.5, seconds=3.0, high=2.0)


def fig11(done: Reproduction) -> Figure:
    """Noise on the measured angle."""
    figure, whole, near = _whole_and_near()
    noisy = done.noisy
    shown: dict[str, Any] = {"color": "C1", "marker": ".", "markersize": 2.5, "linestyle": ""}
    moved: dict[str, Any] = {"color": "black", "linewidth": 1.6}
    quiet: dict[str, Any] = {"color": "C0", "linestyle": "--", "linewidth": 1.6}
    whole.plot(noisy.time[:-1], noisy.measured_load_angle, **shown)
    whole.plot(noisy.time, noisy.load_angle, **moved)
    near.plot(noisy.time[:-1], (noisy.measured_load_angle - 1.0) / B, label="what the encoder says", **shown)
    _near_target(near, noisy, label="where the load is", **moved)
    _near_target(near, done.steps["two_region"], label="without noise", **quiet)
    whole.set_xlim(0, 0.5)
    _label_error(near, 2.5)
    near.legend(loc="lower right", fontsize="small", markerscale=4)
    figure.suptitle(f"Fig. 11: ±{1e3 * NOISY.load_noise:g} mrad of noise on the measured angle hardly move the load")
    return figure


def fig12(done: Reproduction) -> Figure:
    """Variations of the drive, and where the law fails."""
    figure = plt.figure(figsize=(10, 10), constrained_layout=True)
    panels = figure.subplot_mosaic("ab;cd;ee", sharex=True, sharey=True)
    for (letter, axes), (title, runs) in zip(panels.items(), done.variations.items(), strict=True):
        for style, (name, result) in zip(_SEQUENCE, runs.items(), strict=False):
            case: Case = VARIATIONS[title][name]
            _near_target(axes, result, b=case.drive.gear.backlash_angle, label=name, linewidth=1.4, **style)
        _label_error(axes, SECONDS)
        axes.set_title(f"({letter}) {title}", fontsize="medium")
        axes.legend(loc="lower right", fontsize="small", ncol=2)
        axes.label_outer()
    figure.suptitle("Fig. 12: the two-region law, designed for the nominal drive, on other drives")
    return figure


def harmonic_balance(done: Reproduction) -> Figure:
    """Prediction against simulation."""
    figure, panels = plt.subplots(1, 2, figsize=(10, 4), sharey=True, constrained_layout=True)
    sweeps = (
        ("backlash_sweep", "backlash_m", 1e3, "backlash d, mm"),
        ("damping_sweep", "tooth_damping", 1.0, "damping of the teeth, N s/m"),
    )
    for axes, (name, key, scale, label) in zip(panels, sweeps, strict=True):
        rows = [row for row in done.numbers[name] if row["predicted_period_s"]]
        for what, style in (("amplitude_b", "ko-"), ("period_s", "C1s--")):
            ratio = [row[f"predicted_{what}"] / row[what] for row in rows]
            axes.semilogx([scale * row[key] for row in rows], ratio, style, label=what.split("_")[0])
        axes.axhspan(0.85, 1.15, color="0.9", zorder=0, label="within 15 %")
        axes.axhline(1.0, color="0.7", linewidth=0.8, zorder=0)
        axes.set(ylim=(0.0, 1.4), xlabel=label)
        _ticks_at(axes, [scale * row[key] for row in rows])
        axes.legend(loc="lower left", fontsize="small")
    panels[0].set_ylabel("predicted over simulated")
    panels[0].set_title("the paper's contact law: the period is missed", fontsize="medium")
    panels[1].set_title("elastic teeth", fontsize="medium")
    figure.suptitle("Harmonic balance: the limit cycle predicted from the describing function")
    return figure


def momentum_share(done: Reproduction) -> Figure:
    """Amplitude over the ratio of the inertias."""
    figure, axes = plt.subplots(figsize=(7, 4), constrained_layout=True)
    rows = done.numbers["inertia_sweep"]
    ratios = [row["inertia_ratio"] for row in rows]
    smooth = np.geomspace(0.8 * ratios[0], 1.25 * ratios[-1], 100)
    axes.axhline(1.0, color="C1", linestyle="--", label="amplitude = backlash (the paper)")
    axes.semilogx(smooth, smooth / (1 + smooth), color="0.4", linestyle=":", label="share of the gap, J_r/(J_r + J_l)")
    axes.plot(ratios, [row["amplitude_b"] for row in rows], "ko", label="simulated", clip_on=False)
    for row in rows:
        if not row["amplitude_b"]:
            axes.annotate("at rest", (row["inertia_ratio"], 0.0), (0, 8), textcoords="offset points", ha="center")
    _ticks_at(axes, ratios)
    axes.set(xlim=(smooth[0], smooth[-1]), ylim=(0, 1.15))
    axes.set(xlabel="reflected motor inertia over load inertia, J_r/J_l", ylabel="amplitude over backlash")
    axes.set_title("The lighter the motor, the less of the backlash the load's swing shows")
    axes.legend(fontsize="small", loc="lower center")
    return figure


def friction_boundary(done: Reproduction) -> Figure:
    """Where Coulomb friction ends the cycle."""
    figure, axes = plt.subplots(figsize=(7, 4), constrained_layout=True)
    rows = done.numbers["friction_boundary"]
    gap = [1e3 * row["backlash_m"] for row in rows]
    least = [1e3 * row["coulomb_friction_Nm"] for row in rows]
    axes.semilogx(gap, least, "ko-")
    axes.fill_between(gap, least, color="0.9")
    axes.text(0.5, 0.3, "limit cycle", transform=axes.transAxes, ha="center")
    axes.text(0.5, 0.9, "rest", transform=axes.transAxes, ha="center")
    axes.set(xlabel="backlash d, mm", ylabel="Coulomb friction on the load, mN m", ylim=(0, 1.4 * max(least)))
    _ticks_at(axes, gap)
    axes.set_title("A little dry friction ends the cycle of the fast gains")
    return figure


def all_laws(done: Reproduction) -> Figure:
    """Every law, nominal drive."""
    rows = [row[::-1] for row in np.array_split(list(LAWS)[::-1], math.ceil(len(LAWS) / 4))][
        ::-1
    ]  # the last ones fullest
    columns = math.lcm(*(len(row) for row in rows))
    mosaic: list[Any] = [[str(name) for name in row for _ in range(columns // len(row))] for row in rows]
    figure = plt.figure(figsize=(12, 3.2 * len(rows)), constrained_layout=True)
    for name, axes in figure.subplot_mosaic(mosaic, sharex=True, sharey=True).items():
        _near_target(axes, done.steps[name], color="black", linewidth=1.0)
        _label_error(axes, 4.0, high=2.0)
        axes.set_xticks(range(5))
        axes.set_title(LAWS[name].title, fontsize="medium")
        axes.label_outer()
    figure.suptitle(f"All laws near the target, {next(iter(CASES))} drive; grey: ±b/2")
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
