"""The paper's laws: state feedback (eq 15), fast, over-damped, and fast far from the target, over-damped near it."""

import math

import numpy as np

from backlash_ros.control.command import within
from backlash_ros.control.gains import Gains
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, OVERDAMPED_REGION, REGION, Array, ControlLaw, NamedLaw
from backlash_ros.control.observer import CURRENT, LOAD_TORQUE, OMEGA_L, THETA_L
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.compiled import compiled_as

_TICKS = 1
_OVERDAMPED, _ENTER, _LEAVE, _DWELL = 4, 8, 9, 10


@compiled_as(LAW_SIGNATURE)
def two_region_step(law: Array, memory: Array, estimate: Array, reference: float, low: float, high: float) -> float:
    """V = k_tau tau_l - k1 (theta_l - reference) - k2 omega_l - k3 i (eq 15), the region's gains, then saturated."""
    error = estimate[THETA_L] - reference
    region, ticks = memory[REGION], memory[_TICKS] + 1.0
    if ticks >= law[_DWELL]:
        if region == FAST_REGION and abs(error) < law[_ENTER]:
            region, ticks = float(OVERDAMPED_REGION), 0.0
        elif region == OVERDAMPED_REGION and abs(error) >= law[_LEAVE]:
            region, ticks = float(FAST_REGION), 0.0
    memory[REGION], memory[_TICKS] = region, ticks
    k = 0 if region == FAST_REGION else _OVERDAMPED
    voltage = law[k + 3] * estimate[LOAD_TORQUE]
    voltage -= law[k] * error + law[k + 1] * estimate[OMEGA_L] + law[k + 2] * estimate[CURRENT]
    return within(voltage, low, high)


def _with_torque(drive: Drive, gains: Gains) -> list[float]:
    """Return k1, k2, k3 and k_tau = -n (R + k3)/K_m."""
    k_tau = -drive.gear.ratio * (drive.motor.resistance + gains.current) / drive.motor.torque_constant
    return [gains.position, gains.velocity, gains.current, k_tau]


def _law(drive: Drive, settings: ServoSettings, enter: float, leave: float) -> ControlLaw:
    dwell_ticks = math.ceil(settings.min_dwell / settings.period - 1e-9)
    constants = [
        *_with_torque(drive, settings.gains.fast),
        *_with_torque(drive, settings.gains.overdamped),
        *(enter, leave, dwell_ticks),
    ]
    # The first region holds from the start: no dwell to wait for.
    return ControlLaw(two_region_step, np.array(constants, dtype=float), np.array([float(FAST_REGION), 1e9]))


def two_region(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Over-damped gains within the backlash, fast gains outside, with hysteresis and a least dwell (figs 6, 9)."""
    b = settings.backlash_angle
    return _law(drive, settings, b, (1.0 + settings.hysteresis) * b)


def fast(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Fast gains throughout (fig 4)."""
    return _law(drive, settings, 0.0, 0.0)


def overdamped(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Over-damped gains throughout (fig 5)."""
    return _law(drive, settings, math.inf, math.inf)


LAWS = {
    "fast": NamedLaw("fast state feedback", fast),
    "overdamped": NamedLaw("over-damped state feedback", overdamped),
    "two_region": NamedLaw("two-region law (adaptive)", two_region),
}
