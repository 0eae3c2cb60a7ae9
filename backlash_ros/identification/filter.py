"""Predicts each sample of a recording from the previous ones, with the derivatives by the parameters to identify.

An extended Kalman filter over both shafts as seen at the output: motor angle n theta_m and its speed, drive torque
K_m i/n, load angle and speed. The teeth act between them by the contact law of the drive, linearly implicit at half
the step, so that stiff teeth need no short steps; dry friction brakes each shaft and holds it where it can. The
derivatives of the state by the parameters go through the same linear maps as its covariance, corrections by the samples
included: one pass gives the innovations and their derivatives (recursive prediction errors: Ljung, System
Identification, 2nd ed., ch. 11).
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain.compiled import compiled, specialize, unbound
from backlash_ros.drivetrain.contact import Constants, Contact, ForceFunction, SlopesFunction
from backlash_ros.drivetrain.signals import Array

(
    LN_HALF_GAP,
    OFFSET,
    GAP_SLOPE,
    LN_TEETH,
    LN_INERTIA,
    LN_VISCOUS,
    COULOMB_L,
    TORQUE,
    GRAVITY,
    COULOMB_M,
    ECCENTRICITY,
    DELAY,
) = range(12)
"""The parameters: ln of half the gap (rad) at the load's start, motor angle minus load angle in its middle (rad),
relative growth of the gap with the load's angle (1/rad), ln of the teeth's force relative to their contact law; for the
load ln of inertia (kg m^2) and of viscous friction (N m s/rad), dry friction and torque (N m), and growth of that
torque with its angle (N m/rad); the motor's dry friction at the output (N m); relative scale error of the load's
encoder; time from a sample to when its command acts, s."""
PARAMETERS = 12
_P, _W, _T, _Q, _V = range(5)
LEAST, LARGEST = 5, 6
"""Columns of the states beside the filter's own: torques of the teeth since the previous sample, N m."""
STATES = 7

_LONGEST = 5e-4
_SHORTEST = 2e-5
"""Shortest step between two samples, s."""
_UNSURE, _MOST_TORQUE = 1e-2, 1e6
"""Variance of both speeds (rad^2/s^2) and of the torque (N^2 m^2) at the start; torque beyond which the motion has
left all bounds, N m."""
_COLUMNS = 5 + PARAMETERS
_WIDE = 4 * math.ceil(_COLUMNS / 4)
"""Stored columns, processed four at a time. The rows follow each other in one array at distances known to the compiler,
so that it sees that the columns are independent."""


class MotorSide(NamedTuple):
    """The motor as seen at the output, and the teeth.

    ``rate`` is R/L (1/s; infinite where a current is commanded); ``gain`` N m at standstill for each V or A, and
    ``braking`` N m s/rad by the back-EMF.
    """

    inertia: float
    viscous: float
    rate: float
    gain: float
    braking: float
    load_radius: float
    contact: Constants


class Noise(NamedTuple):
    """Variances: of the readings (rad^2), per second of both speeds; and the share of the teeth's torque, for 1 ms."""

    motor_reading: float
    load_reading: float
    motor_speed: float
    load_speed: float
    teeth: float


_force: ForceFunction = unbound
_slopes: SlopesFunction = unbound


@compiled
def _observe(
    z: Array, row: int, column: int, scale: float, variance: float, way: float, gains: Array, change: Array
) -> None:
    """Update covariance and derivatives with one reading of the state's ``row``; write its ``gains``.

    The load's encoder, whose scale error has a ``column`` (else -1), reads ``scale`` times the travel ``way`` (rad).
    The changes by the reading are written to ``change``, shape (`_WIDE`,).
    """
    for j in range(_WIDE):
        change[j] = scale * z[row * _WIDE + j]
    if column >= 0:
        change[column] += way
    for state in range(5):
        gains[state] = gain = scale * z[state * _WIDE + row] / variance
        for j in range(_WIDE):
            z[state * _WIDE + j] -= gain * change[j]


@compiled
def _in_force(
    time: Array, command: Array, doubt: Array, delay: float, held: int, now: float, length: float
) -> tuple[int, float, float, float]:
    """Return the index of the command that acts ``now``; mean over a ``length``, its slope by the delay, its doubt.

    Before the first command acts, half of it is assumed, with the corresponding doubt.
    """
    while held + 1 < time.shape[0] and time[held + 1] + delay <= now:
        held += 1
    while held >= 0 and time[held] + delay > now:
        held -= 1
    mean, off = command[max(held, 0)], doubt[max(held, 0)]
    if held < 0:
        mean, off = 0.5 * mean, 0.5 * abs(mean)
    if held + 1 >= time.shape[0] or time[held + 1] + delay > now + length + 1e-12:
        return held, mean, 0.0, off
    follows = command[held + 1]
    share = (time[held + 1] + delay - now) / length
    return held, share * mean + (1.0 - share) * follows, (mean - follows) / length, max(off, doubt[held + 1])


@compiled
def _step_length(longest: float, inside: float, approach: float, torque: float, stiffness: float, rate: float) -> float:
    """Return a step (s) that ends at contact or is short compared with the dynamics of the teeth.

    Parameters
    ----------
    inside, approach : rad from the teeth, and rad/s towards them
    torque, stiffness : of the teeth, N m and N m/rad
    rate : of the swing on them, rad/s
    """
    length = longest
    if abs(torque) > 1e-5 and stiffness > 0.0:
        length = min(length, 0.25 / rate)
        if approach != 0.0:
            length = min(length, max(_SHORTEST, 0.25 * abs(torque) / (stiffness * abs(approach))))
    if inside > 0.0 and approach > 0.0:
        length = min(length, max(_SHORTEST, inside / approach))
    return length


@compiled
def _with_friction(
    m11: float, m12: float, m22: float, rhs_w: float, rhs_v: float, w: float, v: float, c_m: float, c_l: float
) -> tuple[float, float, float, float, float, float, float]:
    """Solve for both speeds with dry friction, which brakes moving shafts and holds a shaft that it stops.

    Returns both speeds, the inverse matrix [11, 12, 22], zero for a held shaft, and the direction of each shaft.
    """
    per_det = 1.0 / (m11 * m22 - m12 * m12)
    s11, s12, s22 = per_det * m22, -per_det * m12, per_det * m11
    side_m = math.copysign(1.0, w if w != 0.0 else s11 * rhs_w + s12 * rhs_v)
    side_l = math.copysign(1.0, v if v != 0.0 else s12 * rhs_w + s22 * rhs_v)
    rhs_w -= side_m * c_m
    rhs_v -= side_l * c_l
    if (s12 * rhs_w + s22 * rhs_v) * side_l < 0.0:  # it turns back, or stops
        back = rhs_v + 2.0 * side_l * c_l
        if (s12 * rhs_w + s22 * back) * side_l < 0.0:
            rhs_v, side_l = back, -side_l
        else:
            s11, s12, s22 = 1.0 / m11, 0.0, 0.0
    if (s11 * rhs_w + s12 * rhs_v) * side_m < 0.0:
        back = rhs_w + 2.0 * side_m * c_m
        if (s11 * back + s12 * rhs_v) * side_m < 0.0:
            rhs_w, side_m = back, -side_m
        else:
            s11, s12, s22 = 0.0, 0.0, 1.0 / m22 if s22 > 0.0 else 0.0
    return s11 * rhs_w + s12 * rhs_v, s12 * rhs_w + s22 * rhs_v, s11, s12, s22, side_m, side_l


@compiled
def _carry(
    z: Array,
    forcing: Array,
    columns: int,
    teeth: tuple[float, float],
    shafts: tuple[float, float, float],
    inverse: tuple[float, float, float],
    current: tuple[float, float, float, float],
    half: float,
) -> None:
    """Take the first ``columns`` of the covariance or of the derivatives through a step of twice ``half``, s.

    Parameters
    ----------
    z, forcing : rows behind each other; what else acts on both shafts, and on the torque: shape (3 `_WIDE`,)
    teeth : how their torque follows a difference of the angles, and of the speeds
    shafts : inertia over time of both, less half the friction; torque on the load by its angle
    inverse : of the matrix of both speeds, see `_with_friction`
    current : the drive torque's mean by itself and by the speed, and its end by itself and by the speed
    """
    stiff, damp = teeth
    keep_w, keep_v, gravity = shafts
    s11, s12, s22 = inverse
    mean_tau, mean_w, end_tau, end_w = current
    for j in range(columns):
        dp, dw, dtau = z[_P * _WIDE + j], z[_W * _WIDE + j], z[_T * _WIDE + j]
        dq, dv = z[_Q * _WIDE + j], z[_V * _WIDE + j]
        pull = stiff * (dp - dq) + damp * (dw - dv)
        rhs_w = keep_w * dw + mean_tau * dtau + mean_w * dw - pull + forcing[j]
        rhs_v = keep_v * dv + gravity * dq + pull + forcing[_WIDE + j]
        next_w, next_v = s11 * rhs_w + s12 * rhs_v, s12 * rhs_w + s22 * rhs_v
        z[_P * _WIDE + j] = dp + half * (dw + next_w)
        z[_Q * _WIDE + j] = dq + half * (dv + next_v)
        z[_T * _WIDE + j] = end_tau * dtau + end_w * dw + forcing[2 * _WIDE + j]
        z[_W * _WIDE + j], z[_V * _WIDE + j] = next_w, next_v


@compiled
def _turn(z: Array) -> None:
    """Transpose the covariance."""
    for row in range(5):
        for column in range(row):
            z[row, column], z[column, row] = z[column, row], z[row, column]


def _predict(
    side: MotorSide,
    noise: Noise,
    parameters: Array,
    time: Array,
    motor: Array,
    load: Array,
    command: Array,
    doubt: Array,
    innovations: Array,
    derivatives: Array,
    states: Array,
) -> float:
    """Fill in the innovations divided by their standard deviation, their derivatives, and the states after each sample.

    Parameters
    ----------
    time : of the samples, s, shape (N,)
    motor, load : angles, the motor's as seen at the output; rad, shape (N,); nan, but for the first, where there is no
        reading: there the innovations stay as they are
    command, doubt : that answered each sample, and how far off it may be, V or A, shape (N,)
    innovations, derivatives, states : to be filled in, shapes (N, 2), (N, 2, `PARAMETERS`) and (N, `STATES`): the
        state, then the `LEAST` and the `LARGEST` torque of the teeth since the sample before, N m; speeds and torque of
        the first state are those to start from

    Returns
    -------
    the sum of the logarithms of the innovations' variances; infinite if the motion leaves all bounds
    """
    half_gap, offset, widens = math.exp(parameters[LN_HALF_GAP]), parameters[OFFSET], parameters[GAP_SLOPE]
    radius, teeth = side.load_radius, math.exp(parameters[LN_TEETH])
    inertia, viscous = math.exp(parameters[LN_INERTIA]), math.exp(parameters[LN_VISCOUS])
    c_l, load_torque, gravity = parameters[COULOMB_L], parameters[TORQUE], parameters[GRAVITY]
    scale, c_m, delay = 1.0 + parameters[ECCENTRICITY], parameters[COULOMB_M], parameters[DELAY]
    per_radius = radius * radius * teeth
    per_inertia = 1.0 / side.inertia + 1.0 / inertia
    z = np.zeros((5, _WIDE))  # the covariance's columns, then the derivatives'
    for row in range(5):
        z[row, row] = _UNSURE
    z[_P, _P], z[_Q, _Q] = noise.motor_reading, noise.load_reading
    forcing, none, gains, change = np.zeros((3, _WIDE)), np.zeros(3 * _WIDE), np.zeros(5), np.zeros(_WIDE)
    flat, forces = z.reshape(5 * _WIDE), forcing.reshape(3 * _WIDE)
    states[0, _P], states[0, _Q] = motor[0], load[0]
    p, w, tau, q, v = states[0, _P], states[0, _W], states[0, _T], states[0, _Q], states[0, _V]
    start, total, held = load[0], 0.0, 0
    for sample in range(1, time.shape[0]):
        now, end = time[sample - 1], time[sample]
        least, largest = math.inf, -math.inf
        while end - now > 1e-9:
            x, r = p - q - offset, w - v
            h = half_gap * max(0.1, 1.0 + widens * (q - start))
            tooth = _force(side.contact, radius * h, radius * x, radius * r)
            torque, k, c = radius * teeth * tooth[0], per_radius * tooth[1], per_radius * tooth[2]
            least, largest = min(least, torque), max(largest, torque)
            if not abs(torque) < _MOST_TORQUE or not abs(x) < _MOST_TORQUE:
                return math.inf
            rate, approach = math.sqrt(max(k, 0.0) * per_inertia), math.copysign(1.0, x) * r
            dt = _step_length(_LONGEST, h - abs(x), approach, torque, k, rate)
            dt = (end - now) / math.ceil((end - now) / dt - 1e-6)
            held, volts, slope, off = _in_force(time, command, doubt, delay, held, now, dt)
            # The drive torque relaxes towards what command and speed settle at.
            decay = math.exp(-side.rate * dt)
            lag = (1.0 - decay) / (side.rate * dt) if math.isfinite(side.rate) else 0.0
            halfway = w + 0.5 * dt * (tau - side.viscous * w - torque) / side.inertia if lag > 0.0 else w
            settled = side.gain * volts - side.braking * halfway
            drive, tau = settled + (tau - settled) * lag, settled + (tau - settled) * decay
            # Both speeds, linearly implicit.
            a, d, kappa = side.inertia / dt, inertia / dt, 0.25 * k * dt + 0.5 * c
            keep_w, keep_v = a - 0.5 * side.viscous, d - 0.5 * viscous
            pull = torque + kappa * r - c * r
            rhs_w, rhs_v = keep_w * w + drive - pull, keep_v * v + load_torque + gravity * (q - start) + pull
            w1, v1, s11, s12, s22, side_m, side_l = _with_friction(
                a + 0.5 * side.viscous + kappa, -kappa, d + 0.5 * viscous + kappa, rhs_w, rhs_v, w, v, c_m, c_l
            )
            by_gap = per_radius * h * _slopes(side.contact, radius * h, radius * x, tooth)[2]
            for column, by in (
                (LN_HALF_GAP, by_gap),
                (GAP_SLOPE, by_gap * (q - start)),
                (OFFSET, -k),
                (LN_TEETH, torque),
            ):
                forcing[0, 5 + column], forcing[1, 5 + column] = -by, by
            forcing[1, 5 + LN_INERTIA], forcing[1, 5 + LN_VISCOUS] = d * (v - v1), -0.5 * viscous * (v + v1)
            forcing[1, 5 + TORQUE], forcing[1, 5 + GRAVITY] = 1.0, q - start
            forcing[1, 5 + COULOMB_L], forcing[0, 5 + COULOMB_M] = -side_l, -side_m
            forcing[0, 5 + DELAY], forcing[2, 5 + DELAY] = (
                (1.0 - lag) * side.gain * slope,
                (1.0 - decay) * side.gain * slope,
            )
            current = lag, (lag - 1.0) * side.braking, decay, (decay - 1.0) * side.braking
            shafts, inverse = (keep_w, keep_v, gravity), (s11, s12, s22)
            _carry(flat, forces, _WIDE, (k, kappa), shafts, inverse, current, 0.5 * dt)
            _turn(z)
            _carry(flat, none, 5, (k, kappa), shafts, inverse, current, 0.5 * dt)
            p, q = p + 0.5 * dt * (w + w1), q + 0.5 * dt * (v + v1)
            w, v = w1, v1
            # Noise: of each speed, of a command that is not known, and of the teeth's torque, which acts on both.
            shaken = noise.teeth * torque * torque * dt * 1e-3
            unknown = (side.gain * off / side.inertia) ** 2 * (end - time[sample - 1]) if off > 0.0 else 0.0
            z[_W, _W] += (noise.motor_speed + unknown) * dt + shaken / side.inertia**2
            z[_V, _V] += noise.load_speed * dt + shaken / inertia**2
            z[_W, _V] -= shaken / (side.inertia * inertia)
            z[_V, _W] -= shaken / (side.inertia * inertia)
            now += dt
        for which, row, column, factor, reading, variance in (
            (0, _P, -1, 1.0, motor[sample], noise.motor_reading),
            (1, _Q, 5 + ECCENTRICITY, scale, load[sample], noise.load_reading),
        ):
            if math.isnan(reading):
                continue
            expected = p if which == 0 else q + (scale - 1.0) * (q - start)
            expectable = variance + factor * factor * z[row, row]
            per_deviation = 1.0 / math.sqrt(expectable)
            innovations[sample, which] = (reading - expected) * per_deviation
            _observe(flat, row, column, factor, expectable, q - start, gains, change)
            for j in range(PARAMETERS):
                derivatives[sample, which, j] = -change[5 + j] * per_deviation
            total += math.log(expectable)
            miss, deepest = reading - expected, max(h, abs(p - q - offset)) + 0.2 * h
            p, w, tau = p + gains[_P] * miss, w + gains[_W] * miss, tau + gains[_T] * miss
            q, v = q + gains[_Q] * miss, v + gains[_V] * miss
            # A shaft without a reading is not pressed into the teeth by the other shaft's reading.
            if math.isnan(load[sample]):
                q = p - offset - min(max(p - q - offset, -deepest), deepest)
            elif math.isnan(motor[sample]):
                p = q + offset + min(max(p - q - offset, -deepest), deepest)
        states[sample, _P], states[sample, _W], states[sample, _T] = p, w, tau
        states[sample, _Q], states[sample, _V], states[sample, LEAST], states[sample, LARGEST] = q, v, least, largest
    return total


Predict = Callable[[MotorSide, Noise, Array, Array, Array, Array, Array, Array, Array, Array, Array], float]


@cache
def filter_with(law: type[Contact]) -> Predict:
    """Return `_predict` compiled for a contact law."""
    return specialize(_predict, fused=True, _force=law.force, _slopes=law.half_gap_slopes)
