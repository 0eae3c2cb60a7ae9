"""The closed loop offline: single runs and experiments, with the same compiled functions as the nodes."""

from backlash_ros.simulation.closed_loop import Scenario, run
from backlash_ros.simulation.experiment import excite, learn_backlash, run_experiment
from backlash_ros.simulation.response import Run
from backlash_ros.simulation.simulated_drive import SimulatedDrive, largest_load_torque

__all__ = [
    "Run",
    "Scenario",
    "SimulatedDrive",
    "excite",
    "largest_load_torque",
    "learn_backlash",
    "run",
    "run_experiment",
]
