"""References that keep coming are one smooth motion, not one move each.

A reference at rest is a step: the setpoint leaps to it. References that follow each other quickly are a path drawn by
whoever sends them: a ramp, a jog, a hand on a slider. A law that plans a move for each of them never gets beyond the
first milliseconds of any. So the setpoint then goes to the newest reference along a quintic, which begins with the
position, velocity and acceleration that it has, ends at rest at the reference, and takes no less time than the drive
needs. Each new reference starts another quintic. The setpoint never passes a reference that was the last one, and lags
behind a steady ramp by half of the quintic's time. Pure computation, compiled into the tick.
"""

import math
from typing import NamedTuple

import numpy as np

from backlash_ros.control.command_range import clamp
from backlash_ros.control.limits import Limits
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import ACCELERATION, OMEGA_L, POSITION, THETA_L, VELOCITY, Estimate, Setpoint

_QUICK = 0.25
"""Longest time between two references of one path, s: more than two periods of the slowest path, 10 Hz, so that one
lost message does not end it."""
_CORRECTIONS = 2.0
"""Quick references after the first from which on they are a path."""
_SHORTEST = 0.03
"""Shortest time in which the setpoint goes to a reference, s: about the time in which the teeth change sides."""
_INTERVALS = 2.0
"""The same, in intervals between references: the setpoint still moves when the next one comes."""
_SPEED, _ACCELERATION = 0.5, 0.3
"""Shares of the no-load speed, and of the acceleration at standstill, that one motion from rest uses. References that
turn back again and again ask for up to 2.4 times as much; load torque and back-EMF need the rest."""
_PEAK_SPEED, _PEAK_ACCELERATION = 1.875, 5.774
"""Of a quintic from rest to rest: its largest speed times duration over distance, and acceleration times its square."""
_STOPS = 4.0
"""Of a quintic that ends at rest: bound on its time, times the drive's acceleration over the speed at its start."""


class MotionConstants(NamedTuple):
    """What the drive can do: speed, rad/s, and acceleration, rad/s^2, of the load, and the ends of its travel, rad."""

    speed: float
    acceleration: float
    lower_end: float
    upper_end: float


def motion_constants(drive: Drive, limits: Limits) -> MotionConstants:
    """Return what ``drive`` can do within ``limits``."""
    motor, command = drive.motor, min(drive.command_limit, limits.command)
    no_load = drive.gear.ratio * motor.voltage_limit / motor.torque_constant
    return MotionConstants(
        speed=_SPEED * no_load,
        acceleration=_ACCELERATION * drive.standstill_torque(command) / drive.effective_inertia,
        lower_end=float(limits.position_lower),
        upper_end=float(limits.position_upper),
    )


_REFERENCE, _SINCE, _QUICKLY, _ON_PATH, _TIME, _DURATION = range(6)
_START = 6
"""Of the memory: the newest reference, rad, time since it came, s, how many came quickly one after the other, whether
the setpoint goes along a path, time in the present quintic and its duration, s; then position, velocity and
acceleration at its start."""


def motion_memory() -> Array:
    """Return the initial memory."""
    memory = np.zeros(_START + 3)
    memory[_REFERENCE], memory[_SINCE] = math.nan, math.inf
    return memory


def taken_reference(memory: Array) -> float:
    """Return the newest reference that a sample has taken, rad; nan if there is none, or another plan since."""
    return float(memory[_REFERENCE])


@compiled
def forget_path(memory: Array) -> None:
    """Take the next reference for a step."""
    memory[_REFERENCE], memory[_SINCE], memory[_ON_PATH] = math.nan, math.inf, 0.0


@compiled
def _take(
    constants: MotionConstants, memory: Array, reference: float, estimate: Estimate, period: float, setpoint: Setpoint
) -> None:
    """Take a new reference: a step, or the next point of a path.

    A step may be corrected once while it lasts, so the third quick reference begins the path. The load may still be far
    from the second: the path begins where the load is.
    """
    interval = memory[_SINCE]
    memory[_REFERENCE], memory[_SINCE] = reference, 0.0
    memory[_QUICKLY] = memory[_QUICKLY] + 1.0 if interval <= _QUICK else 0.0
    if memory[_QUICKLY] < _CORRECTIONS:
        memory[_ON_PATH] = 0.0
        return
    start = memory[_START : _START + 3]
    if memory[_ON_PATH] != 0.0:
        start[:], memory[_TIME] = setpoint, period  # that of the sample before
    else:
        start[0], start[1], start[2], memory[_TIME] = estimate[THETA_L], estimate[OMEGA_L], 0.0, 0.0
    left = abs(reference - start[0])
    memory[_ON_PATH] = 1.0
    memory[_DURATION] = max(
        _SHORTEST,
        _INTERVALS * interval,
        _PEAK_SPEED * left / constants.speed,
        math.sqrt(_PEAK_ACCELERATION * left / constants.acceleration),
        _STOPS * abs(start[1]) / constants.acceleration,
    )


@compiled
def reference_setpoint(
    constants: MotionConstants,
    memory: Array,
    reference: float,
    estimate: Estimate,
    period: float,
    setpoint: Setpoint,
) -> None:
    """Write the setpoint of a sample into ``setpoint``, which has that of the sample before.

    Parameters
    ----------
    memory : from `motion_memory`, updated in place
    reference : the newest one, rad
    period : since the previous sample, s
    """
    memory[_SINCE] += period
    memory[_TIME] += period
    if reference != memory[_REFERENCE]:
        _take(constants, memory, reference, estimate, period, setpoint)
    left, setpoint[POSITION] = memory[_DURATION] - memory[_TIME], reference
    setpoint[VELOCITY] = setpoint[ACCELERATION] = 0.0
    if memory[_ON_PATH] == 0.0 or left <= 0.0:
        return
    time, length = memory[_TIME], memory[_DURATION]
    p, v, a = memory[_START], memory[_START + 1], memory[_START + 2]
    way, speed, bend = reference - p, v * length, a * length * length
    u = time / length
    cubic, quartic, fifth = (
        10.0 * way - 6.0 * speed - 1.5 * bend,
        -15.0 * way + 8.0 * speed + 1.5 * bend,
        6.0 * way - 3.0 * speed - 0.5 * bend,
    )
    position = p + u * (speed + u * (0.5 * bend + u * (cubic + u * (quartic + u * fifth))))
    velocity = speed + u * (bend + u * (3.0 * cubic + u * (4.0 * quartic + u * 5.0 * fifth)))
    acceleration = bend + u * (6.0 * cubic + u * (12.0 * quartic + u * 20.0 * fifth))
    setpoint[POSITION] = clamp(position, min(constants.lower_end, reference), max(constants.upper_end, reference))
    setpoint[VELOCITY] = velocity / length
    setpoint[ACCELERATION] = acceleration / (length * length)
