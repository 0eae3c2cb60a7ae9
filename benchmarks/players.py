"""Who plays the scenarios of `scenarios.py`: the package's integrator, the loop in C, scipy's methods."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from radau import equations_of
from scenarios import COUNT, PERIOD, Play
from scipy.integrate import solve_ivp

from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.motion.integrator import DONE, integration_memory, integrator_for
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, at_rest

Stretch = Callable[[Array, Array], None]
Start = Callable[[], Stretch]
"""Begins a run; what it returns plays on for a stretch of ``feed`` and writes the load angles."""


def whole(start: Start, play: Play, count: int = COUNT) -> Array:
    """Return the load angle at the first ``count`` samples."""
    out = np.empty(count)
    start()(play.feed[:count], out)
    return out


@numba.njit
def _play(advance, plant, state, memory, gains, feed, limit, tolerance, out):  # type: ignore[no-untyped-def]
    status = 0
    for k in range(out.shape[0]):
        volts = feed[k] - gains[0] * state[2] - gains[1] * state[3] - gains[2] * state[4]
        status = max(status, advance(plant, state, memory, min(max(volts, -limit), limit), 0.0, PERIOD, tolerance)[0])
        out[k] = state[2]
    return status


def ours(play: Play, tolerance: float) -> Start:
    """Return the package's integrator on a scenario."""
    advance, plant, limit = integrator_for(play.drive), plant_constants(play.drive), play.drive.motor.voltage_limit

    def start() -> Stretch:
        state, memory = at_rest(), integration_memory()

        def stretch(feed: Array, out: Array) -> None:
            if _play(advance, plant, state, memory, play.gains, feed, limit, tolerance, out) != DONE:
                raise FloatingPointError(f"{play.name}: not integrated at tolerance {tolerance:g}")

        return stretch

    return start


class _Drive(ctypes.Structure):
    _names = "R L Km Jm Bm R1 R2 half Jl Bl rub_m rub_l limit c0 c1"
    _fields_ = [*((name, ctypes.c_double) for name in _names.split()), ("n", ctypes.c_int)]


def compile_loops(folder: Path) -> Any | None:
    """Return the library of `plant.c`, None where no compiler is found."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    made = folder / "plant.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", made, Path(__file__).with_name("plant.c"), "-lm"], check=True)
    return ctypes.CDLL(str(made))


def _address(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def in_c(loop: Any, play: Play, steps: int) -> Start:
    """Return a loop in C on a scenario, with ``steps`` for each sample."""
    p = plant_constants(play.drive)
    exponent = 0 if play.elastic else int(p.contact[2])
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


def by_scipy(play: Play, method: str, rtol: float, spent: list[int] | None = None) -> Start:
    """Return a method of scipy on the compiled right-hand side, for a drive without dry friction.

    It adds to ``spent`` how often it has evaluated that for each sample.
    """
    slope = equations_of(play).slope

    def start() -> Stretch:
        held = [np.zeros(5)]

        def stretch(feed: Array, out: Array) -> None:
            state = held[0]
            for k in range(len(out)):
                args = (play.voltage(feed[k], state), 1.0, 1.0)
                solved = solve_ivp(slope, (0, PERIOD), state, method, args=args, rtol=rtol, atol=1e-3 * rtol)
                if not solved.success:
                    raise FloatingPointError(f"{method}: {solved.message}")
                if spent is not None:
                    spent.append(solved.nfev)
                state = solved.y[:, -1]
                out[k] = state[THETA_L]
            held[0] = state

        return stretch

    return start
