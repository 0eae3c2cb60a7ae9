"""One tick: the controller of one axis for one sample, compiled once for each law.

    monitor -> observer -> setpoint -> range -> law -> command

This is the only path from a sample to a command. The node, offline runs, learning runs and batches all call it.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numba

from backlash_ros.control.command_range import RangeConstants, clamp, command_of, voltage_range
from backlash_ros.control.law import LawStep
from backlash_ros.control.monitoring.bounds import MonitorConstants
from backlash_ros.control.monitoring.fault_texts import FaultDetails
from backlash_ros.control.monitoring.monitor import MonitorMemory, monitor_step
from backlash_ros.control.monitoring.plausibility import (
    PlausibilityConstants,
    PlausibilityMemory,
    plausibility_step,
    settle_angles,
)
from backlash_ros.control.monitoring.tracking import TrackingMemory, departure, forget_tracking
from backlash_ros.control.motion.moving_reference import (
    MotionConstants,
    MotionMemory,
    forget_path,
    reference_path,
)
from backlash_ros.control.motion.setpoint import AHEAD, Cursor, Pace, go_at, is_reference, look_ahead
from backlash_ros.control.observer import ObserverConstants, ObserverMemory, observer_step
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array, Record, cells, part, view_of
from backlash_ros.foundation.signals import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_M,
    POSITION,
    THETA_L,
    THETA_M,
    Estimate,
    Measurement,
    as_estimate,
    as_measurement,
)
from backlash_ros.gates.faults import Fault

_NONE, _NOT_FINITE, _AWAY = int(Fault.NONE), int(Fault.NOT_FINITE), int(Fault.TRACKING)
_MOTOR_CURRENT = int(Fault.MOTOR_CURRENT)
_MOTOR_SPEED, _LOAD_SPEED = int(Fault.MOTOR_SPEED), int(Fault.LOAD_SPEED)

MISSING = 1.5
"""Periods between two samples above which a sample between them is missing."""
NOT_BEGUN = -1.0
"""Plan time that marks a plan as beginning with the next sample."""


class TickConstants(Record):
    """Everything that a tick needs from drive, settings and limits; the law's constants are separate."""

    observer: ObserverConstants = part(ObserverConstants)
    monitor: MonitorConstants = part(MonitorConstants)
    plausibility: PlausibilityConstants = part(PlausibilityConstants)
    range: RangeConstants = part(RangeConstants)
    motion: MotionConstants = part(MotionConstants)
    watched: float = 1.0  # 0 while the monitor is off


class Inputs(Record):
    """The inputs of a tick beside the sample."""

    elapsed: float = 0.0  # s, since the previous sample
    offset: float = 0.0  # rad, an experiment's, on the setpoint; the tick keeps it within the travel
    torque: float = 0.0  # N m, an experiment's, at the output
    known_load_torque: float = math.nan  # N m, nan if it is not known
    experimenting: float = 0.0  # 1 while an experiment moves the load
    pace: float = 1.0  # 0 to 1, wanted: how fast time goes on along the plan


class Results(Record):
    """The results of a tick."""

    command: float = 0.0  # V or A, in force
    fault: float = 0.0  # a `Fault`
    plan_time: float = NOT_BEGUN  # s, since the plan began, by its own pace
    low: float = 0.0  # V, the smallest voltage that the law was allowed
    high: float = 0.0  # V, the largest one
    details: FaultDetails = part(FaultDetails)


class TickMemory(Record):
    """What a tick remembers, without the law's state."""

    used: Array = cells(5)  # the last `Measurement` as used: nan where implausible
    observer: ObserverMemory = part(ObserverMemory)
    monitor: MonitorMemory = part(MonitorMemory)
    plausibility: PlausibilityMemory = part(PlausibilityMemory)
    motion: MotionMemory = part(MotionMemory)
    tracking: TrackingMemory = part(TrackingMemory)
    setpoint: Array = cells(3)  # the last `Setpoint`, with an experiment's offset
    path: Array = cells(AHEAD, 3)  # that and those of the next samples, as far as they are known
    cursor: Cursor = part(Cursor)
    pace: Pace = part(Pace)
    results: Results = part(Results)


tick_constants_at, tick_memory_at, inputs_at = view_of(TickConstants), view_of(TickMemory), view_of(Inputs)


@compiled
def _find_fault(
    constants: TickConstants, memory: TickMemory, used: Measurement, command: float, elapsed: float, period: float
) -> int:
    """Return the fault that the monitor finds in a sample; replace implausible values in ``used``."""
    observer, details = constants.observer, memory.results.details
    signal = plausibility_step(constants.plausibility, observer, memory.plausibility, used, command, period, details)
    if signal >= 0:
        return _MOTOR_CURRENT if signal == CURRENT else _MOTOR_SPEED if signal == OMEGA_M else _LOAD_SPEED
    fault = monitor_step(constants.monitor, observer, memory.monitor, used, command, elapsed, period, details)
    if fault == _NONE:
        settle_angles(observer.ratio, memory.plausibility, used, memory.observer, period)
    return fault


@compiled
def _plan_setpoint(
    constants: MotionConstants,
    memory: TickMemory,
    segments: Array,
    estimate: Estimate,
    wanted_pace: float,
    period: float,
    nominal: float,
) -> None:
    """Write the setpoint of this sample and the path; a plan that has yet to begin holds the load where it is.

    ``period``: since the previous sample, s; ``nominal``: between two samples.
    """
    results, pace = memory.results, memory.pace
    if math.isnan(segments[0, 0]):
        segments[0, 0] = estimate[THETA_L]
    if results.plan_time < 0.0:
        memory.cursor.row, memory.cursor.begins = 0.0, 0.0
        pace.now, pace.rate = 1.0, 0.0
        results.plan_time = 0.0
    else:
        results.plan_time += go_at(pace, wanted_pace, period)
    if is_reference(segments):
        reference_path(constants, memory.motion, segments[0, 0], estimate, period, nominal, memory.path[:])
    else:
        forget_path(memory.motion)
        time = results.plan_time
        look_ahead(segments, memory.cursor, pace, wanted_pace, constants.acceleration, time, nominal, memory.path)
    memory.setpoint[:] = memory.path[0]


@compiled
def _goes_away(
    constants: TickConstants, memory: TickMemory, estimate: Estimate, experimenting: bool, period: float
) -> bool:
    """Return whether the load has left its reference by more than load torques explain."""
    monitor, tracking, details = constants.monitor, memory.tracking, memory.results.details
    if experimenting:
        forget_tracking(tracking)
    away = departure(tracking, memory.setpoint[POSITION], estimate, constants.motion.acceleration, period)
    gives_way = monitor.gives_way
    # With the load's encoder alone no load torque is found, and the law holds against it by an error.
    if math.isnan(memory.used[THETA_M]):
        gives_way = max(gives_way, monitor.sags)
    bound = monitor.tracking + gives_way * abs(memory.monitor.unexplained_torque)
    if not away > bound:
        return False
    details.value, details.bound = away, bound
    return True


@compiled
def _add_offset(ends: RangeConstants, memory: TickMemory, inputs: Inputs) -> None:
    """Add an experiment's offset to the path: not beyond an end, unless the load is held there."""
    planned, largest = memory.setpoint[POSITION], abs(inputs.offset)
    beyond = min(max(planned + inputs.offset, ends.lower_end), ends.upper_end)
    inputs.offset = min(max(beyond - planned, -largest), largest)
    memory.setpoint[POSITION] += inputs.offset
    for k in range(memory.path.shape[0]):
        memory.path[k, POSITION] += inputs.offset


@compiled
def _all_finite(observer: ObserverMemory, state: Array, command: float) -> bool:
    """Return whether command, observer and law have only finite numbers; not if they add up to more than 1e308."""
    total = command + observer.started + observer.momentum
    for value in observer.estimate:
        total += value
    for value in state:
        total += value
    return math.isfinite(total)


law_step: Callable[[Array, Array, Array, Array, float, float], float] = unbound


def _tick(
    constants_row: Array,
    memory_row: Array,
    law: Array,
    state: Array,
    segments: Array,
    measured: Measurement,
    inputs_row: Array,
) -> float:
    """Take one sample and return the command, V or A; 0 if the sample shows a fault.

    Parameters
    ----------
    constants_row, memory_row, inputs_row : `TickConstants`, `TickMemory` and `Inputs`
    law, state : constants and state of the law
    segments : the plan, as `setpoint.Source.segments` returns it; if its first coefficient is nan, hold the present
        position of the load
    """
    constants, memory, inputs = tick_constants_at(constants_row), tick_memory_at(memory_row), inputs_at(inputs_row)
    observer, results, watched = constants.observer, memory.results, constants.watched != 0.0
    used, estimate = as_measurement(memory.used), as_estimate(memory.observer.estimate)
    used[:] = measured
    before = results.command
    elapsed = inputs.elapsed if inputs.elapsed > 0.0 else observer.period  # nan, too
    # The nominal period, unless samples are missing: stamps jitter, the drive's period does not.
    period = elapsed if elapsed > MISSING * observer.period else observer.period
    results.command, results.fault = 0.0, _NONE
    if math.isnan(used[THETA_M]) and math.isnan(used[THETA_L]):
        results.fault = _NOT_FINITE
        return 0.0
    if watched:
        results.fault = _find_fault(constants, memory, used, before, elapsed, period)
        if results.fault != _NONE:
            return 0.0
    observer_step(observer, memory.observer, used, before, period, observer.torque_bandwidth)
    if not math.isnan(inputs.known_load_torque):
        estimate[LOAD_TORQUE] = inputs.known_load_torque
    _plan_setpoint(constants.motion, memory, segments, estimate, inputs.pace, period, observer.period)
    if watched and _goes_away(constants, memory, estimate, inputs.experimenting != 0.0, period):
        results.fault = _AWAY
        return 0.0
    if inputs.offset != 0.0:
        _add_offset(constants.range, memory, inputs)
    low, high = voltage_range(constants.range, estimate)
    results.low, results.high = low, high
    # An experiment's torque is subtracted from the range, so that both together stay within it.
    added = inputs.torque * constants.range.feedforward
    added = clamp(added, low, high) if added != 0.0 else 0.0
    voltage = law_step(law, state, estimate, memory.path[:], low - added, high - added) + added
    # A law stays in its range; this makes sure of it.
    if not low <= voltage <= high and math.isfinite(voltage):
        voltage = clamp(voltage, low, high)
    command = command_of(constants.range, estimate, voltage)
    if not _all_finite(memory.observer, state, command):
        results.fault = _NOT_FINITE
        return 0.0
    results.command = command
    return command


Tick = Callable[[Array, Array, Array, Array, Array, Measurement, Array], float]


_types: Any = numba.types
_row, _table = _types.float64[::1], _types.float64[:, ::1]
TICK_SIGNATURE = _types.float64(_row, _row, _row, _row, _table, _row, _row)
"""numba's signature of `Tick`."""


@cache
def tick_with(step: LawStep) -> Tick:
    """Return the tick with one law's step in it, compiled for `TICK_SIGNATURE`."""
    return specialize(_tick, TICK_SIGNATURE, law_step=step)
