"""The law: gains, two-region state feedback, observer, learning unit, and the servo made of them."""

from backlash_ros.control.gains import Gains, GainSet, design_gains
from backlash_ros.control.law import FAST_REGION, OVERDAMPED_REGION, ControlLaw
from backlash_ros.control.laws import LAWS, design_law
from backlash_ros.control.learning import BacklashEstimate, LearningSettings, Method
from backlash_ros.control.limit_cycle import LimitCycle, find_limit_cycle
from backlash_ros.control.monitor import NO_LIMIT, DriveMonitor, Limits
from backlash_ros.control.servo import Servo
from backlash_ros.control.settings import ServoSettings
from backlash_ros.control.stability import Margins, check_stable, stability_margins

__all__ = [
    "FAST_REGION",
    "LAWS",
    "NO_LIMIT",
    "OVERDAMPED_REGION",
    "BacklashEstimate",
    "ControlLaw",
    "DriveMonitor",
    "GainSet",
    "Gains",
    "LearningSettings",
    "LimitCycle",
    "Limits",
    "Margins",
    "Method",
    "Servo",
    "ServoSettings",
    "check_stable",
    "design_gains",
    "design_law",
    "find_limit_cycle",
    "stability_margins",
]
