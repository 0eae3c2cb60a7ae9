"""The two-region law: eq 15, its switch, its limit."""

import math

import numpy as np
import pytest

from backlash_ros.control import FAST_REGION, OVERDAMPED_REGION, GainSet, Mode, ServoSettings
from backlash_ros.control.law import LawConstants, law_memory, law_step
from backlash_ros.drivetrain import NOMINAL_DRIVE

B = 0.02


def law(gains: GainSet, mode: Mode = Mode.TWO_REGION, **others: float) -> LawConstants:
    choice = {"backlash_angle": B, "hysteresis": 0.5, "min_dwell": 0.0, **others}
    return ServoSettings(gains, mode=mode, **choice).law(NOMINAL_DRIVE)


def regions(constants: LawConstants, errors: list[float]) -> list[int]:
    memory = law_memory()
    seen = []
    for error in errors:
        law_step(constants, memory, error, 0.0, 0.0, 0.0, 0.0)
        seen.append(int(memory[0]))
    return seen


@pytest.mark.parametrize(("error", "region"), [(0.5, "fast"), (0.001, "overdamped")])
def test_voltage_is_that_of_eq_15(gains: GainSet, error: float, region: str) -> None:
    k = getattr(gains, region)
    omega, current, torque = 0.3, -0.2, 0.04
    k_tau = -0.1 * (2.0 + k.k3) / 0.05
    expected = k_tau * torque - k.k1 * error - k.k2 * omega - k.k3 * current
    voltage = law_step(law(gains), law_memory(), 1.0 + error, omega, current, 1.0, torque)
    assert voltage == pytest.approx(expected, rel=1e-12)


def test_feedforward_leaves_no_error_at_rest_under_a_load_torque(gains: GainSet) -> None:
    """DC algebra of the rigid model: at zero error and speed the law gives just the voltage that holds the torque."""
    for mode in (Mode.FAST, Mode.OVERDAMPED):
        torque = 0.3
        current = -0.1 * torque / 0.05
        voltage = law_step(law(gains, mode), law_memory(), 1.0, 0.0, current, 1.0, torque)
        assert voltage == pytest.approx(2.0 * current)


def test_saturation_comes_last(gains: GainSet) -> None:
    for error, limit in ((-10.0, 24.0), (10.0, -24.0)):
        assert law_step(law(gains), law_memory(), error, 0.0, 0.0, 0.0, 0.0) == limit


def test_switch_has_hysteresis(gains: GainSet) -> None:
    errors = [2 * B, 0.99 * B, 1.2 * B, 1.49 * B, 1.5 * B, 1.2 * B, 0.99 * B]
    fast, slow = FAST_REGION, OVERDAMPED_REGION
    assert regions(law(gains), errors) == [fast, slow, slow, slow, fast, fast, slow]


def test_switch_keeps_a_region_for_the_least_dwell(gains: GainSet) -> None:
    errors = [0.0, *[5 * B] * 6]
    seen = regions(law(gains, min_dwell=0.016), errors)  # four periods of 4 ms
    assert seen == [OVERDAMPED_REGION] * 4 + [FAST_REGION] * 3


def test_unknown_backlash_leaves_the_fast_gains_alone(gains: GainSet) -> None:
    assert regions(law(gains, backlash_angle=0.0), [1.0, 0.0, 0.0]) == [FAST_REGION] * 3


@pytest.mark.parametrize(("mode", "region"), [(Mode.FAST, FAST_REGION), (Mode.OVERDAMPED, OVERDAMPED_REGION)])
def test_one_region_laws_never_switch(gains: GainSet, mode: Mode, region: int) -> None:
    assert regions(law(gains, mode), [0.0, 1e6, 0.0, B, -1.0]) == [region] * 5


def test_law_is_odd(gains: GainSet) -> None:
    rng = np.random.default_rng(1)
    for inputs in rng.normal(size=(50, 5)):
        assert law_step(law(gains), law_memory(), *inputs) == -law_step(law(gains), law_memory(), *(-inputs))


def test_a_value_that_is_not_finite_never_passes_as_a_voltage_within_limits(gains: GainSet) -> None:
    voltage = law_step(law(gains), law_memory(), math.nan, 0.0, 0.0, 0.0, 0.0)
    assert math.isnan(voltage)
