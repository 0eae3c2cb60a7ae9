"""Predicts each sample of a recording from the previous ones, with the derivatives by the parameters to identify.

An extended Kalman filter over both shafts as seen at the output: motor angle n theta_m and its speed, drive torque
K_m i/n, load angle and speed. With the motor's inertia J_r by its data sheet, which sets the unit of torque:

    J_r p'' = e^G g u - (e^R b + B_r) p' - (c_m + loss abs(T)) sign p' - T
    J_l q'' = T - B_l q' - c_l sign q' + tau + kappa (q - q_0)

The command u acts late, less the amplifier's dead band, and through the winding. T is the torque of the teeth: see
`candidates`. It is linearly implicit at half the step, so that stiff teeth need no short steps; dry friction brakes
each shaft and holds it where it can. The derivatives of the state by the parameters go through the same linear maps as
its covariance, corrections by the samples included: one pass gives the innovations and their derivatives (recursive
prediction errors: Ljung, System Identification, 2nd ed., ch. 11). A pass without them takes a third of the time.

The steps are in `shafts`, the corrections in `readings`.
"""

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from backlash_ros.drivetrain.contact import Contact
from backlash_ros.foundation.compiled import fused, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.candidates import torque_by
from backlash_ros.identification.fitting.memory import (
    MEMORY,
    Given,
    Memory,
    MotorSide,
    Noise,
    Results,
    Steps,
    Teeth,
    columns_at,
    memory_at,
    trace_at,
)
from backlash_ros.identification.fitting.parameters import parameters_at
from backlash_ros.identification.fitting.readings import (
    NO_READING,
    correct_by_motor,
    keep_out_of_teeth,
    keep_symmetric,
    no_gain,
    read_load,
    read_motor,
)
from backlash_ros.identification.fitting.shafts import step
from backlash_ros.identification.recording import Recording

_UNSURE = 1e-2
"""Variance of both speeds (rad^2/s^2) and of the torque (N^2 m^2) at the start."""
_SLIVER = 1e-9
"""Time between two samples, s, that is not worth a step: rounding leaves less."""

_step: Callable[[Memory, Given, Recording, bool, int, float], float] = unbound
_between: Callable[[Memory, Given, Recording, bool, int], bool] = unbound
_follow: Callable[[Array, Given, Recording, Results, bool], float] = unbound


@fused
def _set_model(row: Array, side: MotorSide, depth: float, parameters: Array) -> None:
    """Set the drive by its parameters, in a row of memory; ``depth`` of the teeth."""
    model, x = memory_at(row).model, parameters_at(parameters)
    model.half_gap, model.offset, model.gap_slope = math.exp(x.ln_half_gap), x.offset, x.gap_slope
    model.stiffness, model.damping = math.exp(x.ln_stiffness), math.exp(x.ln_damping)
    model.rebound, model.exponent, model.depth = math.exp(x.ln_rebound), math.exp(x.ln_exponent), depth
    model.inertia, model.viscous = math.exp(x.ln_load_inertia), math.exp(x.ln_load_viscous)
    model.load_coulomb, model.motor_coulomb, model.gear_loss = x.load_coulomb, x.motor_coulomb, x.gear_loss
    model.load_torque, model.load_torque_slope = x.load_torque, x.load_torque_slope
    model.scale, model.delay = 1.0 + x.load_scale_error, x.delay
    model.gain = side.gain * math.exp(x.ln_motor_gain)
    model.braking = side.braking * math.exp(x.ln_motor_braking)
    model.dead_band = x.dead_band
    model.per_inertia = 1.0 / side.inertia + 1.0 / model.inertia


@fused
def _begin(memory: Memory, noise: Noise, recording: Recording, first: Array) -> None:
    """Start from the first readings, with the speeds and the torque of the ``first`` state."""
    rows, state, given = memory.rows, memory.state, trace_at(first).state
    given.motor_angle, given.load_angle = recording.motor[0], recording.load[0]
    state.motor_angle, state.motor_speed, state.drive_torque = given.motor_angle, given.motor_speed, given.drive_torque
    state.load_angle, state.load_speed = given.load_angle, given.load_speed
    memory.start = recording.load[0]
    columns_at(rows.motor_angle).state.motor_angle = noise.motor_reading
    columns_at(rows.motor_speed).state.motor_speed = _UNSURE
    columns_at(rows.drive_torque).state.drive_torque = _UNSURE
    columns_at(rows.load_angle).state.load_angle = noise.load_reading
    columns_at(rows.load_speed).state.load_speed = _UNSURE


def between(memory: Memory, given: Given, recording: Recording, derive: bool, sample: int) -> bool:
    """Go on from the previous sample to this one; return whether the motion stays within all bounds."""
    now, end = recording.time[sample - 1], recording.time[sample]
    memory.least_torque, memory.largest_torque = math.inf, -math.inf
    while end - now > _SLIVER:
        length = _step(memory, given, recording, derive, sample, now)
        if math.isnan(length):
            return False
        now += length
    return True


@fused
def _correct(memory: Memory, noise: Noise, recording: Recording, results: Results, derive: bool, sample: int) -> None:
    """Correct by the readings of a sample, as far as there are any."""
    motor, load = recording.motor[sample], recording.load[sample]
    motor_read, load_read = not math.isnan(motor), not math.isnan(load)
    speed, miss = memory.state.load_speed, NO_READING
    no_gain(memory.gain)
    if motor_read:
        miss = read_motor(memory, noise, results, motor, sample, derive)
    correct_by_motor(memory, miss)
    if load_read:
        read_load(memory, noise, results, miss, (load, speed), sample, derive)
    keep_out_of_teeth(memory, motor_read, load_read)
    if not (motor_read and load_read):
        keep_symmetric(memory.rows)


@fused
def _leave(memory: Memory, row: Array) -> None:
    """Write the state after a sample, and the torques before it."""
    trace, state = trace_at(row), memory.state
    left = trace.state
    left.motor_angle, left.motor_speed, left.drive_torque = state.motor_angle, state.motor_speed, state.drive_torque
    left.load_angle, left.load_speed = state.load_angle, state.load_speed
    trace.least_torque, trace.largest_torque = memory.least_torque, memory.largest_torque


def follow(row: Array, given: Given, recording: Recording, results: Results, derive: bool) -> float:
    """Go through a recording with a ``row`` of memory: see `predict`."""
    memory, total = memory_at(row), 0.0
    _begin(memory, given.noise, recording, results.states[0])
    for sample in range(1, recording.time.shape[0]):
        if not _between(memory, given, recording, derive, sample):
            return math.inf
        _correct(memory, given.noise, recording, results, derive, sample)
        # One by one, in the order of the readings: so is their sum rounded.
        if not math.isnan(recording.motor[sample]):
            total += results.logs[sample, 0]
        if not math.isnan(recording.load[sample]):
            total += results.logs[sample, 1]
        _leave(memory, results.states[sample])
    return total


def predict(
    side: MotorSide,
    teeth: Teeth,
    noise: Noise,
    parameters: Array,
    steps: Steps,
    recording: Recording,
    results: Results,
    derive: bool,
) -> float:
    """Fill in the ``results``: see there.

    Parameters
    ----------
    parameters : shape (`PARAMETERS`,): see `Parameters`
    recording : its angles are nan, but for the first, where there is no reading
    derive : whether the derivatives are wanted

    Returns
    -------
    the sum of the logarithms; infinite if the motion leaves all bounds
    """
    row = np.zeros(MEMORY)
    _set_model(row, side, teeth.depth, parameters)
    return _follow(row, Given(side, teeth.constants, noise, steps), recording, results, derive)


Predict = Callable[[MotorSide, Teeth, Noise, Array, Steps, Recording, Results, bool], float]


@cache
def filter_with(law: type[Contact] | None) -> Predict:
    """Return `predict` compiled for a contact law, or for the free law for None."""
    one = specialize(step, fused=True, inlined=True, _torque=torque_by(law))  # type: ignore[arg-type]
    some = specialize(between, fused=True, inlined=True, _step=one)
    return specialize(predict, fused=True, _follow=specialize(follow, fused=True, _between=some))
