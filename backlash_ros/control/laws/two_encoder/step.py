"""One step of the law: it executes planned moves, follows moving setpoints, and holds by events.

In flight the motor follows its plan on its own encoder, without feedback from the load. In hold the law leaves the load
alone while it is near enough, with the motor in the middle of the gap, or on the flank where the load torque holds it.
If the load is not near enough:

    held by a load torque     it is moved with the motor, without leaving the flank: led in, or by a shift
    stuck by dry friction     it is pressed to its target
    free                      it is led in by the flank behind or before it, no faster than it can stop by itself
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import LAW_SIGNATURE
from backlash_ros.control.laws.two_encoder.layout import (
    ACTING,
    BACK_EMF,
    CARRIED,
    COMMANDS,
    CONSTANT,
    COULOMB,
    COUNT,
    CROSSING,
    CURRENT_TORQUE,
    DAMPING,
    DELAY,
    DISTURBANCE,
    ELECTRICAL,
    EXPECTED,
    FLANK,
    FLIGHT,
    FOLLOW,
    FRICTION,
    FROM,
    GAP,
    HELD,
    HOLD,
    INERTIA,
    KEPT,
    LANDED,
    LAST_ERROR,
    LAST_LOAD,
    LAST_MOTOR,
    LOAD,
    LOAD_SPEED,
    MIDDLE,
    MOMENTUM,
    MOTOR,
    MOTOR_COULOMB,
    MOTOR_FRICTION,
    MOTOR_INERTIA,
    PARKED,
    PERIOD,
    PHASE,
    PLACE,
    PULL,
    PULL_SLOW,
    RATIO,
    RESISTANCE,
    ROUGH,
    SHAKEN,
    SHARE,
    SIDE,
    SIDE_TIME,
    SPEED,
    STARTED,
    STEPPED,
    STIFFNESS,
    TARGET,
    TIME,
    TRIES,
    VOLTS_PER_SPEED,
    VOLTS_PER_TORQUE,
    WAITED,
)
from backlash_ros.control.laws.two_encoder.observers import (
    FREE,
    UNSEEN,
    attribute,
    contact,
    dry,
    expect,
    holds,
    landed,
    predict_motor,
    pull_at,
    pulls,
    rests_on,
    see_load,
    see_middle,
    see_motor,
    see_pull,
    slower,
)
from backlash_ros.control.laws.two_encoder.plan import evaluate, fly, length_of, press, shift, stopping_way
from backlash_ros.foundation.compiled import compiled, compiled_as
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import (
    ACCELERATION,
    OMEGA_L,
    OMEGA_M,
    POSITION,
    THETA_L,
    THETA_M,
    VELOCITY,
    Estimate,
    Setpoint,
)

_CREEPS = 0.1
"""Speed of a setpoint, in gaps per second, up to which it is held like one at rest; and the same as a leap in a sample.
Holding lets the load be off by a twelfth of the gap, so nothing is lost."""
_TIGHT, _WIDE = (0.04, 0.3), (0.08, 0.55)
"""Errors below which the load is left alone, and above which it no longer is: shares of the gap, or of a count if that
is more."""
_NOISY = 4.0
"""Width of the noise that counts as one encoder count, divided by the readings' mean second difference."""
_STILL, _STANDS, _SLOW = 0.02, 0.05, 0.5
"""Speeds, rad/s, below which a load stands: when a flight is planned, when it was stuck, when it can be shifted."""
_STRIKES = 150.0
"""1/s, by which the load's speed at a take-over makes the torque that held it uncertain, as momentum: it may rattle."""
_DRY = 3e-3
"""Friction, N m, above which a shaft stays where it stops."""
_LEADS, _FASTEST, _OF_OWN = 15.0, 12.0, 0.65
"""Rates, 1/s, with which a held load is led in, and at most a free one; share of its own rate B/J."""
_MEETS, _AWAY, _HASTE = 20.0, 0.06, 2.0
"""Rate, 1/s, with which a free load is met, share of the gap within which it is touched, and largest speed, rad/s."""
_PARK, _DWELL = 0.05, 0.05
_SETTLES, _AGAIN, _MOST_TRIES = 0.04, 0.06, 5.0
"""Time, s, for which a load is observed before it is moved; it grows each time, up to this many times."""
_RESTED = 1.0
"""Time at rest, s, after which earlier tries to move the load say nothing any more."""
_AHEAD, _FAR = 0.3, 2.0
_GOES = 40.0
"""Rate, 1/s, with which a motor that dry friction keeps from its target goes there."""
_LESS, _LEAST = 0.8, 0.3
"""Factor by which each change of the error's sign shortens the next move, and the smallest share."""


@compiled
def _start(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint) -> None:
    """Start at the present position, assumed to be the middle of the gap."""
    motor = law[RATIO] * estimate[THETA_M]
    state[MOTOR] = state[PLACE] = state[LAST_MOTOR] = motor
    state[LOAD] = state[LAST_LOAD] = estimate[THETA_L]
    state[MIDDLE] = motor - estimate[THETA_L]
    state[COUNT] = UNSEEN * law[GAP]
    far = abs(setpoint[POSITION] - estimate[THETA_L]) > _FAR * law[GAP]
    state[TARGET] = estimate[THETA_L] if far else setpoint[POSITION]  # a new target means a flight
    state[PHASE], state[SHARE], state[STARTED] = HOLD, 1.0, 1.0
    expect(law, state)
    state[CONSTANT] = law[EXPECTED]
    pulls(state, clamp(pull_at(state, state[LOAD]), -law[COULOMB], law[COULOMB]), state[LOAD])


@compiled
def _take_off(law: Array, state: Array) -> None:
    """Start a plan that was just made."""
    state[PHASE], state[TIME], state[LANDED] = FLIGHT, 0.0, 0.0
    if law[COULOMB] + law[MOTOR_COULOMB] > 0.0 and abs(state[LOAD_SPEED]) < _STANDS:
        state[ACTING] = state[DISTURBANCE] = 0.0  # the friction at rest does not act in motion


@compiled
def _fly(law: Array, state: Array, motor: Array) -> None:
    """Plan a flight to the target from the drive's position at the time when the command acts."""
    speed = state[LOAD_SPEED] if abs(state[LOAD_SPEED]) > _STILL else 0.0
    load, at = state[LOAD] + law[DELAY] * speed, motor[0] - state[MIDDLE]
    state[FLANK] = fly(law, state, state[TARGET], load, speed, at, motor[1])
    _take_off(law, state)


@compiled
def _wait(state: Array) -> None:
    """Start to hold, or change the kind of holding."""
    state[PHASE] = HOLD
    state[WAITED] = state[SIDE] = state[SIDE_TIME] = 0.0
    state[PARKED] = -1.0


@compiled
def _shorter(state: Array, error: float) -> float:
    """Return an error, reduced if its sign has changed, to prevent hunting."""
    if state[LAST_ERROR] * error < 0.0:
        state[SHARE] = max(_LEAST, _LESS * state[SHARE])
    state[LAST_ERROR] = error
    return float(state[SHARE] * error)


@compiled
def _moves(law: Array, setpoint: Setpoint) -> bool:
    """Return whether a setpoint moves, or begins or ends to move within a crossing of the gap."""
    speed = abs(setpoint[VELOCITY]) + law[CROSSING] * abs(setpoint[ACCELERATION])
    return bool(speed > _CREEPS * law[GAP])


@compiled
def _patience(state: Array) -> float:
    """Return the time for which the load is observed before it is moved, s."""
    return float(_SETTLES + _AGAIN * min(state[TRIES], _MOST_TRIES))


@compiled
def _afresh(state: Array) -> None:
    """Forget earlier tries if the load was at rest for long: something else has moved it."""
    if state[WAITED] > _RESTED:
        state[TRIES], state[SHARE], state[LAST_ERROR] = 0.0, 1.0, 0.0


@compiled
def _band(law: Array, state: Array) -> tuple[float, float]:
    """Return the errors below which the load is left alone, and above which it no longer is, rad."""
    seen = max(state[COUNT], _NOISY * state[ROUGH])
    return max(_TIGHT[0] * law[GAP], _TIGHT[1] * seen), max(_WIDE[0] * law[GAP], _WIDE[1] * seen)


@compiled
def _hold_held(law: Array, state: Array, error: float, motor: Array) -> tuple[float, float, float]:
    """Hold a load that a torque holds on a flank: return the motor's position, rad, its speed and the torque, N m."""
    tight, wide = _band(law, state)
    state[FLANK], speed = -math.copysign(1.0, state[PULL]), 0.0
    if state[PARKED] < 0.0 and abs(error) < tight and abs(state[LOAD_SPEED]) * _AHEAD < 2.0 * tight:
        state[PARKED] = 0.0
    elif state[PARKED] >= 0.0 and abs(error) > wide:
        state[PARKED] = -1.0
        _afresh(state)
    if state[PARKED] < 0.0:
        if law[COULOMB] + law[MOTOR_COULOMB] > _DRY or abs(error) > law[GAP]:
            if state[WAITED] > _patience(state) and abs(state[LOAD_SPEED]) < _SLOW:
                state[TRIES] += 1.0
                if slower(law, state) > 1.0 and abs(error) > law[GAP]:
                    _fly(law, state, motor)
                else:
                    to = state[LOAD] + _shorter(state, error)
                    state[FLANK] = shift(law, state, to, state[LOAD])
                    _take_off(law, state)
        elif abs(state[PLACE] - motor[0]) < 0.5 * law[GAP] + 2e-3:  # not ahead of the motor
            speed = clamp(_LEADS / slower(law, state) * error, -_HASTE, _HASTE)
            state[PLACE] += law[PERIOD] * speed
    return state[PLACE], speed, -state[PULL]


@compiled
def _lead(law: Array, state: Array, error: float, resting: float, tight: float, load: float, motor: Array) -> float:
    """Lead a free load in by one of the flanks: return the motor's speed, rad/s."""
    state[SIDE_TIME] += law[PERIOD]
    turned = state[SIDE] * resting < -max(2.0 * tight, _AHEAD * abs(error))
    if state[SIDE_TIME] > _DWELL and (state[SIDE] == 0.0 or turned):
        state[SIDE], state[SIDE_TIME] = math.copysign(1.0, resting), 0.0
    left = state[SIDE] * contact(law, 0.0) - (motor[0] - load - state[MIDDLE])
    if state[SIDE] * left > _AWAY * law[GAP]:
        speed = clamp(state[LOAD_SPEED] + _MEETS * left, -_HASTE, _HASTE)
    else:
        speed = min(_OF_OWN * law[FRICTION] / law[INERTIA], _FASTEST) * error
    state[FLANK] = state[SIDE]
    place, ahead = state[PLACE] + law[PERIOD] * speed, _AHEAD * law[GAP]
    state[PLACE] = clamp(place, motor[0] - ahead, motor[0] + ahead)
    return speed


@compiled
def _hold_free(law: Array, state: Array, error: float, load: float, motor: Array) -> tuple[float, float, float]:
    """Hold a load that no torque holds: return the motor's position, rad, its speed and the torque, N m."""
    tight, wide = _band(law, state)
    coasts = stopping_way(law, state[LOAD_SPEED])
    resting = error - coasts
    state[FLANK] = 0.0
    if state[PARKED] >= 0.0 and abs(error) > wide and state[WAITED] > _DWELL:
        _afresh(state)
        state[PARKED], state[WAITED] = -1.0, 0.0
        if law[COULOMB] > _DRY:  # it slid without a command
            pulls(state, -math.copysign(max(abs(state[PULL]), law[COULOMB] + 2.0 * FREE), error), load)
    elif state[PARKED] < 0.0:
        if abs(resting) < tight and abs(error) < wide and abs(coasts) < wide:
            state[PARKED], state[FROM] = 0.0, motor[0]
            state[PLACE] = load + coasts + state[MIDDLE]
        elif abs(error) > _FAR * law[GAP] and state[WAITED] > _patience(state):
            state[TRIES] += 1.0
            _fly(law, state, motor)
        elif law[COULOMB] <= _DRY:
            return state[PLACE], _lead(law, state, error, resting, tight, load, motor), 0.0
        elif state[WAITED] > _patience(state):
            state[TRIES] += 1.0
            to = load + coasts + _shorter(state, resting)
            state[FLANK] = press(law, state, to, load, motor[0] - state[MIDDLE], motor[1])
            _take_off(law, state)
    if state[PARKED] < 0.0:
        return state[PLACE], 0.0, 0.0
    state[PARKED] += law[PERIOD]
    u, way = min(state[PARKED] / _PARK, 1.0), state[PLACE] - state[FROM]
    place = state[FROM] + way * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
    speed = way * 30.0 * u * u * (1.0 - u) * (1.0 - u) / _PARK
    return place, speed, law[MOTOR_INERTIA] * way * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / _PARK**2


@compiled
def _follow(law: Array, state: Array, setpoint: Setpoint) -> tuple[float, float, float, float]:
    """Follow a moving setpoint: return the motor's position, rad, its speed, its torque and that of the teeth, N m.

    The sign of the load's torque gives the flank; the motor crosses to it in the time of a flight's crossing.
    """
    speed, acceleration = setpoint[VELOCITY], setpoint[ACCELERATION]
    takes = law[INERTIA] * acceleration + law[FRICTION] * speed - pull_at(state, setpoint[POSITION])
    if speed != 0.0:
        takes += math.copysign(law[COULOMB], speed)
    flank = math.copysign(1.0, takes) if abs(takes) > _DRY else state[FLANK]
    state[FLANK] = flank
    to, most = flank * contact(law, takes), law[PERIOD] * law[GAP] / law[CROSSING]
    step = clamp(to - state[STEPPED], -most, most)
    state[STEPPED] += step
    carried = takes if abs(to - state[STEPPED]) < 0.1 * law[GAP] and takes * flank > 0.0 else 0.0
    motor_speed = speed + (step / law[PERIOD] if carried == 0.0 else 0.0)
    place = setpoint[POSITION] + speed * law[DELAY] + state[STEPPED] + state[MIDDLE]
    torque = law[MOTOR_INERTIA] * acceleration + law[MOTOR_FRICTION] * motor_speed + carried
    state[PLACE], state[TARGET] = place, setpoint[POSITION]
    return place, motor_speed, torque, carried


@compiled
def _hold(law: Array, state: Array, target: float, motor: Array) -> tuple[float, float, float]:
    """Hold the load at its target: return the motor's position, rad, its speed and the torque, N m."""
    state[WAITED] += law[PERIOD]
    state[LANDED] += law[PERIOD]
    load = state[LOAD] + law[DELAY] * state[LOAD_SPEED]
    if state[HELD] != 0.0:
        return _hold_held(law, state, target - load, motor)
    return _hold_free(law, state, target - load, load, motor)


@compiled_as(LAW_SIGNATURE)
def two_encoder_step(
    law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, low: float, high: float
) -> float:
    """Observe, plan if the setpoint has jumped or the load is off its target, and move the motor."""
    target, period = setpoint[POSITION], law[PERIOD]
    if state[STARTED] == 0.0:
        _start(law, state, estimate, setpoint)
    else:
        see_motor(law, state, law[RATIO] * estimate[THETA_M])
        see_load(law, state, estimate[THETA_L])
    see_middle(law, state)
    see_pull(law, state)
    if state[PHASE] == HOLD:
        expect(law, state)
    motor = predict_motor(law, state)
    if _moves(law, setpoint):
        if state[PHASE] != FOLLOW:
            state[PHASE], state[STEPPED] = FOLLOW, motor[0] - state[LOAD] - state[MIDDLE]
            state[LANDED] = 0.0
    elif state[PHASE] == FOLLOW:
        landed(law, state)
        _wait(state)
        state[TARGET] = target
    if state[PHASE] != FOLLOW:
        leap = abs(target - state[TARGET]) - abs(setpoint[VELOCITY]) * period
        state[TARGET] = target
        if leap > _CREEPS * period * law[GAP]:
            state[SHARE], state[LAST_ERROR], state[TRIES] = 1.0, 0.0, 0.0
            _fly(law, state, motor)
    if state[PHASE] == FLIGHT and state[TIME] > length_of(state) + law[DELAY] + period:
        landed(law, state)
        _wait(state)
    held = 1.0 if holds(law, state[PULL]) else 0.0
    if held != state[HELD]:
        state[HELD] = held
        if state[PHASE] == HOLD:
            _wait(state)
    place = speed = torque = carried = 0.0
    mean_speed = motor[1]
    if state[PHASE] == HOLD:
        place, speed, torque = _hold(law, state, target, motor)
        carried = torque if held != 0.0 else 0.0
        if state[PHASE] == HOLD:
            attribute(state, carried)
    elif state[PHASE] == FOLLOW:
        place, speed, torque, carried = _follow(law, state, setpoint)
    if state[PHASE] == FLIGHT:  # holding may just have started it
        time, later = state[TIME], state[TIME] + law[ELECTRICAL]
        place, speed, _ = evaluate(law, state, time)
        end, _, _ = evaluate(law, state, time + period)
        _, _, carried = evaluate(law, state, time + 0.5 * period)
        from_, before, first = evaluate(law, state, later)
        _, _, half = evaluate(law, state, later + 0.5 * period)
        to, after, last = evaluate(law, state, later + period)
        torque = law[MOTOR_INERTIA] * (after - before) / period + law[MOTOR_FRICTION] * (to - from_) / period
        torque += (first + 4.0 * half + last) / 6.0
        mean_speed = (end - place) / period
        state[PLACE] = end
        state[TIME] += period
    torque += (
        dry(law, speed + _GOES * (place - motor[0]))
        + state[ACTING]
        + law[STIFFNESS] / slower(law, state) * (place - motor[0])
        + law[DAMPING] * (speed - motor[1])
    )
    voltage = clamp(law[VOLTS_PER_TORQUE] * torque + law[VOLTS_PER_SPEED] * mean_speed, low, high)
    for k in range(KEPT - 1, 0, -1):
        state[COMMANDS + k], state[CARRIED + k] = state[COMMANDS + k - 1], state[CARRIED + k - 1]
    state[COMMANDS] = (voltage - law[BACK_EMF] * estimate[OMEGA_M]) / law[RESISTANCE]
    state[CARRIED] = carried
    return voltage


def begin(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, holding: float) -> None:
    """Take over from another law that held the load with a voltage: see `law.TakeOver`."""
    state[1:] = 0.0
    _start(law, state, estimate, setpoint)
    state[SPEED], state[LOAD_SPEED] = law[RATIO] * estimate[OMEGA_M], estimate[OMEGA_L]
    state[MOMENTUM] = law[MOTOR_INERTIA] * state[SPEED] + law[INERTIA] * state[LOAD_SPEED]
    seen, hidden = -holding / law[VOLTS_PER_TORQUE], law[COULOMB] + law[MOTOR_COULOMB]
    state[PULL_SLOW], pull = seen, seen
    state[SHAKEN] = abs(state[LOAD_SPEED])
    if moves := state[SHAKEN] > _STANDS:
        hidden += _STRIKES * law[INERTIA] * state[SHAKEN]
        pull = clamp(pull_at(state, state[LOAD]), seen - hidden, seen + hidden)
    elif not holds(law, seen):
        pull = clamp(clamp(state[PULL], seen - hidden, seen + hidden), -law[COULOMB], law[COULOMB])
    pulls(state, pull, estimate[THETA_L])
    state[HELD] = 1.0 if holds(law, state[PULL]) else 0.0
    state[PARKED] = -1.0
    if not moves:
        rests_on(law, state, state[PULL])
    state[COMMANDS : COMMANDS + KEPT] = (holding - law[BACK_EMF] * estimate[OMEGA_M]) / law[RESISTANCE]
    state[CARRIED : CARRIED + KEPT] = -state[PULL] * state[HELD]
    state[CURRENT_TORQUE] = holding / law[VOLTS_PER_TORQUE]
    state[DISTURBANCE] = state[ACTING] = -state[PULL] * (1.0 - state[HELD])
