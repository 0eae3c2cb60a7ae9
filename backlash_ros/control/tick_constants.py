"""The constants of the tick for one drive, one choice of settings, and limits."""

from backlash_ros.control.command_range import range_constants
from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.bounds import monitor_constants
from backlash_ros.control.monitoring.plausibility import plausibility_constants
from backlash_ros.control.motion.moving_reference import motion_constants
from backlash_ros.control.observer import ObserverConstants
from backlash_ros.control.settings import ServoSettings
from backlash_ros.control.tick import TickConstants
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array, row_of


def tick_constants(
    drive: Drive, settings: ServoSettings, limits: Limits, observer: ObserverConstants, *, ahead: int, watched: bool
) -> Array:
    """Return the row of `TickConstants`.

    Parameters
    ----------
    drive : as the controller knows it
    observer : of the same drive and settings
    ahead : periods of a path of references that the law wants to see
    watched : whether the monitor is on
    """
    gains = settings.gains
    monitor = monitor_constants(
        drive,
        limits,
        settings.thresholds_of(drive),
        settings.period,
        settings.velocity_bandwidth,
        settings.backlash_angle,
        min(gains.fast.position, gains.overdamped.position),
        may_grow=settings.renew,
    )
    return row_of(
        TickConstants,
        observer=observer,
        monitor=monitor,
        plausibility=plausibility_constants(drive),
        range=range_constants(drive, limits),
        motion=motion_constants(drive, limits, ahead),
        watched=float(watched),
    )
