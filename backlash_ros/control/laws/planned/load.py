"""The load's observer: a filter for its angle and speed that knows how a free load moves.

Its gains are Kalata's (IEEE Trans. AES 20, 1984), for the count that the readings show: their smallest step, or noise
of that width.
"""

import math

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.memory import HOLD, Load, Memory
from backlash_ros.control.laws.planned.readings import check_reading, largest_error
from backlash_ros.control.laws.planned.teeth import teeth_are_apart
from backlash_ros.foundation.compiled import compiled

_NO_CHANGE = 1e-9
"""Rad, up to which two readings are the same."""
_SMALLEST_COUNT = 1e-6
"""Least step that is taken for a count, rad."""
_NOISE_TIME = 0.2
"""Time, s, over which noise is looked at while holding. Tuned on the populations."""
_NOISE_COUNT = 1.6
"""A count that is as wide as noise, over the mean second difference of the readings."""
UNKNOWN_COUNT = 0.05
"""Assumed encoder count, as a share of the gap, until one is seen."""
_FLIGHT_UNCERTAINTY = 60.0
"""Unknown acceleration of the load in flight and follow, rad/s^2, at 250 Hz. Tuned on the populations."""
_HOLD_UNCERTAINTY = 4.0
"""The same in hold, rad/s^2. Tuned on the populations."""
_FREE_UNCERTAINTY = 0.3
"""The same in hold while the load touches nothing, rad/s^2. Tuned on the populations."""
_USUAL_PERIOD = 0.004
"""Period, s, for which these uncertainties hold."""
_ASTRAY_COUNTS = 1.5
"""Largest error of a load at rest, in counts. Tuned on the populations."""
_ASTRAY_READINGS = 4.0
"""So many readings in a row beyond that error mean motion. Tuned on the populations."""
_SPEED_SHARE = 0.5
"""Share of the speed that these readings show which is believed, as they are noisy."""
STANDSTILL = 0.02
"""Speed, rad/s, below which the load stands. Tuned on the populations."""
_LEAST_LAG = 0.1
"""Least pole of the filter, so that it does not ring where its readings have no count."""


@compiled
def measure_count(constants: Constants, load: Load, reading: float, holds: bool) -> None:
    """Look for the smallest step of the readings, the first one only in hold at rest, and in hold for their noise."""
    change = reading - load.last_reading
    step = abs(change)
    if step > _NO_CHANGE and load.smallest_step > 0.0:
        load.smallest_step = max(min(load.smallest_step, step), _SMALLEST_COUNT)
    elif step > _NO_CHANGE and holds and abs(load.speed) * constants.period < 0.5 * step:
        load.smallest_step = step
    if holds:
        bend = min(abs(change - load.last_change), constants.gap)
        load.roughness += min(constants.period / _NOISE_TIME, 1.0) * (bend - load.roughness)
    load.last_reading, load.last_change = reading, change


@compiled
def _readings_astray(load: Load, error: float) -> float:
    """Return how many readings in a row a load at rest is beyond its place, with the sign of the side."""
    if abs(error) <= _ASTRAY_COUNTS * load.count:
        return 0.0
    same_side = load.readings_astray * error >= 0.0
    return math.copysign(1.0, error) + (load.readings_astray if same_side else 0.0)


@compiled
def _uncertainty(constants: Constants, memory: Memory) -> float:
    """Return the unknown acceleration of the load at 250 Hz, rad/s^2."""
    if memory.phase != HOLD or abs(memory.load.readings_astray) > _ASTRAY_READINGS:
        return _FLIGHT_UNCERTAINTY
    if memory.held == 0.0 and teeth_are_apart(constants, memory):
        return _FREE_UNCERTAINTY
    return _HOLD_UNCERTAINTY


@compiled
def _correct(load: Load, error: float, uncertainty: float, period: float) -> None:
    """Correct angle and speed with the gains for an uncertain acceleration, rad/s^2 at 250 Hz."""
    index = uncertainty * math.sqrt(_USUAL_PERIOD / period) * period * period * math.sqrt(12.0) / load.count
    r = max(0.25 * (4.0 + index - math.sqrt(8.0 * index + index * index)), _LEAST_LAG)
    alpha = 1.0 - r * r
    load.angle += alpha * error
    load.speed += (2.0 * (2.0 - alpha) - 4.0 * r) / period * error


@compiled
def observe_load(constants: Constants, memory: Memory, reading: float) -> None:
    """Take the load's angle, rad, one period after the previous one."""
    load, period, holds, before = memory.load, constants.period, memory.phase == HOLD, memory.load.last_reading
    measure_count(constants, load, reading, holds)
    load.angle += period * load.speed
    error, unexpected_motion = reading - load.angle, reading - before - period * load.speed
    bound = largest_error(constants, memory, load.count)
    correction = check_reading(load.doubt, error, unexpected_motion, bound, period)
    if not correction.plausible:
        load.angle += correction.angle
        load.speed += correction.speed
        return
    step = load.smallest_step if load.smallest_step > 0.0 else UNKNOWN_COUNT * constants.gap
    load.count = max(step, _NOISE_COUNT * load.roughness)
    load.readings_astray = _readings_astray(load, error) if holds else 0.0
    # The load does not move as one at rest: the error has grown since the first of these readings.
    if abs(load.readings_astray) == _ASTRAY_READINGS:
        load.angle = reading
        load.speed += _SPEED_SHARE * error / (_ASTRAY_READINGS * period)
        return
    if holds and memory.held == 0.0 and abs(load.readings_astray) < _ASTRAY_READINGS:
        load.speed *= math.exp(-constants.load_friction / constants.load_inertia * period)
    _correct(load, error, _uncertainty(constants, memory), period)
