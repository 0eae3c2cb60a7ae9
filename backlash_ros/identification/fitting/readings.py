"""How the readings of a sample correct the filter: first the motor's, then the load's."""

import math
from typing import NamedTuple

from backlash_ros.foundation.compiled import fused
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.memory import (
    COUNT,
    WIDE,
    Memory,
    Noise,
    Results,
    Rows,
    State,
    columns_at,
)
from backlash_ros.identification.fitting.parameters import PARAMETERS

_LEAST_VARIANCE = 0.25
"""Least variance of what is expected of the load, in that of its reading alone: it must stay above 0."""
_INTO_TEETH = 0.2
"""How far beyond the gap, in half gaps, a shaft without a reading may be left by the other one's reading."""


class Miss(NamedTuple):
    """How far the motor's reading was off, rad, with which ``variance``, rad^2.

    ``shared``: the covariance with the load's reading, rad^2, since the times of both readings are off by the same.
    """

    angle: float
    variance: float
    shared: float


NO_READING = Miss(0.0, 1.0, 0.0)


@fused
def _subtract(rows: Rows, gain: State, seen: Array, columns: int) -> None:
    """Take out of the rows what a reading says of them: the ``gain`` of each state times a row ``seen``."""
    for j in range(columns):
        rows.motor_angle[j] -= gain.motor_angle * seen[j]
        rows.motor_speed[j] -= gain.motor_speed * seen[j]
        rows.drive_torque[j] -= gain.drive_torque * seen[j]
        rows.load_angle[j] -= gain.load_angle * seen[j]
        rows.load_speed[j] -= gain.load_speed * seen[j]


@fused
def _correct(state: State, gain: State, miss: float) -> None:
    """Correct the motion by the ``gain`` of each state times a miss, rad."""
    state.motor_angle += gain.motor_angle * miss
    state.motor_speed += gain.motor_speed * miss
    state.drive_torque += gain.drive_torque * miss
    state.load_angle += gain.load_angle * miss
    state.load_speed += gain.load_speed * miss


@fused
def _record(results: Results, sample: int, encoder: int, miss: float, variance: float) -> float:
    """Write an innovation and the logarithm of its variance; return its standard deviation's reciprocal, 1/rad."""
    deviation = 1.0 / math.sqrt(variance)
    results.innovations[sample, encoder] = miss * deviation
    results.logs[sample, encoder] = math.log(variance)
    return deviation


@fused
def _record_slopes(results: Results, sample: int, encoder: int, seen: Array, deviation: float) -> None:
    """Write the derivatives of an innovation, from the row of what was read."""
    for j in range(PARAMETERS):
        results.derivatives[sample, encoder, j] = -seen[COUNT + j] * deviation


@fused
def no_gain(gain: State) -> None:
    """Let no state follow the motor's reading."""
    gain.motor_angle = gain.motor_speed = gain.drive_torque = gain.load_angle = gain.load_speed = 0.0


@fused
def read_motor(memory: Memory, noise: Noise, results: Results, reading: float, sample: int, derive: bool) -> Miss:
    """Correct covariance and derivatives by the motor's reading, rad, and write its innovation."""
    rows, gain, state, first = memory.rows, memory.gain, memory.state, memory.first
    w, v = state.motor_speed, state.load_speed
    variance = columns_at(rows.motor_angle).state.motor_angle + noise.motor_reading + noise.timing * w * w
    miss = reading - state.motor_angle
    columns = WIDE if derive else COUNT
    for j in range(columns):
        first[j] = rows.motor_angle[j]
    gain.motor_angle = columns_at(rows.motor_angle).state.motor_angle / variance
    gain.motor_speed = columns_at(rows.motor_speed).state.motor_angle / variance
    gain.drive_torque = columns_at(rows.drive_torque).state.motor_angle / variance
    gain.load_angle = columns_at(rows.load_angle).state.motor_angle / variance
    gain.load_speed = columns_at(rows.load_speed).state.motor_angle / variance
    _subtract(rows, gain, first, columns)
    deviation = _record(results, sample, 0, miss, variance)
    if derive:
        _record_slopes(results, sample, 0, first, deviation)
    return Miss(miss, variance, noise.timing * w * v)


@fused
def _expect_load(memory: Memory, noise: Noise, miss: Miss, speed: float) -> float:
    """Return the variance of the load's reading, rad^2, and set the gain of each state; ``speed`` before the sample."""
    rows, by_motor, gain = memory.rows, memory.gain, memory.load_gain
    scale, reading, shared = memory.model.scale, noise.load_reading, miss.shared
    rho = shared / miss.variance
    plain = scale * scale * columns_at(rows.load_angle).state.load_angle + reading + noise.timing * speed * speed
    expected = plain - rho * shared - 2.0 * scale * by_motor.load_angle * shared
    expected = max(expected, _LEAST_VARIANCE * reading)
    gain.motor_angle = (
        scale * columns_at(rows.motor_angle).state.load_angle - by_motor.motor_angle * shared
    ) / expected
    gain.motor_speed = (
        scale * columns_at(rows.motor_speed).state.load_angle - by_motor.motor_speed * shared
    ) / expected
    gain.drive_torque = (
        scale * columns_at(rows.drive_torque).state.load_angle - by_motor.drive_torque * shared
    ) / expected
    gain.load_angle = (scale * columns_at(rows.load_angle).state.load_angle - by_motor.load_angle * shared) / expected
    gain.load_speed = (scale * columns_at(rows.load_speed).state.load_angle - by_motor.load_speed * shared) / expected
    return float(expected)


@fused
def read_load(
    memory: Memory, noise: Noise, results: Results, miss: Miss, reading: tuple[float, float], sample: int, derive: bool
) -> None:
    """Correct motion, covariance and derivatives by the load's reading, and write its innovation.

    Parameters
    ----------
    miss : of the motor's reading, which has corrected the motion already
    reading : the angle, rad, and the load's speed before the motor's reading, rad/s
    """
    rows, gain, state, first, second = memory.rows, memory.load_gain, memory.state, memory.first, memory.second
    scale, rho, along = memory.model.scale, miss.shared / miss.variance, state.load_angle - memory.start
    off = reading[0] - (state.load_angle + (scale - 1.0) * along) - rho * miss.angle
    expected = _expect_load(memory, noise, miss, reading[1])
    if derive:
        for j in range(COUNT, WIDE):
            second[j] = scale * rows.load_angle[j] - rho * first[j]
        columns_at(second).parameter.load_scale_error += along
    seen = columns_at(second).state
    seen.motor_angle, seen.motor_speed = gain.motor_angle * expected, gain.motor_speed * expected
    seen.drive_torque = gain.drive_torque * expected
    seen.load_angle, seen.load_speed = gain.load_angle * expected, gain.load_speed * expected
    _subtract(rows, gain, second, WIDE if derive else COUNT)
    deviation = _record(results, sample, 1, off, expected)
    if derive:
        _record_slopes(results, sample, 1, second, deviation)
    _correct(state, gain, off)


@fused
def correct_by_motor(memory: Memory, miss: Miss) -> None:
    """Correct the motion by the motor's reading."""
    _correct(memory.state, memory.gain, miss.angle)


@fused
def keep_symmetric(rows: Rows) -> None:
    """Make the covariance symmetric again: while one shaft is not read, rounding errors apart would grow."""
    p, w = columns_at(rows.motor_angle).state, columns_at(rows.motor_speed).state
    tau, q, v = (
        columns_at(rows.drive_torque).state,
        columns_at(rows.load_angle).state,
        columns_at(rows.load_speed).state,
    )
    p.motor_speed = w.motor_angle = 0.5 * (p.motor_speed + w.motor_angle)
    p.drive_torque = tau.motor_angle = 0.5 * (p.drive_torque + tau.motor_angle)
    p.load_angle = q.motor_angle = 0.5 * (p.load_angle + q.motor_angle)
    p.load_speed = v.motor_angle = 0.5 * (p.load_speed + v.motor_angle)
    w.drive_torque = tau.motor_speed = 0.5 * (w.drive_torque + tau.motor_speed)
    w.load_angle = q.motor_speed = 0.5 * (w.load_angle + q.motor_speed)
    w.load_speed = v.motor_speed = 0.5 * (w.load_speed + v.motor_speed)
    tau.load_angle = q.drive_torque = 0.5 * (tau.load_angle + q.drive_torque)
    tau.load_speed = v.drive_torque = 0.5 * (tau.load_speed + v.drive_torque)
    q.load_speed = v.load_angle = 0.5 * (q.load_speed + v.load_angle)


@fused
def keep_out_of_teeth(memory: Memory, motor_read: bool, load_read: bool) -> None:
    """Keep a shaft without a reading from being pressed into the teeth by the other shaft's reading."""
    if motor_read == load_read:
        return
    state, offset = memory.state, memory.model.offset
    deepest = max(memory.half_gap, abs(memory.twist)) + _INTO_TEETH * memory.half_gap
    twist = min(max(state.motor_angle - state.load_angle - offset, -deepest), deepest)
    if motor_read:
        state.load_angle = state.motor_angle - offset - twist
    else:
        state.motor_angle = state.load_angle + offset + twist
