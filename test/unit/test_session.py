"""Judging a recorded session: what a busy machine does is told apart from what the law does."""

import numpy as np

from backlash_ros.analysis.bag import Recording, Series
from backlash_ros.analysis.session import Interval, judge_step, late_answers, quiet_end
from backlash_ros.drivetrain import NOMINAL_DRIVE

STAMPS = 100.0 + np.arange(1001) * 0.004
TURN = 2 * np.pi / 0.032


def recording(late: list[int], wild: float = 0.0) -> Recording:
    """A cycle of 0.8 b about 1 rad, wider by ``wild`` b for 0.1 s after each late answer."""
    rows = np.zeros((STAMPS.size, 6))
    amplitude = np.full(STAMPS.size, 0.4)
    for k in late:
        amplitude[k : k + 25] += wild / 2
    rows[:, 3] = 1.0 + 0.02 * amplitude * np.sin(TURN * STAMPS)
    answers = np.delete(STAMPS + 0.001, late)
    return Recording(Series(STAMPS, rows), {"/command": Series(answers, np.zeros(answers.size))}, [], {})


def test_late_answers_are_those_that_come_after_the_next_sample() -> None:
    samples = np.array([0.0, 1.0, 2.0, 3.0])
    assert late_answers(samples, np.array([0.1, 2.1, 2.2])).tolist() == [1.0]
    assert late_answers(samples, np.array([0.1, 1.1, 2.1])).tolist() == []


def test_residual_is_taken_where_the_loop_ran_as_it_should() -> None:
    interval = Interval(100.0, 104.0, 1.0)
    assert quiet_end(recording([]), interval) == STAMPS[-1] - 0.004 or quiet_end(recording([]), interval) == STAMPS[-1]
    disturbed = recording([900], wild=1.0)
    assert quiet_end(disturbed, interval) == STAMPS[900]
    assert abs(judge_step(disturbed, interval, NOMINAL_DRIVE).residual - 0.8) < 0.01


def test_residual_of_a_loop_that_never_ran_as_it_should_is_that_of_its_end() -> None:
    interval = Interval(100.0, 104.0, 1.0)
    disturbed = recording(list(range(500, 1000, 50)), wild=1.0)
    assert quiet_end(disturbed, interval) is None
    assert judge_step(disturbed, interval, NOMINAL_DRIVE).residual > 1.5
