"""Thousands of independent runs, on all cores or on a cluster, resumed after an interruption."""

from backlash_ros.simulation.batch.code import code_digest
from backlash_ros.simulation.batch.engine import run_batch
from backlash_ros.simulation.batch.journal import Entry, Journal
from backlash_ros.simulation.batch.worker import CannotRunError

__all__ = ["CannotRunError", "Entry", "Journal", "code_digest", "run_batch"]
