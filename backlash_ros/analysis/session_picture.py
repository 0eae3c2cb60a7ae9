"""The picture of a recorded session: what the load, the teeth and the voltage do in three steps, and a load step."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from backlash_ros.analysis.bag import Recording
from backlash_ros.analysis.session import LABELS, Interval
from backlash_ros.drivetrain import Drive

_LINES = {"fast": ("C3", 0.9), "overdamped": ("C0", 1.4), "two_region": ("black", 1.6)}
_SHOWN = 2.0
_RISE = 0.4
"""How much of a step is shown near its target, and whole, s."""


def plot_session(
    recording: Recording, intervals: Mapping[str, Interval], load: Interval, drive: Drive, learned: float, path: Path
) -> None:
    """Draw the three step responses, near the target and whole, and the load step; write ``path`` (PNG)."""
    b, ratio = drive.gear.backlash_angle, drive.gear.ratio
    figure = plt.figure(figsize=(9, 10.5), constrained_layout=True)
    near, teeth, voltage, whole, loaded = figure.subplot_mosaic(
        [["near", "near"], ["teeth", "teeth"], ["voltage", "voltage"], ["whole", "loaded"]],
        height_ratios=[1.6, 1, 1, 1.3],
    ).values()
    for name, interval in intervals.items():
        color, width = _LINES[name]
        style: dict[str, Any] = {"color": color, "linewidth": width, "label": LABELS[name]}
        part = recording.joint_states.between(interval.start, interval.start + _SHOWN)
        time, angle = part.time - interval.start, part.values[:, 3]
        near.plot(time, (angle - interval.target) / b, **style)
        whole.plot(time, angle, **style)
        if name != "overdamped":  # its teeth rest on one flank
            teeth.plot(time, (ratio * part.values[:, 0] - angle) / b, **style)
        command = recording.scalars["/command"].between(interval.start, interval.start + _SHOWN)
        voltage.step(command.time - interval.start, command.values, where="post", **style)
    near.axhspan(-0.5, 0.5, color="0.92", zorder=0)
    near.text(0.01 * _SHOWN, 0.5, "as wide as the gap", va="bottom", color="0.4", fontsize="small")
    near.set(ylim=(-1.2, 0.9), ylabel="load from target, b")
    near.set_title(f"A step of 1 rad, near its target; learned b = {1e3 * learned:.2f} mrad", loc="left")
    figure.legend(*near.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    for flank in (-0.5, 0.5):
        teeth.axhline(flank, color="0.5", linewidth=0.8, linestyle=":")
    teeth.set(ylim=(-0.75, 0.75), ylabel="teeth in the gap, b")
    teeth.set_title("Between the two flanks: the fast gains beat against both", loc="left")
    voltage.set(ylim=(-2.5, 2.5), ylabel="command, V", xlabel="time after the step, s")
    voltage.set_title(
        f"What the motor gets (cut off at 2.5 V; up to {drive.motor.voltage_limit:g} V at first)", loc="left"
    )
    for axes in (near, teeth, voltage):
        axes.set_xlim(0, _SHOWN)
    whole.set(xlim=(0, _RISE), xlabel="time after the step, s", ylabel="load, rad")
    whole.set_title("The same steps, whole", loc="left")
    _draw_load_step(recording, load, b, loaded)
    for axes in (near, teeth, voltage, whole, loaded):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_load_step(recording: Recording, load: Interval, b: float, axes: Axes) -> None:
    part = recording.joint_states.between(load.start - 0.2, load.end)
    estimate = recording.scalars["/controller/state/load_torque"].between(load.start - 0.2, load.end)
    axes.plot(part.time - load.start, (part.values[:, 3] - load.target) / b, color="black")
    axes.set(xlim=(-0.1, 1.2), xlabel="time after the load torque, s", ylabel="load from target, b")
    axes.set_title("A load torque comes on", loc="left")
    torque = axes.twinx()
    # A sample tells what acted before it: the estimate is that of its stamp, and not of before.
    torque.step(estimate.time - load.start, estimate.values, color="C2", where="post")
    torque.set_ylabel("its estimate, N m", color="C2")
    torque.tick_params(axis="y", colors="C2")
    torque.set_ylim(bottom=0.0)
