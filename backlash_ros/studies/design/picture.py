"""The picture of a design: the load near its targets on every drive of the range, before and after."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from backlash_ros.drivetrain import IntegrationError
from backlash_ros.studies.design.search import Design
from backlash_ros.studies.design.trial import simulate, targets_of
from backlash_ros.studies.metrics import SETTLED

_SHOWN = 4.0
"""Of each step, s."""


def draw(design: Design, path: Path) -> None:
    """Draw it; a drive that cannot be simulated is left out."""
    loop = design.loop
    targets = targets_of(loop)
    titles = "step of 1 rad", "step of 5 b"
    figure, panels = plt.subplots(2, 2, figsize=(11, 7), sharex=True, sharey=True, constrained_layout=True)
    rows = (("default", design.default, design.default_outcomes), ("designed", design.choice, design.outcomes))
    for (name, choice, outcomes), row in zip(rows, panels, strict=True):
        for number, (case, _) in reversed(list(enumerate(outcomes))):
            try:
                done = simulate(loop, choice, case)
            except IntegrationError:
                continue
            held, b = (done.time.size - 1) // len(targets), case.drive.gear.backlash_angle
            style = {"color": "0.65", "linewidth": 0.7} if number else {"color": "black", "linewidth": 1.4}
            for k, (axes, target) in enumerate(zip(row, targets, strict=True)):
                part = slice(k * held, (k + 1) * held + 1)
                error = (done.load_angle[part] - target) / b
                axes.plot(done.time[part] - done.time[k * held], error, **style)
        gains = choice.gains
        row[0].set_ylabel("error over the gap")
        for axes, title in zip(row, titles, strict=True):
            axes.axhspan(-SETTLED, SETTLED, color="C0", alpha=0.12, zorder=0)
            axes.set(title=f"{name}, {title}", xlim=(0, _SHOWN), ylim=(-1.5, 1.5))
            axes.grid(alpha=0.3)
        text = f"k = [{gains.position:.3g}, {gains.velocity:.3g}, {gains.current:.3g}], width {choice.width:.2g} b"
        row[1].text(0.98, 0.05, text, transform=row[1].transAxes, ha="right", fontsize="small")
    for axes in panels[1]:
        axes.set_xlabel("time, s (black: as described; grey: the range; blue: within b/4)")
    figure.savefig(path, dpi=110)
    plt.close(figure)
