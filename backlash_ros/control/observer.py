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

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, cells, row_of, view_of
from backlash_ros.foundation.signals import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    OMEGA_M,
    THETA_L,
    THETA_M,
    Estimate,
    Measurement,
    as_estimate,
)


class ObserverConstants(Record):
    """The drive and the bandwidths, as the compiled step reads them."""

    period: float  # s, of the samples
    ratio: float  # of the gear, n
    torque_constant: float  # N m/A
    back_emf: float  # V s/rad, of the winding between command and current; 0 where the command is the current
    resistance: float  # ohm, of the same winding; 1 where the command is the current
    electrical_rate: float  # 1/s, R/L; infinite where the current is imposed
    motor_inertia: float  # kg m^2
    motor_friction: float  # N m s/rad
    load_inertia: float  # kg m^2
    load_friction: float  # N m s/rad
    velocity_bandwidth: float  # rad/s
    torque_bandwidth: float  # rad/s, of the load torque; 0 for none


class ObserverMemory(Record):
    """What the observer remembers."""

    estimate: Array = cells(LOAD_TORQUE + 1)  # an `Estimate`
    started: float = 0.0  # 1 once a sample has been seen
    momentum: float = 0.0  # N m s, of both shafts at the output, at the last sample


observer_constants_at, observer_memory_at = view_of(ObserverConstants), view_of(ObserverMemory)


def observer_constants(
    drive: Drive, period: float, *, velocity_bandwidth: float, torque_bandwidth: float
) -> ObserverConstants:
    """Return the observer for one drive, sampled every ``period`` seconds; bandwidths in rad/s."""
    motor, takes_current = drive.motor, drive.takes_current
    row = row_of(
        ObserverConstants,
        period=period,
        ratio=drive.gear.ratio,
        torque_constant=motor.torque_constant,
        back_emf=0.0 if takes_current else motor.torque_constant,
        resistance=1.0 if takes_current else motor.resistance,
        electrical_rate=math.inf if takes_current else motor.resistance / motor.inductance,
        motor_inertia=motor.inertia,
        motor_friction=motor.viscous_friction,
        load_inertia=drive.load.inertia,
        load_friction=drive.load.viscous_friction,
        velocity_bandwidth=velocity_bandwidth,
        torque_bandwidth=torque_bandwidth,
    )
    return observer_constants_at(row)


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
def _momentum(constants: ObserverConstants, estimate: Estimate) -> float:
    """Return the momentum of both shafts at the output, N m s."""
    load, motor = constants.load_inertia * estimate[OMEGA_L], constants.motor_inertia * estimate[OMEGA_M]
    return float(load + motor / constants.ratio)


@compiled
def _through_the_gear(ratio: float, measured: Measurement) -> tuple[float, float, float, float]:
    """Return angle and speed of motor and load; those of a missing encoder are the other's, through the rigid gear."""
    theta_m, theta_l = measured[THETA_M], measured[THETA_L]
    omega_m, omega_l = measured[OMEGA_M], measured[OMEGA_L]
    if math.isnan(theta_l):
        theta_l, omega_l = ratio * theta_m, ratio * omega_m
    elif math.isnan(theta_m):
        theta_m, omega_m = theta_l / ratio, omega_l / ratio
    return theta_m, omega_m, theta_l, omega_l


@compiled
def _start(constants: ObserverConstants, memory: ObserverMemory, measured: Measurement) -> None:
    """Take the first sample: what is not measured is 0."""
    estimate = as_estimate(memory.estimate)
    theta_m, omega_m, theta_l, omega_l = _through_the_gear(constants.ratio, measured)
    estimate[THETA_M], estimate[THETA_L] = theta_m, theta_l
    estimate[OMEGA_M] = 0.0 if math.isnan(omega_m) else omega_m
    estimate[OMEGA_L] = 0.0 if math.isnan(omega_l) else omega_l
    estimate[CURRENT] = 0.0 if math.isnan(measured[CURRENT]) else measured[CURRENT]
    estimate[LOAD_TORQUE] = 0.0
    memory.momentum = _momentum(constants, estimate)
    memory.started = 1.0


@compiled
def _track(
    estimate: Estimate, angle: int, speed: int, position: float, measured: float, gain: float, period: float
) -> None:
    """Update one shaft: the measured speed if there is one, else the filtered difference quotient."""
    if math.isnan(measured):
        predicted = estimate[angle] + period * estimate[speed]
        estimate[speed] += gain / period * (position - predicted)
    else:
        estimate[speed] = measured
    estimate[angle] = position


@compiled
def observer_step(
    constants: ObserverConstants,
    memory: ObserverMemory,
    measured: Measurement,
    command: float,
    period: float,
    torque_bandwidth: float,
) -> None:
    """Take one sample into the estimate.

    Parameters
    ----------
    memory : updated in place
    measured : nan where not measured; at least one angle
    command : held since the previous sample, V or A
    period : since the previous sample, s
    torque_bandwidth : of the load torque estimate, rad/s; 0 for none
    """
    if memory.started == 0.0:
        _start(constants, memory, measured)
        return
    n, estimate = constants.ratio, as_estimate(memory.estimate)
    theta_m, omega_m, theta_l, omega_l = _through_the_gear(n, measured)
    before = estimate[CURRENT]
    speed_before_m, speed_before_l = estimate[OMEGA_M], estimate[OMEGA_L]
    gain = low_pass_gain(constants.velocity_bandwidth, period)
    _track(estimate, THETA_M, OMEGA_M, theta_m, omega_m, gain, period)
    _track(estimate, THETA_L, OMEGA_L, theta_l, omega_l, gain, period)
    mean_speed_m = 0.5 * (speed_before_m + estimate[OMEGA_M])
    if math.isnan(measured[CURRENT]):
        estimate[CURRENT] = next_current(constants, before, command, mean_speed_m, period)
    else:
        estimate[CURRENT] = measured[CURRENT]
    weight = _mean_weight(constants.electrical_rate, period)
    mean_current = weight * before + (1.0 - weight) * estimate[CURRENT]
    friction = constants.load_friction * 0.5 * (speed_before_l + estimate[OMEGA_L])
    friction += constants.motor_friction / n * mean_speed_m
    drive_torque = constants.torque_constant * mean_current / n
    momentum = _momentum(constants, estimate)
    unexplained = momentum - memory.momentum - period * (drive_torque - friction + estimate[LOAD_TORQUE])
    memory.momentum = momentum
    # With the load encoder alone, an estimate through the rigid gear would keep up a limit cycle.
    if math.isnan(measured[THETA_M]) or torque_bandwidth == 0.0:
        estimate[LOAD_TORQUE] = 0.0
    else:
        estimate[LOAD_TORQUE] += low_pass_gain(torque_bandwidth, period) / period * unexplained


def keep_estimate(constants: ObserverConstants, memory: ObserverMemory) -> None:
    """Keep the estimate under new ``constants``: the momentum changes with the inertias, without any torque."""
    if memory.started != 0.0:
        # Not compiled: what is called between two samples must not wait for machine code.
        memory.momentum = _momentum.py_func(constants, memory.estimate)  # type: ignore[attr-defined]
