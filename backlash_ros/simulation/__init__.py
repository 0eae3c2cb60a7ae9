"""The closed loop offline: single runs and learning, with the compiled functions that the nodes run."""

from backlash_ros.simulation.closed_loop import Run, Scenario, run
from backlash_ros.simulation.learning import learn_backlash

__all__ = ["Run", "Scenario", "learn_backlash", "run"]
