"""One encoder and the speed measured beside it: which angle is believed, and whether the speed agrees with it.

All angles and speeds are at the output, so that both sides of the gear can be compared.
"""

import math

from backlash_ros.control.monitoring.fault_texts import FaultDetails
from backlash_ros.control.observer import low_pass_gain
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Record
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Estimate, Measurement

PATIENCE = 3
"""Number of consecutive implausible samples that are a fault, or after which an angle is believed."""
LATELY = 0.05
"""Time constant of forgetting, s. Tuned."""


class Side(Record):
    """What is remembered of one encoder and its speed, at the output."""

    believed: float = math.nan  # rad, the newest angle that is believed
    reading: float = math.nan  # rad, the newest angle, believed or not
    mean_speed: float = math.nan  # rad/s, between the last two believed angles
    speed_change: float = 0.0  # rad/s, of the mean speed, at the last angle that was believed
    measured_speed: float = math.nan  # rad/s, at the last sample; the mean speed in the place of a grossly wrong one
    drift: float = 0.0  # rad, of the travel from the integral of the measured speed, lately
    implausible_speeds: float = 0.0  # in a row
    implausible_angles: float = 0.0  # in a row
    moved_at_last: float = 0.0  # 1 if this sample's angle is believed after others that were not
    smallest_step: float = math.inf  # rad, of the angle so far


@compiled
def count_of(side: Side, coarsest: float) -> float:
    """Return the count assumed for a speed, rad at the output: the smallest step so far, or ``coarsest``."""
    return max(coarsest, side.smallest_step) if side.smallest_step < math.inf else coarsest


@compiled
def follow_encoder(side: Side, angle: float, bound: float, trusted: bool, period: float) -> float:
    """Take an angle (rad at the output); return the change of its mean speed since the previous sample, rad/s.

    An angle that deviates from its motion by more than ``bound`` (rad/s) is not believed before its third sample,
    unless it is ``trusted``: with a measured speed, an angle that jumps causes no speed.
    """
    speed_of_readings = (angle - side.reading) / period
    mean_speed = (angle - side.believed) / period
    change = mean_speed - side.mean_speed
    side.reading, side.moved_at_last = angle, 0.0
    if math.isnan(change):
        change = 0.0
    elif abs(change) > bound and not trusted:
        side.implausible_angles += 1.0
        # Until it is believed, the angle goes on as before.
        if side.implausible_angles < PATIENCE:
            side.believed += period * side.mean_speed
            return 0.0
        side.moved_at_last = 1.0
        mean_speed, change = speed_of_readings, speed_of_readings - side.mean_speed
    step = abs(angle - side.believed)
    if step > 0.0:  # false for nan
        side.smallest_step = min(step, side.smallest_step)
    side.believed, side.mean_speed, side.implausible_angles = angle, mean_speed, 0.0
    side.speed_change = change
    return float(abs(change))


@compiled
def settle_angle(
    side: Side, shaft: int, to_shaft: float, across: float, used: Measurement, estimate: Estimate, period: float
) -> None:
    """Let the observer extrapolate while an angle is not believed, and restart when it is believed at last.

    Parameters
    ----------
    shaft : the signal of the side's angle, `THETA_M` or `THETA_L`
    to_shaft, across : a speed at this shaft per speed at the output, and per speed at the other shaft
    used : the sample, in which an angle that is not believed is replaced
    estimate : of the sample before, updated in place
    period : since the previous sample, s
    """
    speed = OMEGA_M if shaft == THETA_M else OMEGA_L
    if side.implausible_angles > 0.0:
        used[shaft] = estimate[shaft] + period * estimate[speed]
        return
    if side.moved_at_last == 0.0:
        return
    estimate[speed] = to_shaft * side.mean_speed
    estimate[shaft] = used[shaft] - period * estimate[speed]
    other, other_speed = (THETA_L, OMEGA_L) if shaft == THETA_M else (THETA_M, OMEGA_M)
    # A shaft without an encoder goes with this one, through the rigid gear.
    if math.isnan(used[other]):
        estimate[other], estimate[other_speed] = estimate[shaft] / across, estimate[speed] / across


@compiled
def speed_is_plausible(
    side: Side, measured: float, bound: float, drift_bound: float, period: float, details: FaultDetails
) -> bool:
    """Return whether a measured speed agrees with the encoder since the last sample, and recently.

    Parameters
    ----------
    measured, bound : rad/s at the output
    drift_bound : rad, of the recent drift between travel and integrated speed
    period : since the previous sample, s
    """
    before = side.measured_speed
    side.measured_speed = measured
    if math.isnan(side.mean_speed) or math.isnan(measured) or math.isnan(before):
        side.implausible_speeds = 0.0
        return True
    grossly_wrong = not abs(measured - side.mean_speed) <= bound
    if grossly_wrong:
        side.measured_speed = side.mean_speed  # it says nothing about the next ones
    else:
        drift = side.drift
        drift += period * (side.mean_speed - 0.5 * (before + measured)) - low_pass_gain(1.0 / LATELY, period) * drift
        side.drift = drift
        if abs(drift) <= drift_bound:
            side.implausible_speeds = 0.0
            return True
    side.implausible_speeds += 1.0
    details.value, details.expected, details.bound = measured, side.mean_speed, bound
    details.drift = 0.0 if grossly_wrong else abs(side.drift)
    return False
