"""Judging what a loop did: metrics, bags, figures."""

from backlash_ros.analysis.bag import Recording, Series, read_bag
from backlash_ros.analysis.metrics import StepResponse, count_impacts, rise_time, settling_time, step_response

__all__ = [
    "Recording",
    "Series",
    "StepResponse",
    "count_impacts",
    "read_bag",
    "rise_time",
    "settling_time",
    "step_response",
]
