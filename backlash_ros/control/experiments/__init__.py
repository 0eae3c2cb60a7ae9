"""The experiments by name. An experiment is one file here, or anywhere, with a table ``EXPERIMENTS`` of its names."""

from backlash_ros.control.experiment import NamedExperiment
from backlash_ros.foundation.registry import Registry

EXPERIMENTS: Registry[NamedExperiment] = Registry(__name__, __path__, "EXPERIMENTS", first="limit_cycle")
"""Every experiment by its name; the paper's leads."""
