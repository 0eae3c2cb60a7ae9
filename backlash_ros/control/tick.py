"""One tick: the controller of one axis for one sample, compiled once for each law.

    monitor -> observer -> setpoint -> range -> law -> command

This is the only path from a sample to a command. The node, offline runs, learning runs and batches all call it.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.np.unsafe import ndarray as numba_arrays

from backlash_ros.control.command_range import RangeConstants, command_of, voltage_range
from backlash_ros.control.law import LawStep
from backlash_ros.control.monitoring.faults import DETAILS
from backlash_ros.control.monitoring.monitor import (
    MonitorConstants,
    monitor_memory,
    monitor_step,
    unexplained_torque,
)
from backlash_ros.control.monitoring.plausibility import (
    PlausibilityConstants,
    plausibility_memory,
    plausibility_step,
    settle_angles,
)
from backlash_ros.control.monitoring.tracking import departure, forget_tracking, tracking_memory
from backlash_ros.control.motion.moving_reference import (
    MotionConstants,
    forget_path,
    motion_memory,
    reference_setpoint,
)
from backlash_ros.control.motion.setpoint import evaluate, is_reference
from backlash_ros.control.observer import ObserverConstants, observer_memory, observer_step
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_M,
    POSITION,
    THETA_L,
    THETA_M,
    Estimate,
    Measurement,
    Setpoint,
    as_estimate,
    as_measurement,
    as_setpoint,
)
from backlash_ros.gates.faults import Fault

_NONE, _NOT_FINITE, _AWAY = int(Fault.NONE), int(Fault.NOT_FINITE), int(Fault.TRACKING)
_MOTOR_CURRENT, _MOTOR_SPEED, _LOAD_SPEED = (
    int(Fault.MOTOR_CURRENT),
    int(Fault.MOTOR_SPEED),
    int(Fault.LOAD_SPEED),
)

ELAPSED, OFFSET, TORQUE, KNOWN_LOAD_TORQUE, EXPERIMENTING = range(5)
"""The inputs of a tick beside the sample: time since the previous sample (s), an experiment's excitation (rad, N m),
the load torque if known (N m), else nan, and whether an experiment moves the load: 1, else 0."""
INPUTS = 5

MISSING = 1.5
"""Periods between two samples above which a sample between them is missing."""

COMMAND, FAULT, PLAN_TIME, LOW, HIGH = range(5)
"""Results of a tick in `TickMemory.out`: the command in force (V or A), the `Fault`, the time since the plan began, s,
the smallest and the largest voltage allowed to the law (V), then the fault's details."""
NOT_BEGUN = -1.0
"""Plan time that marks a plan as beginning with the next sample."""
_DETAILS = HIGH + 1


class TickConstants(NamedTuple):
    """Everything that a tick needs from drive, settings and limits; the law's constants are separate."""

    observer: ObserverConstants
    monitor: MonitorConstants
    plausibility: PlausibilityConstants
    range: RangeConstants
    motion: MotionConstants


to_fixed_tuple: Any = numba_arrays.to_fixed_tuple
_PARTS = (ObserverConstants, MonitorConstants, PlausibilityConstants, RangeConstants, MotionConstants)
_O, _M, _P, _R, _S = (len(part._fields) for part in _PARTS)


def pack(constants: TickConstants, *, watched: bool) -> Array:
    """Return the constants in one row, and at its end whether the monitor is on.

    A tick called from Python costs 0.7 us with one array and 4 us with as many numbers in named tuples.
    """
    return np.array([*(value for part in constants for value in part), float(watched)])


@compiled
def _unpack(packed: Array) -> TickConstants:
    """Return what `pack` packed; it costs nothing once compiled."""
    return TickConstants(
        ObserverConstants(*to_fixed_tuple(packed[:_O], _O)),
        MonitorConstants(*to_fixed_tuple(packed[_O : _O + _M], _M)),
        PlausibilityConstants(*to_fixed_tuple(packed[_O + _M : _O + _M + _P], _P)),
        RangeConstants(*to_fixed_tuple(packed[_O + _M + _P : _O + _M + _P + _R], _R)),
        MotionConstants(*to_fixed_tuple(packed[_O + _M + _P + _R : _O + _M + _P + _R + _S], _S)),
    )


_OBSERVER = 5
_MONITOR = _OBSERVER + observer_memory().size
_PLAUSIBILITY = _MONITOR + monitor_memory().size
_MOTION = _PLAUSIBILITY + plausibility_memory().size
_TRACKING = _MOTION + motion_memory().size
_SETPOINT = _TRACKING + tracking_memory().size
_OUT = _SETPOINT + 3


class TickMemory:
    """The memory of a tick, without the law's state: one array, ``row``, and views of its parts.

    ``used`` is the last `Measurement` as used, nan where implausible; ``observer`` begins with the `Estimate`;
    ``setpoint`` is the last `Setpoint`, including an experiment's offset; ``out`` has the results that `COMMAND` and
    the others index.
    """

    def __init__(self) -> None:
        self.row: Array = np.zeros(_OUT + _DETAILS + DETAILS)
        self.used = Measurement(self.row[:_OBSERVER])
        self.observer: Array = self.row[_OBSERVER:_MONITOR]
        self.monitor: Array = self.row[_MONITOR:_PLAUSIBILITY]
        self.plausibility: Array = self.row[_PLAUSIBILITY:_MOTION]
        self.motion: Array = self.row[_MOTION:_TRACKING]
        self.tracking: Array = self.row[_TRACKING:_SETPOINT]
        self.setpoint = Setpoint(self.row[_SETPOINT:_OUT])
        self.out: Array = self.row[_OUT:]
        self.forget()

    def forget(self) -> None:
        """Forget everything but the setpoint."""
        self.observer[:] = observer_memory()
        self.monitor[:] = monitor_memory()
        self.plausibility[:] = plausibility_memory()
        self.motion[:] = motion_memory()
        self.tracking[:] = tracking_memory()
        self.out[:] = 0.0
        self.out[PLAN_TIME] = NOT_BEGUN


def fault_details(memory: TickMemory) -> Array:
    """Return the values for the text of the last fault, shape (3,)."""
    return memory.out[_DETAILS:]


@compiled
def tick_estimate(memory: Array) -> Estimate:
    """Return the estimate in a tick's memory, as a view."""
    return as_estimate(memory[_OBSERVER : _OBSERVER + LOAD_TORQUE + 1])


@compiled
def tick_out(memory: Array) -> Array:
    """Return the results of a tick in its memory, see `COMMAND`, as a view."""
    return memory[_OUT:]


law_step: Callable[[Array, Array, Array, Array, float, float], float] = unbound


def _tick(
    packed: Array, memory: Array, law: Array, state: Array, segments: Array, measured: Measurement, inputs: Array
) -> float:
    """Take one sample and return the command, V or A; 0 if the sample shows a fault.

    Parameters
    ----------
    packed, memory : constants, from `pack`, and `TickMemory.row`
    law, state : constants and state of the law
    segments : the plan, as `setpoint.Source.segments` returns it; if its first coefficient is nan, hold the present
        position of the load
    inputs : see `ELAPSED` and the following
    """
    constants = _unpack(packed)
    used, observed, out = as_measurement(memory[:_OBSERVER]), memory[_OBSERVER:_MONITOR], memory[_OUT:]
    estimate, setpoint = tick_estimate(memory), as_setpoint(memory[_SETPOINT:_OUT])
    used[:] = measured
    nominal, before = constants.observer.period, out[COMMAND]
    elapsed = inputs[ELAPSED] if inputs[ELAPSED] > 0.0 else nominal  # nan, too
    # The nominal period, unless samples are missing: stamps jitter, the drive's period does not.
    period = elapsed if elapsed > MISSING * nominal else nominal
    out[COMMAND], out[FAULT] = 0.0, _NONE
    if math.isnan(used[THETA_M]) and math.isnan(used[THETA_L]):
        out[FAULT] = _NOT_FINITE
        return 0.0
    if packed[-1] != 0.0:
        signal = plausibility_step(
            constants.plausibility,
            constants.observer,
            memory[_PLAUSIBILITY:_MOTION],
            used,
            before,
            period,
            out[_DETAILS:],
        )
        if signal >= 0:
            out[FAULT] = _MOTOR_CURRENT if signal == CURRENT else _MOTOR_SPEED if signal == OMEGA_M else _LOAD_SPEED
            return 0.0
        fault = monitor_step(
            constants.monitor,
            constants.observer,
            memory[_MONITOR:_PLAUSIBILITY],
            used,
            before,
            elapsed,
            period,
            out[_DETAILS:],
        )
        if fault != _NONE:
            out[FAULT] = fault
            return 0.0
        settle_angles(constants.observer, memory[_PLAUSIBILITY:_MOTION], used, observed, period)
    observer_step(constants.observer, observed, used, before, period, constants.observer.torque_bandwidth)
    if not math.isnan(inputs[KNOWN_LOAD_TORQUE]):
        estimate[LOAD_TORQUE] = inputs[KNOWN_LOAD_TORQUE]
    if math.isnan(segments[0, 0]):
        segments[0, 0] = estimate[THETA_L]
    out[PLAN_TIME] = 0.0 if out[PLAN_TIME] < 0.0 else out[PLAN_TIME] + period
    if is_reference(segments):
        reference_setpoint(constants.motion, memory[_MOTION:_TRACKING], segments[0, 0], estimate, period, setpoint)
    else:
        forget_path(memory[_MOTION:_TRACKING])
        evaluate(segments, out[PLAN_TIME], setpoint)
    if packed[-1] != 0.0:
        tracking = memory[_TRACKING:_SETPOINT]
        if inputs[EXPERIMENTING] != 0.0:
            forget_tracking(tracking)
        away = departure(tracking, setpoint[POSITION], estimate, constants.motion.acceleration, period)
        torque = unexplained_torque(memory[_MONITOR:_PLAUSIBILITY])
        gives_way = constants.monitor.gives_way
        if math.isnan(used[THETA_M]):
            gives_way = max(gives_way, constants.monitor.sags)
        bound = constants.monitor.tracking + gives_way * abs(torque)
        if away > bound:
            out[FAULT], out[_DETAILS], out[_DETAILS + 1] = _AWAY, away, bound
            return 0.0
    if inputs[OFFSET] != 0.0:
        # Not beyond an end, unless the load is held there.
        planned, ends = setpoint[POSITION], constants.range
        beyond = min(max(planned + inputs[OFFSET], ends.lower_end), ends.upper_end)
        inputs[OFFSET] = min(max(beyond - planned, -abs(inputs[OFFSET])), abs(inputs[OFFSET]))
        setpoint[POSITION] += inputs[OFFSET]
    # An experiment's torque is subtracted from the range, so that both together stay within it.
    added = inputs[TORQUE] * constants.range.feedforward
    low, high = voltage_range(constants.range, estimate)
    out[LOW], out[HIGH] = low, high
    added = min(max(added, low), high) if added != 0.0 else 0.0
    voltage = law_step(law, state, estimate, setpoint, low - added, high - added) + added
    if not low <= voltage <= high and math.isfinite(voltage):  # a law stays in its range; this makes sure
        voltage = min(max(voltage, low), high)
    command = command_of(constants.range, estimate, voltage)
    total = command
    for value in observed:
        total += value
    for value in state:
        total += value
    if not math.isfinite(total):  # finite if and only if all are, except for sums beyond 1e308
        out[FAULT] = _NOT_FINITE
        return 0.0
    out[COMMAND] = command
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
