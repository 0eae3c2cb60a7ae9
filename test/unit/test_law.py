"""The laws: eq 15, its switch, its limit; and what every law by name has to keep to."""

from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.control import FAST_REGION, LAWS, OVERDAMPED_REGION, ControlLaw, GainSet, ServoSettings, design_law
from backlash_ros.control.law import REGION
from backlash_ros.control.laws.two_region import TwoRegionParameters
from backlash_ros.drivetrain import NOMINAL_DRIVE

B = 0.02


AT_REST = np.zeros((1, 3))


def make(gains: GainSet, law: str = "two_region", min_dwell: float = 0.0, backlash_angle: float = B) -> ControlLaw:
    regions = TwoRegionParameters(hysteresis=0.5, min_dwell=min_dwell)
    settings = ServoSettings(gains, backlash_angle=backlash_angle).with_law("two_region", regions)
    return design_law(NOMINAL_DRIVE, settings.with_law(law))


def answer(law: ControlLaw, error: float, omega: float = 0.0, current: float = 0.0, torque: float = 0.0) -> float:
    """Return the first voltage at reference 0."""
    return law.step(
        law.constants,
        law.state.copy(),
        np.array([10 * error, 10 * omega, error, omega, current, torque]),
        AT_REST,
        -24.0,
        24.0,
    )


def regions(law: ControlLaw, errors: list[float]) -> list[int]:
    state = law.state.copy()
    seen = []
    for error in errors:
        law.step(law.constants, state, np.array([0.0, 0.0, error, 0.0, 0.0, 0.0]), AT_REST, -24.0, 24.0)
        seen.append(int(state[REGION]))
    return seen


@pytest.mark.parametrize(("error", "region"), [(0.5, "fast"), (0.001, "overdamped")])
def test_voltage_is_that_of_eq_15(gains: GainSet, error: float, region: str) -> None:
    k = getattr(gains, region)
    omega, current, torque = 0.3, -0.2, 0.04
    k_tau = -0.1 * (2.0 + k.current) / 0.05
    expected = k_tau * torque - k.position * error - k.velocity * omega - k.current * current
    assert answer(make(gains), error, omega, current, torque) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("law", ["fast", "overdamped"])
def test_feedforward_leaves_no_error_at_rest_under_a_load_torque(gains: GainSet, law: str) -> None:
    """DC algebra of the rigid model: at zero error and speed the law gives just the voltage that holds the torque."""
    torque = 0.3
    current = -0.1 * torque / 0.05
    assert answer(make(gains, law), 0.0, 0.0, current, torque) == pytest.approx(2.0 * current)


@pytest.mark.parametrize("law", ["fast", "overdamped", "two_region"])
def test_feedforward_leaves_no_error_in_an_even_motion(gains: GainSet, law: str) -> None:
    """With the torque of friction and of acceleration, the law gives just the voltage of that motion."""
    speed, acceleration, torque, drive = 2.0, 30.0, 0.1, NOMINAL_DRIVE
    needed = drive.effective_inertia * acceleration + drive.effective_friction * speed - torque
    current = 0.1 * needed / 0.05
    designed = make(gains, law)
    estimate, path = np.array([3.0, 10 * speed, 0.3, speed, current, torque]), np.array([[0.3, speed, acceleration]])
    voltage = designed.step(designed.constants, designed.state.copy(), estimate, path, -100.0, 100.0)
    assert voltage == pytest.approx(2.0 * current + 0.05 * 10 * speed)


def test_switch_has_hysteresis(gains: GainSet) -> None:
    errors = [2 * B, 0.99 * B, 1.2 * B, 1.49 * B, 1.5 * B, 1.2 * B, 0.99 * B]
    fast, slow = FAST_REGION, OVERDAMPED_REGION
    assert regions(make(gains), errors) == [fast, slow, slow, slow, fast, fast, slow]


def test_switch_keeps_a_region_for_the_least_dwell(gains: GainSet) -> None:
    errors = [0.0, *[5 * B] * 6]
    seen = regions(make(gains, min_dwell=0.016), errors)  # four periods of 4 ms
    assert seen == [OVERDAMPED_REGION] * 4 + [FAST_REGION] * 3


def test_unknown_backlash_leaves_the_fast_gains_alone(gains: GainSet) -> None:
    assert regions(make(gains, backlash_angle=0.0), [1.0, 0.0, 0.0]) == [FAST_REGION] * 3


@pytest.mark.parametrize(("law", "region"), [("fast", FAST_REGION), ("overdamped", OVERDAMPED_REGION)])
def test_one_region_laws_never_switch(gains: GainSet, law: str, region: int) -> None:
    assert regions(make(gains, law), [0.0, 1e6, 0.0, B, -1.0]) == [region] * 5


@pytest.mark.parametrize("name", sorted(LAWS))
def test_every_law_is_odd_and_saturates_last(gains: GainSet, name: str) -> None:
    law = make(gains, name)
    for inputs in np.random.default_rng(1).normal(size=(50, 4)):
        assert answer(law, *inputs) == -answer(law, *(-inputs))
    state = law.state.copy()
    for _ in range(200):
        voltage = law.step(law.constants, state, np.zeros(6), np.array([[1e6, 0.0, 0.0]]), -24.0, 24.0)
        assert abs(voltage) <= 24.0
    assert voltage == 24.0


@pytest.mark.parametrize("name", sorted(LAWS))
def test_every_law_is_at_rest_at_rest(gains: GainSet, name: str) -> None:
    """At the target, unloaded, no law wants a voltage, however long it has been there."""
    law = make(gains, name)
    state, target = law.state.copy(), np.array([[0.3, 0.0, 0.0]])
    for _ in range(100):
        voltage = law.step(law.constants, state, np.array([3.0, 0.0, 0.3, 0.0, 0.0, 0.0]), target, -24.0, 24.0)
        assert voltage == pytest.approx(0.0, abs=1e-9)


def test_unknown_law_is_refused_with_the_names_there_are(gains: GainSet) -> None:
    with pytest.raises(ValueError, match=r"law must be one of \[.*'cascade', .*'two_region'\], got 'bang_bang'"):
        make(gains, "bang_bang")


def test_a_drive_for_which_a_law_has_no_design_is_refused_by_the_laws_name(gains: GainSet) -> None:
    """The equations of the elastic model are too ill-conditioned: a weak motor at a very heavy load."""
    motor, load = NOMINAL_DRIVE.motor, NOMINAL_DRIVE.load
    weak = replace(motor, resistance=1000 * motor.resistance)
    drive = replace(NOMINAL_DRIVE, motor=weak, load=replace(load, inertia=1000 * load.inertia))
    with pytest.raises(ValueError, match="law = 'elastic_lqg' cannot be designed for this drive"):
        design_law(drive, ServoSettings(gains, law="elastic_lqg"))
