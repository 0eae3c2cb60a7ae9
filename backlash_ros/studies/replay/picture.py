"""The picture of a replay: recorded and replayed commands of each activation, and their difference."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from backlash_ros.studies.replay.again import Replayed


def draw(pairs: Sequence[tuple[Replayed, Replayed | None]], path: Path) -> None:
    """Draw both curves with the changes of parameters, and below the second minus the first."""
    figure, panels = plt.subplots(
        2, len(pairs), figsize=(max(9, 5 * len(pairs)), 6), sharex="col", squeeze=False, constrained_layout=True
    )
    for k, (done, other) in enumerate(pairs):
        above, below = panels[:, k]
        shown, name = (done, "replayed") if other is None else (other, "with what was set, open loop")
        above.step(done.time, done.recorded, where="post", color="black", linewidth=1.4, label="recorded")
        above.step(shown.time, shown.replayed, where="post", color="C1", linewidth=0.9, label=name)
        below.step(shown.time, shown.replayed - shown.recorded, where="post", color="C3", linewidth=0.9)
        above.set_title(f"activation {k + 1}" if len(pairs) > 1 else "Commands for the recorded samples")
        below.set_xlabel("time after the first sample, s")
        for axes in (above, below):
            axes.grid(alpha=0.3)
    panels[0, 0].set_ylabel(f"command, {pairs[0][0].unit}")
    panels[1, 0].set_ylabel(f"difference, {pairs[0][0].unit}")
    panels[0, 0].legend(loc="upper right", fontsize="small")
    figure.savefig(path, dpi=110)
    plt.close(figure)
