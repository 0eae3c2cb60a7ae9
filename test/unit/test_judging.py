"""Judging a record: trajectories made by hand, each with one thing to find."""

import math

import numpy as np
import pytest

from backlash_ros.studies.judging import Move, judge_move, recovery, threshold

B, COUNT = 0.02, 1e-4
TIME = np.arange(6001) / 1000.0


def judged(position: np.ndarray, count: float = COUNT) -> Move:
    return judge_move(TIME, position, 1.0, B, count)


def ramp(seconds: float = 0.1) -> np.ndarray:
    """From 0 to 1 rad, then at rest there."""
    return np.minimum(TIME / seconds, 1.0)


def test_a_ramp_that_stops_on_the_target() -> None:
    move = judged(ramp(0.1))
    assert move.swing == 0
    assert move.error == 0
    assert move.overshoot == 0
    assert move.rise == pytest.approx(0.08, abs=1e-9)
    assert move.settle == pytest.approx(0.1 * (1 - 0.25 * B), abs=0.0011)


def test_a_step_down_is_judged_as_one_up() -> None:
    up, down = judged(ramp()), judge_move(TIME, 2.0 - ramp(), 1.0, B, COUNT)
    assert vars(down) == pytest.approx(vars(up), abs=1e-9)


def test_overshoot_is_beyond_the_target_and_not_before_it() -> None:
    position = ramp()
    position[500] = 1.0 + 0.3 * B
    position[700] = 1.0 - 0.9 * B
    assert judged(position).overshoot == pytest.approx(0.3)


def test_settled_is_from_the_last_excursion_on() -> None:
    position = ramp()
    position[2000:2100] = 1.0 + 0.26 * B
    position[3000:3100] = 1.0 - 0.24 * B
    assert judged(position).settle == pytest.approx(2.1)


def test_an_excursion_in_the_last_second_is_not_settled() -> None:
    position = ramp()
    position[5500] = 1.0 + 0.26 * B
    assert judged(position).settle == 6.0


def test_a_load_that_never_arrives_has_the_length_of_the_record() -> None:
    move = judged(0.5 * ramp())
    assert (move.settle, move.rise) == (6.0, 6.0)
    assert move.error == pytest.approx(0.5 / B)
    assert move.overshoot == 0


def test_the_swing_is_peak_to_peak_in_the_last_second() -> None:
    position = ramp() + np.where(TIME >= 5.0, 0.03, 0.5) * B * np.sin(2 * math.pi * 20 * TIME) * (TIME > 0.2)
    move = judged(position)
    assert move.swing == pytest.approx(0.06, abs=1e-3)
    assert move.error == pytest.approx(0.0, abs=1e-3)
    assert move.overshoot == pytest.approx(0.5, abs=1e-2)


def test_the_final_error_is_that_of_the_mean() -> None:
    position = ramp() * (1.0 - 0.2 * B) + 0.01 * B * np.sin(2 * math.pi * 10 * TIME)
    assert judged(position).error == pytest.approx(0.2, abs=1e-3)


def test_no_threshold_is_below_a_count() -> None:
    assert threshold(0.25, B, COUNT) == 0.25
    assert threshold(0.05, B, 0.1 * B) == pytest.approx(0.1)
    position = ramp()
    position[3000:] = 1.0 + 0.9 * B
    assert judged(position).settle == 6.0
    assert judged(position, count=B).settle == pytest.approx(0.1, abs=0.01)


def test_recovered_is_when_it_is_back_for_good() -> None:
    time = np.arange(5001) / 1000.0
    position = np.ones(5001)
    position[10:400] += B
    position[600:650] -= 0.3 * B
    assert recovery(time, position, 1.0, B, COUNT) == pytest.approx(0.65)
    assert recovery(time, np.ones(5001), 1.0, B, COUNT) == 0.0
    assert recovery(time, np.zeros(5001), 1.0, B, COUNT) == 5.0
