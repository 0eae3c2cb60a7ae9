"""Estimates what the law needs and the drive may not measure: speeds, current and load torque.

Each signal is the measured one if there is one. Otherwise
a speed is the difference quotient of its encoder through a first-order low-pass,
the current follows the armature equation (eq 7) under the commanded voltage, or is the commanded current, and
a missing encoder is replaced by the other one through the rigid gear.

The load torque has no sensor. Adding eq 1 and eq 2 over n cancels the contact force,

    d/dt (J_l omega_l + J_m omega_m / n) = K_m i / n - B_l omega_l - B_m omega_m / n + tau_l,

so the momentum of both shafts gives tau_l whether the teeth touch or not: a momentum observer (De Luca &
Mattone, ICRA 2003) with one bandwidth, which stores only the estimate and the last momentum, so that a change of
bandwidth while it runs causes no step. With the load encoder alone the motor's momentum inside the gap is unknown, and
an estimate through the rigid gear would keep up a limit cycle by itself: the load torque then stays 0.
"""

import math
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    OMEGA_M,
    THETA_L,
    THETA_M,
    Estimate,
    Measurement,
)

_STARTED, _MOMENTUM = 6, 7
MEMORY = 8
"""Length of the observer's memory: the estimate, then its auxiliary values."""


class ObserverConstants(NamedTuple):
    """The observer as the compiled step reads it.

    ``back_emf`` and ``resistance`` are those of the winding between command and current: K_m and R, or 0 and 1 where
    the command is the current; ``electrical_rate`` is R/L in 1/s, infinite where the current is imposed.
    """

    period: float
    ratio: float
    K_m: float
    back_emf: float
    resistance: float
    electrical_rate: float
    J_m: float
    B_m: float
    J_l: float
    B_l: float
    velocity_bandwidth: float
    torque_bandwidth: float


def observer_constants(
    drive: Drive, period: float, *, velocity_bandwidth: float, torque_bandwidth: float
) -> ObserverConstants:
    """Return the observer for one drive, sampled every ``period`` seconds; bandwidths in rad/s."""
    motor, takes_current = drive.motor, drive.takes_current
    return ObserverConstants(
        period=float(period),
        ratio=drive.gear.ratio,
        K_m=float(motor.torque_constant),
        back_emf=0.0 if takes_current else float(motor.torque_constant),
        resistance=1.0 if takes_current else float(motor.resistance),
        electrical_rate=math.inf if takes_current else motor.resistance / motor.inductance,
        J_m=float(motor.inertia),
        B_m=float(motor.viscous_friction),
        J_l=float(drive.load.inertia),
        B_l=float(drive.load.viscous_friction),
        velocity_bandwidth=float(velocity_bandwidth),
        torque_bandwidth=float(torque_bandwidth),
    )


def observer_memory() -> Array:
    """Return the initial memory: shape (8,), the estimate and its auxiliary values."""
    return np.zeros(MEMORY)


@compiled
def low_pass_gain(bandwidth: float, period: float) -> float:
    """Return the share of a step that a first-order low-pass of a bandwidth (rad/s) follows within a period, s."""
    return -math.expm1(-bandwidth * period)


@compiled
def next_current(constants: ObserverConstants, before: float, command: float, omega_m: float, period: float) -> float:
    """Return the current (A) after ``period`` under a command (V or A) at a mean motor speed (rad/s): eq 7."""
    settled = (command - constants.back_emf * omega_m) / constants.resistance
    decay = math.exp(-constants.electrical_rate * period)
    return decay * before + (1.0 - decay) * settled


@compiled
def _mean_weight(electrical_rate: float, period: float) -> float:
    """Return the weight of the previous current in the mean over a period in which it relaxes with L/R."""
    electrical = electrical_rate * period
    if math.isinf(electrical):
        return 0.0
    return 1.0 - (1.0 + math.expm1(-electrical) / electrical) / -math.expm1(-electrical)


@compiled
def _track(memory: Array, angle: int, speed: int, position: float, measured: float, gain: float, period: float) -> None:
    """Update one shaft: the measured speed if there is one, else the filtered difference quotient."""
    if math.isnan(measured):
        predicted = memory[angle] + period * memory[speed]
        memory[speed] += gain / period * (position - predicted)
    else:
        memory[speed] = measured
    memory[angle] = position


@compiled
def observer_step(
    constants: ObserverConstants,
    memory: Array,
    measured: Measurement,
    command: float,
    period: float,
    torque_bandwidth: float,
) -> None:
    """Take one sample into ``memory``, whose first six entries are then the `Estimate`.

    Parameters
    ----------
    memory : from `observer_memory`, updated in place
    measured : nan where not measured; at least one angle
    command : held since the previous sample, V or A
    period : since the previous sample, s
    torque_bandwidth : of the load torque estimate, rad/s; 0 for none
    """
    n = constants.ratio
    theta_m, theta_l = measured[THETA_M], measured[THETA_L]
    omega_m, omega_l = measured[OMEGA_M], measured[OMEGA_L]
    if math.isnan(theta_l):
        theta_l, omega_l = n * theta_m, n * omega_m
    elif math.isnan(theta_m):
        theta_m, omega_m = theta_l / n, omega_l / n
    before = memory[CURRENT]
    speed_before_m, speed_before_l = memory[OMEGA_M], memory[OMEGA_L]
    if memory[_STARTED] == 0.0:
        memory[THETA_M], memory[THETA_L] = theta_m, theta_l
        memory[OMEGA_M] = 0.0 if math.isnan(omega_m) else omega_m
        memory[OMEGA_L] = 0.0 if math.isnan(omega_l) else omega_l
        memory[CURRENT] = 0.0 if math.isnan(measured[CURRENT]) else measured[CURRENT]
        memory[LOAD_TORQUE] = 0.0
        memory[_MOMENTUM] = constants.J_l * memory[OMEGA_L] + constants.J_m * memory[OMEGA_M] / n
        memory[_STARTED] = 1.0
        return
    gain = low_pass_gain(constants.velocity_bandwidth, period)
    _track(memory, THETA_M, OMEGA_M, theta_m, omega_m, gain, period)
    _track(memory, THETA_L, OMEGA_L, theta_l, omega_l, gain, period)
    mean_speed_m = 0.5 * (speed_before_m + memory[OMEGA_M])
    if math.isnan(measured[CURRENT]):
        memory[CURRENT] = next_current(constants, before, command, mean_speed_m, period)
    else:
        memory[CURRENT] = measured[CURRENT]
    weight = _mean_weight(constants.electrical_rate, period)
    mean_current = weight * before + (1.0 - weight) * memory[CURRENT]
    friction = constants.B_l * 0.5 * (speed_before_l + memory[OMEGA_L]) + constants.B_m / n * mean_speed_m
    momentum = constants.J_l * memory[OMEGA_L] + constants.J_m * memory[OMEGA_M] / n
    drive_torque = constants.K_m * mean_current / n
    unexplained = momentum - memory[_MOMENTUM] - period * (drive_torque - friction + memory[LOAD_TORQUE])
    memory[_MOMENTUM] = momentum
    if math.isnan(measured[THETA_M]) or torque_bandwidth == 0.0:
        memory[LOAD_TORQUE] = 0.0
    else:
        memory[LOAD_TORQUE] += low_pass_gain(torque_bandwidth, period) / period * unexplained


def keep_estimate(constants: ObserverConstants, memory: Array) -> None:
    """Keep the estimate under new ``constants``: the momentum changes with the inertias, without any torque."""
    if memory[_STARTED] != 0.0:
        memory[_MOMENTUM] = constants.J_l * memory[OMEGA_L] + constants.J_m * memory[OMEGA_M] / constants.ratio


def estimate_of(memory: Array) -> Estimate:
    """Return the estimate in an observer's memory, as a view."""
    return Estimate(memory[: LOAD_TORQUE + 1])
