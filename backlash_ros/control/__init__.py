"""The law: gains, two-region state feedback, observer, learning unit, and the servo made of them."""

from backlash_ros.control.gains import Gains, GainSet, check_stable, design_gains
from backlash_ros.control.law import FAST_REGION, OVERDAMPED_REGION, Mode
from backlash_ros.control.learning import BacklashEstimate, LearningSettings, Method
from backlash_ros.control.limit_cycle import LimitCycle, find_limit_cycle
from backlash_ros.control.servo import Servo, ServoSettings

__all__ = [
    "FAST_REGION",
    "OVERDAMPED_REGION",
    "BacklashEstimate",
    "GainSet",
    "Gains",
    "LearningSettings",
    "LimitCycle",
    "Method",
    "Mode",
    "Servo",
    "ServoSettings",
    "check_stable",
    "design_gains",
    "find_limit_cycle",
]
