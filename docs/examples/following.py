"""Paths that one axis follows with three laws, each told speed and acceleration: prints a table, and draws one of them.

The laws know the drive, as after learning and identifying; its load has dry friction, so that it rests where it is.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from backlash_ros.control import GainSet, Polynomials, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.simulation import Run, Scenario, run
from backlash_ros.studies.evaluation.motion import LEAD, PATHS, Path, sine
from backlash_ros.studies.metrics import count_impacts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FRICTION = 0.02 * NOMINAL_DRIVE.standstill_torque()
DRIVE = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, coulomb_friction=FRICTION))
SENSORS = Sensors(measured=POSITIONS, motor_counts=2.0**12, load_counts=2.0**16)
LAWS = {"cascade": "PID with feedforward", "two_region": "law two_region", "planned": "law planned"}
DRAWN = sine(0.5, 0.5)
RATE = 250.0
B = DRIVE.gear.backlash_angle


def followed(path: Path, law: str) -> Run:
    """Simulate a path."""
    settings = ServoSettings(GainSet.of(DRIVE), law=law, backlash_angle=B, identified=True)
    reference = np.zeros(round((LEAD + path.length) * RATE))
    return run(DRIVE, settings, Scenario(reference, sensors=SENSORS, source=Polynomials(path.rows(0.0))))


def row(path: Path, law: str) -> str:
    """Return a line of the table: errors in b, and how often the teeth met."""
    done = followed(path, law)
    judged = done.time[:-1] >= LEAD + path.judged
    error, gap, force = done.error[:-1][judged] / B, done.gap[:-1][judged], np.max(done.peak_force[judged])
    impacts = count_impacts(gap, DRIVE.gear.backlash)
    return f"  {LAWS[law]:22} {np.sqrt(np.mean(error**2)):8.3f} {np.max(np.abs(error)):10.3f} {impacts:8} {force:9.1f}"


def draw(name: str) -> None:
    """Draw the sine for the three laws: the path, the error, the tooth in its gap, and the motor's torque."""
    import matplotlib.pyplot as plt  # noqa: PLC0415 - takes a second

    from backlash_ros.simulation.colours import LIGHT  # noqa: PLC0415

    figure, panels = plt.subplots(
        4, 3, figsize=(9.0, 6.2), sharex=True, sharey="row", layout="constrained", height_ratios=(1.0, 1.2, 1.2, 1.0)
    )
    names = "load, rad", "error, b", "tooth in gap, b", "motor, N m"
    for axes, label in zip(panels[:, 0], names, strict=True):
        axes.set_ylabel(label)
    for column, law in zip(panels.T, LAWS, strict=True):
        done = followed(DRAWN, law)
        _column(column, done, LIGHT)
        column[0].set_title(LAWS[law])
        column[-1].set_xlabel("time, s")
    figure.savefig(name, dpi=110)


def _column(column: Sequence["Axes"], done: Run, colours: dict[str, str]) -> None:
    path, error, tooth, torque = column
    time = done.time - LEAD - DRAWN.judged
    load, motor = {"color": colours["load"], "linewidth": 1.3}, {"color": colours["motor"], "linewidth": 1.0}
    path.plot(time, done.load_angle, **load)
    path.plot(time[:-1], done.setpoint, color=colours["model"], linewidth=0.8, linestyle="--")
    error.plot(time[:-1], done.error[:-1] / B, **load)
    for flank in (-1, 1):
        tooth.axhspan(0.5 * flank, 0.8 * flank, color=colours["band"])
    tooth.plot(time, done.gap / DRIVE.gear.backlash, **motor)
    current = done.table()["current"][1]
    torque.plot(time[:-1], DRIVE.motor.torque_constant * current / DRIVE.gear.ratio, **motor)
    tooth.set(ylim=(-0.8, 0.8), yticks=(-0.5, 0.0, 0.5))
    for axes in column:
        axes.grid(alpha=0.3)
        axes.set_xlim(0.0, 2.0)


def main(words: Sequence[str] | None = None) -> None:
    """Print how the laws follow each path."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", metavar="FILE", help="also draw the sine of 0.5 Hz, such as following.png")
    given = parser.parse_args(words)
    print(f"{'':24} {'rms, b':>8} {'largest, b':>10} {'impacts':>8} {'teeth, N':>9}")
    for path in PATHS:
        print(f"{path.name}:")
        for law in LAWS:
            print(row(path, law))
    if given.plot:
        draw(given.plot)


if __name__ == "__main__":
    main()
