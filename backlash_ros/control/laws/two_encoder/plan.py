"""The plans: the motion of load and motor until the load rests at its target, in closed form.

A plan consists of segments. In each, the load's acceleration is a straight line plus a bump. Either the motor is in
contact on one flank, at the depth at which the teeth carry the load's torque, or it crosses to the other flank while
the load coasts. Everything is written for a move forward; a move backward is its mirror image.

The load needs the torque J a + B v + c, where c = tau_c - tau_l brakes it at any speed. The plans:

    flight   approach the driving flank, push, cross while the load coasts, brake on the other flank; under a load
             torque that goes against the move cross back while the load comes to rest
    press    all on the driving flank: friction, or the load torque, brakes hard enough
    carry    all on the braking flank: the load torque carries the load
"""

import math

from backlash_ros.control.laws.two_encoder.layout import (
    BRAKE,
    COLUMNS,
    COULOMB,
    CROSSING,
    FRICTION,
    GAP,
    INERTIA,
    MIDDLE,
    MOTOR_INERTIA,
    NO_LOAD,
    PERIOD,
    PLAN,
    PUSH,
    REST_TORQUE,
    SEGMENTS,
    STALL,
)
from backlash_ros.control.laws.two_encoder.observers import contact, holds
from backlash_ros.drivetrain.compiled import compiled
from backlash_ros.drivetrain.signals import Array

_LENGTH, _AT, _V, _STARTS, _ENDS, _BUMP, _FROM, _TO, _CROSSES, _WAY, _LEVEL, _CLOSING, _SOFT = range(COLUMNS)
"""Of a segment: s; position and speed of the load at its start; acceleration of the straight line at either end; the
bump's mean; g at its start and end, and whether the motor crosses; the move's direction; c; how fast g changes at the
start, rad/s; whether the bump ends softly."""

_PEAK = 1.5
"""Peak of a bump divided by its mean."""
_SPEED, _EFFORT, _LEFT = 0.6, 0.75, 0.1
"""Shares of the no-load speed, and of the torque available at a speed, that a plan uses."""
_TOUCH = 0.02
"""Torque with which teeth are touched, N m."""
_BRAKES, _VISCOUS = 0.8, 0.3
"""Share of what brakes the load by itself that a plan on one flank uses, so that the teeth stay in contact, and of its
viscous friction at first in that."""
_OWN, _SHORTEST, _LEAST, _HARD = 1.33, 0.035, 0.02, 165.0
"""A brake is so short that the teeth do more than the load by itself: most of its time over that of the load's own; s
below which one flank does it, s at least, and rad/s^2 of friction and load torque from which on one flank does it."""
_LONGEST, _OF_WAY, _CROSSES_IN = 0.3, 0.25, 3.0
"""Longest time to catch a load, s; share of its travel and least number of periods for the motor's crossing to it."""
_NEAR, _STOPS = 0.92, 0.3
"""g, in half gaps, above which a flank is reached; speed, rad/s, below which a load may be carried from rest."""
_QUICKER, _SHORT = 0.9, 0.03
_UNSURE = 0.06
"""Shortest time, s, for each half of a shift if friction hides the load torque, so that the shift shows it."""
_GAP_WAYS = 2.0


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
    level: float,
    closing: float,
    kind: int,
) -> None:
    """Add a segment to the plan. ``kind``: 0 contact, 1 contact whose bump ends softly, 2 crossing."""
    row = PLAN + int(state[SEGMENTS]) * COLUMNS
    state[row + _LENGTH], state[row + _AT], state[row + _V] = length, at, speed
    state[row + _STARTS], state[row + _ENDS], state[row + _BUMP] = starts, ends, bump
    state[row + _FROM], state[row + _TO], state[row + _CLOSING] = from_, to, closing
    state[row + _WAY], state[row + _LEVEL] = way, level
    state[row + _CROSSES], state[row + _SOFT] = 1.0 if kind == 2 else 0.0, 1.0 if kind == 1 else 0.0
    state[SEGMENTS] += 1.0


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
            torque = law[INERTIA] * a + law[FRICTION] * v + row[_LEVEL]
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
    return float(_BRAKES * law[CROSSING] * max(0.3, math.sqrt(min(1.0, (0.5 * law[GAP] - g) / law[GAP]))))


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
    if length > 0.0:
        segment(state, length, x, v, -slows, -slows, 0.0, g, edge, way, 0.0, closing, 2)
        x, v = x + v * length - 0.5 * slows * length * length, v - slows * length
    left, push, top = target - x, law[PUSH], _SPEED * law[NO_LOAD]
    speed = cruise = 0.0
    brake = law[PUSH]
    for _ in range(6):
        decelerates = _BRAKES * (c + _VISCOUS * law[FRICTION] * speed) / law[INERTIA]
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
    segment(state, push, x, v, 0.0, 0.0, (speed - v) / push, edge, edge, way, c, 0.0, 0)
    x += 0.5 * (v + speed) * push
    if cruise > 0.0:
        segment(state, cruise, x, speed, 0.0, 0.0, 0.0, edge, edge, way, c, 0.0, 0)
        x += cruise * speed
    segment(state, brake, x, speed, 0.0, 0.0, -speed / brake, edge, edge, way, c, 0.0, 1)


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
    speed, cruise, edge = left / (0.5 * (run + brake)), 0.0, contact(law, _TOUCH)
    if speed > _SPEED * law[NO_LOAD]:
        speed = _SPEED * law[NO_LOAD]
        cruise = left / speed - 0.5 * (run + brake)
    if g > -0.9 * 0.5 * law[GAP]:
        segment(state, law[CROSSING], x, v, 0.0, 0.0, 0.0, g, -edge, way, 0.0, closing, 2)
    segment(state, run, x, 0.0, 0.0, 0.0, speed / run, -edge, -edge, way, c, 0.0, 0)
    if cruise > 0.0:
        segment(state, cruise, x + 0.5 * speed * run, speed, 0.0, 0.0, 0.0, -edge, -edge, way, c, 0.0, 0)
    segment(state, brake, target - 0.5 * speed * brake, speed, 0.0, 0.0, -speed / brake, -edge, -edge, way, c, 0.0, 0)
    return True


@compiled
def _catch(
    law: Array, state: Array, target: float, x: float, v: float, g: float, closing: float, c: float, way: float
) -> None:
    """Plan to meet a fast load on its front side, and to brake it."""
    inertia, edge = law[INERTIA], contact(law, _TOUCH)
    length = law[CROSSING] * max(0.3, math.sqrt(min(1.0, max(0.0, 0.5 * law[GAP] + g) / law[GAP])))
    if v * length > _OF_WAY * (target - x):  # too fast for a soft crossing
        length = max(_OF_WAY * (target - x) / v, _CROSSES_IN * law[PERIOD])
    slows = min((law[FRICTION] * v + c) / inertia, v / length)
    segment(state, length, x, v, -slows, -slows, 0.0, g, -edge, way, 0.0, closing, 2)
    x, v = x + v * length - 0.5 * slows * length * length, v - slows * length
    brake = _LONGEST
    if v > 0.0:
        brake = min(max(2.0 * (target - x) / v, _push_time(law, _LEAST, v, v, -c)), _LONGEST)
    starts, ends = -(law[FRICTION] * v + c) / inertia, -max(c, 0.0) / inertia
    bump = min(-v / brake - 0.5 * (starts + ends), 0.0)
    segment(state, brake, x, v, starts, ends, bump, -edge, -edge, way, c, 0.0, 0)


@compiled
def _lands(
    law: Array, x: float, v: float, speed: float, push: float, brake: float, c: float, back: float, moves: bool
) -> tuple[float, float, float, float, float, float]:
    """Compute a flight in which the push reaches a given speed.

    Returns
    -------
    where it ends (rad); the acceleration with which the push starts and its bump; the load's deceleration while the
    motor crosses; the bump of the brake, and the speed that is left after it for ``back`` seconds, rad/s (^2).
    """
    inertia, viscous, crossing = law[INERTIA], law[FRICTION], law[CROSSING]
    starts = -(viscous * v + c) / inertia if moves else 0.0
    ends = -(viscous * speed + c) / inertia
    bump = (speed - v) / push - 0.5 * (starts + ends)
    x += v * push + push * push * (starts / 3.0 + ends / 6.0 + 0.5 * bump)
    slows = (viscous * speed + c) / (inertia + 0.5 * viscous * crossing)
    met = speed - slows * crossing
    x += speed * crossing - 0.5 * slows * crossing * crossing
    left = c / inertia * back
    first, last = -(viscous * met + c) / inertia, -(viscous * left + max(c, 0.0)) / inertia
    brakes = (left - met) / brake - 0.5 * (first + last)
    x += met * brake + brake * brake * (first / 3.0 + last / 6.0 + 0.6 * brakes)
    return x + 0.5 * left * back, starts, bump, slows, brakes, left


@compiled
def fly(
    law: Array, state: Array, to: float, load: float, speed_l: float, motor: float, speed_m: float, pull: float
) -> float:
    """Plan a move of the load from where it is to rest at ``to``; return the flank on which it ends.

    Parameters
    ----------
    to, load : rad
    speed_l, speed_m : of the load, and of the motor at the output, rad/s
    motor : at the output, from the middle of the gap, rad
    pull : load torque, N m
    """
    inertia, viscous, dry = law[INERTIA], law[FRICTION], law[COULOMB]
    held, stops = holds(law, pull), stopping_way(law, speed_l)
    far = abs(to - load) > _GAP_WAYS * law[GAP] + abs(stops)
    way = 1.0 if to - load - (0.0 if held or far else stops) >= 0.0 else -1.0
    x, v, target, g = way * load, way * speed_l, way * to, way * (motor - load)
    closing, c, edge = way * (speed_m - speed_l), dry - way * pull, contact(law, _TOUCH)
    state[SEGMENTS], state[REST_TORQUE] = 0.0, -pull if held else 0.0
    if c < 0.0 and abs(v) < _STOPS and _carry(law, state, target, x, v, g, closing, c, way, False):
        return -way
    # The load alone until it is touched: friction brakes it, and holds it once it stands.
    length = _approach(law, g)
    if v < 0.0:
        slows = (viscous * v - dry - (way * pull if held else 0.0)) / inertia
    else:
        slows = (viscous * v + (c if v > 0.0 else min(c, 0.0))) / inertia
    if v > 0.0 and slows * length > v:
        slows = v / length
    touched, v_touched = x + v * length - 0.5 * slows * length * length, v - slows * length
    moves = abs(v) > 1e-3 or (held and c < 0.0)
    push, brake, back = law[PUSH], law[BRAKE], law[CROSSING] if held and c > 0.0 else 0.0
    one_flank = c > 0.0 and c / inertia >= _HARD
    speed = cruise = 0.0
    for _ in range(5):
        without = _lands(law, touched, v_touched, 0.0, push, brake, c, back, moves)[0]
        per_speed = _lands(law, touched, v_touched, 1.0, push, brake, c, back, moves)[0] - without
        speed, cruise = (target - without) / per_speed, 0.0
        if speed > _SPEED * law[NO_LOAD]:
            cruise = (speed / (_SPEED * law[NO_LOAD]) - 1.0) * per_speed
            speed = _SPEED * law[NO_LOAD]
        push = _push_time(law, push, speed - v_touched, speed, c)
        if c >= 0.0:
            slowed = _lands(law, touched, v_touched, speed, push, brake, c, back, moves)[3]
            met = speed - slowed * law[CROSSING]
            if met <= 0.0:
                one_flank = c > 0.0
                break
            longest = _OWN * met * inertia / (viscous * met + 2.0 * c)
            if c > 0.0 and longest < _SHORTEST:
                one_flank = True
                break
            brake = max(min(law[BRAKE], longest), _LEAST)
    if one_flank:
        _press(law, state, target, x, v, slows, g, closing, c, way)
        return way
    _, starts, bump, slowed, brakes, left = _lands(law, touched, v_touched, speed, push, brake, c, back, moves)
    ends = -(viscous * speed + c) / inertia
    if v_touched > 0.0 and bump < 0.0:
        if c < 0.0 and abs(v) < _STOPS:
            _carry(law, state, target, x, v, g, closing, c, way, True)
        else:
            _catch(law, state, target, x, v, g, closing, c, way)
        return -way
    if length > 0.0:
        segment(state, length, x, v, -slows, -slows, 0.0, g, edge, way, 0.0, closing, 2)
    segment(state, push, touched, v_touched, starts, ends, bump, edge, edge, way, c, 0.0, 0)
    at = touched + v_touched * push + push * push * (starts / 3.0 + ends / 6.0 + 0.5 * bump)
    if cruise > 0.0:
        segment(state, cruise, at, speed, 0.0, 0.0, 0.0, edge, edge, way, c, 0.0, 0)
        at += speed * cruise
    crossing = law[CROSSING]
    segment(state, crossing, at, speed, -slowed, -slowed, 0.0, edge, -edge, way, 0.0, 0.0, 2)
    at, met = at + speed * crossing - 0.5 * slowed * crossing * crossing, speed - slowed * crossing
    first, last = -(viscous * met + c) / inertia, -(viscous * left + max(c, 0.0)) / inertia
    segment(state, brake, at, met, first, last, brakes, -edge, -edge, way, c, 0.0, 1)
    if back > 0.0:
        segment(
            state,
            back,
            target - 0.5 * left * back,
            left,
            -left / back,
            -left / back,
            0.0,
            -edge,
            edge,
            way,
            0.0,
            0.0,
            2,
        )
        return way
    return -way


@compiled
def shift(law: Array, state: Array, to: float, load: float, pull: float) -> float:
    """Plan a move of a load that a torque (N m) holds on a flank, without leaving the flank; return the flank."""
    way = 1.0 if to >= load else -1.0
    c, distance, at = law[COULOMB] - way * pull, abs(to - load), way * load
    least = _UNSURE if law[COULOMB] > 0.0 else _SHORT
    length = max(least, math.sqrt(_PEAK * distance * law[INERTIA] / (_BRAKES * max(abs(c), 1e-4))))
    flank, speed = math.copysign(1.0, c), distance / length
    state[SEGMENTS], state[REST_TORQUE] = 0.0, -pull
    segment(state, length, at, 0.0, 0.0, 0.0, speed / length, flank, flank, way, c, 0.0, 0)
    segment(state, length, at + 0.5 * distance, speed, 0.0, 0.0, -speed / length, flank, flank, way, c, 0.0, 0)
    return way * flank


@compiled
def press(law: Array, state: Array, to: float, load: float, motor: float, speed_m: float, pull: float) -> float:
    """Plan to push a load that friction holds to its target; return the flank."""
    way = 1.0 if to >= load else -1.0
    c = max(law[COULOMB] - way * pull, 0.3 * law[COULOMB])
    state[SEGMENTS] = state[REST_TORQUE] = 0.0
    _press(law, state, way * to, way * load, 0.0, 0.0, way * (motor - load), way * speed_m, c, way)
    return way
