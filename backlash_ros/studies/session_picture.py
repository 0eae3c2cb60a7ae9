"""The picture of a recorded session: steps under the paper's laws and ours, and load steps."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from backlash_ros.drivetrain import Drive
from backlash_ros.recordings.bag import Recording
from backlash_ros.studies.session import COMPARED, LABELS, Interval, judge_step

_LINES: dict[str, Any] = {
    "fast": {"color": "C1", "linewidth": 0.9},
    "overdamped": {"color": "C0", "linewidth": 1.6, "linestyle": "-."},
    "two_region": {"color": "black", "linewidth": 1.8, "linestyle": "--"},
    "planned": {"color": "C2", "linewidth": 2.6},
}
_SHOWN, _RISE, _LOADED = (2.5, 4.0), 0.4, 1.0
"""Times that are shown, s: of a step near its target, by part; of a whole step; after a load torque."""


def plot_session(
    parts: Sequence[tuple[Recording, Mapping[str, Interval], str]],
    loads: Mapping[str, Interval],
    drive: Drive,
    path: Path,
) -> None:
    """Draw steps and load steps; write ``path`` (PNG).

    ``parts``: recordings, the intervals of the steps by law, and titles: first the nominal drive's, which has the load
    steps ``loads``, then another one's.
    """
    figure = plt.figure(figsize=(9, 10), constrained_layout=True)
    *near, whole, loaded = figure.subplot_mosaic("nn;hh;wl", height_ratios=[1.4, 1.1, 1]).values()
    for axes, (recording, steps, title), seconds in zip(near, parts, _SHOWN, strict=True):
        for law, interval in steps.items():
            swing = judge_step(recording, interval, drive)["residual"]
            _draw_error(axes, recording, interval, seconds, law, drive, f": {swing:.2f} b")
        axes.set_title(title, loc="left")
        axes.legend(loc="lower right", title="swing in the last second")
        axes.set(ylim=(-1.2, 0.7), xlabel="time after the step, s")
    nominal, steps, _ = parts[0]
    for law, interval in steps.items():
        part = nominal.joint_states.between(interval.start, interval.start + _RISE)
        whole.plot(part.time - interval.start, part.values[:, 3], **_LINES[law])
    whole.set(xlim=(0, _RISE), xlabel="time after the step, s", ylabel="load, rad")
    whole.set_title("The first steps, whole", loc="left")
    for law in COMPARED:
        _draw_error(loaded, nominal, loads[law], _LOADED, law, drive)
    loaded.set_title("A load torque comes on", loc="left")
    loaded.set_xlabel("time after the load torque, s")
    for axes in (*near, loaded):
        axes.axhspan(-0.5, 0.5, color="0.92", zorder=0)
        axes.set_ylabel("load from target, b")
    near[0].text(0.99 * _SHOWN[0], 0.52, "grey: as wide as the gap", va="bottom", ha="right", color="0.35")
    for axes in (*near, whole, loaded):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_error(
    axes: Axes, recording: Recording, interval: Interval, seconds: float, law: str, drive: Drive, remark: str = ""
) -> None:
    part = recording.joint_states.between(interval.start, interval.start + seconds)
    error = (part.values[:, 3] - interval.target) / drive.gear.backlash_angle
    axes.plot(part.time - interval.start, error, label=LABELS[law] + remark, **_LINES[law])
    axes.set_xlim(0, seconds)
