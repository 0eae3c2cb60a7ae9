"""Where in the gap the motor is while it follows: on a flank that carries the load, or on its way to the other one."""

import math
from typing import NamedTuple

from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.memory import Follow, Memory
from backlash_ros.control.laws.planned.moves import LEAST_PERIODS
from backlash_ros.control.laws.planned.reference import learned_of, moves_within, needed_torque, reference_at
from backlash_ros.control.laws.planned.teeth import gap_position, light_contact_distance, on_the_way
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

TOUCHING_SHARE = 1.5e-5
"""Share of the stall torque with which teeth that carry nothing are touched."""
_COAST = 0.05
"""Distance, in gaps, by which a load that coasts while the motor crosses may leave its path."""
_EFFORT = 0.4
"""Share of the torque available at standstill that a crossing takes at most."""
_PEAK = 5.77
"""Peak of the acceleration of a quintic over a distance d in the time T, in d/T^2."""
_LASTS = 5
"""Periods for which the needed torque must keep its new sign, and the reference must rest, to be no chance: the drag is
noisy."""
_RELEASES = 0.35
"""Share of the crossing time before the end at which a free load is released: it then comes to rest by itself."""
_LIES_ON_A_FLANK = 0.4
"""Share of the gap, from its middle, beyond which a held load lies on the motor's flank."""
_SURE_TIME = 0.1
"""Time on a flank, s, after which its seat is surely learned. Tuned on random drives."""
_FALLEN_TIME = 0.02
"""Time, s, for which a load lies on the other flank that has fallen through the gap. Tuned on random drives."""
_LONGEST_RETURN = 0.15
"""Time, s, in which the motor takes such a load back to its path at most. Tuned on random drives."""
_SMALL = 5e-4
"""Share of the stall torque that such a load needs at least. Below it, the needed torque is then not believed to change
its sign; that doubles with each fall. Tuned on random drives."""
_MOST_DOUBT = 0.01
"""The largest such share. Tuned on random drives."""
_DOUBTED_TIME = 0.5
"""Time, s, in which this doubt fades. Tuned on random drives."""
_BEATS_TIME = 0.3
"""Time, s, in which a beat is forgotten. Tuned on random drives."""
_ON_A_SIDE = 0.25
"""Share of the gap, from its middle, beyond which the motor is on one side of it."""


class GapMotion(NamedTuple):
    """Where the motor is to be in the gap."""

    position: float  # g, rad
    speed: float  # of g, rad/s
    torque: float  # N m, that the teeth carry


@compiled
def seat(constants: Constants, memory: Memory, flank: float, torque: float) -> float:
    """Return g on a flank whose teeth carry a torque, N m, with what was learned of this flank, rad."""
    carried = torque if torque * flank > 0.0 else TOUCHING_SHARE * constants.stall_torque
    return flank * light_contact_distance(constants, carried) + learned_of(memory.follow, flank).seat


@compiled
def sure_seat(follow: Follow) -> float:
    """Return the error of the seat of the flank in use, rad, less what a short time on it may have made up."""
    learned = learned_of(follow, follow.flank)
    return min(learned.seat_time / _SURE_TIME, 1.0) * learned.seat


@compiled
def gap_motion_at(constants: Constants, memory: Memory, path: Array, k: float) -> GapMotion:
    """Return where in the gap the motor is to be k periods after the sample."""
    follow, crossing, flank = memory.follow, memory.follow.crossing, memory.follow.flank
    if follow.crosses != 0.0:
        u = (k - crossing.starts) * constants.period / crossing.duration
        if u < 1.0:
            at = on_the_way(crossing.begin, crossing.end, crossing.speed, crossing.duration, max(u, 0.0))
            return GapMotion(at.position, at.speed, 0.0)
        flank = crossing.flank
    if flank == 0.0:
        return GapMotion(crossing.end, 0.0, 0.0)
    before, after = needed_torque(constants, memory, path, k - 0.5), needed_torque(constants, memory, path, k + 0.5)
    torque = 0.5 * (before + after)
    change = seat(constants, memory, flank, after) - seat(constants, memory, flank, before)
    least = TOUCHING_SHARE * constants.stall_torque
    # Where the teeth begin or end to carry, their depth leaps: no motor follows that.
    if before * flank <= least or after * flank <= least:
        change = 0.0
    position = seat(constants, memory, flank, torque)
    return GapMotion(position, change / constants.period, torque if torque * flank > 0.0 else 0.0)


@compiled
def _shortest_time(constants: Constants, inertia: float, torque: float) -> float:
    """Return the shortest time in which a torque (N m) takes an inertia (kg m^2) through the gap and to rest, s."""
    return math.sqrt(_PEAK * constants.gap * inertia / torque)


@compiled
def _crossing_time(constants: Constants, memory: Memory, path: Array, k: float) -> float:
    """Return how long a crossing may take around k periods after the sample, s: as soft as the path allows.

    The load coasts meanwhile. With dry friction the torque that it lacks leaps, without it grows evenly.
    """
    period, gap, first = constants.period, constants.gap, max(k - 1.0, 0.0)
    shortest = _shortest_time(constants, constants.motor_inertia, _EFFORT * constants.available_torque)
    least = max(LEAST_PERIODS * period, shortest)
    change = abs(needed_torque(constants, memory, path, k + 1.0) - needed_torque(constants, memory, path, first))
    if constants.load_dry_friction > 0.0 and change > 0.5 * constants.load_dry_friction:
        soft = math.sqrt(8.0 * _COAST * gap / max(abs(reference_at(constants, path, k).acceleration), 1e-3))
    else:
        jerk = change / ((k + 1.0 - first) * period) / constants.load_inertia
        soft = 2.0 * (3.0 * _COAST * gap / max(jerk, 1e-3)) ** (1.0 / 3.0)
    return max(least, min(soft, constants.crossing_time))


@compiled
def _cross(constants: Constants, memory: Memory, path: Array, k: float, duration: float, flank: float) -> None:
    """Begin to cross to a flank, or to the middle of the gap for 0, k periods after the sample."""
    follow, crossing = memory.follow, memory.follow.crossing
    now = gap_motion_at(constants, memory, path, k)
    crossing.begin, crossing.speed = now.position, now.speed
    if follow.flank == 0.0:
        motor, load = memory.motor.predicted, memory.load
        crossing.begin = motor.angle - load.angle - constants.delay * load.speed - memory.middle
        crossing.speed = motor.speed - load.speed
    if flank == 0.0:
        crossing.end = sure_seat(follow)
    else:
        torque = needed_torque(constants, memory, path, k + duration / constants.period)
        crossing.end = seat(constants, memory, flank, torque)
    crossing.starts, crossing.duration, crossing.flank, follow.crosses = k, duration, flank, 1.0
    follow.time_on_flank = 0.0


@compiled
def _lasts(constants: Constants, memory: Memory, path: Array, k: float, flank: float) -> bool:
    """Return whether the needed torque keeps the sign of a flank for a while."""
    for later in range(1, _LASTS + 1):  # noqa: SIM110 - numba knows no all()
        if needed_torque(constants, memory, path, k + later) * flank < 0.0:
            return False
    return True


@compiled
def _cross_where_torque_turns(constants: Constants, memory: Memory, path: Array, k: float) -> None:
    """Begin a crossing half of its time before the needed torque changes its sign for good."""
    follow, period = memory.follow, constants.period
    least = max(TOUCHING_SHARE * constants.stall_torque, follow.doubt)
    for later in range(int(0.5 * constants.crossing_time / period) + 2):
        needed = needed_torque(constants, memory, path, k + later)
        turns = needed * follow.flank < -least or (follow.flank == 0.0 and abs(needed) > least)
        flank = math.copysign(1.0, needed)
        if not turns or (follow.flank != 0.0 and not _lasts(constants, memory, path, k + later, flank)):
            continue
        duration = constants.crossing_time
        if follow.flank != 0.0:
            duration = _crossing_time(constants, memory, path, k + later)
        if later * period <= 0.5 * duration:
            _cross(constants, memory, path, k, duration, flank)
        return


@compiled
def _release_at_the_end(constants: Constants, memory: Memory, path: Array, k: float) -> None:
    """Let the motor leave a free load on which nothing acts, shortly before its reference comes to rest."""
    for later in range(int(_RELEASES * constants.crossing_time / constants.period) + 1):
        if not moves_within(constants, path, k + later, _LASTS):
            _cross(constants, memory, path, k, constants.crossing_time, 0.0)
            return


@compiled
def _cross_with_load(constants: Constants, memory: Memory, path: Array, k: float) -> None:
    """Follow on the flank on which a load lies that has fallen through the gap unforeseen.

    The torque that it needs has changed its sign, then, and is taken to be small.
    """
    follow, period, stall = memory.follow, constants.period, constants.stall_torque
    fell = gap_position(memory) * follow.flank < -_LIES_ON_A_FLANK * constants.gap
    follow.time_fallen = follow.time_fallen + period if fell else 0.0
    if follow.time_fallen <= _FALLEN_TIME + constants.delay:
        return
    needed, small = needed_torque(constants, memory, path, k), _SMALL * stall
    if needed * follow.flank > 0.0:
        follow.drag.load -= needed + follow.flank * small
    follow.doubt = min(max(2.0 * follow.doubt, small), _MOST_DOUBT * stall)
    # Slower than the load would leave this flank again.
    torque = max(abs(needed_torque(constants, memory, path, k)), small)
    slow = _shortest_time(constants, constants.load_inertia, torque)
    follow.time_fallen = 0.0
    _cross(constants, memory, path, k, max(min(slow, _LONGEST_RETURN), constants.crossing_time), -follow.flank)


@compiled
def _count_beats(constants: Constants, memory: Memory) -> None:
    """Count how often the motor went from one side of the gap to the other though it was not to cross."""
    follow, g = memory.follow, gap_position(memory)
    follow.beats *= max(1.0 - constants.period / _BEATS_TIME, 0.0)
    if abs(g) > _ON_A_SIDE * constants.gap:
        side = math.copysign(1.0, g)
        if side == -follow.side and follow.crosses == 0.0:
            follow.beats += 1.0
        follow.side = side


@compiled
def choose_flank(constants: Constants, memory: Memory, path: Array, free: bool) -> None:
    """End a crossing that is done, and begin the next one in time. ``free``: nothing holds the load where it rests."""
    follow, k = memory.follow, constants.delay / constants.period
    _count_beats(constants, memory)
    if follow.crosses != 0.0 and (k - follow.crossing.starts) * constants.period >= follow.crossing.duration:
        follow.flank, follow.crosses, follow.time_on_flank = follow.crossing.flank, 0.0, 0.0
    if follow.crosses != 0.0:
        return
    follow.time_on_flank += constants.period
    follow.doubt *= max(1.0 - constants.period / _DOUBTED_TIME, 0.0)
    if follow.flank != 0.0:
        _cross_with_load(constants, memory, path, k)
    if follow.crosses == 0.0:
        _cross_where_torque_turns(constants, memory, path, k)
    if free and follow.crosses == 0.0 and follow.flank != 0.0:
        _release_at_the_end(constants, memory, path, k)


@compiled
def lies_on_flank(constants: Constants, memory: Memory, held: bool) -> float:
    """Return the flank on which a load lies as its reference begins to move; 0 if it is free."""
    position = gap_position(memory)
    return math.copysign(1.0, position) if held and abs(position) > _LIES_ON_A_FLANK * constants.gap else 0.0
