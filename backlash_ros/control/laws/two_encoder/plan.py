"""The plans: the motion of load and motor until the load rests at its target, in closed form.

A plan consists of segments. In each, the load's acceleration is a straight line plus a bump. Either the motor is in
contact on one flank, at the depth at which the teeth carry the load's torque, or it crosses to the other flank while
the load coasts. Everything is written for a move forward; a move backward is its mirror image.

The load needs the torque J a + B v + c, where c = tau_c - tau_l brakes it at any speed. The plans:

    throw    approach the driving flank, push, cross while the load coasts, brake on the other flank, and leave it;
             under a load torque that goes against the move cross back while the load comes to rest
    press    all on the driving flank: friction, or the load torque, brakes hard enough
    carry    all on the braking flank: the load torque carries the load
    catch    cross to the braking flank, brake, and leave it: the load is already too fast
    shift    all on the flank on which a load torque holds the load
"""

import math

from backlash_ros.control.laws.two_encoder.layout import (
    BRAKE,
    CLEAR,
    COLUMNS,
    COULOMB,
    CROSSING,
    FRICTION,
    GAP,
    INERTIA,
    LOAD_UNEXPLAINED,
    MIDDLE,
    MOTOR_COULOMB,
    MOTOR_INERTIA,
    MOTOR_UNEXPLAINED,
    NO_LOAD,
    PERIOD,
    PLAN,
    PUSH,
    REST_TORQUE,
    SEGMENTS,
    STALL,
    STIFFNESS,
)
from backlash_ros.control.laws.two_encoder.observers import contact, holds, pull_at, pulls
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

_LENGTH, _AT, _V, _STARTS, _ENDS, _BUMP, _FROM, _TO, _CROSSES, _WAY, _CLOSING, _SOFT = range(COLUMNS)
"""Of a segment: s; position and speed of the load at its start; acceleration of the straight line at either end; the
bump's mean; g at its start and end, and whether the motor crosses; the move's direction; how fast g changes at the
start, rad/s; whether the bump ends softly."""

_PEAK = 1.5
"""Peak of a bump divided by its mean."""
_SPEED, _EFFORT, _LEFT = 0.6, 0.75, 0.1
"""Shares of the no-load speed, and of the torque available at a speed, that a plan uses."""
_TOUCH = 0.02
"""Torque with which teeth are touched, N m."""
_SOON = 0.8
"""Share of the crossing time in which a flank is approached."""
_PRESSED, _SHIFTED, _VISCOUS = 0.5, 0.8, 0.3
"""Shares of what brakes the load by itself that a press and a shift use, so that the teeth stay in contact; and the
share of the load's viscous friction that a press counts with."""
_OWN, _SHORTEST, _LEAST, _HARD = 1.33, 0.035, 0.02, 165.0
"""A brake is so short that the teeth do more than the load by itself: most of its time over that of the load's own; s
below which one flank does it, s at least, and rad/s^2 of friction and load torque from which on one flank does it."""
_LONGEST, _OF_WAY, _CROSSES_IN = 0.3, 0.25, 3.0
"""Longest time to catch a load, s; share of its travel and least number of periods for the motor's crossing to it."""
_NEAR, _STOPS = 0.92, 0.3
"""g, in half gaps, above which a flank is reached; speed, rad/s, below which a load may be carried from rest."""
_GAINS = 1.0
"""By how much of its speed a load torque may speed a load up while the motor crosses the gap to push it."""
_FALLS = 8.0
"""Gaps, doubled, through which a load torque would pull the load while the motor approaches it, from which on the load
lies on the motor's flank already."""
_QUICKER, _SHORT = 0.9, 0.03
_UNSURE = 0.06
"""Shortest time, s, for each half of a shift if friction hides the load torque, so that the shift shows it."""
_GAP_WAYS = 2.0
_ABOUT, _ROUNDS = 0.35, 5
"""Share of a move at which the motor crosses, at first, and times that a flight is computed anew."""
_AT_FIRST = 0.3
"""Share of a load torque that carries the load at first, but not all the way, that a plan uses."""
_MOTOR_OFF, _LOAD_OFF, _MOST_SHORT = 3.0, 0.3, 0.2
"""A load with dry friction, which waits where it lands, is to land short. By how much: these factors of the way by
which the motor's unexplained torque deflects its loop, and by which the load's moves the load in a crossing; at most,
as a share of the move."""
_LEAVES = 0.5
"""Share of the crossing time in which the motor leaves a load that it has brought to rest."""
_HIDDEN = 0.3
"""Share of its friction that resists a load at least, however large the torque that it hides."""


@compiled
def segment(
    state: Array,
    length: float,
    at: float,
    speed: float,
    starts: float,
    ends: float,
    bump: float,
    from_: float,
    to: float,
    way: float,
    closing: float,
    kind: int,
) -> None:
    """Add a segment to the plan. ``kind``: 0 contact, 1 contact whose bump ends softly, 2 crossing."""
    row = PLAN + int(state[SEGMENTS]) * COLUMNS
    state[row + _LENGTH], state[row + _AT], state[row + _V] = length, at, speed
    state[row + _STARTS], state[row + _ENDS], state[row + _BUMP] = starts, ends, bump
    state[row + _FROM], state[row + _TO], state[row + _CLOSING] = from_, to, closing
    state[row + _WAY] = way
    state[row + _CROSSES], state[row + _SOFT] = 1.0 if kind == 2 else 0.0, 1.0 if kind == 1 else 0.0
    state[SEGMENTS] += 1.0


@compiled
def resists(law: Array, state: Array, way: float, x: float) -> float:
    """Return c where the load is at x in the move's own direction, N m."""
    return float(law[COULOMB] - way * pull_at(state, way * x))


@compiled
def length_of(state: Array) -> float:
    """Return the duration of the plan, s."""
    total = 0.0
    for k in range(int(state[SEGMENTS])):
        total += state[PLAN + k * COLUMNS + _LENGTH]
    return total


@compiled
def evaluate(law: Array, state: Array, time: float) -> tuple[float, float, float]:
    """Return the motor's p (rad) and w (rad/s), and the torque of the teeth (N m), at a time in the plan, s."""
    count, k = int(state[SEGMENTS]), 0
    while k < count - 1 and time > state[PLAN + k * COLUMNS + _LENGTH]:
        time -= state[PLAN + k * COLUMNS + _LENGTH]
        k += 1
    row = state[PLAN + k * COLUMNS : PLAN + (k + 1) * COLUMNS]
    length, way = row[_LENGTH], row[_WAY]
    over = time >= length
    time = min(max(time, 0.0), length)
    u = time / length
    if row[_SOFT] == 0.0:
        rate, bump = 6.0 * (1.0 - 2.0 * u), 6.0 * u * (1.0 - u)
        bump_v, bump_x = u * u * (3.0 - 2.0 * u), u * u * u * (1.0 - 0.5 * u)
    else:
        rate, bump = 12.0 * (1.0 - u) * (1.0 - 3.0 * u), 12.0 * u * (1.0 - u) * (1.0 - u)
        bump_v, bump_x = u * u * (6.0 - 8.0 * u + 3.0 * u * u), u * u * u * (2.0 - 2.0 * u + 0.6 * u * u)
    rises = row[_ENDS] - row[_STARTS]
    a = row[_STARTS] + rises * u + row[_BUMP] * bump
    v = row[_V] + length * (row[_STARTS] * u + 0.5 * rises * u * u + row[_BUMP] * bump_v)
    x = row[_AT] + row[_V] * time
    x += length * length * (0.5 * row[_STARTS] * u * u + rises * u * u * u / 6.0 + row[_BUMP] * bump_x)
    at_rest = over and k == count - 1
    torque = way * state[REST_TORQUE] if at_rest else 0.0
    if row[_CROSSES] != 0.0:
        back, left = 1.0 - u, row[_TO] - row[_FROM]
        g = row[_FROM] + left * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
        closing = left * 30.0 * u * u * back * back / length
        g += row[_CLOSING] * length * u * back**3 * (1.0 + 3.0 * u)
        closing += row[_CLOSING] * back * back * (back * (1.0 + 6.0 * u) - 3.0 * u * (1.0 + 3.0 * u))
    else:
        flank = math.copysign(1.0, row[_TO])
        if not at_rest:
            torque = law[INERTIA] * a + law[FRICTION] * v + resists(law, state, way, x)
        if torque * flank < 0.0:
            torque = 0.0
        g, closing = flank * contact(law, torque), 0.0
        if torque != 0.0 and not over:
            jerk = (rises + row[_BUMP] * rate) / length
            rate = law[INERTIA] * jerk + law[FRICTION] * a
            small = 0.02 * abs(torque) + 1e-6
            give = contact(law, abs(torque) + small) - contact(law, max(abs(torque) - small, 0.0))
            closing = give / (2.0 * small) * rate
    return way * (x + g) + state[MIDDLE], way * (v + closing), way * torque


@compiled
def stopping_way(law: Array, speed: float) -> float:
    """Return the distance that a load coasts from a speed (rad/s) against its friction, rad, signed."""
    inertia, viscous, dry = law[INERTIA], law[FRICTION], law[COULOMB]
    size = abs(speed)
    if dry > 0.0 and viscous * size < 1e-6 * dry:
        way = 0.5 * inertia * size * size / dry
    elif dry > 0.0:
        way = inertia / viscous * (size - dry / viscous * math.log(1.0 + viscous * size / dry))
    else:
        way = inertia * size / max(viscous, 1e-12)
    return float(math.copysign(way, speed))


@compiled
def _push_time(law: Array, length: float, gain: float, speed: float, c: float) -> float:
    """Return the shortest time for a push that gains a speed, s, given the motor's torque."""
    both, steady = law[MOTOR_INERTIA] + law[INERTIA], max(c, 0.0) + law[FRICTION] * speed
    most = _EFFORT * law[STALL] * (1.0 - min(speed / law[NO_LOAD], 0.9))
    if both * _PEAK * gain / length + steady <= most:
        return length
    return float(max(length, both * _PEAK * gain / max(most - steady, _LEFT * law[STALL])))


@compiled
def _approach(law: Array, g: float) -> float:
    """Return the time that the motor takes from g to the driving flank, s; 0 if it is there."""
    if g >= _NEAR * 0.5 * law[GAP]:
        return 0.0
    return float(_SOON * law[CROSSING] * max(0.3, math.sqrt(min(1.0, (0.5 * law[GAP] - g) / law[GAP]))))


@compiled
def _press(
    law: Array,
    state: Array,
    target: float,
    x: float,
    v: float,
    slows: float,
    g: float,
    closing: float,
    c: float,
    way: float,
) -> None:
    """Plan a move on the driving flank alone, in the move's own direction; c > 0 brakes.

    ``slows``: deceleration of the load before it is touched, rad/s^2.
    """
    length = _approach(law, g)
    edge = contact(law, _TOUCH)
    if slows * length * length > _FALLS * law[GAP]:
        length = 0.0  # such a load torque has long laid the load on that flank, wherever the middle is thought to be
    if length > 0.0:
        segment(state, length, x, v, -slows, -slows, 0.0, g, edge, way, closing, 2)
        x, v = x + v * length - 0.5 * slows * length * length, v - slows * length
    left, push, top = target - x, law[PUSH], _SPEED * law[NO_LOAD]
    speed = cruise = 0.0
    brake = law[PUSH]
    for _ in range(6):
        decelerates = _PRESSED * (c + _VISCOUS * law[FRICTION] * speed) / law[INERTIA]
        needed = left - 0.5 * v * push
        if needed <= 0.0:
            speed = 0.0
            break
        per_square = 0.4 * _PEAK / decelerates
        speed = (-0.5 * push + math.sqrt(0.25 * push * push + 4.0 * per_square * needed)) / (2.0 * per_square)
        cruise = 0.0
        if speed > top:
            speed = top
            cruise = (needed - 0.5 * speed * push - per_square * speed * speed) / speed
        brake = _PEAK * speed / decelerates
        push = _push_time(law, push, speed - v, speed, c)
    if brake < law[PUSH]:
        brake, cruise = law[PUSH], 0.0
        speed = max((left - 0.5 * v * push) / (0.5 * push + 0.4 * brake), 0.0)
    segment(state, push, x, v, 0.0, 0.0, (speed - v) / push, edge, edge, way, 0.0, 0)
    x += 0.5 * (v + speed) * push
    if cruise > 0.0:
        segment(state, cruise, x, speed, 0.0, 0.0, 0.0, edge, edge, way, 0.0, 0)
        x += cruise * speed
    segment(state, brake, x, speed, 0.0, 0.0, -speed / brake, edge, edge, way, 0.0, 1)


@compiled
def _carry(
    law: Array,
    state: Array,
    target: float,
    x: float,
    v: float,
    g: float,
    closing: float,
    c: float,
    way: float,
    must: bool,
) -> bool:
    """Plan a move on the braking flank alone if c < 0 carries the load; False, without a plan, if others are faster.

    Parameters
    ----------
    must : plan it in any case
    """
    gains, left, brake = 0.85 * abs(c) / law[INERTIA] / _PEAK, max(target - x, 1e-6), law[BRAKE]
    run = 0.5 * (-brake + math.sqrt(brake * brake + 8.0 * left / gains))
    both = max(_SHORT, math.sqrt(left / gains))
    if 2.0 * both < run + brake:
        run = brake = both
    if not must and run + brake >= _QUICKER * (2.0 * law[CROSSING] + law[PUSH] + law[BRAKE]):
        return False
    crosses = g > -0.9 * 0.5 * law[GAP]
    begins = 0.0 if crosses or v < _STOPS else v
    speed, cruise, edge = (left - 0.5 * begins * run) / (0.5 * (run + brake)), 0.0, contact(law, _TOUCH)
    if speed <= 0.0:  # it is too fast for so short a way
        return False
    if speed > _SPEED * law[NO_LOAD]:
        speed = _SPEED * law[NO_LOAD]
        cruise = (left - 0.5 * begins * run) / speed - 0.5 * (run + brake)
    if crosses:
        segment(state, law[CROSSING], x, v, 0.0, 0.0, 0.0, g, -edge, way, closing, 2)
    segment(state, run, x, begins, 0.0, 0.0, (speed - begins) / run, -edge, -edge, way, 0.0, 0)
    if cruise > 0.0:
        segment(state, cruise, x + 0.5 * (begins + speed) * run, speed, 0.0, 0.0, 0.0, -edge, -edge, way, 0.0, 0)
    segment(state, brake, target - 0.5 * speed * brake, speed, 0.0, 0.0, -speed / brake, -edge, -edge, way, 0.0, 0)
    return True


@compiled
def _catch(law: Array, state: Array, target: float, x: float, v: float, g: float, closing: float, way: float) -> None:
    """Plan to meet a fast load on its front side, and to brake it."""
    inertia, edge = law[INERTIA], contact(law, _TOUCH)
    length = law[CROSSING] * max(0.3, math.sqrt(min(1.0, max(0.0, 0.5 * law[GAP] + g) / law[GAP])))
    if v * length > _OF_WAY * (target - x):  # too fast for a soft crossing
        length = max(_OF_WAY * (target - x) / v, _CROSSES_IN * law[PERIOD])
    slows = min((law[FRICTION] * v + resists(law, state, way, x)) / inertia, v / length)
    if slows > 0.0 or g > -_NEAR * 0.5 * law[GAP]:  # else it lies on that side already
        segment(state, length, x, v, -slows, -slows, 0.0, g, -edge, way, closing, 2)
        x, v = x + v * length - 0.5 * slows * length * length, v - slows * length
    met, last = resists(law, state, way, x), resists(law, state, way, target)
    brake = _LONGEST
    if v > 0.0:
        brake = min(max(2.0 * (target - x) / v, _push_time(law, _LEAST, v, 0.0, -last)), _LONGEST)
    # A torque that helps is held by the flank from the first moment on: the load must not fall ahead.
    starts, ends = -(law[FRICTION] * v + max(met, 0.0)) / inertia, -max(last, 0.0) / inertia
    bump = min(-v / brake - 0.5 * (starts + ends), 0.0)
    segment(state, brake, x, v, starts, ends, bump, -edge, -edge, way, 0.0, 0)


@compiled
def _holds_back(
    law: Array,
    state: Array,
    target: float,
    x: float,
    v: float,
    g: float,
    closing: float,
    first: float,
    most: float,
    way: float,
) -> bool:
    """Plan to hold back a load that lies on the motor's braking flank and that a load torque drives on.

    Were the motor to cross the gap to push it, the load would be gone. False, without a plan, where it would not.
    ``first``, ``most``: what resists the load where it is, and at most, N m.
    """
    gains = -(law[FRICTION] * v + first) / law[INERTIA] * _approach(law, g)
    if v < _STOPS or g > -_NEAR * 0.5 * law[GAP] or gains < _GAINS * v:
        return False
    if most >= 0.0 or not _carry(law, state, target, x, v, g, closing, most, way, True):
        _catch(law, state, target, x, v, g, closing, way)
    return True


@compiled
def _lands(
    law: Array,
    x: float,
    v: float,
    speed: float,
    push: float,
    brake: float,
    c: tuple[float, float, float],
    back: float,
    moves: bool,
) -> tuple[float, float, float, float, float, float, float]:
    """Compute a flight in which the push reaches a given speed.

    ``c`` is taken where the push starts, where the motor crosses, and at the end, N m.

    Returns
    -------
    where it ends, and the push, rad; the acceleration with which the push starts and its bump; the load's deceleration
    while the motor crosses; the bump of the brake, and the speed left after it for ``back`` seconds, rad/s (^2).
    """
    inertia, viscous, crossing = law[INERTIA], law[FRICTION], law[CROSSING]
    starts = -(viscous * v + c[0]) / inertia if moves else 0.0
    ends = -(viscous * speed + c[1]) / inertia
    bump = (speed - v) / push - 0.5 * (starts + ends)
    x += v * push + push * push * (starts / 3.0 + ends / 6.0 + 0.5 * bump)
    pushed = x
    slows = (viscous * speed + c[1]) / (inertia + 0.5 * viscous * crossing)
    met = speed - slows * crossing
    x += speed * crossing - 0.5 * slows * crossing * crossing
    left = c[2] / inertia * back
    first, last = -(viscous * met + c[1]) / inertia, -(viscous * left + max(c[2], 0.0)) / inertia
    brakes = (left - met) / brake - 0.5 * (first + last)
    x += met * brake + brake * brake * (first / 3.0 + last / 6.0 + 0.6 * brakes)
    return x + 0.5 * left * back, pushed, starts, bump, slows, brakes, left


@compiled
def _throw(
    law: Array,
    state: Array,
    way: float,
    target: float,
    x: float,
    v: float,
    c: tuple[float, float, float],
    back: float,
    moves: bool,
    follows: bool,
) -> tuple[float, float, float, float, tuple[float, float, float], bool]:
    """Compute how a load that is touched at x with speed v is to be pushed so that it lands at its target.

    Parameters
    ----------
    c : see `_lands`
    follows : whether c while the motor crosses follows the place where it does

    Returns
    -------
    the speed, rad/s; the times for which it is kept, of the push and of the brake, s; c; and whether the load is better
    pressed, on one flank
    """
    inertia, viscous, crossing = law[INERTIA], law[FRICTION], law[CROSSING]
    push, brake, top = law[PUSH], law[BRAKE], _SPEED * law[NO_LOAD]
    first, between, last = c
    speed = cruise = 0.0
    for k in range(_ROUNDS + 1):
        c = first, between, last
        least, most = min(between, last), max(between, last)
        if k == 0 and least > 0.0 and least / inertia >= _HARD:
            return speed, cruise, push, brake, c, True
        without = _lands(law, x, v, 0.0, push, brake, c, back, moves)[0]
        per_speed = _lands(law, x, v, 1.0, push, brake, c, back, moves)[0] - without
        speed, cruise = (target - without) / per_speed, 0.0
        if speed > top:
            speed, cruise = top, (speed / top - 1.0) * per_speed
        if k == _ROUNDS:
            break
        push = _push_time(law, push, speed - v, speed, max(first, between))
        _, at, _, _, slowed, _, _ = _lands(law, x, v, speed, push, brake, c, back, moves)
        if least >= 0.0:
            met = speed - slowed * crossing
            if met <= 0.0:
                return speed, cruise, push, brake, c, least > 0.0
            longest = _OWN * met * inertia / (viscous * met + 2.0 * most)
            if least > 0.0 and longest < _SHORTEST:
                return speed, cruise, push, brake, c, True
            brake = max(min(law[BRAKE], longest), _LEAST)
        if follows:
            between = resists(law, state, way, min(max(at + speed * (cruise + 0.5 * crossing), x), target))
    return speed, cruise, push, brake, c, False


@compiled
def _short(law: Array, way: float) -> float:
    """Return by how much a move is to end short of its target, rad, signed like ``way``, the move."""
    if law[COULOMB] == 0.0:
        return 0.0
    motor = _MOTOR_OFF * law[MOTOR_UNEXPLAINED] / law[STIFFNESS]
    load = _LOAD_OFF * 0.5 * law[CROSSING] ** 2 * law[LOAD_UNEXPLAINED] / law[INERTIA]
    return float(math.copysign(min(motor + load, _MOST_SHORT * abs(way)), way))


@compiled
def _leave(law: Array, state: Array, target: float, way: float) -> None:
    """Let the motor leave a free load, which has come to rest, as far as the teeth would push it back."""
    if state[REST_TORQUE] == 0.0 and law[COULOMB] + law[MOTOR_COULOMB] == 0.0:  # friction hides what may hold it
        length, edge = _LEAVES * law[CROSSING], contact(law, _TOUCH)
        segment(state, length, target, 0.0, 0.0, 0.0, 0.0, -edge, -law[CLEAR], way, 0.0, 2)


@compiled
def fly(law: Array, state: Array, to: float, load: float, speed_l: float, motor: float, speed_m: float) -> float:
    """Plan a move of the load from where it is to rest at ``to``; return the flank on which it ends.

    Parameters
    ----------
    to, load : rad
    speed_l, speed_m : of the load, and of the motor at the output, rad/s
    motor : at the output, from the middle of the gap, rad
    """
    inertia, viscous, dry = law[INERTIA], law[FRICTION], law[COULOMB]
    to -= _short(law, to - load)
    pull, rests = pull_at(state, load), pull_at(state, to)
    held, stops = holds(law, pull), stopping_way(law, speed_l)
    far = abs(to - load) > _GAP_WAYS * law[GAP] + abs(stops)
    way = 1.0 if to - load - (0.0 if held or far else stops) >= 0.0 else -1.0
    x, v, target, g = way * load, way * speed_l, way * to, way * (motor - load)
    closing, edge = way * (speed_m - speed_l), contact(law, _TOUCH)
    first, last = dry - way * pull, dry - way * rests
    between = resists(law, state, way, x + _ABOUT * (target - x))
    state[SEGMENTS], state[REST_TORQUE] = 0.0, -rests if holds(law, rests) else 0.0
    most = max(first, between, last)
    carries = most < 0.0 and abs(v) < _STOPS and _carry(law, state, target, x, v, g, closing, most, way, False)
    if carries or _holds_back(law, state, target, x, v, g, closing, first, most, way):
        return -way
    # The load alone until it is touched: friction brakes it, and holds it once it stands.
    length = _approach(law, g)
    if v < 0.0:
        slows = (viscous * v - dry - (way * pull if held else 0.0)) / inertia
    else:
        slows = (viscous * v + (first if v > 0.0 else min(first, 0.0))) / inertia
    if v > 0.0 and slows * length > v:
        slows = v / length
    touched, v_touched = x + v * length - 0.5 * slows * length * length, v - slows * length
    moves = abs(v) > 1e-3 or (held and first < 0.0)
    returns = holds(law, rests) and last > 0.0
    back = law[CROSSING] if returns else 0.0
    c = first, between, last
    speed, cruise, push, brake, c, one_flank = _throw(law, state, way, target, touched, v_touched, c, back, moves, True)
    if speed <= v_touched and not one_flank:  # it cannot be thrown where the torque changes so much
        c = first, last, last
        speed, cruise, push, brake, c, one_flank = _throw(
            law, state, way, target, touched, v_touched, c, back, moves, False
        )
    _, between, _ = c
    if one_flank:
        _press(law, state, target, x, v, slows, g, closing, min(between, last), way)
        return way
    _, at, starts, bump, slowed, brakes, left = _lands(law, touched, v_touched, speed, push, brake, c, back, moves)
    if brakes > 0.0 and last > 0.0 and speed > v_touched:  # at its end the load torque brakes more than is needed
        _press(law, state, target, x, v, slows, g, closing, last, way)
        return way
    ends = -(viscous * speed + between) / inertia
    if v_touched > 0.0 and bump < 0.0:
        most = max(first, between, last)
        if first < 0.0 and abs(v) < _STOPS:
            # the load torque may carry it only at first, as a weight's does on the way down
            _carry(law, state, target, x, v, g, closing, most if most < 0.0 else _AT_FIRST * first, way, True)
        else:
            _catch(law, state, target, x, v, g, closing, way)
            _leave(law, state, target, way)
        return -way
    if length > 0.0:
        segment(state, length, x, v, -slows, -slows, 0.0, g, edge, way, closing, 2)
    segment(state, push, touched, v_touched, starts, ends, bump, edge, edge, way, 0.0, 0)
    if cruise > 0.0:
        segment(state, cruise, at, speed, 0.0, 0.0, 0.0, edge, edge, way, 0.0, 0)
        at += speed * cruise
    crossing = law[CROSSING]
    segment(state, crossing, at, speed, -slowed, -slowed, 0.0, edge, -edge, way, 0.0, 2)
    at, met = at + speed * crossing - 0.5 * slowed * crossing * crossing, speed - slowed * crossing
    starts, ends = -(viscous * met + between) / inertia, -(viscous * left + max(last, 0.0)) / inertia
    segment(state, brake, at, met, starts, ends, brakes, -edge, -edge, way, 0.0, 1)
    if back > 0.0:
        at, slows = target - 0.5 * left * back, left / back
        segment(state, back, at, left, -slows, -slows, 0.0, -edge, edge, way, 0.0, 2)
        return way
    _leave(law, state, target, way)
    return -way


@compiled
def shift(law: Array, state: Array, to: float, load: float) -> float:
    """Plan a move of a load that a torque holds on a flank, without leaving the flank; return the flank."""
    way = 1.0 if to >= load else -1.0
    c, distance, at = resists(law, state, way, way * load), abs(to - load), way * load
    least = _UNSURE if law[COULOMB] > 0.0 else _SHORT
    length = max(least, math.sqrt(_PEAK * distance * law[INERTIA] / (_SHIFTED * max(abs(c), 1e-4))))
    flank, speed = math.copysign(1.0, c), distance / length
    state[SEGMENTS], state[REST_TORQUE] = 0.0, -pull_at(state, to)
    segment(state, length, at, 0.0, 0.0, 0.0, speed / length, flank, flank, way, 0.0, 0)
    segment(state, length, at + 0.5 * distance, speed, 0.0, 0.0, -speed / length, flank, flank, way, 0.0, 0)
    return way * flank


@compiled
def press(law: Array, state: Array, to: float, load: float, motor: float, speed_m: float) -> float:
    """Plan to push a load that dry friction holds, a stuck one, to its target; return the flank."""
    way = 1.0 if to >= load else -1.0
    c = max(resists(law, state, way, way * load), _HIDDEN * law[COULOMB])
    pulls(state, way * (law[COULOMB] - c), load)
    state[SEGMENTS] = state[REST_TORQUE] = 0.0
    _press(law, state, way * to, way * load, 0.0, 0.0, way * (motor - load), way * speed_m, c, way)
    return way
