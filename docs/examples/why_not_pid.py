"""Steps of one axis with a PID, with a PID and a dead band, and with the laws of this package: prints a table.

The PID is the one of servo drives: P on the load's position, PI on the motor's speed. Its gains are searched on a grid.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from backlash_ros.control import GainSet, ServoSettings
from backlash_ros.control.laws.cascade import CascadeParameters
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.simulation import Scenario, run
from backlash_ros.studies.metrics import StepFigures, count_impacts, step_figures

STEPS = (0.2, 0.5, 0.8, 1.0, 1.3)
"""Steps from rest, rad; of each figure the worst counts."""
SENSORS = Sensors(measured=POSITIONS, motor_counts=2.0**12, load_counts=2.0**16)
POSITION, SPEED = (5.0, 8.0, 12.0, 18.0, 25.0, 35.0, 50.0), (20.0, 40.0, 80.0, 160.0)
"""Bandwidths of the PID's loops that are tried, rad/s."""
DEAD_BANDS = (0.1, 0.25, 0.5)
"""Dead bands that are tried: errors, of either sign, that are ignored, b."""
NO_GAP = (25.0, 100.0)
"""Those with which it is as fast as the fast gains, on a gear without backlash."""
QUIET, OVER = 0.05, 0.5
"""Largest swing of a load at rest, and largest overshoot of a PID that counts as tuned, b."""


def step(drive: Drive, settings: ServoSettings, target: float) -> tuple[StepFigures, int]:
    """Simulate a step of 4 s and return its figures, in s and b, and how often the teeth met near the target."""
    b = drive.gear.backlash_angle
    done = run(drive, settings, Scenario(np.full(1000, target), sensors=SENSORS))
    found = step_figures(done.time, done.load_angle, target, b / 4)
    arrived = int(np.argmax(np.abs(done.load_angle - target) < b))
    figures = replace(found, overshoot=found.overshoot / b, swing=found.swing / b, error=found.error / b)
    return figures, count_impacts(done.gap[arrived:], drive.gear.backlash)


def settings_of(drive: Drive, law: str, *pid: float) -> ServoSettings:
    """Return the settings of a law, which knows the drive; ``pid``: two bandwidths and the dead band of the PID, b."""
    given = (("cascade", CascadeParameters(*pid)),) if pid else ()
    gains, b = GainSet.of(drive), drive.gear.backlash_angle
    return ServoSettings(gains, law=law, law_parameters=given, backlash_angle=b, identified=True)


def slowest(drive: Drive, pid: tuple[float, ...]) -> float:
    """Return after which time the slowest step of a PID has settled, s; infinite if one is not as it should."""
    worst = 0.0
    for target in STEPS:
        found, _ = step(drive, settings_of(drive, "cascade", *pid), target)
        worst = max(worst, found.settling if found.swing < QUIET and found.overshoot < OVER else math.inf)
        if math.isinf(worst):
            break
    return worst


def tuned(drive: Drive, *dead_bands: float) -> tuple[float, ...]:
    """Return the bandwidths and the dead band with which the slowest step settles first."""
    return min(product(POSITION, SPEED, dead_bands), key=lambda pid: slowest(drive, pid))


def row(name: str, drive: Drive, settings: ServoSettings) -> str:
    """Return a line of the table: the worst of the steps."""
    figures, impacts = zip(*(step(drive, settings, target) for target in STEPS), strict=True)
    rise, settled = (max(getattr(each, what) for each in figures) for what in ("rise", "settling"))
    over, swing = (max(getattr(each, what) for each in figures) for what in ("overshoot", "swing"))
    off = max(abs(each.error) for each in figures)
    shown = "never" if math.isinf(settled) else f"{settled:.2f}"
    return f"  {name:34} {rise:8.3f} {shown:>10} {over:7.2f} {off:6.2f} {swing:6.2f} {max(impacts):8}"


def draw(path: str, drive: Drive) -> None:
    """Draw the load near its target, before and after: a PID tuned without a gap, and the law of planned moves."""
    import matplotlib.pyplot as plt  # noqa: PLC0415 - takes a second

    b = drive.gear.backlash_angle
    before, after = settings_of(drive, "cascade", *NO_GAP, 0.0), settings_of(drive, "planned")
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 2.7), sharey=True, layout="constrained")
    cases = (
        ("before: a PID, fast", before, "C1"),
        ("after: gap learned, drive identified", after, "C2"),
    )
    for axes, (title, settings, colour) in zip(panels, cases, strict=True):
        done = run(drive, settings, Scenario(np.full(500, 1.0), sensors=SENSORS))
        axes.axhspan(-0.5, 0.5, color="0.92")
        axes.plot(done.time, (done.load_angle - 1.0) / b, color=colour, linewidth=1.4)
        axes.set(title=title, xlabel="time after a step of 1 rad, s", xlim=(0.0, 2.0), ylim=(-1.2, 1.2))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("load from target, gaps")
    panels[1].text(1.97, -0.45, "grey: as wide as the gap", ha="right", color="0.35", fontsize=9)
    figure.savefig(path, dpi=110)


def main(words: Sequence[str] | None = None) -> None:
    """Tune on the nominal drive, and print how it does there and with four times the load inertia."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", metavar="FILE", help="also draw the load before and after, such as before_after.png")
    given = parser.parse_args(words)
    heavy = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, inertia=4.0 * NOMINAL_DRIVE.load.inertia))
    plain, banded = tuned(NOMINAL_DRIVE, 0.0), tuned(NOMINAL_DRIVE, *DEAD_BANDS)
    laws = (
        ("PID, tuned without a gap", "cascade", (*NO_GAP, 0.0)),
        ("PID, tuned on it", "cascade", plain),
        ("PID with a dead band, tuned on it", "cascade", banded),
        ("law two_region", "two_region", ()),
        ("law planned", "planned", ()),
    )
    for pid in (plain, banded):
        print("tuned: {:g} rad/s for the position, {:g} rad/s for the speed, dead band {:g} b".format(*pid))
    print(f"{'':36} {'rise, s':>8} {'settled, s':>10} {'over/b':>7} {'off/b':>6} {'rest/b':>6} {'impacts':>8}")
    for title, drive in (("nominal drive:", NOMINAL_DRIVE), ("4 times the load inertia:", heavy)):
        print(title)
        for name, law, pid in laws:
            print(row(name, drive, settings_of(drive, law, *pid)))
    if given.plot:
        draw(given.plot, NOMINAL_DRIVE)


if __name__ == "__main__":
    main()
