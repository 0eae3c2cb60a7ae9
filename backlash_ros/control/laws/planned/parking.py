"""Parking: a load that is near enough to its target is left alone, and what the law waits for before it moves it."""

from backlash_ros.control.laws.planned.command import Wanted
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.memory import Hold, Load, Memory
from backlash_ros.control.laws.planned.phases import forget_attempts
from backlash_ros.foundation.compiled import compiled

LONG = 2.0
"""Error of the load, in gaps, above which a load that nothing holds gets a new plan. Tuned on the populations."""
LARGEST_LEAD = 2.0
"""Largest speed, rad/s, with which a load is led or met. Tuned on the populations."""
DWELL = 0.05
"""Shortest time, s, for which a flank leads; and after hold began or parking ended, until parking of a load that no
torque holds may end. Tuned on the populations."""
_INNER_GAP = 0.04
"""Error of the load, in gaps, below which it is left alone. Tuned on the populations."""
_INNER_COUNT = 0.3
"""The same in counts, if that is more. Tuned on the populations."""
_OUTER_GAP = 0.08
"""Error of the load, in gaps, above which it is no longer left alone. Tuned on the populations."""
_OUTER_COUNT = 0.55
"""The same in counts, if that is more. Tuned on the populations."""
_NOISE_COUNT = 4.0
"""Width of the noise that counts as one encoder count, divided by the readings' mean second difference."""
_WATCH_TIME = 0.04
"""Time, s, for which a load is observed before it is moved. Tuned on the populations."""
_WATCH_GROWTH = 0.06
"""Time, s, by which that is longer after each attempt. Tuned on the populations."""
_MOST_ATTEMPTS = 5.0
"""Attempts up to which it grows. Tuned on the populations."""
_REST_TIME = 1.0
"""Time, s, since hold began or parking ended, after which earlier attempts say nothing any more: something else has
moved the load."""
_SHORTER = 0.8
"""Factor by which each change of the error's sign shortens the next move, to prevent hunting."""
_LEAST_SHARE = 0.3
"""Share of the error that a move takes at least. Tuned on the populations."""
_PARK_TIME = 0.05
"""Time, s, in which the motor goes to the middle of the gap. Tuned on the populations."""


@compiled
def inner_band(constants: Constants, load: Load) -> float:
    """Return the error below which the load is left alone, rad."""
    return max(_INNER_GAP * constants.gap, _INNER_COUNT * max(load.count, _NOISE_COUNT * load.roughness))


@compiled
def outer_band(constants: Constants, load: Load) -> float:
    """Return the error above which the load is no longer left alone, rad."""
    return max(_OUTER_GAP * constants.gap, _OUTER_COUNT * max(load.count, _NOISE_COUNT * load.roughness))


@compiled
def has_watched(hold: Hold) -> bool:
    """Return whether the load was observed for long enough to move it; that takes longer after each attempt."""
    return hold.waiting_time > _WATCH_TIME + _WATCH_GROWTH * min(hold.attempts, _MOST_ATTEMPTS)


@compiled
def shortened(hold: Hold, error: float) -> float:
    """Return an error, reduced if its sign has changed, to prevent hunting."""
    if hold.last_error * error < 0.0:
        hold.error_share = max(_LEAST_SHARE, _SHORTER * hold.error_share)
    hold.last_error = error
    return hold.error_share * error


@compiled
def end_parking(hold: Hold) -> None:
    """No longer leave the load alone; forget earlier attempts if the last is long ago."""
    hold.parking_time = -1.0
    if hold.waiting_time > _REST_TIME:
        forget_attempts(hold)


@compiled
def go_to_the_middle(constants: Constants, memory: Memory) -> Wanted:
    """Return the motor's motion to the middle of the gap of a parked load: a quintic."""
    hold = memory.hold
    hold.parking_time += constants.period
    u, distance = min(hold.parking_time / _PARK_TIME, 1.0), memory.motor_target - hold.parked_from
    angle = hold.parked_from + distance * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
    speed = distance * 30.0 * u * u * (1.0 - u) * (1.0 - u) / _PARK_TIME
    torque = constants.motor_inertia * distance * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / _PARK_TIME**2
    return Wanted(angle, speed, torque, 0.0, memory.motor.predicted.speed)
