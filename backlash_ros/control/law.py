"""The control law: state feedback (eq 15) with fast gains far from the target, over-damped inside the backlash.

The compiled `law_step` is the one that drives the motor and the one that the offline simulation runs.
"""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backlash_ros.control.gains import GainSet
from backlash_ros.drivetrain import Drive, compiled

FAST_REGION, OVERDAMPED_REGION = 1, 2


class Mode(Enum):
    """Which regions the law has: both, or one set of gains throughout."""

    TWO_REGION = "two_region"
    FAST = "fast"
    OVERDAMPED = "overdamped"


class LawConstants(NamedTuple):
    """The law as the compiled step reads it: gains per region, the switch, the limit."""

    fast_k1: float
    fast_k2: float
    fast_k3: float
    fast_k_tau: float
    overdamped_k1: float
    overdamped_k2: float
    overdamped_k3: float
    overdamped_k_tau: float
    enter: float
    leave: float
    dwell_ticks: int
    voltage_limit: float


def law_constants(
    drive: Drive,
    gains: GainSet,
    mode: Mode,
    backlash_angle: float,
    *,
    period: float,
    hysteresis: float = 0.0,
    min_dwell: float = 0.0,
) -> LawConstants:
    """Return the law for one drive.

    Parameters
    ----------
    backlash_angle : b, rad; the over-damped region is abs(error) < b. 0 when not known: then it is never entered
    period : of the samples, s
    hysteresis : the over-damped region is left at abs(error) >= (1 + hysteresis) b
    min_dwell : time a region is kept at least, s
    """
    enter, leave = backlash_angle, backlash_angle * (1.0 + hysteresis)
    if mode is Mode.FAST:
        enter = leave = 0.0
    elif mode is Mode.OVERDAMPED:
        enter = leave = math.inf
    fast, slow = gains.fast, gains.overdamped
    per_k3 = -drive.gear.ratio / drive.motor.torque_constant
    return LawConstants(
        *(fast.k1, fast.k2, fast.k3, per_k3 * (drive.motor.resistance + fast.k3)),
        *(slow.k1, slow.k2, slow.k3, per_k3 * (drive.motor.resistance + slow.k3)),
        enter=enter,
        leave=leave,
        dwell_ticks=math.ceil(min_dwell / period - 1e-9),
        voltage_limit=drive.motor.voltage_limit,
    )


def law_memory() -> NDArray[np.float64]:
    """Return what the law remembers between ticks, shape (2,): the region and the ticks spent in it."""
    return np.array([float(FAST_REGION), 1e9])


@compiled
def law_step(
    law: LawConstants,
    memory: NDArray[np.float64],
    theta_l: float,
    omega_l: float,
    current: float,
    reference: float,
    load_torque: float,
) -> float:
    """Return the voltage for one sample; update the region in ``memory``.

    V = k_tau tau_l - k1 (theta_l - reference) - k2 omega_l - k3 i (eq 15), saturated last. rad, rad/s, A, N m; V.
    """
    error = theta_l - reference
    region, ticks = memory[0], memory[1] + 1.0
    if ticks >= law.dwell_ticks:
        if region == FAST_REGION and abs(error) < law.enter:
            region, ticks = float(OVERDAMPED_REGION), 0.0
        elif region == OVERDAMPED_REGION and abs(error) >= law.leave:
            region, ticks = float(FAST_REGION), 0.0
    memory[0], memory[1] = region, ticks
    if region == FAST_REGION:
        voltage = law.fast_k_tau * load_torque
        voltage -= law.fast_k1 * error + law.fast_k2 * omega_l + law.fast_k3 * current
    else:
        voltage = law.overdamped_k_tau * load_torque
        voltage -= law.overdamped_k1 * error + law.overdamped_k2 * omega_l + law.overdamped_k3 * current
    return min(max(voltage, -law.voltage_limit), law.voltage_limit)
