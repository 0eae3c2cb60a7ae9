"""The picture of a recorded session: three step responses and a load step."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from backlash_ros.analysis.bag import Recording
from backlash_ros.analysis.session import LABELS, Interval
from backlash_ros.drivetrain import Drive

_LINES = {"fast": ("C3", "--"), "overdamped": ("C0", "-."), "two_region": ("black", "-")}


def plot_session(
    recording: Recording, intervals: Mapping[str, Interval], load: Interval, drive: Drive, learned: float, path: Path
) -> None:
    """Draw the three step responses, whole and near the target, and the load step; write ``path`` (PNG)."""
    b = drive.gear.backlash_angle
    figure, (whole, near, loaded) = plt.subplots(3, 1, figsize=(8, 9.5), constrained_layout=True)
    for name, interval in intervals.items():
        part = recording.joint_states.between(interval.start, interval.end)
        color, line = _LINES[name]
        time = part.time - interval.start
        style = {"color": color, "linestyle": line, "label": LABELS[name], "linewidth": 1.2}
        whole.plot(time, part.values[:, 3], **style)
        near.plot(time, (part.values[:, 3] - interval.target) / b, **style)
    whole.set(
        xlim=(0, 2),
        xlabel="time after the step, s",
        ylabel="load angle, rad",
        title="Step of the reference, 0 to 1 rad",
    )
    whole.legend(loc="lower right")
    near.axhspan(-learned / b, learned / b, color="0.9", label="over-damped region (learned backlash)")
    near.set(xlim=(0, 2), ylim=(-1.3, 1.3), xlabel="time after the step, s", ylabel="error, in units of the backlash")
    near.set_title("The same, near the target")
    near.legend(loc="lower right", fontsize="small", ncols=2)
    part = recording.joint_states.between(load.start - 0.2, load.end)
    estimate = recording.scalars["/controller/state/load_torque"].between(load.start - 0.2, load.end)
    loaded.plot(part.time - load.start, (part.values[:, 3] - load.target) / b, color="black", label="error")
    loaded.set(xlim=(-0.2, 1.5), xlabel="time after the load torque, s", ylabel="error, in units of the backlash")
    loaded.set_title("A load torque comes on, two-region law")
    torque = loaded.twinx()
    torque.plot(estimate.time - load.start, estimate.values, "C0--", label="load torque estimate (right axis)")
    torque.set_ylabel("torque, N m")
    lines: Sequence[matplotlib.lines.Line2D] = [*loaded.get_lines(), *torque.get_lines()]
    loaded.legend(lines, [str(line.get_label()) for line in lines], loc="center right")
    for axes in (whole, near, loaded):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)
