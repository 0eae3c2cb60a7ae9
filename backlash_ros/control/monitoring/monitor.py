"""Checks sample by sample whether the drive does what its parameters say; beyond a threshold there is a fault.

Pure computation, compiled into the tick. Four things are watched, each with its own threshold: the speed of either
shaft (an encoder that jumps moves faster than any motor), the relative travel of both shafts (an encoder that stands
still or counts backwards), the torque that the momentum of both shafts does not explain (a motor that does not follow
its command, a blocked load, two encoders that stand still), and the ends of the travel.

The unexplained torque U is that of `observer`, with the torque that the command should make as the drive's torque D. It
is compared with its limit only while the momentum changes in the direction of the load torque, (D + U) D <= 0.05 D^2. A
wrong inertia, resistance or torque constant only changes the factor between D and the momentum, so it causes no fault
at any torque.

Not detected is whatever looks like a load torque within the limit: encoders that all stand still, a blocked load or a
dead motor while the command stays small, and a command or encoders of the wrong sign until the command has grown. With
``faults.load_torque`` lowered to what the axis must hold they are found sooner. Not detected either: an encoder that
stands still together with its shaft; an only encoder that jumps by less than ``faults.gap`` plus one sample's travel at
``faults.velocity``; a gear that slips by less than 2 % of the travel; angles that stand still while their measured
speeds are right.

With one encoder the gap is not seen, and the momentum is that of a rigid gear. A false fault is possible if the drive
hammers from flank to flank (the load encoder alone under a current: nothing damps the motor in the gap) and the load is
a quarter of what its inertia says.
"""

import math

from backlash_ros.control.monitoring.bounds import MonitorConstants
from backlash_ros.control.monitoring.fault_texts import FaultDetails
from backlash_ros.control.observer import ObserverConstants, ObserverMemory, low_pass_gain, observer_step
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, cells, part
from backlash_ros.foundation.signals import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    OMEGA_M,
    THETA_L,
    THETA_M,
    Measurement,
    as_estimate,
    as_measurement,
)
from backlash_ros.gates.faults import Fault

_FOLLOWS = 0.05
"""Smallest share of the drive's torque with which the momentum changes if only the parameters are wrong. Tuned."""

_RATIO_ERROR = 0.02
"""Tolerance of the gear ratio: share of the travel by which the shafts may drift apart."""

_RATE_SHARE = 0.8
"""Share of the period: samples that come faster than this for a while are those of a drive with another rate. Tuned."""
_WHILE = 0.1
"""That while, s: the time constant of the mean. Tuned."""
_LONGEST = 10.0
"""Largest interval that counts in the mean, in periods, so that one long pause does not hide a wrong rate."""

_NONE = int(Fault.NONE)
_MOTOR_JUMP, _LOAD_JUMP = int(Fault.MOTOR_JUMP), int(Fault.LOAD_JUMP)
_OVERSPEED = int(Fault.MOTOR_OVERSPEED) - _MOTOR_JUMP
_DISAGREE, _UNEXPLAINED_TORQUE = int(Fault.ENCODERS_DISAGREE), int(Fault.UNEXPLAINED_TORQUE)
_RATE = int(Fault.RATE)
_LOWER_END, _UPPER_END = int(Fault.LOWER_END), int(Fault.UPPER_END)


class MonitorMemory(Record):
    """What the monitor remembers; angles at the output."""

    motor_angle: float = math.nan  # rad, at the last sample
    load_angle: float = math.nan  # rad, at the last sample
    nearest: float = math.inf  # rad, smallest difference of motor and load so far
    farthest: float = -math.inf  # rad, largest one
    lower_end: float = -math.inf  # rad; beyond the end for a load that came from there
    upper_end: float = math.inf  # rad
    commanded_torque: float = 0.0  # N m, of the command, filtered as the observer filters the torque that it finds
    drive_torque: float = 0.0  # N m, the same filtered once more
    unexplained_torque: float = 0.0  # N m on the output shaft, filtered as often: the load torque, if all is well
    watched_time: float = 0.0  # s, since the first sample
    mean_interval: float = 1.0  # periods, between samples lately
    observer: ObserverMemory = part(ObserverMemory)  # driven by what the command should cause
    sample: Array = cells(5)  # the `Measurement` for that observer


def forget_ends(memory: MonitorMemory) -> None:
    """Let a load outside new ends of the travel come back in."""
    memory.lower_end, memory.upper_end = -math.inf, math.inf


@compiled
def _too_fast(memory: MonitorMemory, period: float, elapsed: float) -> bool:
    """Return whether samples have come faster than their rate for a while; if slower, some may have been lost."""
    interval = min(elapsed / period, _LONGEST)
    memory.mean_interval += low_pass_gain(1.0 / _WHILE, period) * (interval - memory.mean_interval)
    return bool(memory.mean_interval < _RATE_SHARE)


@compiled
def _speed(
    limits: MonitorConstants,
    before: float,
    angle: float,
    measured: float,
    elapsed: float,
    details: FaultDetails,
    jump: int,
) -> int:
    """Return ``jump`` if an encoder moved too far, the next fault, overspeed, for a measured speed; at the output."""
    moved = abs(angle - before)
    # One count may be much in a short period. False for nan.
    if moved > limits.velocity * elapsed + limits.gap:
        details.value, details.elapsed = moved, elapsed
        return jump
    if abs(measured) > limits.velocity:
        details.value = abs(measured)
        return jump + _OVERSPEED
    return _NONE


@compiled
def _gap_travel(memory: MonitorMemory, apart: float, moved: float) -> float:
    """Return how far the shafts have moved apart (rad), less what a slightly wrong gear ratio explains."""
    if math.isnan(apart):
        return 0.0
    drift = 0.0 if math.isnan(moved) else _RATIO_ERROR * moved
    memory.nearest = min(memory.nearest + drift, apart)
    memory.farthest = max(memory.farthest - drift, apart)
    return float(memory.farthest - memory.nearest)


@compiled
def _unexplained_torque(
    limits: MonitorConstants,
    observer: ObserverConstants,
    memory: MonitorMemory,
    measured: Measurement,
    command: float,
    elapsed: float,
    period: float,
) -> float:
    """Return the unexplained torque, N m; 0 if a wrong parameter may be the cause."""
    sample = as_measurement(memory.sample)
    sample[:] = measured
    sample[CURRENT] = math.nan  # what the command should cause, not what the drive reports
    if math.isnan(sample[THETA_M]):  # through the rigid gear: good enough for a limit
        sample[THETA_M], sample[OMEGA_M] = sample[THETA_L] / observer.ratio, sample[OMEGA_L] / observer.ratio
    observer_step(observer, memory.observer, sample, command, period, limits.torque_bandwidth)
    estimate = as_estimate(memory.observer.estimate)
    memory.watched_time += elapsed
    if memory.watched_time < limits.start_time:
        estimate[LOAD_TORQUE] = 0.0  # the first speeds have no earlier momentum
    weight = low_pass_gain(limits.torque_bandwidth, period)
    commanded = observer.torque_constant * estimate[CURRENT] / observer.ratio
    memory.commanded_torque += weight * (commanded - memory.commanded_torque)
    memory.drive_torque += weight * (memory.commanded_torque - memory.drive_torque)
    memory.unexplained_torque += weight * (estimate[LOAD_TORQUE] - memory.unexplained_torque)
    drive, torque = memory.drive_torque, memory.unexplained_torque
    return float(torque) if (drive + torque) * drive <= _FOLLOWS * drive**2 else 0.0


@compiled
def _ends(limits: MonitorConstants, memory: MonitorMemory, angle: float, details: FaultDetails) -> int:
    """Return the fault of a load angle (rad) beyond an end; a load that starts outside may only come in."""
    details.value = angle
    if memory.lower_end - angle > limits.soft_zone:
        return _LOWER_END
    if angle - memory.upper_end > limits.soft_zone:
        return _UPPER_END
    memory.lower_end = min(limits.lower_end, max(memory.lower_end, angle))
    memory.upper_end = max(limits.upper_end, min(memory.upper_end, angle))
    return _NONE


@compiled
def monitor_step(
    limits: MonitorConstants,
    observer: ObserverConstants,
    memory: MonitorMemory,
    measured: Measurement,
    command: float,
    elapsed: float,
    period: float,
    details: FaultDetails,
) -> int:
    """Take one sample and return its fault, a `Fault` as a number.

    Parameters
    ----------
    memory : updated in place
    command : in force since the previous sample, V or A
    elapsed : since the previous sample, s
    period : the same, or the nominal one if no sample is missing, s
    """
    if _too_fast(memory, observer.period, elapsed):
        details.value, details.bound = memory.mean_interval * observer.period, observer.period
        return _RATE
    elapsed, n = max(elapsed, observer.period), observer.ratio
    motor, load, before = n * measured[THETA_M], measured[THETA_L], memory.motor_angle
    found = _speed(limits, before, motor, n * measured[OMEGA_M], elapsed, details, _MOTOR_JUMP)
    if found == _NONE:
        found = _speed(limits, memory.load_angle, load, measured[OMEGA_L], elapsed, details, _LOAD_JUMP)
    memory.motor_angle, memory.load_angle = motor, load
    if found != _NONE:
        return found
    travel = _gap_travel(memory, motor - load, abs(motor - before))
    if travel > limits.gap:
        details.value, details.bound = travel, limits.gap
        return _DISAGREE
    torque = _unexplained_torque(limits, observer, memory, measured, command, elapsed, period)
    if abs(torque) > limits.held_torque:
        details.value, details.bound = abs(torque), limits.held_torque
        return _UNEXPLAINED_TORQUE
    return _ends(limits, memory, motor if math.isnan(load) else load, details)
