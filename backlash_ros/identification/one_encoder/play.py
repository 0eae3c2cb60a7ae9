"""A first guess of gap, load and delay from the motor's angle alone, with hard teeth that do not rebound.

The load coasts where the teeth are apart and goes with the motor where they bear: so the motor's angle gives the
load's, and the sum of both shafts' equations tells of which gap it fits best.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.memory import MotorSide
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.regression import Guess, guess_of

_ROUNDS = 3
"""Number of times that the load's motion and what brakes it are guessed in turn; tuned."""
_FASTEST = 200.0
"""Largest rate at which friction slows a coasting load, 1/s; tuned."""


class PlayGuess(NamedTuple):
    """The gap, rad; the time from a sample to when its command acts, s; the load beside them."""

    gap: float
    delay: float
    load: Guess


@compiled
def carried(time: Array, motor: Array, half_gap: float, decay: float, dry: float, push: float) -> Array:
    """Return the angle of a load that the motor carries, which begins in the middle of the gap, rad, shape (N,).

    Parameters
    ----------
    time, motor : shapes (N,), s and rad
    decay, dry, push : viscous and dry friction of the load and the torque on it, over its inertia, 1/s and rad/s^2
    """
    load = np.empty_like(motor)
    load[0], speed = motor[0], 0.0
    for k in range(1, time.size):
        length = time[k] - time[k - 1]
        acceleration = push - decay * speed
        if speed != 0.0:
            acceleration -= math.copysign(dry, speed)
        else:
            acceleration -= math.copysign(min(dry, abs(push)), push)
        next_speed = speed + length * acceleration
        if speed * next_speed < 0.0 and abs(push) <= dry:
            next_speed = 0.0
        load[k] = load[k - 1] + 0.5 * length * (speed + next_speed)
        beyond = motor[k] - load[k]
        speed = next_speed
        if abs(beyond) > half_gap:
            load[k] = motor[k] - math.copysign(half_gap, beyond)
            speed = (motor[k] - motor[k - 1]) / length
    return load


def _guess_at(side: MotorSide, recording: Recording, begin: Guess, gap: float, delay: float) -> Guess:
    guess = begin
    for _ in range(_ROUNDS):
        decay = min(guess.viscous / guess.inertia, _FASTEST)
        dry, push = guess.coulomb_l / guess.inertia, guess.load_torque / guess.inertia
        load = carried(recording.time, recording.motor, 0.5 * gap, decay, dry, push)
        guess = guess_of(side, recording._replace(load=load), delay)
    return guess


def guess_in_play(
    side: MotorSide, recording: Recording, widths: Sequence[float] | Array, delays: Sequence[float]
) -> PlayGuess:
    """Return the gap and the delay with the least misfit, of those to try, and the load with them.

    Parameters
    ----------
    recording : of the motor's angle; the load's is not looked at
    widths, delays : to try, rad and s
    """
    read = np.isfinite(recording.motor)
    motor = np.interp(recording.time, recording.time[read], recording.motor[read])
    seen = recording._replace(motor=motor, load=motor)
    begin = min((guess_of(side, seen, delay) for delay in delays), key=lambda guess: guess.misfit)
    tried = (PlayGuess(gap, delay, _guess_at(side, seen, begin, gap, delay)) for delay in delays for gap in widths)
    return min(tried, key=lambda each: each.load.misfit)
