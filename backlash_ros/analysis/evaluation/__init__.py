"""Judging learning and laws on a random population of drives: the population, the task, the verdicts, the report."""

from backlash_ros.analysis.evaluation.population import POPULATIONS, Member, draw_member

__all__ = ["POPULATIONS", "Member", "draw_member"]
