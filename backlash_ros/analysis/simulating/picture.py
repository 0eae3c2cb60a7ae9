"""The picture of one simulated step."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from backlash_ros.drivetrain import Drive
from backlash_ros.simulation import Run


def draw(result: Run, drive: Drive, reference: float, title: str, path: Path) -> None:
    """Draw load, load near the target, teeth in the gap, and command over time; write ``path`` (PNG or SVG)."""
    b = drive.gear.backlash_angle
    figure, (whole, near, teeth, command) = plt.subplots(4, 1, figsize=(8, 9), sharex=True, constrained_layout=True)
    whole.plot(result.time, result.load_angle, color="black")
    whole.axhline(reference, color="0.5", linestyle=":", linewidth=0.8)
    whole.set_ylabel("load, rad")
    whole.set_title(title, loc="left")
    near.axhspan(-0.5, 0.5, color="0.92", zorder=0)
    near.plot(result.time, (result.load_angle - reference) / b, color="black", linewidth=1.0)
    near.set(ylim=(-1.5, 1.5), ylabel="load from target, b")
    teeth.plot(result.time, result.gap(drive) / drive.gear.backlash, color="C0", linewidth=1.0)
    for flank in (-0.5, 0.5):
        teeth.axhline(flank, color="0.5", linestyle=":", linewidth=0.8)
    teeth.set_ylabel("teeth in gap, b")
    command.step(result.time[: result.command.size], result.command, where="post", color="C2", linewidth=1.0)
    command.set(ylabel=f"command, {drive.command_unit}", xlabel="time after the step, s")
    for axes in (whole, near, teeth, command):
        axes.grid(alpha=0.3)
        axes.set_xlim(0.0, result.time[-1])
    figure.savefig(path, dpi=110)
    plt.close(figure)
