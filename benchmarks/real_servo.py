"""How well is a real servo identified from its one encoder? Half of the public recordings are fitted, half predicted.

The recordings are those of github.com/kscalelabs/sysid, commit 6b78737, folder
data/feetech/STS_3215_12V_20250317/processed: 476 runs of a Feetech STS3215 that swings a pendulum. They have no
licence, so this package does not contain them. Every second run, in the order of their names, is fitted. Each of the
others is simulated from its first angle and the servo's commands (goal, gain, supply, on or off), and compared.
"""

import argparse
import json
import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from output_error import ServoFit, fit_servo, mean_errors, refit
from position_servo import PositionServo, ServoRun, simulate
from servo_gap import FOLDS, ServoGap, judge_gap

from backlash_ros.foundation.quantity import quantities

ERROR_GAIN, LARGEST_DUTY, GRAVITY = 0.165, 0.97, 9.80665
"""Duty for each unit of the firmware's gain and each rad, and at which it clips, as the authors measured; m/s^2."""
WEIGHTS = 2.468e-3
"""Square of the weights' radius of gyration, m^2."""
ARMS = {0.1: (6.45e-5, 1.79e-3), 0.15: (3.20e-4, 3.73e-3)}
"""Inertia, kg m^2, and mass by distance, kg m, of the arm by the pendulum's length, m. These three are from
feetech/sts3215-12v/configs of a later commit of the authors, f4739df."""
DATA_SHEET = PositionServo(torque_per_volt=0.245, back_emf=2.5, inertia=0.02)
"""Where the search starts: 30 kg cm at standstill and 45 turns a minute at 12 V; the inertia is a guess."""
RIGID = (
    "torque_per_volt",
    "back_emf",
    "inertia",
    "viscous_friction",
    "coulomb_friction",
    "gravity_offset",
)
LADDER: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rigid, viscous and Coulomb friction", ()),
    ("+ delay", ("delay",)),
    ("+ the goal's speed limit", ("speed_limit",)),
    ("+ start duty", ("start_duty",)),
    ("+ friction by the motor's torque", ("motor_share",)),
    ("+ friction by the weight", ("weight_share",)),
    ("+ Stribeck friction", ("stribeck_friction", "stribeck_speed")),
)
GOAL = 0.031
BEGIN, END = "<!-- measured: begin -->\n", "<!-- measured: end -->\n"
EXAMPLE = """example:
  git clone https://github.com/kscalelabs/sysid && git -C sysid checkout 6b78737
  python benchmarks/real_servo.py sysid/data/feetech/STS_3215_12V_20250317/processed
about twenty minutes on one core"""


class Recorded(NamedTuple):
    """A run, how it is labelled, and the duty that the servo itself reported, which is not used for the fit."""

    run: ServoRun
    kind: str
    gain: int
    mass: float
    length: float
    duty: np.ndarray


def read(path: Path) -> Recorded:
    """Read one recording."""
    recorded = json.loads(path.read_text())
    columns = {
        name: np.array([float(entry[name]) for entry in recorded["entries"]])
        for name in ("timestamp", "position", "goal_position", "torque_enable", "input_volts", "torque")
    }
    mass, length = recorded["mass"], recorded["length"]
    inertia, moment = ARMS[length]
    run = ServoRun(
        time=columns["timestamp"],
        angle=columns["position"],
        goal=columns["goal_position"],
        enabled=columns["torque_enable"],
        supply=np.full(columns["timestamp"].size, np.median(columns["input_volts"])),  # single readings are wrong
        gain=ERROR_GAIN * recorded["kp"],
        largest_duty=LARGEST_DUTY,
        load_inertia=mass * (length**2 + WEIGHTS) + inertia,
        weight_torque=GRAVITY * (mass * length + moment),
    )
    # In tenths of a per cent of 10; 1024 more of them stand for the positive sign.
    reported = columns["torque"]
    duty = np.where(reported > 10.235, reported - 10.24, -reported) / 10.0
    return Recorded(run, recorded["trajectory"], int(recorded["kp"]), float(recorded["mass"]), float(length), duty)


def say(text: str) -> None:
    """Tell on the standard error how far it is."""
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


def left_out(runs: Sequence[ServoRun], fit: ServoFit, group: Sequence[Any]) -> np.ndarray:
    """Return each run's error by a fit to the runs of other groups."""
    errors = np.empty(len(runs))
    for value in sorted(set(group)):
        kept = [run for run, other in zip(runs, group, strict=True) if other != value]
        left = [k for k, other in enumerate(group) if other == value]
        errors[left] = mean_errors(refit(kept, fit.servo, fit.free)[0], [runs[k] for k in left])
    return errors


class Rung(NamedTuple):
    """A model: its name, its fit, and mean errors of the fitted half by cross-validation and of the other half."""

    name: str
    fit: ServoFit
    crossed: float
    predicted: np.ndarray


def climb(fitted: Sequence[ServoRun], predicted: Sequence[ServoRun]) -> list[Rung]:
    """Fit one model after the other, each with one more term."""
    rungs, servo, free = [], DATA_SHEET, RIGID
    folds = [k % FOLDS for k in range(len(fitted))]
    for name, more in LADDER:
        free = (*free, *more)
        fit = fit_servo(fitted, servo, free)
        rungs.append(Rung(name, fit, float(np.mean(left_out(fitted, fit, folds))), mean_errors(fit.servo, predicted)))
        say(f"{name}: {np.mean(rungs[-1].predicted):.4f} rad")
        servo = fit.servo
    return rungs


def reported_limit(recordings: Sequence[Recorded]) -> np.ndarray:
    """Return how fast the goal travels inside the servo after a step, rad/s, from the duty that it reported."""
    speeds = []
    for recorded in recordings:
        run, duty = recorded.run, recorded.duty
        goal = run.angle + duty / run.gain
        steady = np.abs(np.gradient(duty)) < 0.1
        seen = (run.time > 0.5) & (run.time < 0.95) & (np.abs(duty) < 0.95) & (goal > 0.25) & (goal < 1.3) & steady
        if recorded.kind == "brutal" and np.count_nonzero(seen) > 8:
            speeds.append(np.polyfit(run.time[seen], goal[seen], 1)[0])
    return np.array(speeds)


def repeats(recordings: Sequence[Recorded]) -> np.ndarray:
    """Return the mean differences between two runs with the same motion, gain and load, rad."""
    groups: dict[tuple[Any, ...], list[np.ndarray]] = {}
    for recorded in recordings:
        label = (recorded.kind, recorded.gain, recorded.mass, recorded.length)
        groups.setdefault(label, []).append(recorded.run.angle)
    pairs = [group for group in groups.values() if len(group) == 2]
    sizes = [min(a.size, b.size) for a, b in pairs]
    return np.array([np.mean(np.abs(a[:n] - b[:n])) for (a, b), n in zip(pairs, sizes, strict=True)])


def ladder_table(rungs: Sequence[Rung], gaps: Sequence[tuple[str, ServoGap, float, float]]) -> list[str]:
    """Return the mean absolute errors of all models, as Markdown."""
    lines = [
        "| model | fitted half | fitted half, cross-validated | other half, predicted | all runs |",
        "|---|---|---|---|---|",
    ]
    for rung in rungs:
        fitted = rung.fit.errors
        everything = np.concatenate([fitted, rung.predicted])
        cells = (np.mean(fitted), rung.crossed, np.mean(rung.predicted), np.mean(everything))
        lines.append(f"| {rung.name} | {' | '.join(f'{cell:.4f}' for cell in cells)} |")
    for name, gap, predicted, everything in gaps:
        cells = (float(np.mean(gap.fit.errors)), gap.beside, predicted, everything)
        lines.append(f"| {name} | {' | '.join(f'{cell:.4f}' for cell in cells)} |")
    return lines


def parameter_table(fit: ServoFit) -> list[str]:
    """Return the parameters with their uncertainties, as Markdown."""
    lines = ["| parameter | value | standard uncertainty | unit | |", "|---|---|---|---|---|"]
    for name in fit.free:
        described, value = quantities(PositionServo)[name], getattr(fit.servo, name)
        told = [f"{value:.4g}", f"{fit.uncertainty[name]:.1g}"] if name not in fit.untold else ["not determined", ""]
        note = fit.untold.get(name, described.description)
        lines.append(f"| `{name}` | {' | '.join(told)} | {described.unit} | {note} |")
    return lines


def group_table(
    recordings: Sequence[Recorded], half: Sequence[Recorded], first: Rung, best: Rung, title: str
) -> list[str]:
    """Return errors by group: of the other half, and where the whole group was left out of the fit, as Markdown."""
    labels: tuple[tuple[str, Callable[[Recorded], Any], bool], ...] = (
        ("motion", lambda r: r.kind, True),
        ("length, m", lambda r: r.length, True),
        ("mass, kg", lambda r: round(r.mass, 3), False),
        ("gain", lambda r: r.gain, False),
    )
    runs = [recorded.run for recorded in recordings]
    lines = [
        f"| runs | {first.name} | {title} | {title}, fitted to all runs with another motion or length |",
        "|---|---|---|---|",
    ]
    for name, label, apart in labels:
        everyone, others = np.array([label(r) for r in recordings]), np.array([label(r) for r in half])
        errors = left_out(runs, best.fit, everyone.tolist()) if apart else None
        for value in sorted(set(everyone.tolist())):
            cells = [f"{np.mean(rung.predicted[others == value]):.4f}" for rung in (first, best)]
            cells.append("" if errors is None else f"{np.mean(errors[everyone == value]):.4f}")
            lines.append(f"| {name} {value} | {' | '.join(cells)} |")
        if errors is not None:
            say(f"each {name} predicted from the others: {np.mean(errors):.4f} rad")
            lines.append(f"| all of them |  |  | {np.mean(errors):.4f} |")
    return lines


def draw(path: Path, half: Sequence[Recorded], rigid: Rung, best: Rung) -> None:
    """Draw the run of median error of three motions, from the half that was not fitted."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(2, 3, figsize=(12, 5.2), sharex="col", height_ratios=(3, 1.3), layout="constrained")
    for column, kind in enumerate(("brutal", "lift_and_drop", "sin_time_square")):
        places = [k for k, recorded in enumerate(half) if recorded.kind == kind]
        place = sorted(places, key=lambda k: float(best.predicted[k]))[len(places) // 2]
        recorded = half[place]
        run = recorded.run
        upper, lower = axes[0, column], axes[1, column]
        upper.plot(run.time, run.goal, color="0.6", lw=1, label="goal")
        upper.plot(run.time, run.angle, color="black", lw=1.6, label="measured")
        for rung, colour, label in ((rigid, "tab:orange", "rigid"), (best, "tab:blue", "all terms")):
            angle = simulate(rung.fit.servo, [run])[0]
            upper.plot(run.time, angle, color=colour, lw=1, label=label)
            lower.plot(run.time, angle - run.angle, color=colour, lw=0.8)
        upper.set_title(f"{kind}, gain {recorded.gain}, {recorded.mass:.2f} kg at {recorded.length:g} m", fontsize=10)
        lower.set_ylim(-0.2, 0.2)
        lower.set_xlabel("time, s")
        lower.grid(alpha=0.3)
        upper.grid(alpha=0.3)
    axes[0, 0].set_ylabel("angle, rad")
    axes[1, 0].set_ylabel("error, rad")
    axes[0, 0].legend(fontsize=8)
    figure.savefig(path, dpi=80)
    say(f"wrote {path}")


def report(recordings: Sequence[Recorded], figure: Path | None) -> str:
    """Fit, predict, and return what came out, as Markdown."""
    half, other = recordings[::2], recordings[1::2]
    fitted, predicted = [recorded.run for recorded in half], [recorded.run for recorded in other]
    rungs = climb(fitted, predicted)
    best = min(rungs, key=lambda rung: rung.crossed)
    gaps = []
    title = "all terms" if best is rungs[-1] else f"all terms to {best.name!r}"
    for rung, called in ((rungs[0], rungs[0].name), (best, title)):
        gap = judge_gap(fitted, rung.fit)
        out = mean_errors(gap.fit.servo, predicted)
        everything = np.concatenate([gap.fit.errors, out])
        gaps.append((f"{called}, and a gap", gap, float(np.mean(out)), float(np.mean(everything))))
        say(f"gap beside {called}: {gap.reason}")
    if figure is not None:
        draw(figure, other, rungs[0], best)
    spread, limits = repeats(recordings), reported_limit(half)
    error = float(np.mean(np.concatenate([best.fit.errors, best.predicted])))
    worst = max(range(len(other)), key=lambda k: float(best.predicted[k]))
    lines = [
        f"{len(recordings)} runs, {len(half)} fitted. Mean absolute error of the angle, rad, mean over runs:",
        "",
        *ladder_table(rungs, gaps),
        "",
        f"Goal over all runs: {GOAL} rad. {'Met' if error <= GOAL else 'Missed'}: {error:.4f} rad with the model that "
        f"predicts best in cross-validation, {title}. "
        f"Of the runs that were not fitted, {100 * np.mean(best.predicted <= GOAL):.1f} % are within it; the largest "
        f"error of a run is {best.predicted[worst]:.4f} rad "
        f"({other[worst].kind}, gain {other[worst].gain}, {other[worst].mass:.3f} kg at {other[worst].length:g} m).",
        "",
        f"Two runs with the same motion, gain and load differ by {np.mean(spread):.4f} rad ({spread.size} pairs), so "
        f"no free simulation can have a mean error below half of that, {0.5 * np.mean(spread):.4f} rad.",
        "",
        *parameter_table(best.fit),
        "",
    ]
    for name, gap, _, _ in gaps:
        verdict = f"{gap.angle:.3g} +- {gap.uncertainty:.1g} rad" if gap.valid else "refused"
        place = "" if gap.valid else f" (the fit put it at {gap.fit.servo.backlash_angle:.2g} rad)"
        lines += [f"Gap ({name}): {verdict}: {gap.reason}{place}.", ""]
    lines += [
        f"Speed limit of the goal from the duty that the servo reported, {limits.size} steps of the fitted half: "
        f"median {np.median(limits):.2f} rad/s, quartiles {np.quantile(limits, 0.25):.2f} to "
        f"{np.quantile(limits, 0.75):.2f}; fitted to the angles alone: {best.fit.servo.speed_limit:.2f}.",
        "",
        *group_table(recordings, other, rungs[0], best, title),
        "",
    ]
    return "\n".join(lines)


def fill(page: Path, text: str) -> None:
    """Write ``text`` between the marks of a page."""
    pattern = re.compile(f"({re.escape(BEGIN)}).*({re.escape(END)})", re.DOTALL)
    old = page.read_text()
    if not pattern.search(old):
        raise SystemExit(f"{page} has no lines {BEGIN.strip()} and {END.strip()}")
    page.write_text(pattern.sub(lambda match: f"{match[1]}\n{text}\n{match[2]}", old))


def main() -> None:
    """Fit, predict and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="with the recordings, sysid_*.json")
    parser.add_argument("--page", type=Path, help="write the tables between the marks of this page, too")
    parser.add_argument("--figure", type=Path, help="draw three runs into this file")
    arguments = parser.parse_args()
    paths = sorted(arguments.folder.glob("sysid_*.json"))
    if len(paths) < 2 * FOLDS:
        parser.error(f"FOLDER must have >= {2 * FOLDS} files sysid_*.json, {arguments.folder} has {len(paths)}")
    say(f"{len(paths)} recordings")
    text = report([read(path) for path in paths], arguments.figure)
    print(text)
    if arguments.page is not None:
        fill(arguments.page, text)


if __name__ == "__main__":
    main()
