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
from typing import NamedTuple

import numpy as np

from backlash_ros.control import observer as observing
from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import (
    FOUND,
    GAPS_AWAY,
    FaultThresholds,
    mechanical_time_constant,
    pressed,
)
from backlash_ros.control.observer import ObserverConstants, low_pass_gain, observer_step
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
    Measurement,
    as_measurement,
)
from backlash_ros.gates.faults import Fault

_BANDWIDTHS = 5.0, 50.0
"""Range for the bandwidth of the two low-passes of the unexplained torque, rad/s: an impact is over before it counts, a
runaway is not, and the encoder counts of a slow drive cause no fault."""

_HELD = 0.9
"""Share of the standstill torque that a drive can hold against a load; beyond it the load is blocked."""

_FOLLOWS = 0.05
"""Smallest share of the drive's torque with which the momentum changes if only the parameters are wrong."""

_RATIO_ERROR = 0.02
"""Tolerance of the gear ratio: share of the travel by which the shafts may drift apart."""


_GROWS = 6.0
"""Factor by which a gap that will be learned again may have grown."""

_COUNT = 2 * math.pi / 2**12
"""Count of a coarse load encoder, rad."""


_RATE_SHARE, _WHILE, _LONGEST = 0.8, 0.1, 10.0
"""Share of the period: samples that come faster than this for a while, s, are those of a drive with another rate; and
the largest interval that counts, so that one long pause does not hide this."""


_NONE = int(Fault.NONE)
_MOTOR_JUMP, _LOAD_JUMP = int(Fault.MOTOR_JUMP), int(Fault.LOAD_JUMP)
_OVERSPEED = int(Fault.MOTOR_OVERSPEED) - _MOTOR_JUMP
_DISAGREE, _UNEXPLAINED_TORQUE = int(Fault.ENCODERS_DISAGREE), int(Fault.UNEXPLAINED_TORQUE)
_RATE = int(Fault.RATE)
_LOWER_END, _UPPER_END = int(Fault.LOWER_END), int(Fault.UPPER_END)


class MonitorConstants(NamedTuple):
    """Thresholds and ends as the compiled step reads them (rad, rad/s, N m); the torque's filter is in rad/s.

    ``gives_way``: how far a sudden load torque moves the load until the law holds it, rad per N m; ``sags``: how far it
    does for good, where the load's encoder alone is there, so that no load torque is found.
    """

    velocity: float
    held_torque: float
    gap: float
    tracking: float
    gives_way: float
    sags: float
    lower_end: float
    upper_end: float
    soft_zone: float
    torque_bandwidth: float
    start_time: float


def gives_way(drive: Drive) -> float:
    """Return how far a sudden load torque moves the load until the law holds it, rad per N m.

    It drives the motor back as far as it goes at the speed that the torque makes, in its mechanical time constant and
    the time in which a load torque is found.
    """
    motor = drive.motor
    speed = drive.gear.ratio * motor.voltage_limit / motor.torque_constant / drive.standstill_torque()
    return float(speed * (mechanical_time_constant(drive) + FOUND))


def monitor_constants(
    drive: Drive,
    limits: Limits,
    thresholds: FaultThresholds,
    period: float,
    velocity_bandwidth: float,
    backlash_angle: float,
    least_gain: float,
    *,
    may_grow: bool = False,
) -> MonitorConstants:
    """Return the monitor of one drive.

    A learned backlash (rad, > 0) lowers the gap threshold to 1.5 times the larger of it and the drive's own (because of
    eccentric encoders and a varying gap), plus the teeth's wind-up and two counts. With ``may_grow`` the factor is 6.
    ``least_gain``: the smaller one of both regions on the position, V/rad.
    """
    share = _GROWS if may_grow else 1.5
    known = share * max(backlash_angle, drive.gear.backlash_angle) + 2.0 * pressed(drive) + 2.0 * _COUNT
    gap = (max if may_grow else min)(thresholds.gap, known)
    own = 1.0 / mechanical_time_constant(drive)
    bandwidth = min(max(own, _BANDWIDTHS[0]), _BANDWIDTHS[1])
    return MonitorConstants(
        velocity=float(thresholds.velocity),
        held_torque=float(min(thresholds.load_torque, _HELD * drive.standstill_torque(limits.command))),
        gap=float(gap if backlash_angle > 0 else thresholds.gap),
        tracking=float(max(thresholds.tracking, GAPS_AWAY * backlash_angle)),
        gives_way=gives_way(drive),
        sags=float(max(drive.gear.ratio * drive.motor.resistance / drive.motor.torque_constant / least_gain, 0.0)),
        lower_end=float(limits.position_lower),
        upper_end=float(limits.position_upper),
        soft_zone=float(limits.soft_zone),
        torque_bandwidth=bandwidth,
        start_time=5.0 / velocity_bandwidth + 2.0 * period,
    )


_MOTOR, _LOAD, _NEAREST, _FARTHEST, _LOWER, _UPPER, _MAKES, _DRIVES, _UNEXPLAINED, _SEEN = range(10)
_ELAPSED = 10
_OBSERVER = 11
_SAMPLE = _OBSERVER + observing.MEMORY


def monitor_memory() -> Array:
    """Return the initial memory."""
    memory = np.zeros(_SAMPLE + 5)
    memory[[_MOTOR, _LOAD]] = math.nan
    memory[_ELAPSED] = 1.0
    memory[[_NEAREST, _FARTHEST, _LOWER, _UPPER]] = math.inf, -math.inf, -math.inf, math.inf
    return memory


def forget_ends(memory: Array) -> None:
    """Let a load outside new ends of the travel come back in."""
    memory[[_LOWER, _UPPER]] = -math.inf, math.inf


def keep_torque(observer: ObserverConstants, memory: Array) -> None:
    """Keep the torque estimate when the ``observer`` changes to another drive's."""
    observing.keep_estimate(observer, memory[_OBSERVER:_SAMPLE])


@compiled
def unexplained_torque(memory: Array) -> float:
    """Return the unexplained torque on the output shaft, N m: the load torque, if all is well."""
    return float(memory[_UNEXPLAINED])


@compiled
def _too_fast(period: float, memory: Array, elapsed: float) -> bool:
    """Return whether samples have come faster than their rate for a while; if slower, some may have been lost."""
    memory[_ELAPSED] += low_pass_gain(1.0 / _WHILE, period) * (min(elapsed / period, _LONGEST) - memory[_ELAPSED])
    return bool(memory[_ELAPSED] < _RATE_SHARE)


@compiled
def _speed(
    limits: MonitorConstants, before: float, angle: float, measured: float, elapsed: float, details: Array, jump: int
) -> int:
    """Return ``jump`` if an encoder moved too far, the next fault, overspeed, for a measured speed; at the output."""
    moved = abs(angle - before)
    # One count may be much in a short period. False for nan.
    if moved > limits.velocity * elapsed + limits.gap:
        details[0], details[1] = moved, elapsed
        return jump
    if abs(measured) > limits.velocity:
        details[0] = abs(measured)
        return jump + _OVERSPEED
    return _NONE


@compiled
def _gap_travel(memory: Array, apart: float, moved: float) -> float:
    """Return how far the shafts have moved apart (rad), less what a slightly wrong gear ratio explains."""
    if math.isnan(apart):
        return 0.0
    drift = 0.0 if math.isnan(moved) else _RATIO_ERROR * moved
    memory[_NEAREST] = min(memory[_NEAREST] + drift, apart)
    memory[_FARTHEST] = max(memory[_FARTHEST] - drift, apart)
    return float(memory[_FARTHEST] - memory[_NEAREST])


@compiled
def _unexplained_torque(
    limits: MonitorConstants,
    observer: ObserverConstants,
    memory: Array,
    measured: Measurement,
    command: float,
    elapsed: float,
    period: float,
) -> float:
    """Return the unexplained torque, N m; 0 if a wrong parameter may be the cause."""
    sample = as_measurement(memory[_SAMPLE : _SAMPLE + 5])
    sample[:] = measured
    sample[CURRENT] = math.nan  # what the command should cause, not what the drive reports
    if math.isnan(sample[THETA_M]):  # through the rigid gear: good enough for a limit
        sample[THETA_M], sample[OMEGA_M] = sample[THETA_L] / observer.ratio, sample[OMEGA_L] / observer.ratio
    seen = memory[_OBSERVER:_SAMPLE]
    observer_step(observer, seen, sample, command, period, limits.torque_bandwidth)
    memory[_SEEN] += elapsed
    if memory[_SEEN] < limits.start_time:
        seen[LOAD_TORQUE] = 0.0  # the first speeds have no earlier momentum
    weight = low_pass_gain(limits.torque_bandwidth, period)
    makes = observer.K_m * seen[CURRENT] / observer.ratio
    memory[_MAKES] += weight * (makes - memory[_MAKES])  # as the observer filters the torque that it finds
    memory[_DRIVES] += weight * (memory[_MAKES] - memory[_DRIVES])
    memory[_UNEXPLAINED] += weight * (seen[LOAD_TORQUE] - memory[_UNEXPLAINED])
    drives, torque = memory[_DRIVES], memory[_UNEXPLAINED]
    return float(torque) if (drives + torque) * drives <= _FOLLOWS * drives**2 else 0.0


@compiled
def _ends(limits: MonitorConstants, memory: Array, angle: float, details: Array) -> int:
    """Return the fault of a load angle (rad) beyond an end; a load that starts outside may only come in."""
    details[0] = angle
    if memory[_LOWER] - angle > limits.soft_zone:
        return _LOWER_END
    if angle - memory[_UPPER] > limits.soft_zone:
        return _UPPER_END
    memory[_LOWER] = min(limits.lower_end, max(memory[_LOWER], angle))
    memory[_UPPER] = max(limits.upper_end, min(memory[_UPPER], angle))
    return _NONE


@compiled
def monitor_step(
    limits: MonitorConstants,
    observer: ObserverConstants,
    memory: Array,
    measured: Measurement,
    command: float,
    elapsed: float,
    period: float,
    details: Array,
) -> int:
    """Take one sample and return its fault, a `Fault` as a number.

    Parameters
    ----------
    observer : of the drive; the monitor has its own, driven by what the command should cause
    memory : from `monitor_memory`, updated in place
    command : in force since the previous sample, V or A
    elapsed : since the previous sample, s
    period : the same, or the nominal one if no sample is missing, s
    details : shape (3,): values for the text of the fault
    """
    if _too_fast(observer.period, memory, elapsed):
        details[0], details[1] = memory[_ELAPSED] * observer.period, observer.period
        return _RATE
    elapsed = max(elapsed, observer.period)
    n = observer.ratio
    motor, load = n * measured[THETA_M], measured[THETA_L]
    before = memory[_MOTOR]
    found = _speed(limits, before, motor, n * measured[OMEGA_M], elapsed, details, _MOTOR_JUMP)
    if found == _NONE:
        found = _speed(limits, memory[_LOAD], load, measured[OMEGA_L], elapsed, details, _LOAD_JUMP)
    memory[_MOTOR], memory[_LOAD] = motor, load
    if found != _NONE:
        return found
    travel = _gap_travel(memory, motor - load, abs(motor - before))
    if travel > limits.gap:
        details[0], details[1] = travel, limits.gap
        return _DISAGREE
    torque = _unexplained_torque(limits, observer, memory, measured, command, elapsed, period)
    if abs(torque) > limits.held_torque:
        details[0], details[1] = abs(torque), limits.held_torque
        return _UNEXPLAINED_TORQUE
    return _ends(limits, memory, motor if math.isnan(load) else load, details)
