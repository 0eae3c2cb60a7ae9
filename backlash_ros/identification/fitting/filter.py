"""Predicts each sample of a recording from the previous ones, with the derivatives by the parameters to identify.

An extended Kalman filter over both shafts as seen at the output: motor angle n theta_m and its speed, drive torque
K_m i/n, load angle and speed. With the motor's inertia J_r by its data sheet, which sets the unit of torque:

    J_r p'' = e^G g u - (e^R b + B_r) p' - (c_m + loss abs(T)) sign p' - T
    J_l q'' = T - B_l q' - c_l sign q' + tau + kappa (q - q_0)

The command u acts late and through the winding. T is the torque of the teeth: see `candidates`. It is linearly implicit
at half the step, so that stiff teeth need no short steps; dry friction brakes each shaft and holds it where it can. The
derivatives of the state by the parameters go through the same linear maps as its covariance, corrections by the samples
included: one pass gives the innovations and their derivatives (recursive prediction errors: Ljung, System
Identification, 2nd ed., ch. 11). A pass without them takes a third of the time.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain.contact import Constants, Contact
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.candidates import Shape, TorqueFunction, torque_by

(
    LN_HALF_GAP,
    OFFSET,
    GAP_SLOPE,
    LN_STIFFNESS,
    LN_DAMPING,
    LN_REBOUND,
    LN_EXPONENT,
    LN_INERTIA,
    LN_VISCOUS,
    COULOMB_L,
    TORQUE,
    GRAVITY,
    COULOMB_M,
    LOSS,
    ECCENTRICITY,
    DELAY,
    LN_GAIN,
    LN_BRAKING,
) = range(18)
"""The parameters: ln of half the gap (rad) at the load's start, motor angle minus load angle in its middle (rad),
relative growth of the gap with the load's angle (1/rad); ln of the teeth's stiffness (N m/rad; of a told law a factor),
damping (N m s/rad), rebound (s/rad) and exponent; for the load ln of inertia (kg m^2) and of viscous friction (N m
s/rad), dry friction and torque (N m), and growth of that torque with its angle (N m/rad); the motor's dry friction at
the output (N m), and the gear's loss, a share of the teeth's torque; relative scale error of the load's encoder; time
from a sample to when its command acts, s; ln of the motor's gain and braking relative to its data sheet."""
PARAMETERS = 18
_P, _W, _T, _Q, _V = range(5)
LEAST, LARGEST = 5, 6
"""Columns of the states beside the filter's own: torques of the teeth since the previous sample, N m."""
STATES = 7


class Steps(NamedTuple):
    """Steps between two samples: the ``longest`` and the ``shortest`` on stiff teeth, s.

    ``swing`` is the largest phase of the swing on the teeth in one step, rad, and change of their torque, a share.
    """

    longest: float
    shortest: float
    swing: float


FINE, COARSE = Steps(5e-4, 2e-5, 0.25), Steps(2e-3, 1e-4, 1.0)
"""Steps to trust, and steps to look around with much noise, which take a third of the time."""
_UNSURE, _MOST_TORQUE, _MOST_TWIST = 1e-2, 1e6, 1e3
"""Variance of both speeds (rad^2/s^2) and of the torque (N^2 m^2) at the start; torque (N m) and twist (rad) beyond
which the motion has left all bounds."""
_COLUMNS = 5 + PARAMETERS
_WIDE = 4 * math.ceil(_COLUMNS / 4)
"""Stored columns, processed four at a time. The rows follow each other in one array at distances known to the compiler,
so that it sees that the columns are independent."""


class MotorSide(NamedTuple):
    """The motor as seen at the output, by its data sheet.

    ``rate`` is R/L (1/s; infinite where a current is commanded); ``gain`` N m at standstill for each V or A, and
    ``braking`` N m s/rad by the back-EMF.
    """

    inertia: float
    viscous: float
    rate: float
    gain: float
    braking: float


class Noise(NamedTuple):
    """Variances: of the readings, rad^2; of both speeds for each second, rad^2/s^3; of the share of the teeth's torque.

    The last is for 1 ms. ``timing``: of the time of both readings of a sample, s^2.
    """

    motor_reading: float
    load_reading: float
    motor_speed: float
    load_speed: float
    teeth: float
    timing: float


_torque: TorqueFunction = unbound


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
def _step_length(steps: Steps, inside: float, approach: float, torque: float, stiffness: float, rate: float) -> float:
    """Return a step (s) that ends at contact or is short compared with the dynamics of the teeth.

    Parameters
    ----------
    inside, approach : rad from the teeth, and rad/s towards them
    torque, stiffness : of the teeth, N m and N m/rad
    rate : of the swing on them, rad/s
    """
    length = steps.longest
    if abs(torque) > 1e-5 and stiffness > 0.0:
        length = min(length, max(steps.shortest, steps.swing / rate))
        if approach != 0.0:
            length = min(length, max(steps.shortest, steps.swing * abs(torque) / (stiffness * abs(approach))))
    if inside > 0.0 and approach > 0.0:
        length = min(length, max(steps.shortest, inside / approach))
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
    teeth: tuple[float, float, float],
    shafts: tuple[float, float, float],
    inverse: tuple[float, float, float],
    current: tuple[float, float, float, float],
    half: float,
) -> None:
    """Take the first ``columns`` of the covariance or of the derivatives through a step of twice ``half``, s.

    Parameters
    ----------
    z, forcing : rows behind each other; what else acts on both shafts, and on the torque: shape (3 `_WIDE`,)
    teeth : how their torque follows a difference of the angles, and of the speeds; how much of it the motor feels
    shafts : inertia over time of both, less half the friction; torque on the load by its angle
    inverse : of the matrix of both speeds, see `_with_friction`
    current : the drive torque's mean by itself and by the speed, and its end by itself and by the speed
    """
    stiff, damp, on_motor = teeth
    keep_w, keep_v, gravity = shafts
    s11, s12, s22 = inverse
    mean_tau, mean_w, end_tau, end_w = current
    for j in range(columns):
        dp, dw, dtau = z[_P * _WIDE + j], z[_W * _WIDE + j], z[_T * _WIDE + j]
        dq, dv = z[_Q * _WIDE + j], z[_V * _WIDE + j]
        pull = stiff * (dp - dq) + damp * (dw - dv)
        rhs_w = keep_w * dw + mean_tau * dtau + mean_w * dw - on_motor * pull + forcing[j]
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
    constants: Constants,
    depth: float,
    noise: Noise,
    parameters: Array,
    steps: Steps,
    derive: bool,
    time: Array,
    motor: Array,
    load: Array,
    command: Array,
    doubt: Array,
    innovations: Array,
    derivatives: Array,
    logs: Array,
    states: Array,
) -> float:
    """Fill in the innovations divided by their standard deviation, their derivatives, and the states after each sample.

    Parameters
    ----------
    constants, depth : of the teeth, see `Candidate`
    derive : whether the derivatives are wanted
    time : of the samples, s, shape (N,)
    motor, load : angles, the motor's as seen at the output; rad, shape (N,); nan, but for the first, where there is no
        reading: there innovations, derivatives and logarithms stay as they are
    command, doubt : that answered each sample, and how far off it may be, V or A, shape (N,)
    innovations, derivatives, logs, states : to be filled in, shapes (N, 2), (N, 2, `PARAMETERS`), (N, 2) and (N,
        `STATES`): ``logs`` of the innovations' variances; the state, then the `LEAST` and the `LARGEST` torque of the
        teeth since the sample before, N m; speeds and torque of the first state are those to start from

    Returns
    -------
    the sum of the logarithms; infinite if the motion leaves all bounds
    """
    half_gap, offset, widens = math.exp(parameters[LN_HALF_GAP]), parameters[OFFSET], parameters[GAP_SLOPE]
    shape = Shape(
        math.exp(parameters[LN_STIFFNESS]),
        math.exp(parameters[LN_DAMPING]),
        math.exp(parameters[LN_REBOUND]),
        math.exp(parameters[LN_EXPONENT]),
        depth,
    )
    inertia, viscous = math.exp(parameters[LN_INERTIA]), math.exp(parameters[LN_VISCOUS])
    c_l, load_torque, gravity = parameters[COULOMB_L], parameters[TORQUE], parameters[GRAVITY]
    scale, c_m, loss, delay = 1.0 + parameters[ECCENTRICITY], parameters[COULOMB_M], parameters[LOSS], parameters[DELAY]
    motor_gain = side.gain * math.exp(parameters[LN_GAIN])
    braking = side.braking * math.exp(parameters[LN_BRAKING])
    per_inertia = 1.0 / side.inertia + 1.0 / inertia
    z = np.zeros((5, _WIDE))
    for row in range(5):
        z[row, row] = _UNSURE
    z[_P, _P], z[_Q, _Q] = noise.motor_reading, noise.load_reading
    forcing, none = np.zeros((3, _WIDE)), np.zeros(3 * _WIDE)
    first, second = np.zeros(_WIDE), np.zeros(_WIDE)
    g, g2 = np.zeros(5), np.zeros(5)
    flat, forces = z.reshape(5 * _WIDE), forcing.reshape(3 * _WIDE)
    states[0, _P], states[0, _Q] = motor[0], load[0]
    p, w, tau, q, v = states[0, _P], states[0, _W], states[0, _T], states[0, _Q], states[0, _V]
    start, total, held = load[0], 0.0, 0
    columns = _WIDE if derive else 5
    for sample in range(1, time.shape[0]):
        now, end = time[sample - 1], time[sample]
        least, largest = math.inf, -math.inf
        while end - now > 1e-9:
            x, r = p - q - offset, w - v
            h = half_gap * max(0.1, 1.0 + widens * (q - start))
            torque, k, c, by_gap, by_k, by_c, by_d, by_e = _torque(constants, shape, h, x, r)
            least, largest = min(least, torque), max(largest, torque)
            if not abs(torque) < _MOST_TORQUE or not abs(x) < _MOST_TWIST:
                return math.inf
            rate, approach = math.sqrt(max(k, 0.0) * per_inertia), math.copysign(1.0, x) * r
            dt = _step_length(steps, h - abs(x), approach, torque, k, rate)
            dt = (end - now) / math.ceil((end - now) / dt - 1e-6)
            held, volts, slope, off = _in_force(time, command, doubt, delay, held, now, dt)
            decay = math.exp(-side.rate * dt)
            lag = (1.0 - decay) / (side.rate * dt) if math.isfinite(side.rate) else 0.0
            halfway = w + 0.5 * dt * (tau - side.viscous * w - torque) / side.inertia if lag > 0.0 else w
            settled = motor_gain * volts - braking * halfway
            drive, tau = settled + (tau - settled) * lag, settled + (tau - settled) * decay
            a, d, kappa = side.inertia / dt, inertia / dt, 0.25 * k * dt + 0.5 * c
            keep_w, keep_v = a - 0.5 * side.viscous, d - 0.5 * viscous
            pull = torque + kappa * r - c * r
            rhs_w, rhs_v = keep_w * w + drive - pull, keep_v * v + load_torque + gravity * (q - start) + pull
            w1, v1, s11, s12, s22, side_m, side_l = _with_friction(
                a + 0.5 * side.viscous + kappa,
                -kappa,
                d + 0.5 * viscous + kappa,
                rhs_w,
                rhs_v,
                w,
                v,
                c_m + loss * abs(torque),
                c_l,
            )
            on_motor = 1.0 + loss * side_m * math.copysign(1.0, torque)
            if derive:
                # The step takes the teeth at its half, linearly from its start.
                rate_halfway = 0.5 * (r + w1 - v1)
                slowed = rate_halfway / r if r != 0.0 else 1.0
                by_k += (0.5 * dt * k) * rate_halfway
                by_c, by_d = slowed * by_c, slowed * by_d
                widening = by_gap * h
                for column, by in (
                    (5 + LN_HALF_GAP, widening),
                    (5 + GAP_SLOPE, widening * (q - start)),
                    (5 + OFFSET, -k),
                    (5 + LN_STIFFNESS, by_k),
                    (5 + LN_DAMPING, by_c),
                    (5 + LN_REBOUND, by_d),
                    (5 + LN_EXPONENT, by_e),
                ):
                    forcing[0, column], forcing[1, column] = -on_motor * by, by
                forcing[1, 5 + LN_INERTIA], forcing[1, 5 + LN_VISCOUS] = d * (v - v1), -0.5 * viscous * (v + v1)
                forcing[1, 5 + TORQUE], forcing[1, 5 + GRAVITY] = 1.0, q - start
                forcing[1, 5 + COULOMB_L], forcing[0, 5 + COULOMB_M] = -side_l, -side_m
                forcing[0, 5 + LOSS] = -side_m * abs(torque)
                for column, by in (
                    (5 + DELAY, motor_gain * slope),
                    (5 + LN_GAIN, motor_gain * volts),
                    (5 + LN_BRAKING, -braking * halfway),
                ):
                    forcing[0, column], forcing[2, column] = (1.0 - lag) * by, (1.0 - decay) * by
            current = lag, (lag - 1.0) * braking, decay, (decay - 1.0) * braking
            shafts, inverse, bent = (keep_w, keep_v, gravity), (s11, s12, s22), (k, kappa, on_motor)
            if derive:
                _carry(flat, forces, _WIDE, bent, shafts, inverse, current, 0.5 * dt)
            else:
                _carry(flat, none, 5, bent, shafts, inverse, current, 0.5 * dt)
            _turn(z)
            _carry(flat, none, 5, bent, shafts, inverse, current, 0.5 * dt)
            p, q = p + 0.5 * dt * (w + w1), q + 0.5 * dt * (v + v1)
            w, v = w1, v1
            shaken = noise.teeth * torque * torque * dt * 1e-3
            unknown = (side.gain * off / side.inertia) ** 2 * (end - time[sample - 1]) if off > 0.0 else 0.0
            z[_W, _W] += (noise.motor_speed + unknown) * dt + shaken / side.inertia**2
            z[_V, _V] += noise.load_speed * dt + shaken / inertia**2
            z[_W, _V] -= shaken / (side.inertia * inertia)
            z[_V, _W] -= shaken / (side.inertia * inertia)
            now += dt
        # The times of both readings may be off by the same.
        late, cross, miss = noise.timing, 0.0, 0.0
        read_motor, read_load = not math.isnan(motor[sample]), not math.isnan(load[sample])
        variance = 1.0
        for row in range(5):
            g[row] = 0.0
        if read_motor:
            variance = z[_P, _P] + noise.motor_reading + late * w * w
            cross = late * w * v
            miss = motor[sample] - p
            for j in range(columns):
                first[j] = flat[_P * _WIDE + j]
            for row in range(5):
                g[row] = z[row, _P] / variance
            for row in range(5):
                for j in range(columns):
                    flat[row * _WIDE + j] -= g[row] * first[j]
            deviation = 1.0 / math.sqrt(variance)
            innovations[sample, 0], logs[sample, 0] = miss * deviation, math.log(variance)
            total += logs[sample, 0]
            if derive:
                for j in range(PARAMETERS):
                    derivatives[sample, 0, j] = -first[5 + j] * deviation
        before = v
        p, w, tau, q, v = p + g[_P] * miss, w + g[_W] * miss, tau + g[_T] * miss, q + g[_Q] * miss, v + g[_V] * miss
        if read_load:
            rho = cross / variance
            miss_l = load[sample] - (q + (scale - 1.0) * (q - start)) - rho * miss
            plain = scale * scale * z[_Q, _Q] + noise.load_reading + late * before * before
            expected = plain - rho * cross - 2.0 * scale * g[_Q] * cross
            expected = max(expected, 0.25 * noise.load_reading)
            for row in range(5):
                g2[row] = (scale * z[row, _Q] - g[row] * cross) / expected
            if derive:
                for j in range(5, _WIDE):
                    second[j] = scale * flat[_Q * _WIDE + j] - rho * first[j]
                second[5 + ECCENTRICITY] += q - start
            for j in range(5):
                second[j] = g2[j] * expected
            for row in range(5):
                for j in range(columns):
                    flat[row * _WIDE + j] -= g2[row] * second[j]
            deviation = 1.0 / math.sqrt(expected)
            innovations[sample, 1], logs[sample, 1] = miss_l * deviation, math.log(expected)
            total += logs[sample, 1]
            if derive:
                for j in range(PARAMETERS):
                    derivatives[sample, 1, j] = -second[5 + j] * deviation
            p, w, tau = p + g2[_P] * miss_l, w + g2[_W] * miss_l, tau + g2[_T] * miss_l
            q, v = q + g2[_Q] * miss_l, v + g2[_V] * miss_l
        # A shaft without a reading is not pressed into the teeth by the other shaft's reading.
        if not read_load and read_motor:
            deepest = max(h, abs(x)) + 0.2 * h
            q = p - offset - min(max(p - q - offset, -deepest), deepest)
        elif not read_motor and read_load:
            deepest = max(h, abs(x)) + 0.2 * h
            p = q + offset + min(max(p - q - offset, -deepest), deepest)
        states[sample, _P], states[sample, _W], states[sample, _T] = p, w, tau
        states[sample, _Q], states[sample, _V], states[sample, LEAST], states[sample, LARGEST] = q, v, least, largest
    return total


Predict = Callable[
    [
        MotorSide,
        Constants,
        float,
        Noise,
        Array,
        Steps,
        bool,
        Array,
        Array,
        Array,
        Array,
        Array,
        Array,
        Array,
        Array,
        Array,
    ],
    float,
]


@cache
def filter_with(law: type[Contact] | None) -> Predict:
    """Return `_predict` compiled for a contact law, or for the free law for None."""
    return specialize(_predict, fused=True, _torque=torque_by(law))  # type: ignore[arg-type]
