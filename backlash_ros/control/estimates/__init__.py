"""Handles requests to learn and valid estimates: applied at once or on request, and stored for the next start."""

from backlash_ros.control.estimates.applying import APPLY, Answer, Estimates
from backlash_ros.control.estimates.file import EstimateFile
from backlash_ros.control.estimates.record import DriveIdentity, History, KeptEstimate, parse, render

__all__ = [
    "APPLY",
    "Answer",
    "DriveIdentity",
    "EstimateFile",
    "Estimates",
    "History",
    "KeptEstimate",
    "parse",
    "render",
]
