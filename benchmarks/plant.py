"""How fast is the plant? Against a fixed-step RK4 in C and against scipy, at equal error of the load angle.

Run with `make bench`; the scenarios stand in `scenarios.py`. Figures are times real time.

The error is the largest of the load angle, over all samples against the exact loop in `plant.c` at 1 us, which finds
where the equations change, and over the first 2 s against scipy's Radau with rtol 1e-12, on equations written down
once more (`radau.py`). scipy's methods play these 2 s only.

Everybody has the loosest setting that meets the error and whose next finer one meets it, too, for the error of a limit
cycle goes up and down. From one setting to the next the error changes by about a quarter: the C loop has 5 % more
steps, ours and scipy's methods a tolerance of which there are ten per decade. The C loop has steps of 1 us at the
least; where that misses the error it is timed there, and the row says so.

Both of a row play the same stretch in turn, many times: counted is the shortest time of each stretch.
What is said of a missed goal counts evaluations of the package's own equations, timed one after another.
"""

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np
from players import Start, by_scipy, compile_loops, in_c, ours, whole
from radau import by_radau
from rows import Row, record
from scenarios import COUNT, PERIOD, Play, plays

from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.motion.dynamics import SLIDES, Acting, equations_of
from backlash_ros.drivetrain.motion.integrator import DEFAULT_TOLERANCE
from backlash_ros.foundation.record import Array

SECOND, SHORT = 250, 500
FINEST = 4000
PASSES, PARTS = 15, 5
SHORT_PARTS = 3
TOLERANCES = tuple(10.0 ** (-0.1 * k) for k in range(20, 128))
C_LOOP = "C loop, RK4, at its largest step"

Found = tuple[Any, float]
"""A setting, and its error in rad."""


def step_counts() -> list[int]:
    """Return steps a sample, each about 5 % more than the one before."""
    steps = [1]
    while steps[-1] < FINEST:
        steps.append(min(FINEST, max(steps[-1] + 1, round(1.05 * steps[-1]))))
    return steps


def loosest(
    settings: Sequence[Any], make: Callable[[Any], Start], error_of: Callable[[Start], float], wanted: float
) -> Found | None:
    """Return the first setting that meets the error and whose next does, too; None where there is none."""
    met: Found | None = None
    for setting in settings:
        error = error_of(make(setting))
        if error > wanted:
            met = None
        elif met is not None:
            return met
        else:
            met = setting, error
    return None


def error_against(play: Play, *exact: Array) -> Callable[[Start], float]:
    """Return what tells the largest error of the load angle, rad, against runs that need not be of the same length."""
    count = max(angles.size for angles in exact)

    def error_of(start: Start) -> float:
        try:
            played = whole(start, play, count)
        except FloatingPointError:
            return math.inf
        error = np.max([np.max(np.abs(played[: angles.size] - angles)) for angles in exact])
        return float(error) if np.isfinite(error) else math.inf

    return error_of


def in_turns(play: Play, starts: tuple[Start, Start], count: int, passes: int, parts: int) -> tuple[Array, Array]:
    """Return times real time of both over the run, and their ratio in each part of the passes."""
    times = np.empty((passes, 2, count // SECOND))
    out = np.empty(SECOND)
    for turn in times:
        stretches = [start() for start in starts]
        for second in range(count // SECOND):
            feed = play.feed[second * SECOND : (second + 1) * SECOND]
            for who, stretch in enumerate(stretches):
                began = time.perf_counter()
                stretch(feed, out)
                turn[who, second] = time.perf_counter() - began
    simulated = PERIOD * count
    each = [part.min(axis=0).sum(axis=1) for part in np.split(times, parts)]
    return simulated / times.min(axis=0).sum(axis=1), np.array([b / a for a, b in each])


@numba.njit
def _evaluate(motion, plant, count):  # type: ignore[no-untyped-def]
    gap = gap_rate = theta_l = omega_m = omega_l = current = 0.0
    for _ in range(count):
        acting = Acting(1.0, 0.0, SLIDES, SLIDES)
        a, b, d, _, _ = motion(plant, gap, gap_rate, theta_l, omega_m, omega_l, current, acting)
        gap, gap_rate = gap + 1e-6 * gap_rate, gap_rate + 1e-6 * (plant.R1 * a - plant.R2 * b)
        theta_l += 1e-6 * omega_l
        omega_m, omega_l, current = omega_m + 1e-6 * a, omega_l + 1e-6 * b, current + 1e-6 * d
    return theta_l


def evaluation_time(play: Play) -> float:
    """Return how long one evaluation of the package's equations of motion takes after another, s."""
    motion, plant, count, times = equations_of(play.drive).motion, plant_constants(play.drive), 100_000, []
    _evaluate(motion, plant, 1)
    for _ in range(20):
        began = time.perf_counter()
        _evaluate(motion, plant, count)
        times.append((time.perf_counter() - began) / count)
    return min(times)


def row(
    play: Play, what: str, against: str, measured: tuple[Array, Array], error: float, goal: str, spent: float
) -> Row:
    """Return the row of a measurement, and, where its goal is missed, how little time the goal leaves.

    ``spent`` are the evaluations of the equations that the other takes for a sample.
    """
    (mine, theirs), ratios = measured
    ratio, wanted, limit = float(mine / theirs), float(goal.split()[1]), None
    if ratio < wanted:
        each, taken, left = evaluation_time(play), PERIOD / mine, PERIOD / theirs / wanted
        limit = (
            f"theirs takes {1e9 * PERIOD / theirs:.0f} ns per sample, for {spent:.0f} evaluations of the equations. To "
            f"meet the goal, ours may take {1e9 * left:.0f} ns, the time of {left / each:.1f} evaluations at "
            f"{1e9 * each:.0f} ns; it takes {1e9 * taken:.0f} ns, the time of {taken / each:.1f}"
        )
    spread = float(min(ratio, *ratios)), float(max(ratio, *ratios))
    return Row(what, float(mine), against, float(theirs), ratio, spread, error, goal, limit)


def unmeasured(what: str, against: str, goal: str, why: str) -> Row:
    """Return the row of what could not be measured."""
    return Row(what, None, against, None, None, None, None, goal, why)


def title(name: str, wanted: float | None) -> str:
    """Return the name of a row."""
    return f"plant, {name}, " + ("at the default tolerance" if wanted is None else f"error <= {wanted:g} rad")


def against_c(loop: Any, play: Play, exact: tuple[Array, ...], wanted: float | None, goal: str) -> Row:
    """Measure one scenario against the C loop; at our default tolerance and its error where none is ``wanted``."""
    error_of, what = error_against(play, *exact), title(play.name, wanted)
    if wanted is None:
        mine: Found | None = (DEFAULT_TOLERANCE, error_of(ours(play, DEFAULT_TOLERANCE)))
        wanted = mine[1]
    else:
        mine = loosest(TOLERANCES, partial(ours, play), error_of, wanted)
    theirs, against = loosest(step_counts(), partial(in_c, loop, play), error_of, wanted), C_LOOP
    if theirs is None:
        theirs = FINEST, error_of(in_c(loop, play, FINEST))
        against = "C loop, RK4, at 1 us, which misses the error" if theirs[1] > wanted else C_LOOP
    print(f"{what}: ours (tolerance, error) {mine}, C (steps, error) {theirs}", flush=True)
    if mine is None:
        return unmeasured(what, against, goal, "ours does not meet the error")
    starts = ours(play, mine[0]), in_c(loop, play, theirs[0])
    return row(play, what, against, in_turns(play, starts, COUNT, PASSES, PARTS), mine[1], goal, 4.0 * theirs[0])


def against_scipy(play: Play, method: str, exact: Array, wanted: float, goal: str) -> Row:
    """Measure the first 2 s of a scenario against a method of scipy."""
    what = title(f"{play.name}, first 2 s", wanted)
    against, error_of = f"scipy {method}, compiled right-hand side", error_against(play, exact)
    mine = loosest(TOLERANCES, partial(ours, play), error_of, wanted)
    theirs = loosest(TOLERANCES, partial(by_scipy, play, method), error_of, wanted)
    print(f"{what}, {method}: ours (tolerance, error) {mine}, scipy (rtol, error) {theirs}", flush=True)
    if mine is None or theirs is None:
        return unmeasured(what, against, goal, f"{'ours' if mine is None else method} does not meet the error")
    starts = ours(play, mine[0]), by_scipy(play, method, theirs[0])
    measured = in_turns(play, starts, SHORT, SHORT_PARTS, SHORT_PARTS)
    spent: list[int] = []
    whole(by_scipy(play, method, theirs[0], spent), play, SHORT)
    return row(play, what, against, measured, mine[1], goal, sum(spent) / SHORT)


GOALS = (
    ("nominal limit cycle", 1e-6, ">= 6"),
    ("nominal limit cycle", 1e-8, ">= 12"),
    ("nominal limit cycle", None, ">= 10"),
    ("free flight and slow motion", 1e-6, ">= 20"),
    ("stiff teeth, exponent 51", 1e-6, ">= 3"),
    ("elastic contact", 1e-4, ">= 3"),
    ("elastic contact", 1e-6, ">= 3"),
    ("with friction", 1e-6, ">= 3"),
)


def all_against_c(made: dict[str, Play], radau: dict[str, Array]) -> list[Row]:
    """Measure all goals against the C loop."""
    with tempfile.TemporaryDirectory() as folder:
        library = compile_loops(Path(folder))
        if library is None:
            return [
                unmeasured(title(name, wanted), C_LOOP, goal, "no C compiler was found") for name, wanted, goal in GOALS
            ]
        exact = {
            name: (whole(in_c(library.exact_loop, play, FINEST), play), radau[name]) for name, play in made.items()
        }
        for name, (by_loop, checked) in exact.items():
            print(f"{name}: C at 1 us and Radau are {np.max(np.abs(by_loop[:SHORT] - checked)):.1e} rad apart")
        return [against_c(library.loop, made[name], exact[name], wanted, goal) for name, wanted, goal in GOALS]


def main() -> None:
    """Measure, print and write."""
    made = plays()
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        radau = dict(zip(made, pool.map(partial(by_radau, count=SHORT), made), strict=True))
    rows = all_against_c(made, radau)
    name = GOALS[0][0]
    record(rows + [against_scipy(made[name], method, radau[name], 1e-6, ">= 1000") for method in ("LSODA", "DOP853")])


if __name__ == "__main__":
    main()
