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

from backlash_ros.control.command_range import RangeConstants, command_of, range_constants, voltage_range
from backlash_ros.control.law import LawStep
from backlash_ros.control.limits import Limits
from backlash_ros.control.monitor import (
    DETAILS,
    Fault,
    MonitorConstants,
    monitor_constants,
    monitor_memory,
    monitor_step,
)
from backlash_ros.control.observer import ObserverConstants, observer_constants, observer_memory, observer_step
from backlash_ros.control.setpoint import evaluate
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.compiled import specialize
from backlash_ros.drivetrain.signals import (
    LOAD_TORQUE,
    POSITION,
    THETA_L,
    THETA_M,
    Array,
    Measurement,
)

_NONE, _NOT_FINITE = int(Fault.NONE), int(Fault.NOT_FINITE)

ELAPSED, OFFSET, TORQUE, KNOWN_LOAD_TORQUE = range(4)
"""The inputs of a tick beside the sample: time since the sample before (s), what an experiment asks for (rad, N m), and
the load torque where it is known (N m), else nan."""
INPUTS = 4

COMMAND, FAULT, PLAN_TIME = range(3)
"""What a tick leaves in `TickMemory.out`: the command in force (V or A), the `Fault`, the time since the plan began (s).
After them come the fault's details."""
_DETAILS = 3


class TickConstants(NamedTuple):
    """One choice of everything that a tick takes from drive, settings and limits; the law's constants go beside it."""

    observer: ObserverConstants
    monitor: MonitorConstants
    monitor_observer: ObserverConstants
    range: RangeConstants
    watched: bool


class TickMemory(NamedTuple):
    """What a tick remembers, without the law's state; all of it is updated in place.

    ``observer`` begins with the `Estimate`; ``setpoint`` is the last `Setpoint`, an experiment's offset in it.
    """

    observer: Array
    monitor: Array
    setpoint: Array
    out: Array


def tick_memory() -> TickMemory:
    """Return the memory of a tick that has seen nothing."""
    return TickMemory(observer_memory(), monitor_memory(), np.zeros(3), np.zeros(_DETAILS + DETAILS))


def fault_details(memory: TickMemory) -> Array:
    """Return what the text of the last fault needs, shape (3,)."""
    return memory.out[_DETAILS:]


def law_step(_law: Array, _state: Array, _estimate: Array, _setpoint: Array, _low: float, _high: float) -> float:
    """Stand for the step of a law, which `tick_with` puts in its place."""
    raise NotImplementedError


def _tick(
    constants: TickConstants,
    memory: TickMemory,
    law: Array,
    state: Array,
    segments: Array,
    measured: Measurement,
    inputs: Array,
) -> float:
    """Take one sample and return the command, V or A; 0 where the sample shows a fault.

    Parameters
    ----------
    law, state : constants and state of the law
    segments : the plan, as `setpoint.Source.segments` returns it; its first coefficient nan: hold the position at which
        the load is found
    inputs : see `ELAPSED` and what follows it
    """
    out, estimate = memory.out, memory.observer[: LOAD_TORQUE + 1]
    nominal, elapsed, before = constants.observer.period, inputs[ELAPSED], out[COMMAND]
    # The nominal period, unless samples are missing: stamps jitter, beats do not.
    period = elapsed if elapsed > 1.5 * nominal else nominal
    out[COMMAND], out[FAULT] = 0.0, _NONE
    if math.isnan(measured[THETA_M]) and math.isnan(measured[THETA_L]):
        out[FAULT] = _NOT_FINITE
        return 0.0
    if constants.watched:
        fault = monitor_step(
            constants.monitor,
            constants.monitor_observer,
            memory.monitor,
            measured,
            before,
            max(elapsed, nominal),
            period,
            out[_DETAILS:],
        )
        if fault != _NONE:
            out[FAULT] = fault
            return 0.0
    observer_step(constants.observer, memory.observer, measured, before, period)
    if not math.isnan(inputs[KNOWN_LOAD_TORQUE]):
        estimate[LOAD_TORQUE] = inputs[KNOWN_LOAD_TORQUE]
    if math.isnan(segments[0, 0]):
        limits = constants.range
        segments[0, 0] = min(max(estimate[THETA_L], limits.lower_end), limits.upper_end)
    evaluate(segments, out[PLAN_TIME], memory.setpoint)
    out[PLAN_TIME] += period
    memory.setpoint[POSITION] += inputs[OFFSET]
    # What an experiment adds is taken off the range: the law and it together keep to it.
    added = inputs[TORQUE] * constants.range.feedforward
    low, high = voltage_range(constants.range, estimate)
    added = min(max(added, low), high) if added != 0.0 else 0.0
    voltage = law_step(law, state, estimate, memory.setpoint, low - added, high - added) + added
    command = command_of(constants.range, estimate, voltage)
    total = command
    for value in memory.observer:
        total += value
    for value in state:
        total += value
    if not math.isfinite(total):  # finite if and only if all are, but for sums beyond 1e308
        out[FAULT] = _NOT_FINITE
        return 0.0
    out[COMMAND] = command
    return command


Tick = Callable[[TickConstants, TickMemory, Array, Array, Array, Measurement, Array], float]


def _signature() -> Any:
    """Return numba's signature of `Tick`, from the values that it is called with."""
    drive = NOMINAL_DRIVE
    limits = Limits.of(drive)
    observer = observer_constants(drive, 1.0, velocity_bandwidth=1.0, torque_bandwidth=1.0)
    constants = TickConstants(
        observer, *monitor_constants(drive, limits, 1.0, 1.0), range_constants(drive, limits), watched=True
    )
    types: Any = numba.types
    flat, table = types.float64[::1], types.float64[:, ::1]
    typeof: Any = numba.typeof
    return types.float64(typeof(constants), typeof(tick_memory()), flat, flat, table, flat, flat)


TICK_SIGNATURE = _signature()


@cache
def tick_with(step: LawStep) -> Tick:
    """Return the tick with one law's step in it, compiled for `TICK_SIGNATURE`."""
    return specialize(_tick, TICK_SIGNATURE, law_step=step)
