"""The plant once more: its equations written down anew, and scipy's Radau on them, which checks all others.

The equations are compiled with the drive's numbers in them, and return an error where the state is not finite: some of
scipy's methods would go on for ever.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np
from scenarios import PERIOD, Play, plays
from scipy.integrate import Radau, solve_ivp

from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L


class Equations(NamedTuple):
    """``slope`` of time, state, voltage and the slip of both shafts; ``torques`` (N m) on both shafts at rest.

    A slip is 1 or -1 as the shaft slides, 0 where it sticks.
    """

    slope: Callable[..., Array]
    torques: Callable[[Array], tuple[float, float]]


@cache
def equations_of(play: Play) -> Equations:
    """Return the equations of motion of a scenario, compiled; FloatingPointError where a state is not finite."""
    p, elastic, n = plant_constants(play.drive), play.elastic, int(plant_constants(play.drive).contact[2])

    @numba.njit
    def force(y: Array) -> float:
        gap, rate = p.R1 * y[0] - p.R2 * y[2], p.R1 * y[1] - p.R2 * y[3]
        if elastic:
            side = 1.0 if gap > 0.0 else -1.0
            spring = p.contact[0] * max(0.0, abs(gap) - p.half_gap)
            return side * (spring + min(max(side * p.contact[1] * rate, -spring), spring))
        s = gap / p.half_gap
        return p.contact[0] * s**n + p.contact[1] * rate * s ** (n + 1)

    @numba.njit
    def torques(y: Array) -> tuple[float, float]:
        teeth = force(y)
        return p.K_m * y[4] - p.R1 * teeth, p.R2 * teeth

    @numba.njit
    def slope(_t: float, y: Array, volts: float, slip_m: float, slip_l: float) -> Array:
        if not math.isfinite(y.sum()):
            raise FloatingPointError("the state is not finite")
        on_motor, on_load = torques(y)
        d = np.zeros(5)
        d[0], d[2] = y[1], y[3]
        if slip_m != 0.0:
            d[1] = (on_motor - p.B_m * y[1] - slip_m * p.coulomb_m) / p.J_m
        if slip_l != 0.0:
            d[3] = (on_load - p.B_l * y[3] - slip_l * p.coulomb_l) / p.J_l
        d[4] = (volts - p.R * y[4] - p.K_m * y[1]) / p.L
        return d

    return Equations(slope, torques)


class _Radau(Radau):  # type: ignore[misc]
    """scipy's Radau, less the time that its calls of LAPACK take: five unknowns are found by an inverse."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.lu, self.solve_lu = np.linalg.inv, np.dot


def by_radau(name: str, count: int) -> Array:
    """Return the load angle at the first samples of a scenario by Radau with rtol 1e-12.

    It stops where a shaft with dry friction comes to rest, reverses or breaks away.
    """
    play = plays()[name]
    slope, torques = equations_of(play)
    plant = plant_constants(play.drive)
    rubs = plant.coulomb_m, plant.coulomb_l
    watched = [shaft for shaft in (0, 1) if rubs[shaft]]
    state, slips, angles = np.zeros(5), [1.0, 1.0], np.empty(count)

    def slip(shaft: int) -> float:
        """Return how a shaft slides: as it turns, or, at rest, where more acts on it than friction holds."""
        if rubs[shaft] == 0.0:
            return 1.0
        if state[2 * shaft + 1] != 0.0:
            return math.copysign(1.0, state[2 * shaft + 1])
        torque = torques(state)[shaft]
        return math.copysign(1.0, torque) if abs(torque) > rubs[shaft] else 0.0

    def event(shaft: int) -> Any:
        def left(_t: float, y: Array, *_: float) -> float:
            if slips[shaft]:
                return slips[shaft] * float(y[2 * shaft + 1])
            return rubs[shaft] - abs(torques(y)[shaft])

        left.terminal, left.direction = True, -1.0  # type: ignore[attr-defined]
        return left

    events = [event(shaft) for shaft in watched] or None
    for k in range(count):
        volts, now = play.voltage(play.feed[k], state), 0.0
        slips[:] = slip(0), slip(1)
        while now < PERIOD:
            solved = solve_ivp(
                *(slope, (now, PERIOD), state, _Radau), args=(volts, *slips), rtol=1e-12, atol=1e-13, events=events
            )
            if solved.status < 0:
                raise RuntimeError(f"{name}: {solved.message}")
            state, now = solved.y[:, -1], solved.t[-1]
            if solved.status == 0:
                break
            for shaft, times in zip(watched, solved.t_events, strict=True):
                if len(times) == 0:
                    continue
                if slips[shaft]:
                    state[2 * shaft + 1] = 0.0
                    slips[shaft] = slip(shaft)
                else:
                    slips[shaft] = math.copysign(1.0, torques(state)[shaft])
        angles[k] = state[THETA_L]
    return angles
