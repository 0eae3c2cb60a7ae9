"""How fast is the plant? Against a fixed-step RK4 in C and scipy's LSODA, at equal error of the load angle.

Run with `make bench`. Every scenario lasts 20 s, sampled at 4 ms, from rest in the middle of the gap:

- *nominal limit cycle*: the nominal drive, a step of 1 rad with the fast gains
- *free flight and slow motion*: the nominal drive, +-1 V, reversed every 2 s: the motor crosses the gap, then pushes
  the load slowly
- *stiff teeth*: as the limit cycle, the contact's exponent 51 in place of 21
- *elastic contact*: as the limit cycle, with the elastic contact at its defaults
- *friction*: as the limit cycle, with Coulomb friction on both sides, each 1 % of the stall torque at the output

The error is the largest of the load angle over all samples against `plant.c` at 1 us and, over the first 0.1 s, against
scipy's Radau with rtol 1e-12 on equations written down here once more (it takes a third of a second for each sample).
`plant.c` has the largest step that meets the error, a search from 4 ms down by 5 % at a time; ours has the loosest
tolerance that does, by half decades. Both play the same second in turn, many times: counted is the shortest time of
each second. Figures are times real time. With the elastic contact the C loop at 1 us is itself good to 1e-5 rad only,
for its steps go across the contact's kinks: so the error there is 1e-4 rad.

scipy's LSODA plays the first 2 s of the limit cycle on the compiled right-hand side, at the loosest rtol that
meets 1e-6 rad there against `plant.c` at 1 us, by decades; ours plays these 2 s, too. Without a compiler ours at
tolerance 1e-12 stands in for `plant.c` there.
"""

import ctypes
import math
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np
from rows import Row, record
from scipy.integrate import solve_ivp

from backlash_ros.control import design_gains
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.motion.dynamics import SLIDES, equations_of
from backlash_ros.drivetrain.motion.integrator import DONE, integration_memory, integrator_for
from backlash_ros.drivetrain.signals import CURRENT, OMEGA_L, THETA_L, Array, at_rest

PERIOD, COUNT, SECOND, CHECKED, SHORT = 0.004, 5000, 250, 25, 500
FINEST = 4000
PASSES, PARTS = 15, 5
SHORT_PARTS = 3
TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(4, 26))


@dataclass(frozen=True)
class Play:
    """A drive, and what commands it: ``feed`` (V) less ``gains`` times load angle, load speed and current."""

    name: str
    drive: Drive
    gains: Array
    feed: Array


def plays() -> dict[str, Play]:
    """Return the scenarios by name."""
    fast = design_gains("fast", NOMINAL_DRIVE, [1000.0, 1.0]).as_array()
    step, gear, motor = np.full(COUNT, fast[0]), NOMINAL_DRIVE.gear, NOMINAL_DRIVE.motor
    slow = np.where(np.arange(COUNT) // 500 % 2 == 0, 1.0, -1.0)
    stall = motor.torque_constant * motor.voltage_limit / motor.resistance
    stiff = replace(NOMINAL_DRIVE, gear=replace(gear, contact=replace(gear.contact, exponent=51)))
    elastic = replace(NOMINAL_DRIVE, gear=replace(gear, contact=CONTACTS["elastic"]()))
    rubbing = replace(
        NOMINAL_DRIVE,
        motor=replace(motor, coulomb_friction=0.01 * stall),
        load=replace(NOMINAL_DRIVE.load, coulomb_friction=0.01 * stall / gear.ratio),
    )
    made = (
        Play("nominal limit cycle", NOMINAL_DRIVE, fast, step),
        Play("free flight and slow motion", NOMINAL_DRIVE, np.zeros(3), slow),
        Play("stiff teeth, exponent 51", stiff, fast, step),
        Play("elastic contact", elastic, fast, step),
        Play("with friction", rubbing, fast, step),
    )
    return {play.name: play for play in made}


# Ours


@numba.njit
def _play(advance, plant, state, memory, gains, feed, limit, tolerance, out):  # type: ignore[no-untyped-def]
    status = 0
    for k in range(out.shape[0]):
        volts = feed[k] - gains[0] * state[2] - gains[1] * state[3] - gains[2] * state[4]
        status = max(status, advance(plant, state, memory, min(max(volts, -limit), limit), 0.0, PERIOD, tolerance)[0])
        out[k] = state[2]
    return status


Stretch = Callable[[Array, Array], None]
Start = Callable[[], Stretch]
"""Begins a run; what it returns plays on for a stretch of ``feed`` and writes the load angles."""


def ours(play: Play, tolerance: float) -> Start:
    """Return the package's integrator on a scenario."""
    advance, plant, limit = integrator_for(play.drive), plant_constants(play.drive), play.drive.motor.voltage_limit

    def start() -> Stretch:
        state, memory = at_rest(), integration_memory()

        def stretch(feed: Array, out: Array) -> None:
            if _play(advance, plant, state, memory, play.gains, feed, limit, tolerance, out) != DONE:
                raise RuntimeError(f"{play.name}: not integrated at tolerance {tolerance:g}")

        return stretch

    return start


# The C loop


class _Drive(ctypes.Structure):
    _names = "R L Km Jm Bm R1 R2 half Jl Bl rub_m rub_l limit c0 c1"
    _fields_ = [*((name, ctypes.c_double) for name in _names.split()), ("n", ctypes.c_int)]


def compile_loop(folder: Path) -> Any | None:
    """Return the function of `plant.c`, None where no compiler is found."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    made = folder / "plant.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", made, Path(__file__).with_name("plant.c"), "-lm"], check=True)
    return ctypes.CDLL(str(made)).loop


def _address(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def in_c(loop: Any, play: Play, steps: int) -> Start:
    """Return the C loop on a scenario, with ``steps`` for each sample."""
    p, gear = plant_constants(play.drive), play.drive.gear
    exponent = 0 if gear.contact.section == "contact.elastic" else int(p.contact[2])
    limit = play.drive.motor.voltage_limit
    numbers = (p.R, p.L, p.K_m, p.J_m, p.B_m, p.R1, p.R2, p.half_gap, p.J_l, p.B_l, p.coulomb_m, p.coulomb_l, limit)
    drive = _Drive(*numbers, p.contact[0], p.contact[1], exponent)

    def start() -> Stretch:
        state = np.zeros(5)

        def stretch(feed: Array, out: Array) -> None:
            loop(
                ctypes.byref(drive),
                _address(play.gains),
                _address(feed),
                len(out),
                ctypes.c_double(PERIOD),
                steps,
                _address(state),
                _address(out),
            )

        return stretch

    return start


def whole(start: Start, play: Play, count: int = COUNT) -> Array:
    """Return the load angle at the first ``count`` samples."""
    out = np.empty(count)
    start()(play.feed, out)
    return out


# scipy


@numba.njit
def _slope(plant, elastic, slip_m, slip_l, y, volts):  # type: ignore[no-untyped-def]
    """Return the equations of motion, written down once more, and what acts on shafts at rest, N m."""
    theta_m, omega_m, theta_l, omega_l, current = y
    gap, rate = plant.R1 * theta_m - plant.R2 * theta_l, plant.R1 * omega_m - plant.R2 * omega_l
    if elastic:
        side = 1.0 if gap > 0.0 else -1.0
        spring = plant.contact[0] * max(0.0, abs(gap) - plant.half_gap)
        force = side * (spring + min(max(side * plant.contact[1] * rate, -spring), spring))
    else:
        s, n = gap / plant.half_gap, int(plant.contact[2])
        force = plant.contact[0] * s**n + plant.contact[1] * rate * s ** (n + 1)
    on_motor, on_load = plant.K_m * current - plant.R1 * force, plant.R2 * force
    slope = np.zeros(5)
    slope[0], slope[2] = omega_m, omega_l
    if slip_m != 0.0:
        slope[1] = (on_motor - plant.B_m * omega_m - slip_m * plant.coulomb_m) / plant.J_m
    if slip_l != 0.0:
        slope[3] = (on_load - plant.B_l * omega_l - slip_l * plant.coulomb_l) / plant.J_l
    slope[4] = (volts - plant.R * current - plant.K_m * omega_m) / plant.L
    return slope, on_motor, on_load


def by_radau(name: str) -> Array:
    """Return the load angle at the first samples by scipy's Radau, stopped where friction switches."""
    play = plays()[name]
    p, limit = plant_constants(play.drive), play.drive.motor.voltage_limit
    elastic = play.drive.gear.contact.section == "contact.elastic"
    rubs = (p.coulomb_m, p.coulomb_l)
    state, slips, angles = np.zeros(5), [1.0, 1.0], []

    def slip(shaft: int, volts: float) -> float:
        if rubs[shaft] == 0.0:
            return 1.0
        if state[2 * shaft + 1] != 0.0:
            return math.copysign(1.0, state[2 * shaft + 1])
        torque = _slope(p, elastic, 0.0, 0.0, state, volts)[1 + shaft]
        return math.copysign(1.0, torque) if abs(torque) > rubs[shaft] else 0.0

    def event(shaft: int) -> Any:
        def left(_t: float, y: Array, volts: float) -> float:
            if slips[shaft]:
                return slips[shaft] * float(y[2 * shaft + 1])
            return rubs[shaft] - abs(_slope(p, elastic, 0.0, 0.0, y, volts)[1 + shaft])

        left.terminal, left.direction = True, -1.0  # type: ignore[attr-defined]
        return left

    def slope(_t: float, y: Array, volts: float) -> Array:
        moved: Array = _slope(p, elastic, slips[0], slips[1], y, volts)[0]
        return moved

    for k in range(CHECKED):
        volts = float(play.feed[k] - play.gains @ state[[THETA_L, OMEGA_L, CURRENT]])
        volts, now = min(max(volts, -limit), limit), 0.0
        slips = [slip(shaft, volts) for shaft in (0, 1)]
        watched = [shaft for shaft in (0, 1) if rubs[shaft]]
        while now < PERIOD:
            solved = solve_ivp(
                slope,
                (now, PERIOD),
                state,
                "Radau",
                args=(volts,),
                rtol=1e-12,
                atol=1e-13,
                events=[event(shaft) for shaft in watched] or None,
            )
            state, now = solved.y[:, -1], solved.t[-1]
            if solved.status != 1:
                break
            for shaft, times in zip(watched, solved.t_events, strict=True):
                if len(times) == 0:
                    continue
                if slips[shaft]:
                    state[2 * shaft + 1] = 0.0
                    slips[shaft] = slip(shaft, volts)
                else:
                    torque = _slope(p, elastic, 0.0, 0.0, state, volts)[1 + shaft]
                    slips[shaft] = math.copysign(1.0, torque)
        angles.append(state[THETA_L])
    return np.array(angles)


def by_scipy(play: Play, method: str, rtol: float) -> Start:
    """Return a method of scipy on the compiled right-hand side."""
    plant, limit = plant_constants(play.drive), play.drive.motor.voltage_limit
    derivative, slope, full = equations_of(play.drive).derivative, np.empty(7), np.zeros(7)

    def equations(_t: float, state: Array, volts: float) -> Array:
        full[:5] = state
        derivative(plant, full, volts, 0.0, SLIDES, SLIDES, slope)
        return slope[:5]

    def start() -> Stretch:
        held = [np.zeros(5)]

        def stretch(feed: Array, out: Array) -> None:
            state = held[0]
            for k in range(len(out)):
                volts = float(feed[k] - play.gains @ state[[THETA_L, OMEGA_L, CURRENT]])
                args = (min(max(volts, -limit), limit),)
                state = solve_ivp(equations, (0, PERIOD), state, method, args=args, rtol=rtol, atol=1e-3 * rtol).y[
                    :, -1
                ]
                out[k] = state[THETA_L]
            held[0] = state

        return stretch

    return start


# Measuring


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


def loosest(candidates: Any, make: Callable[[Any], Start], error_of: Callable[[Start], float], wanted: float) -> Any:
    """Return the first candidate that meets the error, and its error; None where none does."""
    for candidate in candidates:
        error = error_of(make(candidate))
        if error <= wanted:
            return candidate, error
    return None


def fewest_first() -> list[int]:
    """Return steps a sample, each 5 % more than the one before."""
    steps = [1]
    while steps[-1] < 0.75 * FINEST:
        steps.append(max(steps[-1] + 1, round(1.05 * steps[-1])))
    return steps


def against_c(loop: Any, play: Play, radau: Array, wanted: float, goal: str) -> Row:
    """Measure one scenario against the C loop."""
    what, against = f"plant, {play.name}, error <= {wanted:g} rad", "C loop, RK4, at its largest step"
    if loop is None:
        return Row(what, None, against, None, None, None, None, goal, "no C compiler was found")
    exact = whole(in_c(loop, play, FINEST), play)

    def error_of(start: Start) -> float:
        angles = whole(start, play)
        away = [np.max(np.abs(angles - exact)), np.max(np.abs(angles[:CHECKED] - radau))]
        return float(max(away)) if np.all(np.isfinite(away)) else math.inf

    apart = float(np.max(np.abs(exact[:CHECKED] - radau)))
    mine = loosest(TOLERANCES, lambda tolerance: ours(play, tolerance), error_of, wanted)
    theirs = loosest(fewest_first(), lambda steps: in_c(loop, play, steps), error_of, wanted)
    print(
        f"{what}: C at 1 us and Radau are {apart:.1e} apart; ours (tolerance, error) {mine}, C (steps, error) {theirs}"
    )
    if mine is None or theirs is None:
        who = "ours" if mine is None else "the C loop"
        why = f"{who} does not meet the error; C at 1 us and Radau are {apart:.1e} rad apart"
        return Row(what, None, against, None, None, None, None, goal, why)
    starts = ours(play, mine[0]), in_c(loop, play, theirs[0])
    speeds, ratios = in_turns(play, starts, COUNT, PASSES, PARTS)
    why = f"missed; the C loop needs {4 * theirs[0]} evaluations of the equations for a sample, a step of ours takes 12"
    return row(what, against, speeds, ratios, mine[1], goal, why)


def row(what: str, against: str, speeds: Array, ratios: Array, error: float, goal: str, why: str) -> Row:
    """Return the row of a measurement."""
    ratio = float(speeds[0] / speeds[1])
    missed = why if ratio < float(goal.split()[1]) else None
    spread = float(min(ratios)), float(max(ratios))
    return Row(what, float(speeds[0]), against, float(speeds[1]), ratio, spread, error, goal, missed)


def against_scipy(play: Play, method: str, exact: Array) -> Row:
    """Measure the limit cycle against a method of scipy."""

    def error_of(start: Start) -> float:
        return float(np.max(np.abs(whole(start, play, SHORT) - exact)))

    wanted = 1e-6
    what, against = (
        f"plant, {play.name}, first 2 s, error <= {wanted:g} rad",
        f"scipy {method}, compiled right-hand side",
    )
    mine = loosest(TOLERANCES, lambda tolerance: ours(play, tolerance), error_of, wanted)
    rtols = [10.0**-k for k in range(4, 13)]
    theirs = loosest(rtols, lambda rtol: by_scipy(play, method, rtol), error_of, wanted)
    print(f"{what}, {method}: ours (tolerance, error) {mine}, scipy (rtol, error) {theirs}")
    if mine is None or theirs is None:
        return Row(what, None, against, None, None, None, None, ">= 1000", "the error was not met")
    starts = ours(play, mine[0]), by_scipy(play, method, theirs[0])
    speeds, ratios = in_turns(play, starts, SHORT, SHORT_PARTS, SHORT_PARTS)
    return row(what, against, speeds, ratios, mine[1], ">= 1000", "missed")


GOALS = (
    ("nominal limit cycle", 1e-6, ">= 6"),
    ("nominal limit cycle", 1e-8, ">= 12"),
    ("free flight and slow motion", 1e-6, ">= 20"),
    ("stiff teeth, exponent 51", 1e-6, ">= 3"),
    ("elastic contact", 1e-4, ">= 3"),
    ("with friction", 1e-6, ">= 3"),
)


def main() -> None:
    """Measure, print and write."""
    made = plays()
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        radau = dict(zip(made, pool.map(by_radau, made), strict=True))
    with tempfile.TemporaryDirectory() as folder:
        loop = compile_loop(Path(folder))
        rows = [against_c(loop, made[name], radau[name], wanted, goal) for name, wanted, goal in GOALS]
        play = made[GOALS[0][0]]
        exact = whole(ours(play, 1e-12) if loop is None else in_c(loop, play, FINEST), play, SHORT)
    rows += [against_scipy(play, method, exact) for method in ("LSODA",)]
    record(rows)


if __name__ == "__main__":
    main()
