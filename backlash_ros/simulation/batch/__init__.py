"""Thousands of independent runs: on all cores or on a cluster, resumed where they were interrupted."""

from backlash_ros.simulation.batch.code import code_digest
from backlash_ros.simulation.batch.engine import run_batch
from backlash_ros.simulation.batch.journal import Entry, Journal
from backlash_ros.simulation.batch.worker import CannotRunError

__all__ = ["CannotRunError", "Entry", "Journal", "code_digest", "run_batch"]
