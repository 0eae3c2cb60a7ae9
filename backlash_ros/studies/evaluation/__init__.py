"""Judging learning and laws on a random population of drives: the population, the task, the verdicts, the report."""

from backlash_ros.studies.evaluation.population import POPULATIONS, Member, draw_member
from backlash_ros.studies.evaluation.task import Learned, Task, Verdict, perform

__all__ = ["POPULATIONS", "Learned", "Member", "Task", "Verdict", "draw_member", "perform"]
