"""Metrics on signals whose answer is known."""

import math

import numpy as np
import pytest

from backlash_ros.studies.metrics import count_impacts, path_figures, rise_time, step_response

TIME = np.arange(0, 5, 0.01)


def test_rise_time_of_a_first_order_lag() -> None:
    position = 2.0 - 3.0 * np.exp(-TIME / 0.2)  # from -1 to 2
    assert rise_time(TIME, position, -1.0, 2.0) == pytest.approx(0.2 * math.log(9), rel=1e-3)


def test_rise_time_is_nan_where_the_target_is_not_reached() -> None:
    assert math.isnan(rise_time(TIME, 0.5 * np.ones(TIME.size), 0.0, 1.0))


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_overshoot_and_residual_are_in_units_of_the_backlash(direction: float) -> None:
    position = direction * (1.0 - np.exp(-TIME / 0.1) + 0.004 * np.sin(2 * np.pi * TIME))
    result = step_response(TIME, position, np.zeros(TIME.size), target=direction, backlash=1e-3, backlash_angle=0.02)
    assert result.overshoot == pytest.approx(0.2, rel=1e-3)
    assert result.residual == pytest.approx(0.4, rel=1e-3)
    assert result.impacts == 0


def test_impacts_are_entries_into_contact_after_arrival() -> None:
    gap = np.array([0.0, 0.5, 0.5, 0.0, -0.5, 0.0, 0.46, 0.44, 0.5]) * 1e-3
    assert count_impacts(gap, 1e-3) == 4
    assert count_impacts(np.full(9, 0.5e-3), 1e-3) == 0
    position = np.array([0.0, 0.5, 0.9, 0.99, 0.99, 1.0, 1.0, 1.0, 1.0])
    result = step_response(np.arange(9.0), position, gap, target=1.0, backlash=1e-3, backlash_angle=0.02)
    assert result.impacts == 3


@pytest.mark.parametrize("lag", [-0.05, 0.0, 0.3])
def test_a_load_that_is_late_and_off_is_judged_as_that(lag: float) -> None:
    """Late by a third of the path's period, too; what is left after the path's end is no part of its mean."""

    def path(time: np.ndarray) -> np.ndarray:
        return np.where((time >= 0.5) & (time < 4.0), np.sin(2 * np.pi * time), 0.0)

    wanted, late = path(TIME), path(TIME - lag)
    judged = path_figures(TIME, late, wanted, 4.0)
    assert judged.lag == pytest.approx(lag, abs=2e-3)
    assert judged.reversals == 7
    off = path_figures(TIME, wanted + np.where(TIME > 4.0, np.where(TIME > 4.5, 0.2, -0.3), -0.1), wanted, 4.0)
    assert (off.rms, off.largest, off.final) == pytest.approx((0.1, 0.3, 0.2))
    assert math.isnan(path_figures(TIME, late, np.zeros(TIME.size), 4.0).lag)
