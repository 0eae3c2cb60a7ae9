"""References that keep coming are one smooth motion, not one move each.

A reference at rest is a step: the setpoint leaps to it. References that follow each other quickly are a path drawn by
whoever sends them: a ramp, a jog, a hand on a slider. A law that plans a move for each of them never gets beyond the
first milliseconds of any. So the setpoint then goes to the newest reference along a quintic, which begins with the
position, velocity and acceleration that it has, ends at rest at the reference, and takes no less time than the drive
needs. Each new reference starts another quintic. The setpoint never passes a reference that was the last one, and lags
behind a steady ramp by half of the quintic's time.

A law that crosses a gap must begin before the load's motion turns. So the setpoint follows the quintics as many periods
later as the law wants to see ahead, and the law gets what lies between. Pure computation, compiled into the tick.
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.limits import Limits
from backlash_ros.control.motion.setpoint import AHEAD, go_on
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, cells, row_of, view_of
from backlash_ros.foundation.signals import (
    ACCELERATION,
    OMEGA_L,
    POSITION,
    THETA_L,
    VELOCITY,
    Estimate,
    Setpoint,
    as_setpoint,
)

_QUICK = 0.25
"""Longest time between two references of one path, s: more than two periods of the slowest path, 10 Hz, so that one
lost message does not end it."""
_CORRECTIONS = 2.0
"""Quick references after the first from which on they are a path: a step may be corrected once while it lasts."""
_SHORTEST = 0.03
"""Shortest time in which the setpoint goes to a reference, s: about the time in which the teeth change sides."""
_INTERVALS = 2.0
"""The same, in intervals between references: the setpoint still moves when the next one comes."""
_SPEED_SHARE = 0.5
"""Share of the no-load speed that one motion from rest uses. References that turn back again and again ask for up to
2.4 times as much; load torque and back-EMF need the rest."""
_ACCELERATION_SHARE = 0.3
"""Share of the acceleration at standstill that one motion from rest uses, for the same reason."""
_PEAK_SPEED = 1.875
"""Of a quintic from rest to rest: its largest speed times duration over distance."""
_PEAK_ACCELERATION = 5.774
"""Of the same: its largest acceleration times the square of its duration over distance."""
_STOPS = 4.0
"""Of a quintic that ends at rest: bound on its time, times the drive's acceleration over the speed at its start."""


class MotionConstants(Record):
    """What the drive can do with the load, and the ends of its travel."""

    speed: float  # rad/s
    acceleration: float  # rad/s^2
    lower_end: float  # rad
    upper_end: float  # rad
    ahead: float  # periods, of a path that the law wants to see beyond the present one


class MotionMemory(Record):
    """The newest reference, and the quintic on which the setpoint goes to it."""

    reference: float = math.nan  # rad, the newest one that a sample has taken; nan: none, or another plan since
    since: float = math.inf  # s, since it came
    quick_references: float = 0.0  # so many came quickly one after the other
    on_path: float = 0.0  # 1 while the setpoint goes along a path
    ahead: float = 0.0  # periods, by which the present path's newest setpoint is ahead of the one in use
    time: float = 0.0  # s, in the present quintic, of the newest setpoint
    duration: float = 0.0  # s, of the present quintic
    start: Array = cells(3)  # `Setpoint` at its start
    path: Array = cells(AHEAD, 3)  # from the setpoint in use to the newest one, a period apart


_constants_at, motion_memory_at = view_of(MotionConstants), view_of(MotionMemory)


def motion_constants(drive: Drive, limits: Limits, ahead: int) -> MotionConstants:
    """Return what ``drive`` can do within ``limits``; ``ahead``: periods that the law wants to see, as far as kept."""
    command = min(drive.command_limit, limits.command)
    row = row_of(
        MotionConstants,
        speed=_SPEED_SHARE * drive.no_load_speed,
        acceleration=_ACCELERATION_SHARE * drive.standstill_torque(command) / drive.effective_inertia,
        lower_end=limits.position_lower,
        upper_end=limits.position_upper,
        ahead=min(ahead, AHEAD - 1),
    )
    return _constants_at(row)


@compiled
def forget_path(memory: MotionMemory) -> None:
    """Take the next reference for a step."""
    memory.reference, memory.since, memory.on_path = math.nan, math.inf, 0.0


@compiled
def _take(
    constants: MotionConstants,
    memory: MotionMemory,
    reference: float,
    estimate: Estimate,
    nominal: float,
    time: float,
) -> None:
    """Take a new reference: a step, or the next point of a path; ``time``: s, since the newest setpoint.

    A step may be corrected once while it lasts, so the third quick reference begins the path. The load may still be far
    from the second: the path begins where the load is.
    """
    interval = memory.since
    memory.reference, memory.since = reference, 0.0
    memory.quick_references = memory.quick_references + 1.0 if interval <= _QUICK else 0.0
    if memory.quick_references < _CORRECTIONS:
        memory.on_path = 0.0
        return
    start = memory.start
    if memory.on_path != 0.0:
        start[:], memory.time = memory.path[int(memory.ahead)], time
    else:
        start[POSITION], start[VELOCITY], start[ACCELERATION] = estimate[THETA_L], estimate[OMEGA_L], 0.0
        memory.ahead = constants.ahead
        memory.time = memory.ahead * nominal
    memory.on_path = 1.0
    distance = abs(reference - start[POSITION])
    memory.duration = max(
        _SHORTEST,
        _INTERVALS * interval,
        _PEAK_SPEED * distance / constants.speed,
        math.sqrt(_PEAK_ACCELERATION * distance / constants.acceleration),
        _STOPS * abs(start[VELOCITY]) / constants.acceleration,
    )


@compiled
def _evaluate(constants: MotionConstants, memory: MotionMemory, time: float, setpoint: Setpoint) -> None:
    """Write the quintic's point at ``time``, s, into ``setpoint``; after its end the reference, at rest."""
    reference, duration, start = memory.reference, memory.duration, memory.start
    if duration - time <= 0.0:
        setpoint[POSITION], setpoint[VELOCITY], setpoint[ACCELERATION] = reference, 0.0, 0.0
        return
    u = time / duration
    # In units of the duration: the distance left, and speed and acceleration at the start.
    distance = reference - start[POSITION]
    speed, bend = start[VELOCITY] * duration, start[ACCELERATION] * duration * duration
    cubic, quartic, fifth = (
        10.0 * distance - 6.0 * speed - 1.5 * bend,
        -15.0 * distance + 8.0 * speed + 1.5 * bend,
        6.0 * distance - 3.0 * speed - 0.5 * bend,
    )
    position = start[POSITION] + u * (speed + u * (0.5 * bend + u * (cubic + u * (quartic + u * fifth))))
    velocity = speed + u * (bend + u * (3.0 * cubic + u * (4.0 * quartic + u * 5.0 * fifth)))
    acceleration = bend + u * (6.0 * cubic + u * (12.0 * quartic + u * 20.0 * fifth))
    setpoint[POSITION] = clamp(position, min(constants.lower_end, reference), max(constants.upper_end, reference))
    setpoint[VELOCITY] = velocity / duration
    setpoint[ACCELERATION] = acceleration / (duration * duration)


@compiled
def reference_path(
    constants: MotionConstants,
    memory: MotionMemory,
    reference: float,
    estimate: Estimate,
    elapsed: float,
    nominal: float,
    path: Array,
) -> None:
    """Write the setpoint of a sample, and those of the next samples, into ``path``, shape (`AHEAD`, 3).

    Parameters
    ----------
    memory : updated in place
    reference : the newest one, rad
    elapsed : since the previous sample, s
    nominal : between two samples, s
    """
    passed = max(round(elapsed / nominal), 1)
    memory.since += elapsed
    memory.time += passed * nominal
    if reference != memory.reference:
        _take(constants, memory, reference, estimate, nominal, passed * nominal)
    if memory.on_path == 0.0:
        path[:, POSITION], path[:, VELOCITY:] = reference, 0.0
        return
    ahead = int(memory.ahead)
    for k in range(ahead + 1):
        time = memory.time + (k - ahead) * nominal
        if time < 0.0:  # of an earlier quintic
            memory.path[k] = memory.path[k + passed]
        else:
            _evaluate(constants, memory, time, as_setpoint(memory.path[k]))
        path[k] = memory.path[k]
    go_on(nominal, ahead, path)
