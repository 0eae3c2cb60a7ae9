"""One step of the filter: both shafts, the drive torque, and how covariance and derivatives go through it.

See `filter` for the equations. The torque of the teeth is linearly implicit at half the step.
"""

import math
from functools import partial
from typing import NamedTuple

from backlash_ros.drivetrain.motion.rubbing import Solved, with_friction
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.identification.fitting.candidates import Shape, ToothTorque, TorqueFunction
from backlash_ros.identification.fitting.memory import (
    COUNT,
    WIDE,
    Forcing,
    Given,
    Memory,
    Model,
    MotorSide,
    Noise,
    Rows,
    Steps,
    columns_at,
)
from backlash_ros.identification.recording import Recording

_MOST_TORQUE = 1e6
"""Torque of the teeth, N m, beyond which the motion has left all bounds."""
_MOST_TWIST = 1e3
"""Twist, rad, beyond which the motion has left all bounds."""
_LEAST_WIDTH = 0.1
"""Least gap, a share of that at the start, so that no slope of the gap makes it negative."""
_TOUCHING = 1e-5
"""Torque of the teeth, N m, below which they count as apart: the step may be the longest."""
_UNKNOWN_START = 0.5
"""Share of the first command that is assumed before it acts: midway between none and all of it."""


_inlined = partial(specialize, fused=True, inlined=True)
"""Compiles a part of the step into it: calls would take a tenth of the filter's time."""


class Acting(NamedTuple):
    """What the amplifier passes in a step: its ``mean`` and how far off it may be, ``doubt``, V or A.

    ``slope`` by the delay, and ``by_dead_band``. ``number`` is that of the command that acts at the step's start.
    """

    number: int
    mean: float
    slope: float
    by_dead_band: float
    doubt: float


class Torque(NamedTuple):
    """The motor's torque in a step, N m: its ``mean`` and its ``end``; speed ``halfway``, rad/s, by which it brakes.

    ``lag`` and ``decay`` are the shares of the torque at the start that the mean and the end keep.
    """

    mean: float
    end: float
    lag: float
    decay: float
    halfway: float


class Linear(NamedTuple):
    """A step as a linear map of the states.

    Parameters
    ----------
    stiff, damp : how the teeth's torque follows a difference of the angles, N m/rad, and of the speeds, N m s/rad
    on_motor : how much of that torque the motor feels
    keep_motor, keep_load : inertia over time of both shafts, less half the friction, N m s/rad
    slope : torque on the load by its angle, N m/rad
    mean_by_torque, mean_by_speed, end_by_torque, end_by_speed : the drive torque's mean and end
    inverse : of the matrix of both speeds: see `Solved`
    half : half the step, s
    """

    stiff: float
    damp: float
    on_motor: float
    keep_motor: float
    keep_load: float
    slope: float
    mean_by_torque: float
    mean_by_speed: float
    end_by_torque: float
    end_by_speed: float
    inverse: tuple[float, float, float]
    half: float


_torque: TorqueFunction = unbound


@compiled
def passed(command: float, dead_band: float) -> tuple[float, float]:
    """Return what an amplifier with a dead band makes of a command, V or A, and its derivative by the dead band."""
    size = abs(command) - dead_band
    side = 1.0 if command > 0.0 else -1.0
    return (side * size, -side) if size > 0.0 else (0.0, 0.0)


@compiled
def in_force(recording: Recording, model: Model, number: int, now: float, length: float) -> Acting:
    """Return the command that acts ``now`` and for a ``length``, s; ``number`` is that of one which acted lately.

    Before the first command acts, half of it is assumed, with the corresponding doubt.
    """
    time, command, doubt, delay = recording.time, recording.command, recording.doubt, model.delay
    while number + 1 < time.shape[0] and time[number + 1] + delay <= now:
        number += 1
    while number >= 0 and time[number] + delay > now:
        number -= 1
    mean, off = command[max(number, 0)], doubt[max(number, 0)]
    if number < 0:
        mean, off = _UNKNOWN_START * mean, _UNKNOWN_START * abs(mean)
    mean, by_dead_band = passed(mean, model.dead_band)
    if number + 1 >= time.shape[0] or time[number + 1] + delay > now + length + 1e-12:
        return Acting(number, mean, 0.0, by_dead_band, off)
    follows, follows_by = passed(command[number + 1], model.dead_band)
    share = (time[number + 1] + delay - now) / length
    mixed, mixed_by = share * mean + (1.0 - share) * follows, share * by_dead_band + (1.0 - share) * follows_by
    return Acting(number, mixed, (mean - follows) / length, mixed_by, max(off, doubt[number + 1]))


@compiled
def step_length(steps: Steps, inside: float, approach: float, torque: float, stiffness: float, rate: float) -> float:
    """Return a step (s) that ends at contact or is short compared with the dynamics of the teeth.

    Parameters
    ----------
    inside, approach : rad from the teeth, and rad/s towards them
    torque, stiffness : of the teeth, N m and N m/rad
    rate : of the swing on them, rad/s
    """
    length = steps.longest
    if abs(torque) > _TOUCHING and stiffness > 0.0:
        length = min(length, max(steps.shortest, steps.swing / rate))
        if approach != 0.0:
            length = min(length, max(steps.shortest, steps.swing * abs(torque) / (stiffness * abs(approach))))
    if inside > 0.0 and approach > 0.0:
        length = min(length, max(steps.shortest, inside / approach))
    return length


@compiled
def carry(rows: Rows, forcing: Forcing, columns: int, linear: Linear) -> None:
    """Take the first ``columns`` of the covariance or of the derivatives through a step."""
    s11, s12, s22 = linear.inverse
    half = linear.half
    for j in range(columns):
        dp, dw, dtau = rows.motor_angle[j], rows.motor_speed[j], rows.drive_torque[j]
        dq, dv = rows.load_angle[j], rows.load_speed[j]
        pull = linear.stiff * (dp - dq) + linear.damp * (dw - dv)
        rhs_w = linear.keep_motor * dw + linear.mean_by_torque * dtau + linear.mean_by_speed * dw
        rhs_w = rhs_w - linear.on_motor * pull + forcing.on_motor[j]
        rhs_v = linear.keep_load * dv + linear.slope * dq + pull + forcing.on_load[j]
        next_w, next_v = s11 * rhs_w + s12 * rhs_v, s12 * rhs_w + s22 * rhs_v
        rows.motor_angle[j] = dp + half * (dw + next_w)
        rows.load_angle[j] = dq + half * (dv + next_v)
        rows.drive_torque[j] = linear.end_by_torque * dtau + linear.end_by_speed * dw + forcing.on_drive[j]
        rows.motor_speed[j], rows.load_speed[j] = next_w, next_v


@compiled
def _turn(rows: Rows) -> None:
    """Transpose the covariance."""
    p, w, tau = (
        columns_at(rows.motor_angle).state,
        columns_at(rows.motor_speed).state,
        columns_at(rows.drive_torque).state,
    )
    q, v = columns_at(rows.load_angle).state, columns_at(rows.load_speed).state
    p.motor_speed, w.motor_angle = w.motor_angle, p.motor_speed
    p.drive_torque, tau.motor_angle = tau.motor_angle, p.drive_torque
    p.load_angle, q.motor_angle = q.motor_angle, p.load_angle
    p.load_speed, v.motor_angle = v.motor_angle, p.load_speed
    w.drive_torque, tau.motor_speed = tau.motor_speed, w.drive_torque
    w.load_angle, q.motor_speed = q.motor_speed, w.load_angle
    w.load_speed, v.motor_speed = v.motor_speed, w.load_speed
    tau.load_angle, q.drive_torque = q.drive_torque, tau.load_angle
    tau.load_speed, v.drive_torque = v.drive_torque, tau.load_speed
    q.load_speed, v.load_angle = v.load_angle, q.load_speed


@_inlined
def motor_torque(side: MotorSide, memory: Memory, torque: float, volts: float, length: float) -> Torque:
    """Return the motor's torque in a step under a command and a ``torque`` of the teeth; a current has no lag."""
    model, w, tau = memory.model, memory.state.motor_speed, memory.state.drive_torque
    decay = math.exp(-side.rate * length)
    lag = (1.0 - decay) / (side.rate * length) if math.isfinite(side.rate) else 0.0
    halfway = w + 0.5 * length * (tau - side.viscous * w - torque) / side.inertia if lag > 0.0 else w
    settled = model.gain * volts - model.braking * halfway
    return Torque(settled + (tau - settled) * lag, settled + (tau - settled) * decay, lag, decay, halfway)


@_inlined
def _force_by_teeth(forcing: Forcing, tooth: ToothTorque, on_motor: float, half_gap: float, along: float) -> None:
    """Write how the teeth's parameters act in a step; ``along``: the load's angle from its start, rad."""
    motor, load = columns_at(forcing.on_motor).parameter, columns_at(forcing.on_load).parameter
    by = tooth.by_half_gap * half_gap
    motor.ln_half_gap, load.ln_half_gap = -on_motor * by, by
    by *= along
    motor.gap_slope, load.gap_slope = -on_motor * by, by
    by = -tooth.by_twist
    motor.offset, load.offset = -on_motor * by, by
    by = tooth.by_ln_stiffness
    motor.ln_stiffness, load.ln_stiffness = -on_motor * by, by
    by = tooth.by_ln_damping
    motor.ln_damping, load.ln_damping = -on_motor * by, by
    by = tooth.by_ln_rebound
    motor.ln_rebound, load.ln_rebound = -on_motor * by, by
    by = tooth.by_ln_exponent
    motor.ln_exponent, load.ln_exponent = -on_motor * by, by


@_inlined
def _force_by_motor(memory: Memory, acting: Acting, drive: Torque) -> None:
    """Write how delay, dead band, gain and braking act in a step."""
    model, forcing = memory.model, memory.forcing
    motor, end = columns_at(forcing.on_motor).parameter, columns_at(forcing.on_drive).parameter
    by = model.gain * acting.slope
    motor.delay, end.delay = (1.0 - drive.lag) * by, (1.0 - drive.decay) * by
    by = model.gain * acting.by_dead_band
    motor.dead_band, end.dead_band = (1.0 - drive.lag) * by, (1.0 - drive.decay) * by
    by = model.gain * acting.mean
    motor.ln_motor_gain, end.ln_motor_gain = (1.0 - drive.lag) * by, (1.0 - drive.decay) * by
    by = -model.braking * drive.halfway
    motor.ln_motor_braking, end.ln_motor_braking = (1.0 - drive.lag) * by, (1.0 - drive.decay) * by


@_inlined
def _force_by_shafts(memory: Memory, solved: Solved, torque: float, rate: float) -> None:
    """Write how load and friction act in a step, at a ``torque`` of the teeth; ``rate``: load inertia over time."""
    motor, load = columns_at(memory.forcing.on_motor).parameter, columns_at(memory.forcing.on_load).parameter
    v, along = memory.state.load_speed, memory.state.load_angle - memory.start
    load.ln_load_inertia = rate * (v - solved.load_speed)
    load.ln_load_viscous = -0.5 * memory.model.viscous * (v + solved.load_speed)
    load.load_torque, load.load_torque_slope = 1.0, along
    load.load_coulomb, motor.motor_coulomb = -solved.load_side, -solved.motor_side
    motor.gear_loss = -solved.motor_side * abs(torque)


@_inlined
def _halfway(tooth: ToothTorque, rate: float, solved: Solved, length: float) -> ToothTorque:
    """Return the derivatives of the teeth at half the step, linearly from its start; ``rate`` of the twist, rad/s."""
    rate_halfway = 0.5 * (rate + solved.motor_speed - solved.load_speed)
    slowed = rate_halfway / rate if rate != 0.0 else 1.0
    return ToothTorque(
        tooth.torque,
        tooth.by_twist,
        tooth.by_rate,
        tooth.by_half_gap,
        tooth.by_ln_stiffness + (0.5 * length * tooth.by_twist) * rate_halfway,
        slowed * tooth.by_ln_damping,
        slowed * tooth.by_ln_rebound,
        tooth.by_ln_exponent,
    )


@_inlined
def _shake(
    memory: Memory, side: MotorSide, noise: Noise, torque: float, doubt: float, length: float, since: float
) -> None:
    """Add what is unknown of the torques in a step; ``doubt`` of the command, over the time ``since`` a sample."""
    inertia = memory.model.inertia
    w, v = columns_at(memory.rows.motor_speed).state, columns_at(memory.rows.load_speed).state
    shaken = noise.teeth * torque * torque * length * 1e-3
    unknown = (side.gain * doubt / side.inertia) ** 2 * since if doubt > 0.0 else 0.0
    w.motor_speed += (noise.motor_speed + unknown) * length + shaken / side.inertia**2
    v.load_speed += noise.load_speed * length + shaken / inertia**2
    w.load_speed -= shaken / (side.inertia * inertia)
    v.motor_speed -= shaken / (side.inertia * inertia)


@_inlined
def _teeth_ahead(memory: Memory) -> tuple[float, float]:
    """Remember the twist and half the gap; return the rate of the twist, rad/s, and the load's angle from its start."""
    model, state = memory.model, memory.state
    along = state.load_angle - memory.start
    memory.twist = state.motor_angle - state.load_angle - model.offset
    memory.half_gap = model.half_gap * max(_LEAST_WIDTH, 1.0 + model.gap_slope * along)
    return state.motor_speed - state.load_speed, along


@_inlined
def _length_of(memory: Memory, steps: Steps, tooth: ToothTorque, closing: float, left: float) -> float:
    """Return the next step, s: so many of them, of equal length, for the time that is ``left`` to the next sample."""
    swing = math.sqrt(max(tooth.by_twist, 0.0) * memory.model.per_inertia)
    approach = math.copysign(1.0, memory.twist) * closing
    inside = memory.half_gap - abs(memory.twist)
    length = step_length(steps, inside, approach, tooth.torque, tooth.by_twist, swing)
    return left / math.ceil(left / length - 1e-6)


@_inlined
def _solve(
    memory: Memory, side: MotorSide, tooth: ToothTorque, drive: Torque, closing: float, length: float
) -> tuple[Solved, Linear]:
    """Return both speeds after a step of so many seconds, and the step as a linear map."""
    model, state = memory.model, memory.state
    w, v, torque = state.motor_speed, state.load_speed, tooth.torque
    a, d = side.inertia / length, model.inertia / length
    kappa = 0.25 * tooth.by_twist * length + 0.5 * tooth.by_rate
    keep_w, keep_v = a - 0.5 * side.viscous, d - 0.5 * model.viscous
    pull = torque + kappa * closing - tooth.by_rate * closing
    along = state.load_angle - memory.start
    right_m = keep_w * w + drive.mean - pull
    right_l = keep_v * v + model.load_torque + model.load_torque_slope * along + pull
    solved = with_friction(
        (a + 0.5 * side.viscous + kappa, -kappa, d + 0.5 * model.viscous + kappa),
        (right_m, right_l),
        (w, v),
        (model.motor_coulomb + model.gear_loss * abs(torque), model.load_coulomb),
    )
    linear = Linear(
        stiff=tooth.by_twist,
        damp=kappa,
        on_motor=1.0 + model.gear_loss * solved.motor_side * math.copysign(1.0, torque),
        keep_motor=keep_w,
        keep_load=keep_v,
        slope=model.load_torque_slope,
        mean_by_torque=drive.lag,
        mean_by_speed=(drive.lag - 1.0) * model.braking,
        end_by_torque=drive.decay,
        end_by_speed=(drive.decay - 1.0) * model.braking,
        inverse=solved.inverse,
        half=0.5 * length,
    )
    return solved, linear


def step(memory: Memory, given: Given, recording: Recording, derive: bool, sample: int, now: float) -> float:
    """Go one step on from ``now``, towards a sample, s; return its length, s, nan if the motion leaves all bounds."""
    model, state, side = memory.model, memory.state, given.side
    closing, along = _teeth_ahead(memory)
    shape = Shape(model.stiffness, model.damping, model.rebound, model.exponent, model.depth)
    tooth = _torque(given.constants, shape, memory.half_gap, memory.twist, closing)
    memory.least_torque = min(memory.least_torque, tooth.torque)
    memory.largest_torque = max(memory.largest_torque, tooth.torque)
    if not abs(tooth.torque) < _MOST_TORQUE or not abs(memory.twist) < _MOST_TWIST:
        return math.nan
    length = _length_of(memory, given.steps, tooth, closing, recording.time[sample] - now)
    number = int(memory.command)
    acting = in_force(recording, model, number, now, length)
    memory.command = acting.number
    drive = motor_torque(side, memory, tooth.torque, acting.mean, length)
    solved, linear = _solve(memory, side, tooth, drive, closing, length)
    if derive:
        halfway = _halfway(tooth, closing, solved, length)
        _force_by_teeth(memory.forcing, halfway, linear.on_motor, memory.half_gap, along)
        _force_by_shafts(memory, solved, tooth.torque, model.inertia / length)
        _force_by_motor(memory, acting, drive)
        carry(memory.rows, memory.forcing, WIDE, linear)
    else:
        carry(memory.rows, memory.no_forcing, COUNT, linear)
    # A covariance goes through the step from both sides.
    _turn(memory.rows)
    carry(memory.rows, memory.no_forcing, COUNT, linear)
    state.motor_angle += 0.5 * length * (state.motor_speed + solved.motor_speed)
    state.load_angle += 0.5 * length * (state.load_speed + solved.load_speed)
    state.motor_speed, state.load_speed, state.drive_torque = solved.motor_speed, solved.load_speed, drive.end
    since = recording.time[sample] - recording.time[sample - 1]
    _shake(memory, side, given.noise, tooth.torque, acting.doubt, length, since)
    return length
