"""Whether the drive does what its parameters say, sample by sample: thresholds, and the fault that is beyond them.

Pure computation, compiled into the tick. Four things are watched, each with a threshold of its own: the speed of either
shaft (an encoder that jumps moves faster than any motor), how far both shafts have moved apart (an encoder that stands
still or counts backwards), the torque that the momentum of both shafts does not explain (a motor that does not follow
its command, a load that is blocked, encoders that both stand still), and the ends of the travel.

The unexplained torque U is that of `observer`, with what the motor should make as the drive's torque D. It is held
against its limit only where the momentum goes the way of the load torque, (D + U) D <= 0.05 D^2. So a wrong inertia,
resistance or torque constant, which changes by what factor the momentum follows D, is no fault at any torque.

What passes: whatever looks like a load torque within the limit, that is encoders that both stand still (the only one,
where there is one), a blocked load or a dead motor while the command stays small, and a command or encoders of the
wrong sign until it has grown; ``faults.load_torque`` lowered to what the axis has to hold finds them that much sooner.
An encoder that stands still with its shaft. The only encoder that jumps by less than ``faults.gap`` and one sample's
way at ``faults.velocity``. A gear that slips by less than 2 % of the travel. Angles that stand still while their
measured speeds are right.

With one encoder the gap is not seen, and the momentum is that of a rigid gear: a drive that hammers from flank to
flank (the load encoder alone under a current: nothing damps the motor in the gap) and whose load is a quarter of what
its inertia says may look like a fault.
"""

import math
from typing import NamedTuple

import numpy as np

from backlash_ros.control import observer as observing
from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import (
    FaultThresholds,
    mechanical_time_constant,
    pressed,
)
from backlash_ros.control.observer import ObserverConstants, low_pass_gain, observer_step
from backlash_ros.drivetrain import Drive, compiled
from backlash_ros.drivetrain.signals import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    OMEGA_M,
    THETA_L,
    THETA_M,
    Array,
    Measurement,
    as_measurement,
)
from backlash_ros.gates.faults import Fault

_BANDWIDTHS = 5.0, 50.0
"""Of the two low-passes of the torque that is held against its limit, rad/s, within which the drive's own one is taken:
an impact is over before it counts, a runaway is not; counts of an encoder on a slow drive are none."""

_HELD = 0.9
"""Share of the torque at standstill that a drive can hold against a load at all; beyond it the load is blocked."""

_FOLLOWS = 0.05
"""Share of the drive's torque by which the momentum at least changes where only its parameters are wrong."""

_RATIO_ERROR = 0.02
"""Of the gear ratio: of so much of the travel the shafts may come apart without end."""


_GROWS = 6.0
"""Times as wide as it was learned, to which a gap may grow that is to be learned anew."""

_COUNT = 2 * math.pi / 2**12
"""Of a coarse load encoder, rad."""


_RATE_SHARE, _WHILE, _LONGEST = 0.8, 0.1, 10.0
"""Of the period: samples that come faster for a while, s, are those of a drive with another rate; and what counts at
most, so that one long pause does not hide it."""


_NONE = int(Fault.NONE)
_MOTOR_JUMP, _LOAD_JUMP = int(Fault.MOTOR_JUMP), int(Fault.LOAD_JUMP)
_OVERSPEED = int(Fault.MOTOR_OVERSPEED) - _MOTOR_JUMP
_DISAGREE, _UNEXPLAINED_TORQUE = int(Fault.ENCODERS_DISAGREE), int(Fault.UNEXPLAINED_TORQUE)
_RATE = int(Fault.RATE)
_LOWER_END, _UPPER_END = int(Fault.LOWER_END), int(Fault.UPPER_END)


class MonitorConstants(NamedTuple):
    """Thresholds and ends as the compiled step reads them (rad, rad/s, N m); the found torque's filter is in rad/s."""

    velocity: float
    held_torque: float
    gap: float
    lower_end: float
    upper_end: float
    soft_zone: float
    torque_bandwidth: float
    start_time: float


def monitor_constants(
    drive: Drive,
    limits: Limits,
    thresholds: FaultThresholds,
    period: float,
    velocity_bandwidth: float,
    backlash_angle: float,
    *,
    may_grow: bool = False,
) -> MonitorConstants:
    """Return the monitor of one drive.

    A backlash that was learned (rad, > 0) narrows the gap: one and a half of the larger of that and the drive's own
    (eccentric encoders, a gap that varies), the teeth pressed in, and two counts. One that ``may_grow`` widens it, to
    six of them.
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
    """Return a monitor that has seen nothing."""
    memory = np.zeros(_SAMPLE + 5)
    memory[[_MOTOR, _LOAD]] = math.nan
    memory[_ELAPSED] = 1.0
    memory[[_NEAREST, _FARTHEST, _LOWER, _UPPER]] = math.inf, -math.inf, -math.inf, math.inf
    return memory


def forget_ends(memory: Array) -> None:
    """Let who is outside of new ends of the travel come back in."""
    memory[[_LOWER, _UPPER]] = -math.inf, math.inf


def keep_torque(observer: ObserverConstants, memory: Array) -> None:
    """Let the torque that was found go on where the ``observer`` is another drive's."""
    observing.keep_estimate(observer, memory[_OBSERVER:_SAMPLE])


def unexplained_torque(memory: Array) -> float:
    """Return the torque on the output shaft that the drive does not explain, N m: a load torque, where all is well."""
    return float(memory[_UNEXPLAINED])


@compiled
def _too_fast(period: float, memory: Array, elapsed: float) -> bool:
    """Whether samples have come faster than their rate for a while; slower ones may have been lost on the way."""
    memory[_ELAPSED] += low_pass_gain(1.0 / _WHILE, period) * (min(elapsed / period, _LONGEST) - memory[_ELAPSED])
    return bool(memory[_ELAPSED] < _RATE_SHARE)


@compiled
def _speed(
    limits: MonitorConstants, before: float, angle: float, measured: float, elapsed: float, details: Array, jump: int
) -> int:
    """Return ``jump`` for an encoder that moved too far, the overspeed after it for a measured speed; at the output."""
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
    """Return how far the shafts have moved apart (rad), less what a gear ratio that is slightly off explains."""
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
    """Return the torque that the drive does not explain, N m; 0 where it may be a wrong parameter."""
    sample = as_measurement(memory[_SAMPLE : _SAMPLE + 5])
    sample[:] = measured
    sample[CURRENT] = math.nan  # what the command should make, not what the drive reports
    if math.isnan(sample[THETA_M]):  # through the rigid gear: good enough for a limit
        sample[THETA_M], sample[OMEGA_M] = sample[THETA_L] / observer.ratio, sample[OMEGA_L] / observer.ratio
    seen = memory[_OBSERVER:_SAMPLE]
    observer_step(observer, seen, sample, command, period, limits.torque_bandwidth)
    memory[_SEEN] += elapsed
    if memory[_SEEN] < limits.start_time:
        seen[LOAD_TORQUE] = 0.0  # the first speeds have no momentum before them
    weight = low_pass_gain(limits.torque_bandwidth, period)
    makes = observer.K_m * seen[CURRENT] / observer.ratio
    memory[_MAKES] += weight * (makes - memory[_MAKES])  # as the observer filters the torque that it finds
    memory[_DRIVES] += weight * (memory[_MAKES] - memory[_DRIVES])
    memory[_UNEXPLAINED] += weight * (seen[LOAD_TORQUE] - memory[_UNEXPLAINED])
    drives, torque = memory[_DRIVES], memory[_UNEXPLAINED]
    return float(torque) if (drives + torque) * drives <= _FOLLOWS * drives**2 else 0.0


@compiled
def _ends(limits: MonitorConstants, memory: Array, angle: float, details: Array) -> int:
    """Return the fault of a load angle (rad) beyond an end; who starts outside may come back in, and not out again."""
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
    """Take one sample and return the fault that it shows, a `Fault` as a number.

    Parameters
    ----------
    observer : of the drive; the monitor has one of its own, by what the command should make
    memory : from `monitor_memory`, updated in place
    command : in force since the sample before, V or A
    elapsed : since the sample before, s
    period : the same, or the nominal one where no sample is missing, s
    details : shape (3,): what the text of the fault needs
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
