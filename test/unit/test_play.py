"""The load as the motor carries it in play: never beyond the gap, and coasting in it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backlash_ros.identification.one_encoder.play import carried

PERIOD = 1e-3


@given(
    st.floats(1e-4, 0.1), st.floats(0.0, 50.0), st.floats(0.0, 20.0), st.floats(-20.0, 20.0), st.integers(0, 2**32 - 1)
)
def test_a_carried_load_stays_within_the_gap(half_gap: float, decay: float, dry: float, push: float, seed: int) -> None:
    motor = np.cumsum(np.random.default_rng(seed).normal(scale=1e-3, size=400))
    load = carried(PERIOD * np.arange(motor.size), motor, half_gap, decay, dry, push)
    assert np.all(np.abs(motor - load) <= half_gap + 1e-12)


def test_a_load_without_friction_coasts_at_the_speed_at_which_the_motor_left_it() -> None:
    time = PERIOD * np.arange(400)
    motor = np.where(time < 0.2, 2.0 * time, 0.4)
    load = carried(time, motor, 0.05, decay=0.0, dry=0.0, push=0.0)
    coasting = (time > 0.2) & (time < 0.24)
    assert motor[100] - load[100] == pytest.approx(0.05)
    assert np.diff(load[coasting]) == pytest.approx(2.0 * PERIOD)
    assert load[-1] - motor[-1] == pytest.approx(0.05)


@pytest.mark.parametrize(("push", "moves"), [(4.9, False), (5.1, True), (-5.1, True)])
def test_dry_friction_holds_a_load_up_to_its_torque(push: float, moves: bool) -> None:
    time = PERIOD * np.arange(100)
    load = carried(time, np.zeros(time.size), 0.05, decay=0.0, dry=5.0, push=push)
    assert math.copysign(1.0, push) * load[-1] > 0.0 if moves else load[-1] == 0.0
