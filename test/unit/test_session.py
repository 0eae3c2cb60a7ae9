"""Judging a recorded session: known figures come back, and a command of the wrong gains is counted."""

import math

import numpy as np
import pytest

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.recordings.bag import Recording, Series
from backlash_ros.studies.session import Interval, came_on, judge_step, judge_swap

B = NOMINAL_DRIVE.gear.backlash_angle
STAMPS = 100.0 + np.arange(1001) * 0.004
INTERVAL = Interval(100.0, 104.0, 1.0)
OLD, NEW = [4.0, 0.2, 0.1], [8.0, 0.3, 0.2]


def recording(angle: np.ndarray) -> Recording:
    rows = np.zeros((STAMPS.size, 6))
    rows[:, 3] = angle
    return Recording(Series(STAMPS, rows), {}, [], {})


def test_a_load_has_settled_where_it_stays_near_the_target() -> None:
    near = np.where(STAMPS < 101.0, 0.0, 1.0 + 0.2 * B)
    assert judge_step(recording(near), INTERVAL, NOMINAL_DRIVE)["settling_time"] == pytest.approx(1.0)
    swinging = near + 0.4 * B * np.sin(2 * np.pi * (STAMPS - 100.0) / 0.032)
    judged = judge_step(recording(swinging), INTERVAL, NOMINAL_DRIVE)
    assert judged["settling_time"] == math.inf
    assert judged["residual"] == pytest.approx(0.8, abs=0.02)


def test_a_load_torque_comes_on_with_the_last_sample_before_the_load_moves() -> None:
    moved = recording(1.0 + B * (STAMPS > 100.402))
    assert came_on(moved, INTERVAL, NOMINAL_DRIVE).start == pytest.approx(100.4)
    assert came_on(recording(np.ones(STAMPS.size)), INTERVAL, NOMINAL_DRIVE) == INTERVAL


def swapped(*wrong: int) -> Recording:
    """Commands of the old gains up to sample 20 and of the new ones from there on; the ``wrong`` ones the other way."""
    stamps = STAMPS[:40]
    angle, speed = np.linspace(0.2, 0.6, 40), np.full(40, 2.0)
    version = np.where(np.arange(40) < 20, 7.0, 8.0)
    mixed = version.copy()
    mixed[list(wrong)] = 15.0 - mixed[list(wrong)]
    gains = np.where(mixed[:, None] == 7.0, OLD, NEW)
    command = np.clip(-gains[:, 0] * (angle - 1.0) - gains[:, 1] * speed, -24.0, 24.0)
    told = {
        "parameters_version": version,
        "load_angle": angle,
        "load_velocity": speed,
        "command": command,
        "range_low": np.full(40, -24.0),
        "range_high": np.full(40, 24.0),
        "current": np.zeros(40),
        "load_torque": np.zeros(40),
    }
    in_use = [(100.0, version, {"gains.overdamped.k": k}) for version, k in ((6, NEW), (7, OLD), (8, NEW))]
    scalars = {f"/controller/state/{name}": Series(stamps, values) for name, values in told.items()}
    return Recording(Series(stamps, np.zeros((40, 6))), scalars, [], {}, in_use)


def test_commands_of_gains_that_are_not_in_force_are_counted() -> None:
    expected = {"speed": 2.0, "commands": 40, "mixed": 0}
    assert judge_swap(swapped(), INTERVAL, NOMINAL_DRIVE) == expected
    assert judge_swap(swapped(19, 20, 30), INTERVAL, NOMINAL_DRIVE) == expected | {"mixed": 3}
