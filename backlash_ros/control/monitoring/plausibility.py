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

from backlash_ros.control.monitoring.fault_texts import FaultDetails
from backlash_ros.control.monitoring.side import (
    LATELY,
    PATIENCE,
    Side,
    count_of,
    follow_encoder,
    settle_angle,
    speed_is_plausible,
)
from backlash_ros.control.observer import ObserverConstants, ObserverMemory, low_pass_gain, next_current
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Record, part, row_of, view_of
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement, as_estimate

_STALL_SHARE = 0.02
"""Share of the stall current by which a current may be off at rest. Tuned."""
_CURRENT_SHARE = 0.35
"""Share of the largest recent current by which one may be off: the resistance may be a quarter less than its
parameter."""
_BACK_EMF_SHARE = 0.15
"""Share of the current that the largest recent back-EMF would drive: the torque constant may be wrong."""
_LAG = 0.004
"""Delay of a reported speed that is allowed beside two periods, s. Tuned."""
_COUNT = 2 * math.pi / 2**11
"""Count that a speed may come from, rad at its shaft, until all steps seen are larger."""


class PlausibilityConstants(Record):
    """What the motor does alone, and what is allowed to its current."""

    acceleration: float  # rad/s^2 per A at the output, of the motor alone
    current_margin: float  # A, at rest


class CurrentMemory(Record):
    """The currents that the last three commands can cause."""

    smallest: float = 0.0  # A
    largest: float = 0.0  # A
    peak: float = 0.0  # A, the largest magnitude lately
    implausible: float = 0.0  # so many measured currents in a row were
    command_before: float = 0.0  # V or A, one sample before the one in force
    command_before_that: float = 0.0  # V or A, two samples before


class PlausibilityMemory(Record):
    """Both encoders, the current, and how fast and how unsteady the motion was lately, at the output."""

    motor: Side = part(Side)
    load: Side = part(Side)
    current: CurrentMemory = part(CurrentMemory)
    peak_speed: float = 0.0  # rad/s, lately
    peak_change: float = 0.0  # rad/s, lately: of a mean speed from sample to sample, or between the shafts
    lag_travel: float = 0.0  # rad, on which a lag leads, lately
    unseen_travel: float = 0.0  # rad, between the samples, that a trapezoid of the speeds misses, lately


_constants_at = view_of(PlausibilityConstants)


def plausibility_constants(drive: Drive) -> PlausibilityConstants:
    """Return the constants for one drive."""
    motor = drive.motor
    stall = min(motor.voltage_limit / motor.resistance, motor.current_limit if drive.takes_current else math.inf)
    row = row_of(
        PlausibilityConstants,
        acceleration=drive.gear.ratio * motor.torque_constant / motor.inertia,
        current_margin=_STALL_SHARE * stall,
    )
    return _constants_at(row)


@compiled
def speed_lag(period: float) -> float:
    """Return the allowed delay of reported speeds, s."""
    return _LAG + 2.0 * period


@compiled
def settle_angles(
    ratio: float, memory: PlausibilityMemory, used: Measurement, observed: ObserverMemory, period: float
) -> None:
    """Replace an implausible angle in ``used`` by the observer's expectation; see the file.

    Parameters
    ----------
    ratio : of the gear, n
    memory : of `plausibility_step`, which has seen the same sample
    observed : updated in place
    period : since the previous sample, s
    """
    estimate = as_estimate(observed.estimate)
    settle_angle(memory.motor, THETA_M, 1.0 / ratio, 1.0 / ratio, used, estimate, period)
    settle_angle(memory.load, THETA_L, 1.0, ratio, used, estimate, period)


@compiled
def _follow_current(
    observer: ObserverConstants, current: CurrentMemory, omega_m: float, command: float, period: float
) -> None:
    """Update the currents that the last three commands can cause at a motor speed, rad/s."""
    smallest = min(command, current.command_before, current.command_before_that)
    largest = max(command, current.command_before, current.command_before_that)
    current.command_before_that, current.command_before = current.command_before, command
    current.smallest = next_current(observer, current.smallest, smallest, omega_m, period)
    current.largest = next_current(observer, current.largest, largest, omega_m, period)
    peak = max(abs(current.smallest), abs(current.largest))
    current.peak = max(peak, current.peak * (1.0 - low_pass_gain(1.0 / LATELY, period)))


@compiled
def _current_is_plausible(
    constants: PlausibilityConstants, current: CurrentMemory, induced: float, measured: float, details: FaultDetails
) -> bool:
    """Return whether the commands can cause a measured current; ``induced``: that of the back-EMF lately, A."""
    margin = constants.current_margin + _CURRENT_SHARE * current.peak + _BACK_EMF_SHARE * induced
    low, high = min(current.smallest, 0.0) - margin, max(current.largest, 0.0) + margin
    if math.isnan(measured) or low <= measured <= high:
        current.implausible = 0.0
        return True
    current.implausible += 1.0
    details.value, details.low, details.high = measured, low, high
    return False


@compiled
def _angle_bound(side: Side, other_speed: float, peak_change: float, driven: float, count_speed: float) -> float:
    """Return by how much the mean speed of an encoder may change from one sample to the next, rad/s.

    ``other_speed`` is that of the other encoder, nan if there is none; ``peak_change`` that of the mean speeds lately;
    ``driven`` what the current does to a motor alone; ``count_speed`` one count within a period: all in rad/s.
    """
    apart = abs(other_speed - side.mean_speed)
    steady = peak_change if math.isnan(apart) else max(peak_change, apart)
    return float(2.0 * steady + driven + count_speed)


@compiled
def _follow_encoders(
    memory: PlausibilityMemory, measured: Measurement, ratio: float, driven: float, period: float
) -> None:
    """Take the angles; ``driven``: what the current does to the speed of a motor alone, rad/s at the output."""
    motor, load = memory.motor, memory.load
    motor_angle, load_angle = ratio * measured[THETA_M], measured[THETA_L]
    motor_speed, load_speed = (motor_angle - motor.reading) / period, (load_angle - load.reading) / period
    before_m, before_l = motor.speed_change, load.speed_change
    kept = 1.0 - low_pass_gain(1.0 / LATELY, period)
    peak_change = kept * memory.peak_change
    bound = _angle_bound(motor, load_speed, peak_change, driven, count_of(motor, ratio * _COUNT) / period)
    changed = follow_encoder(motor, motor_angle, bound, not math.isnan(measured[OMEGA_M]), period)
    bound = _angle_bound(load, motor_speed, peak_change, driven, count_of(load, _COUNT) / period)
    changed = max(changed, follow_encoder(load, load_angle, bound, not math.isnan(measured[OMEGA_L]), period))
    # A trapezoid of speeds that alternate misses a quarter of the mean speed's second difference, times the period.
    uneven = max(abs(motor.speed_change - before_m), abs(load.speed_change - before_l))
    memory.unseen_travel = kept * memory.unseen_travel + 0.25 * period * uneven
    apart = abs(motor.mean_speed - load.mean_speed)
    if not math.isnan(apart):
        changed = max(changed, apart)
    memory.peak_change = max(peak_change, changed)
    memory.peak_speed *= kept
    for speed in (motor.mean_speed, load.mean_speed):
        if not math.isnan(speed):
            memory.peak_speed = max(memory.peak_speed, abs(speed))
    # After a sample that came late it fades as the sum does that it is the bound of.
    memory.lag_travel = max(kept * memory.lag_travel, speed_lag(period) * memory.peak_speed)


@compiled
def _check_speeds(
    memory: PlausibilityMemory, measured: Measurement, ratio: float, driven: float, period: float, details: FaultDetails
) -> int:
    """Replace implausible speeds by nan; return the one that is now a fault, or -1."""
    bound = 2.0 * memory.peak_change + driven
    for side, speed, to_output in ((memory.motor, OMEGA_M, ratio), (memory.load, OMEGA_L, 1.0)):
        count = count_of(side, to_output * _COUNT)
        drift_bound = 2.0 * count + memory.lag_travel + memory.unseen_travel
        at_output = to_output * measured[speed]
        if not speed_is_plausible(side, at_output, bound + count / period, drift_bound, period, details):
            measured[speed] = math.nan
            if side.implausible_speeds >= PATIENCE:
                return speed
    return -1


@compiled
def _motor_speed(memory: PlausibilityMemory, measured: Measurement, ratio: float, period: float) -> float:
    """Return the motor's speed since the last sample, rad/s, by its own encoder or else by the load's; 0 at first."""
    motor_speed = (ratio * measured[THETA_M] - memory.motor.reading) / period
    load_speed = (measured[THETA_L] - memory.load.reading) / period
    omega_m = (load_speed if math.isnan(motor_speed) else motor_speed) / ratio
    return 0.0 if math.isnan(omega_m) else omega_m


@compiled
def plausibility_step(
    constants: PlausibilityConstants,
    observer: ObserverConstants,
    memory: PlausibilityMemory,
    measured: Measurement,
    command: float,
    period: float,
    details: FaultDetails,
) -> int:
    """Replace implausible values in ``measured`` by nan; return the signal that is now a fault, or -1.

    Parameters
    ----------
    memory : updated in place
    command : in force since the previous sample, V or A
    period : since the previous sample, s
    details : of the fault: for a speed in rad/s and rad, at the output, for a current in A
    """
    ratio, current = observer.ratio, memory.current
    _follow_current(observer, current, _motor_speed(memory, measured, ratio, period), command, period)
    induced = observer.back_emf * memory.peak_speed / ratio / observer.resistance
    if not _current_is_plausible(constants, current, induced, measured[CURRENT], details):
        measured[CURRENT] = math.nan
        if current.implausible >= PATIENCE:
            return CURRENT
    driven = constants.acceleration * current.peak * period
    _follow_encoders(memory, measured, ratio, driven, period)
    return _check_speeds(memory, measured, ratio, driven, period, details)
