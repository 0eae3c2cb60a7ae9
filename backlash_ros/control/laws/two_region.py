"""The paper's laws, state feedback (eq 15): fast; over-damped; two-region, fast only far from the target.

    V = k_tau tau_l + k1 (theta_d - theta_l) + k2 (omega_d - omega_l) - k3 i

with the wanted angle and speed of the setpoint.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from backlash_ros.control.command_range import clamp
from backlash_ros.control.design.gains import Gains
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, OVERDAMPED_REGION, REGION, ControlLaw, NamedLaw
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    POSITION,
    THETA_L,
    VELOCITY,
    Estimate,
    Setpoint,
)

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_TICKS = 1
_OVERDAMPED, _ENTER, _LEAVE, _DWELL = 4, 8, 9, 10


@dataclass(frozen=True)
class TwoRegionParameters(Validated):
    """Width of the over-damped region, and how the regions are switched."""

    section: ClassVar[str] = "laws.two_region"

    width: float = quantity(
        "error, of either sign, below which the over-damped gains act, in units of backlash_angle",
        "",
        above=0,
        at_most=10,
        default=1.0,
    )
    hysteresis: float = quantity(
        "the over-damped region ends at an error of (1 + hysteresis) width backlash_angle",
        "",
        at_least=0,
        at_most=10,
        default=0.1,
    )
    min_dwell: float = quantity("shortest time in a region", "s", at_least=0, at_most=10, default=0.02)


@compiled_as(LAW_SIGNATURE)
def two_region_step(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, low: float, high: float) -> float:
    """Choose the region by the error, apply eq 15 with its gains, and clamp to the range."""
    error = setpoint[POSITION] - estimate[THETA_L]
    region, ticks = state[REGION], state[_TICKS] + 1.0
    if ticks >= law[_DWELL]:
        if region == FAST_REGION and abs(error) < law[_ENTER]:
            region, ticks = float(OVERDAMPED_REGION), 0.0
        elif region == OVERDAMPED_REGION and abs(error) >= law[_LEAVE]:
            region, ticks = float(FAST_REGION), 0.0
    state[REGION], state[_TICKS] = region, ticks
    k = 0 if region == FAST_REGION else _OVERDAMPED
    voltage = law[k + 3] * estimate[LOAD_TORQUE]
    voltage += law[k] * error + law[k + 1] * (setpoint[VELOCITY] - estimate[OMEGA_L]) - law[k + 2] * estimate[CURRENT]
    return clamp(voltage, low, high)


def _with_torque(drive: Drive, gains: Gains) -> list[float]:
    """Return k1, k2, k3 and k_tau = -n (R + k3)/K_m."""
    k_tau = -drive.gear.ratio * (drive.motor.resistance + gains.current) / drive.motor.torque_constant
    return [gains.position, gains.velocity, gains.current, k_tau]


def _law(drive: Drive, settings: "ServoSettings", enter: float, leave: float, min_dwell: float = 0.0) -> ControlLaw:
    constants = [
        *_with_torque(drive, settings.gains.fast),
        *_with_torque(drive, settings.gains.overdamped),
        *(enter, leave, math.ceil(min_dwell / settings.period - 1e-9)),
    ]
    # The first region acts from the start: no dwell time to wait for.
    return ControlLaw(two_region_step, np.array(constants, dtype=float), np.array([float(FAST_REGION), 1e9]))


def two_region(drive: Drive, settings: "ServoSettings", parameters: TwoRegionParameters) -> ControlLaw:
    """Over-damped gains within the backlash, fast gains outside, with hysteresis and a dwell time (figs 6, 9)."""
    enter = parameters.width * settings.backlash_angle
    return _law(drive, settings, enter, (1.0 + parameters.hysteresis) * enter, parameters.min_dwell)


def fast(drive: Drive, settings: "ServoSettings", _parameters: Validated) -> ControlLaw:
    """Fast gains throughout (fig 4)."""
    return _law(drive, settings, 0.0, 0.0)


def overdamped(drive: Drive, settings: "ServoSettings", _parameters: Validated) -> ControlLaw:
    """Over-damped gains throughout (fig 5)."""
    return _law(drive, settings, math.inf, math.inf)


LAWS = {
    "fast": NamedLaw("fast state feedback", fast),
    "overdamped": NamedLaw("over-damped state feedback", overdamped),
    "two_region": NamedLaw("two-region law (adaptive)", two_region, TwoRegionParameters(), adapts=True),
}
