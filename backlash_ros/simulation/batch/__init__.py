"""Thousands of independent runs: on all cores or on a cluster, resumed where they were interrupted."""

from backlash_ros.simulation.batch.engine import run_batch
from backlash_ros.simulation.batch.journal import Entry, Journal

__all__ = ["Entry", "Journal", "run_batch"]
