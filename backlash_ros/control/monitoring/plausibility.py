"""Plausibility: currents and speeds that physics excludes are not used, and after three samples they are a fault.

Pure computation, compiled into the tick, before anything else uses the sample. Positions are taken as true. A measured
current and measured speeds are compared with what follows from positions and commands:

current  follows the armature equation (eq 7) from the commands that may act, the last three (a drive may be late), and
         from the motor's speed. The measured current may deviate by a share of the stall current, and by shares of the
         largest recent current and back-EMF, since resistance and torque constant may be wrong.
speed    has the encoder's travel over a period as its mean. The measured speed may deviate from the mean by as much as
         the mean changed recently from sample to sample and between the shafts (acceleration, impacts), by what the
         current does to a motor that turns alone, and by a count. Over a longer time, travel and integrated speed must
         agree, except for a lag and for what happens between the samples if the travel changes from each sample to the
         next (the impacts of a fast limit cycle). A speed of the wrong unit or sign does not agree, however slow the
         axis.

An implausible signal counts as not measured, and the observer derives it from position or from the command. The third
implausible sample in a row is a fault, which names signal, value and bound.

An angle without a measured speed must not cause a speed by jumping. An angle that deviates by more than the above is
believed only at its third sample: then the shaft has moved, for example by a blow, or the encoder has slipped by less
than the monitor's limit on the gap, which looks the same.
"""

import math
from typing import NamedTuple

import numpy as np

from backlash_ros.control.observer import ObserverConstants, low_pass_gain, next_current
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement

PATIENCE = 3
"""Number of consecutive implausible samples that are a fault."""

_STALL_SHARE = 0.02
"""Share of the stall current by which a current may be off at rest."""
_CURRENT_SHARE = 0.35
"""Share of the largest recent current: the resistance may be a quarter less than its parameter."""
_BACK_EMF_SHARE = 0.15
"""Share of the current that the largest recent back-EMF would drive: the torque constant may be wrong."""
LATELY = 0.05
"""Time constant of forgetting, s."""
_LAG = 0.004
"""Delay of a reported speed that is allowed beside two periods, s."""
_COUNT = 2 * math.pi / 2**11
"""Count that a speed may come from, rad at its shaft, until all steps seen are larger."""


class PlausibilityConstants(NamedTuple):
    """Acceleration of a motor alone per current, rad/s^2 per A at the output; and the current's margin, A."""

    acceleration: float
    current_margin: float


def plausibility_constants(drive: Drive) -> PlausibilityConstants:
    """Return the constants for one drive."""
    motor = drive.motor
    stall = min(motor.voltage_limit / motor.resistance, motor.current_limit if drive.takes_current else math.inf)
    return PlausibilityConstants(
        acceleration=drive.gear.ratio * motor.torque_constant / motor.inertia, current_margin=_STALL_SHARE * stall
    )


@compiled
def speed_lag(period: float) -> float:
    """Return the allowed delay of reported speeds, s."""
    return _LAG + 2.0 * period


# What is remembered: of each side the angle that is believed and the one that was shown, the mean speed and by how much
# it changed last, the measured speed, at the output, the sum of what they disagree on, for how many samples in a row
# speed and angle were not plausible, and the smallest way seen; how fast and how unsteady it was lately, and how far a
# lag, and what is between the samples, may lead off the way; of the current its hull, its peak, for how many samples it
# was not plausible, and the commands before.
_ANGLE, _SHOWN, _MEAN, _CHANGE, _SPEED, _DRIFT, _FAILED, _JUMPED, _RESEATED, _COUNTED = range(10)
_MOTOR, _LOAD = 0, 10
_FASTEST, _UNSTEADY, _LAGGED, _UNEVEN = range(20, 24)
_LEAST, _LARGEST, _PEAK, _CURRENT_FAILED, _BEFORE, _BEFORE_THAT = range(24, 30)


def plausibility_memory() -> Array:
    """Return the initial memory."""
    memory = np.zeros(30)
    memory[[side + part for side in (_MOTOR, _LOAD) for part in (_ANGLE, _SHOWN, _MEAN, _SPEED)]] = math.nan
    memory[[_MOTOR + _COUNTED, _LOAD + _COUNTED]] = math.inf
    return memory


@compiled
def _count_of(memory: Array, side: int, coarsest: float) -> float:
    """Return the count assumed for a speed, rad at the output: the smallest step seen, or ``coarsest``."""
    seen = memory[side + _COUNTED]
    return max(coarsest, seen) if seen < math.inf else coarsest


@compiled
def _follow_encoder(memory: Array, side: int, angle: float, bound: float, trusted: bool, period: float) -> float:
    """Take an angle (rad at the output); return the change of its mean speed since the previous sample, rad/s.

    An angle that deviates from its motion by more than ``bound`` (rad/s) is not believed before its third sample,
    unless it is ``trusted``: with a measured speed, an angle that jumps causes no speed.
    """
    shown = (angle - memory[side + _SHOWN]) / period
    mean = (angle - memory[side + _ANGLE]) / period
    change = mean - memory[side + _MEAN]
    memory[side + _SHOWN], memory[side + _RESEATED] = angle, 0.0
    if math.isnan(change):
        change = 0.0
    elif abs(change) > bound and not trusted:
        memory[side + _JUMPED] += 1.0
        if memory[side + _JUMPED] < PATIENCE:
            memory[side + _ANGLE] += period * memory[side + _MEAN]
            return 0.0
        memory[side + _RESEATED] = 1.0
        mean, change = shown, shown - memory[side + _MEAN]
    moved = abs(angle - memory[side + _ANGLE])
    if moved > 0.0:  # false for nan
        memory[side + _COUNTED] = min(moved, memory[side + _COUNTED])
    memory[side + _ANGLE], memory[side + _MEAN], memory[side + _JUMPED] = angle, mean, 0.0
    memory[side + _CHANGE] = change
    return float(abs(change))


@compiled
def _settle_angle(
    memory: Array, side: int, to_shaft: float, across: float, used: Measurement, observed: Array, period: float
) -> None:
    """Let the observer extrapolate while an angle is not believed, and restart when it is believed at last."""
    angle, speed = (THETA_M, OMEGA_M) if side == _MOTOR else (THETA_L, OMEGA_L)
    if memory[side + _JUMPED] > 0.0:
        used[angle] = observed[angle] + period * observed[speed]
    elif memory[side + _RESEATED] > 0.0:
        observed[speed] = to_shaft * memory[side + _MEAN]
        observed[angle] = used[angle] - period * observed[speed]
        other_angle, other_speed = (THETA_L, OMEGA_L) if side == _MOTOR else (THETA_M, OMEGA_M)
        if math.isnan(used[other_angle]):  # it goes with this one, through the rigid gear
            observed[other_angle], observed[other_speed] = observed[angle] / across, observed[speed] / across


@compiled
def settle_angles(
    observer: ObserverConstants, memory: Array, used: Measurement, observed: Array, period: float
) -> None:
    """Replace an implausible angle in ``used`` by the observer's expectation; see the file.

    Parameters
    ----------
    memory : of `plausibility_step`, which has seen the same sample
    observed : the observer's memory, updated in place
    period : since the previous sample, s
    """
    n = observer.ratio
    _settle_angle(memory, _MOTOR, 1.0 / n, 1.0 / n, used, observed, period)
    _settle_angle(memory, _LOAD, 1.0, n, used, observed, period)


@compiled
def _speed_is_plausible(
    memory: Array, side: int, measured: float, bound: float, count: float, period: float, details: Array
) -> bool:
    """Return whether a measured speed agrees with the encoder since the last sample, and recently; at the output."""
    mean, before = memory[side + _MEAN], memory[side + _SPEED]
    memory[side + _SPEED] = measured
    if math.isnan(mean) or math.isnan(measured) or math.isnan(before):
        memory[side + _FAILED] = 0.0
        return True
    fine = abs(measured - mean) <= bound
    if fine:
        drift = memory[side + _DRIFT]
        drift += period * (mean - 0.5 * (before + measured)) - low_pass_gain(1.0 / LATELY, period) * drift
        memory[side + _DRIFT] = drift
        fine = abs(drift) <= 2.0 * count + memory[_LAGGED] + memory[_UNEVEN]
    else:
        memory[side + _SPEED] = mean  # a grossly wrong one says nothing about the next ones
    if fine:
        memory[side + _FAILED] = 0.0
        return True
    memory[side + _FAILED] += 1.0
    # A negative third value tells the text that the integrals have drifted apart.
    details[0], details[1] = measured, mean
    details[2] = bound if abs(measured - mean) > bound else -abs(memory[side + _DRIFT])
    return False


@compiled
def _current_is_plausible(
    constants: PlausibilityConstants,
    observer: ObserverConstants,
    memory: Array,
    omega_m: float,
    measured: float,
    command: float,
    period: float,
    details: Array,
) -> bool:
    """Return whether the last three commands can cause a measured current at a motor speed, rad/s."""
    least = min(command, memory[_BEFORE], memory[_BEFORE_THAT])
    largest = max(command, memory[_BEFORE], memory[_BEFORE_THAT])
    memory[_BEFORE_THAT], memory[_BEFORE] = memory[_BEFORE], command
    memory[_LEAST] = next_current(observer, memory[_LEAST], least, omega_m, period)
    memory[_LARGEST] = next_current(observer, memory[_LARGEST], largest, omega_m, period)
    peak = max(abs(memory[_LEAST]), abs(memory[_LARGEST]))
    memory[_PEAK] = max(peak, memory[_PEAK] * (1.0 - low_pass_gain(1.0 / LATELY, period)))
    induced = observer.back_emf * memory[_FASTEST] / observer.ratio / observer.resistance
    margin = constants.current_margin + _CURRENT_SHARE * memory[_PEAK] + _BACK_EMF_SHARE * induced
    low, high = min(memory[_LEAST], 0.0) - margin, max(memory[_LARGEST], 0.0) + margin
    if math.isnan(measured) or low <= measured <= high:
        memory[_CURRENT_FAILED] = 0.0
        return True
    memory[_CURRENT_FAILED] += 1.0
    details[0], details[1], details[2] = measured, low, high
    return False


@compiled
def plausibility_step(
    constants: PlausibilityConstants,
    observer: ObserverConstants,
    memory: Array,
    measured: Measurement,
    command: float,
    period: float,
    details: Array,
) -> int:
    """Replace implausible values in ``measured`` by nan; return the signal that is now a fault, or -1.

    Parameters
    ----------
    memory : from `plausibility_memory`, updated in place
    command : in force since the previous sample, V or A
    period : since the previous sample, s
    details : shape (3,): of the fault: the value; for a speed the encoder's mean and the bound around it, rad/s at the
        output, or minus the drift between both, rad; for a current the smallest and the largest plausible value, A
    """
    n = observer.ratio
    motor_angle, load_angle = n * measured[THETA_M], measured[THETA_L]
    motor_shown = (motor_angle - memory[_MOTOR + _SHOWN]) / period
    load_shown = (load_angle - memory[_LOAD + _SHOWN]) / period
    omega_m = (load_shown if math.isnan(motor_shown) else motor_shown) / n
    if math.isnan(omega_m):
        omega_m = 0.0
    current_fine = _current_is_plausible(
        constants, observer, memory, omega_m, measured[CURRENT], command, period, details
    )
    if not current_fine:
        measured[CURRENT] = math.nan
        if memory[_CURRENT_FAILED] >= PATIENCE:
            return CURRENT
    left = 1.0 - low_pass_gain(1.0 / LATELY, period)
    changed = uneven = 0.0
    driven = constants.acceleration * memory[_PEAK] * period
    for side, angle, other, speed, to_output in (
        (_MOTOR, motor_angle, load_shown, measured[OMEGA_M], n),
        (_LOAD, load_angle, motor_shown, measured[OMEGA_L], 1.0),
    ):
        apart = abs(other - memory[side + _MEAN])
        steady = left * memory[_UNSTEADY] if math.isnan(apart) else max(left * memory[_UNSTEADY], apart)
        within = 2.0 * steady + driven + _count_of(memory, side, to_output * _COUNT) / period
        before = memory[side + _CHANGE]
        changed = max(changed, _follow_encoder(memory, side, angle, within, not math.isnan(speed), period))
        uneven = max(uneven, abs(memory[side + _CHANGE] - before))
    # A trapezoid of speeds that alternate misses a quarter of the mean speed's second difference, times the period.
    memory[_UNEVEN] = left * memory[_UNEVEN] + 0.25 * period * uneven
    motor, load = memory[_MOTOR + _MEAN], memory[_LOAD + _MEAN]
    if not math.isnan(motor - load):
        changed = max(changed, abs(motor - load))
    memory[_UNSTEADY] = max(left * memory[_UNSTEADY], changed)
    memory[_FASTEST] *= left
    for speed in (motor, load):
        if not math.isnan(speed):
            memory[_FASTEST] = max(memory[_FASTEST], abs(speed))
    # After a sample that came late it fades as the sum does that it is the bound of.
    memory[_LAGGED] = max(left * memory[_LAGGED], speed_lag(period) * memory[_FASTEST])
    bound = 2.0 * memory[_UNSTEADY] + driven
    for side, speed_index, to_output in ((_MOTOR, OMEGA_M, n), (_LOAD, OMEGA_L, 1.0)):
        count = _count_of(memory, side, to_output * _COUNT)
        shown = to_output * measured[speed_index]
        if not _speed_is_plausible(memory, side, shown, bound + count / period, count, period, details):
            measured[speed_index] = math.nan
            if memory[side + _FAILED] >= PATIENCE:
                return speed_index
    return -1
