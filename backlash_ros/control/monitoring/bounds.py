"""The bounds within which the monitor holds one drive, from its parameters, limits and fault thresholds."""

import math

from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import (
    FOUND,
    GAPS_AWAY,
    FaultThresholds,
    mechanical_time_constant,
    pressed,
)
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Record, row_of, view_of

_SLOWEST = 5.0
"""Smallest bandwidth of the two low-passes of the unexplained torque, rad/s: a runaway is not over before it counts."""
_FASTEST = 50.0
"""Largest one, rad/s: an impact is over before it counts, and the encoder counts of a slow drive cause no fault."""

_HELD = 0.9
"""Share of the standstill torque that a drive can hold against a load; beyond it the load is blocked."""

_VARIES = 1.5
"""Factor by which the gap seen may exceed the learned one: encoders are eccentric, and a gap varies."""
_GROWS = 6.0
"""The same for a gap that will be learned again: it may have grown. Tuned."""

_COUNT = 2 * math.pi / 2**12
"""Count of a coarse load encoder, rad."""


class MonitorConstants(Record):
    """Thresholds, ends and the torque's filter as the compiled step reads them."""

    velocity: float  # rad/s
    held_torque: float  # N m, largest that may be unexplained
    gap: float  # rad
    tracking: float  # rad
    gives_way: float  # rad per N m: how far a sudden load torque moves the load until the law holds it
    sags: float  # rad per N m: how far it does for good where only the load's encoder is there to find it
    lower_end: float  # rad
    upper_end: float  # rad
    soft_zone: float  # rad
    torque_bandwidth: float  # rad/s
    start_time: float  # s, in which the speeds are not known well enough for a torque


_constants_at = view_of(MonitorConstants)


def gives_way(drive: Drive) -> float:
    """Return how far a sudden load torque moves the load until the law holds it, rad per N m.

    It drives the motor back as far as it goes at the speed that the torque makes, in its mechanical time constant and
    the time in which a load torque is found.
    """
    speed = drive.no_load_speed / drive.standstill_torque()
    return float(speed * (mechanical_time_constant(drive) + FOUND))


def _gap_bound(drive: Drive, thresholds: FaultThresholds, backlash_angle: float, *, may_grow: bool) -> float:
    """Return how far the shafts may move apart, rad."""
    if not backlash_angle > 0:
        return thresholds.gap
    factor = _GROWS if may_grow else _VARIES
    known = factor * max(backlash_angle, drive.gear.backlash_angle) + 2.0 * pressed(drive) + 2.0 * _COUNT
    return (max if may_grow else min)(thresholds.gap, known)


def monitor_constants(
    drive: Drive,
    limits: Limits,
    thresholds: FaultThresholds,
    period: float,
    velocity_bandwidth: float,
    backlash_angle: float,
    least_gain: float,
    *,
    may_grow: bool = False,
) -> MonitorConstants:
    """Return the monitor of one drive.

    A learned backlash (rad, > 0) lowers the gap threshold to 1.5 times the larger of it and the drive's own (because of
    eccentric encoders and a varying gap), plus the teeth's wind-up and two counts. With ``may_grow`` the factor is 6.
    ``least_gain``: the smaller one of both regions on the position, V/rad.
    """
    volts_per_torque = drive.gear.ratio * drive.motor.resistance / drive.motor.torque_constant
    row = row_of(
        MonitorConstants,
        velocity=thresholds.velocity,
        held_torque=min(thresholds.load_torque, _HELD * drive.standstill_torque(limits.command)),
        gap=_gap_bound(drive, thresholds, backlash_angle, may_grow=may_grow),
        tracking=max(thresholds.tracking, GAPS_AWAY * backlash_angle),
        gives_way=gives_way(drive),
        sags=max(volts_per_torque / least_gain, 0.0),
        lower_end=limits.position_lower,
        upper_end=limits.position_upper,
        soft_zone=limits.soft_zone,
        torque_bandwidth=min(max(1.0 / mechanical_time_constant(drive), _SLOWEST), _FASTEST),
        start_time=5.0 / velocity_bandwidth + 2.0 * period,
    )
    return _constants_at(row)
