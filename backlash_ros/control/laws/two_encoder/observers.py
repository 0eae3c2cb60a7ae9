"""The law's estimates: of the motor by a Kalman filter on its model, of the load by a filter that knows free motion.

Both are for the instant of the sample; the command of the sample acts later, so the motor is predicted over the delay.
"""

import math

from backlash_ros.control.laws.two_encoder.layout import (
    ACTING,
    AFTER,
    ASTRAY,
    BEFORE,
    CARRIED,
    COMMANDS,
    CONSTANT,
    COSINE,
    COULOMB,
    COUNT,
    CURRENT_TORQUE,
    DELAY,
    DISTURBANCE,
    DOUBTED,
    EXPECTED_COSINE,
    EXPECTED_SINE,
    FLIGHT,
    FRICTION,
    GAIN,
    GAP,
    HELD,
    HOLD,
    INERTIA,
    KEPT,
    LANDED,
    LAST_LOAD,
    LAST_MOTOR,
    LAST_WAY,
    LOAD,
    LOAD_DOUBTED,
    LOAD_SPEED,
    MIDDLE,
    MOMENTUM,
    MOTOR,
    MOTOR_COULOMB,
    MOTOR_FRICTION,
    MOTOR_INERTIA,
    PERIOD,
    PHASE,
    PLACE,
    POINTS,
    PULL,
    PULL_SLOW,
    REST_TORQUE,
    ROUGH,
    SEEN,
    SEEN_TIME,
    SHAKEN,
    SINE,
    SPEED,
    STALL,
    STEP,
    TARGET,
    TEETH,
    TOLD_COSINE,
    TOLD_SINE,
    TRUST,
    WAITED,
    WEIGHED,
    WHOLE,
)
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

_WHOLE = 1e-9
_LEAP, _STRUCK, _DRIVEN, _AT_REST = 0.1, 1.5, 0.3, 0.03
"""By how much a reading may be off: share of the gap, of the way that the shafts' speeds differ by, and of what the
motor's stall torque does to it, in flight and at rest."""
_MOVED, _MOVED_FOR, _LEAPT_FOR = 0.05, 3.0, 11.0
"""Share of what is missed that a shaft goes on by in a period where it was moved; readings until it, and until one that
leapt, is believed: a sample may be wrong ten times."""
_APART = 0.36
"""Share of the gap, to either side of its middle, in which the teeth are apart with any contact law."""
_IN_FLIGHT, _TOUCHED, _ALONE = 60.0, 4.0, 0.3
"""How far the load's acceleration is from what is known of it at 250 Hz, rad/s^2."""
_OFF, _ASTRAY, _SURE = 1.5, 4.0, 0.5
"""Largest error of a load at rest, in counts; number of consecutive readings beyond it that mean motion; share of the
speed that they show which is believed, as they are noisy."""
_RESTS, _THERE = 0.05, 0.1
"""Speed, rad/s, below which the motor rests, and share of the gap within which it has reached its target."""
_LEAST_LAG = 0.1
"""Of the load's filter, so that it does not ring where its readings have no count."""
UNSEEN = 0.05
"""Assumed encoder count, as a share of the gap, until one is seen."""
_SMALLEST, _NOISE, _WIDTH = 1e-6, 0.2, 1.6
"""rad; s over which noise is looked at while holding; a count that is as wide as noise, over the readings' mean second
difference."""
_UNSURE, _LAGS = 0.01, 20.0
"""By how much the load torque that is seen while holding is off: N m where the teeth seem apart, and rad/s^2 of the
load for each rad/s of its speed, the largest lately."""
_CARRIES, _TOUCHES, _LEARN, _WALL, _WRONG, _BEYOND = 0.05, 0.02, 0.012, 0.03, 0.6, 0.02
"""Torque, N m, and times, s, in which teeth that push, and teeth that cannot be where they seem, show where they are;
what is too far off for that, and what g may be beyond the gap, as shares of it."""
_TURNS, _LONG, _DISPROVED = 0.2, 0.05, 2.0
"""Smallest speed, rad/s, and time, s, for which a flight shows the load torque; and how many times as far off it shows
the load torque with the expected slope as without, if the slope is wrong."""
_FALLS, _LIES = 8e-3, 0.5
"""A load torque that pulls the load through the gap within this time, s, has laid it on its flank, up to this speed of
the load, rad/s."""
_SLIDES = 0.05
"""Speed of the motor, rad/s, above which its dry friction is all there."""
_SLOWLY, _PATIENT, _STANDS = 0.05, 0.1, 0.02
FREE, NONE, _MOTOR_OFF = 4e-3, 6e-3, 0.1
"""N m beyond the friction from which on a load torque holds the load; what a flight must show of one at least; share of
the motor's dry friction that is added to this, since the friction is not known better."""


@compiled
def contact(law: Array, torque: float) -> float:
    """Return abs(g) at which teeth at rest carry a torque (N m) of either sign, rad; at least the table's first."""
    size = abs(torque)
    if size <= law[TEETH]:
        return float(law[TEETH + POINTS])
    for k in range(TEETH, TEETH + POINTS - 1):
        if size <= law[k + 1]:
            share = (size - law[k]) / (law[k + 1] - law[k])
            return float(law[k + POINTS] + share * (law[k + POINTS + 1] - law[k + POINTS]))
    return float(law[TEETH + 2 * POINTS - 1])


@compiled
def pull_at(state: Array, load: float) -> float:
    """Return the load torque at an angle of the load (rad), N m."""
    return float(state[CONSTANT] + state[SINE] * math.sin(load) + state[COSINE] * math.cos(load))


@compiled
def pulls(state: Array, pull: float, load: float) -> None:
    """Take ``pull`` (N m) for the load torque at an angle of the load, rad, and with it what it is elsewhere."""
    state[PULL] = pull
    state[CONSTANT] += pull - pull_at(state, load)


@compiled
def expect(law: Array, state: Array) -> None:
    """Take how the load torque is expected to grow with the load's angle, if that is new; for a load at rest."""
    if law[EXPECTED_SINE] != state[TOLD_SINE] or law[EXPECTED_COSINE] != state[TOLD_COSINE]:
        state[SINE] = state[TOLD_SINE] = law[EXPECTED_SINE]
        state[COSINE] = state[TOLD_COSINE] = law[EXPECTED_COSINE]
        pulls(state, state[PULL], state[LOAD])


@compiled
def dry(law: Array, speed: float) -> float:
    """Return the dry friction of a motor that turns, N m; less if it hardly turns."""
    return float(law[MOTOR_COULOMB] * min(max(speed / _TURNS, -1.0), 1.0))


@compiled
def _pass(law: Array, model: int, motor: Array, command: float, carried: float) -> None:
    """Advance the motor by a part of a period: p, w, torque of the current, disturbance."""
    position = speed = torque = 0.0
    carried += dry(law, motor[1])
    for j in range(4):
        position += law[model + j] * motor[j]
        speed += law[model + 6 + j] * motor[j]
        torque += law[model + 12 + j] * motor[j]
    position += law[model + 4] * command + law[model + 5] * carried
    speed += law[model + 10] * command + law[model + 11] * carried
    torque += law[model + 16] * command + law[model + 17] * carried
    motor[0], motor[1], motor[2] = position, speed, torque


@compiled
def _doubt(
    law: Array, state: Array, doubted: int, missed: float, way: float, count: float
) -> tuple[bool, float, float]:
    """Compare a reading with the expected angle; ``doubted`` counts consecutive implausible readings.

    The error of the first of them follows that count.

    Teeth that meet change a speed by their meeting speed; torques change it little within a period, least at rest. A
    shaft that moves away from the expected angle is believed at the third reading, an encoder that jumped much later.

    Parameters
    ----------
    missed : reading minus expected angle, rad
    way : motion since the previous reading minus the expected motion, rad
    count : of the encoder, rad

    Returns
    -------
    whether it is plausible; if not, the corrections of angle, rad, and speed, rad/s
    """
    share = _AT_REST if state[PHASE] == HOLD else _DRIVEN
    struck = _STRUCK * abs(state[SPEED] - state[LOAD_SPEED])
    driven = share * law[PERIOD] * law[STALL] / law[MOTOR_INERTIA]
    if abs(missed) <= _LEAP * law[GAP] + count + law[PERIOD] * (struck + driven):
        state[doubted] = 0.0
        return True, 0.0, 0.0
    state[doubted] += 1.0
    if state[doubted] == 1.0:
        state[doubted + 1] = missed
    times, moved = state[doubted], _MOVED < way / missed < 1.0 - _MOVED
    if times < (_MOVED_FOR if moved else _LEAPT_FOR):
        return False, 0.0, 0.0
    state[doubted] = 0.0
    return False, missed, (missed - state[doubted + 1]) / ((times - 1.0) * law[PERIOD]) if moved else 0.0


@compiled
def slower(law: Array, state: Array) -> float:
    """Return by which factor the loops are slower while the teeth carry the load, except in flights, which are short.

    They are designed for the motor alone. With a load on it that has four times its inertia or more, they would swing.
    """
    if state[PHASE] != FLIGHT and state[CARRIED] != 0.0:
        return float(max(law[INERTIA] / law[MOTOR_INERTIA], 1.0))
    return 1.0


@compiled
def see_motor(law: Array, state: Array, reading: float) -> None:
    """Take the motor's angle at the output, rad, one period after the previous one."""
    motor, k = state[MOTOR : MOTOR + 4], int(law[WHOLE])
    if law[DELAY] - k * law[PERIOD] > _WHOLE * law[PERIOD]:
        _pass(law, BEFORE, motor, state[COMMANDS + k + 1], state[CARRIED + k + 1])
    _pass(law, AFTER, motor, state[COMMANDS + k], state[CARRIED + k])
    missed = reading - motor[0]
    way = reading - state[LAST_MOTOR] - law[PERIOD] * motor[1]
    fine, angle, speed = _doubt(law, state, DOUBTED, missed, way, 0.0)
    motor[0] += angle
    motor[1] += speed
    if fine:
        for i in range(4):
            motor[i] += law[GAIN + i] * missed
    state[LAST_MOTOR] = reading
    rests = state[PHASE] == HOLD and abs(state[SPEED]) < _RESTS and abs(state[PLACE] - motor[0]) < _THERE * law[GAP]
    if not rests or law[MOTOR_COULOMB] == 0.0:  # the dry friction at rest must not wind up
        state[ACTING] += law[TRUST] / slower(law, state) * (state[DISTURBANCE] - state[ACTING])


@compiled
def predict_motor(law: Array, state: Array) -> Array:
    """Return p, w, torque of the current (N m) and disturbance (N m) when the next command begins to act."""
    motor, whole = state[MOTOR : MOTOR + 4].copy(), int(law[WHOLE])
    split = law[DELAY] - whole * law[PERIOD] > _WHOLE * law[PERIOD]
    if split:
        _pass(law, BEFORE, motor, state[COMMANDS + whole], state[CARRIED + whole])
    for k in range(whole - 1, -1, -1):
        _pass(law, AFTER, motor, state[COMMANDS + k], state[CARRIED + k])
        if split:
            _pass(law, BEFORE, motor, state[COMMANDS + k], state[CARRIED + k])
    return motor


@compiled
def attribute(state: Array, carried: float) -> None:
    """Take another torque (N m) for that of the teeth at rest; the disturbance is less by it, so the command stays."""
    change = carried - state[CARRIED]
    state[DISTURBANCE] -= change
    state[ACTING] -= change
    for k in range(KEPT):
        state[CARRIED + k] += change


@compiled
def apart(law: Array, state: Array) -> bool:
    """Return whether the teeth are apart."""
    return bool(abs(state[MOTOR] - state[LOAD] - state[MIDDLE]) < _APART * law[GAP])


@compiled
def see_load(law: Array, state: Array, reading: float) -> None:
    """Take the load's angle, rad, one period after the previous one.

    The gains are Kalata's (IEEE Trans. AES 20, 1984), for the count that the readings show: their smallest step, or
    noise of that width.
    """
    period = law[PERIOD]
    change = abs(reading - state[LAST_LOAD])
    if change > _WHOLE and state[STEP] > 0.0:
        state[STEP] = max(min(state[STEP], change), _SMALLEST)
    elif change > _WHOLE and state[PHASE] == HOLD and abs(state[LOAD_SPEED]) * period < 0.5 * change:
        state[STEP] = change
    before, state[LAST_LOAD] = state[LAST_LOAD], reading
    if state[PHASE] == HOLD:
        bend = min(abs(reading - before - state[LAST_WAY]), law[GAP])
        state[ROUGH] += min(period / _NOISE, 1.0) * (bend - state[ROUGH])
    state[LAST_WAY] = reading - before
    state[LOAD] += period * state[LOAD_SPEED]
    missed, unknown = reading - state[LOAD], _TOUCHED
    way = reading - before - period * state[LOAD_SPEED]
    fine, angle, speed = _doubt(law, state, LOAD_DOUBTED, missed, way, state[COUNT])
    if not fine:
        state[LOAD] += angle
        state[LOAD_SPEED] += speed
        return
    state[COUNT] = max(state[STEP] if state[STEP] > 0.0 else UNSEEN * law[GAP], _WIDTH * state[ROUGH])
    if state[PHASE] != HOLD:
        unknown, state[ASTRAY] = _IN_FLIGHT, 0.0
    else:
        beyond = abs(missed) > _OFF * state[COUNT]
        same = state[ASTRAY] * missed >= 0.0
        state[ASTRAY] = math.copysign(1.0, missed) + (state[ASTRAY] if same else 0.0) if beyond else 0.0
    if abs(state[ASTRAY]) == _ASTRAY:  # it does not move as at rest: what is missed has grown since the first of these
        state[LOAD] = reading
        state[LOAD_SPEED] += _SURE * missed / (_ASTRAY * period)
        return
    if abs(state[ASTRAY]) > _ASTRAY:
        unknown = _IN_FLIGHT
    elif state[PHASE] == HOLD and state[HELD] == 0.0:
        state[LOAD_SPEED] *= math.exp(-law[FRICTION] / law[INERTIA] * period)
        if apart(law, state):
            unknown = _ALONE
    index = unknown * math.sqrt(0.004 / period) * period * period * math.sqrt(12.0) / state[COUNT]
    r = max(0.25 * (4.0 + index - math.sqrt(8.0 * index + index * index)), _LEAST_LAG)
    alpha = 1.0 - r * r
    state[LOAD] += alpha * missed
    state[LOAD_SPEED] += (2.0 * (2.0 - alpha) - 4.0 * r) / period * missed


@compiled
def rests_on(law: Array, state: Array, pull: float) -> None:
    """Assume that the load rests on the flank where a torque (N m) holds it, if the teeth surely carry it."""
    if abs(pull) > law[MOTOR_COULOMB] + _CARRIES:
        state[MIDDLE] = state[MOTOR] - state[LOAD] + math.copysign(contact(law, pull), pull)


@compiled
def see_middle(law: Array, state: Array) -> None:
    """Learn the middle of the gap from teeth that push or hold, and from the fact that no teeth are beyond the gap."""
    sure = min(state[PULL] * state[PULL_SLOW], state[PULL_SLOW] ** 2)
    strong = 2.0 * law[INERTIA] * law[GAP] / _FALLS**2
    if state[PHASE] == HOLD and sure > strong * strong and abs(state[LOAD_SPEED]) < _LIES:
        rests_on(law, state, state[PULL_SLOW])  # it would fall through the gap at once
    elif state[PHASE] == HOLD and state[WAITED] > _PATIENT and abs(state[LOAD_SPEED]) < _STANDS:
        rests_on(law, state, state[PULL_SLOW])
    carried = state[CARRIED + int(law[WHOLE])]
    between = state[MOTOR] - state[LOAD] - state[MIDDLE]
    if state[PHASE] == FLIGHT and abs(carried) > _CARRIES:
        off = between - math.copysign(contact(law, carried), carried)
        if abs(off) < _WRONG * law[GAP]:
            state[MIDDLE] += min(0.3, law[PERIOD] / _LEARN) * off
        return
    most = contact(law, abs(carried + state[DISTURBANCE]) + law[MOTOR_COULOMB] + _TOUCHES)
    beyond = abs(between) - most - _BEYOND * law[GAP] - state[COUNT]
    if beyond > 0.0:
        state[MIDDLE] += min(0.3, law[PERIOD] / _WALL) * math.copysign(beyond, between)


@compiled
def see_pull(law: Array, state: Array) -> None:
    """Learn the load torque from the momentum that both shafts gain beyond what the current gives, N m.

    In motion the friction is known, at rest only its bound. Over a whole flight a wrong inertia cancels.
    """
    w, omega, friction, period = state[SPEED], state[LOAD_SPEED], law[COULOMB], law[PERIOD]
    momentum = law[MOTOR_INERTIA] * w + law[INERTIA] * omega
    gained, state[MOMENTUM] = momentum - state[MOMENTUM], momentum
    state[SHAKEN] = max(abs(omega), state[SHAKEN] * (1.0 - period / _SLOWLY))
    gained -= period * (state[CURRENT_TORQUE] - law[MOTOR_FRICTION] * w - law[FRICTION] * omega)
    if state[PHASE] != HOLD:
        turns = abs(omega) > _TURNS
        slides = law[MOTOR_COULOMB] == 0.0 or abs(w) > _SLIDES
        if turns and slides:
            state[SEEN] += period * math.copysign(friction, omega)
        if (turns or friction == 0.0) and slides:
            state[SEEN_TIME] += period
            pull = pull_at(state, state[LOAD])
            state[SEEN] -= period * pull
            state[WEIGHED] += period * (pull - state[PULL])
        if (turns or friction == 0.0 or state[HELD] == 0.0) and slides:
            state[SEEN] += gained + period * math.copysign(law[MOTOR_COULOMB], w)
        if not turns:
            state[PULL_SLOW] += min(1.0 / _SLOWLY, 1.0 / period) * (gained - period * state[PULL_SLOW])
        return
    state[PULL_SLOW] += min(1.0 / _SLOWLY, 1.0 / period) * (gained - period * state[PULL_SLOW])
    if state[LANDED] > _PATIENT:
        unknown = friction + law[MOTOR_COULOMB] + _LAGS * law[INERTIA] * state[SHAKEN]
        if apart(law, state):
            unknown += _UNSURE
            if abs(omega) < _STANDS:
                pulls(state, min(max(state[PULL], -friction), friction), state[LOAD])
                return
        can_be = min(max(state[PULL], state[PULL_SLOW] - unknown), state[PULL_SLOW] + unknown)
        share = 1.0 if friction > 0.0 else min(period / _SLOWLY, 1.0)
        pulls(state, state[PULL] + share * (can_be - state[PULL]), state[LOAD])


@compiled
def landed(law: Array, state: Array) -> None:
    """Use the load torque that the last flight has shown; a load that stood still bounds it by its friction."""
    at = state[TARGET] if state[PHASE] == FLIGHT else state[LOAD]
    pull = pull_at(state, at)
    if state[SEEN_TIME] > _LONG:
        beyond, without = state[SEEN] / state[SEEN_TIME], (state[SEEN] + state[WEIGHED]) / state[SEEN_TIME]
        if abs(beyond) > _DISPROVED * abs(without) + 2.0 * NONE:
            state[SINE] = state[COSINE] = 0.0
            pull, beyond = state[PULL], without
        pull += beyond
        pull = pull if abs(pull) >= NONE + _MOTOR_OFF * law[MOTOR_COULOMB] else 0.0
        if state[PHASE] == FLIGHT:  # there is no plan while following a setpoint
            state[PULL_SLOW] = -state[REST_TORQUE]
    else:
        unknown = law[COULOMB] + law[MOTOR_COULOMB]
        pull = min(max(pull, state[PULL_SLOW] - unknown), state[PULL_SLOW] + unknown)
    pulls(state, pull, at)
    state[SEEN] = state[WEIGHED] = state[SEEN_TIME] = 0.0


@compiled
def holds(law: Array, pull: float) -> bool:
    """Return whether a load torque (N m) holds the load on a flank, because it exceeds friction."""
    return bool(abs(pull) > law[COULOMB] + FREE)
