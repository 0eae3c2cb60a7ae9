"""The controller: gains, laws, observer, monitor, experiments, the tick that strings them together, and the servo."""

from backlash_ros.control.design.gains import DEFAULT_WEIGHTS, Gains, GainSet, design_gains
from backlash_ros.control.design.limit_cycle import LimitCycle, find_limit_cycle
from backlash_ros.control.design.stability import Margins, check_stable, stability_margins
from backlash_ros.control.experiment import BacklashEstimate, Method
from backlash_ros.control.experiments import EXPERIMENTS
from backlash_ros.control.experiments.gap_map import GapMapSettings
from backlash_ros.control.experiments.gap_probe import GapProbeSettings
from backlash_ros.control.experiments.hysteresis import HysteresisSettings
from backlash_ros.control.experiments.limit_cycle import LimitCycleSettings
from backlash_ros.control.law import FAST_REGION, OVERDAMPED_REGION, ControlLaw
from backlash_ros.control.laws import LAWS, design_law
from backlash_ros.control.limits import NO_LIMIT, Limits
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.control.motion.setpoint import AtRest, Polynomials, Source
from backlash_ros.control.servo import Servo
from backlash_ros.control.settings import AUTO, ServoSettings
from backlash_ros.gates.faults import Fault

__all__ = [
    "AUTO",
    "DEFAULT_WEIGHTS",
    "EXPERIMENTS",
    "FAST_REGION",
    "LAWS",
    "NO_LIMIT",
    "OVERDAMPED_REGION",
    "AtRest",
    "BacklashEstimate",
    "ControlLaw",
    "Fault",
    "FaultThresholds",
    "GainSet",
    "Gains",
    "GapMapSettings",
    "GapProbeSettings",
    "HysteresisSettings",
    "LimitCycle",
    "LimitCycleSettings",
    "Limits",
    "Margins",
    "Method",
    "Polynomials",
    "Servo",
    "ServoSettings",
    "Source",
    "check_stable",
    "design_gains",
    "design_law",
    "find_limit_cycle",
    "stability_margins",
]
