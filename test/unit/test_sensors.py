"""The sensors: counts, zero, eccentricity, missing signals, speeds from positions, and noise that is reproducible."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backlash_ros.drivetrain.sensors import POSITIONS, Sensors, read_sensors, sensor_constants, sensor_memory
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, STATE_NAMES, THETA_L, THETA_M, Measurement, PlantState

PERIOD = 0.004
STATE = PlantState(np.array([3.3, -40.0, 0.34, -4.0, 1.5, 7.0, 5.0]))
ANGLES = st.floats(-50, 50)


def at(theta_m: float, theta_l: float) -> PlantState:
    state = STATE.copy()
    state[THETA_M], state[THETA_L] = theta_m, theta_l
    return state


def read(
    sensors: Sensors,
    states: Sequence[PlantState] = (STATE,),
    *,
    seed: int = 0,
    first: int = 0,
    elapsed: float = PERIOD,
) -> np.ndarray:
    """Return what the sensors show of the states, one after the other, shape (N, 5)."""
    constants, memory, shown = sensor_constants(sensors, 0.0625, seed), sensor_memory(), np.empty((len(states), 5))
    for k, state in enumerate(states):
        read_sensors(constants, memory, state, first + k, elapsed, Measurement(shown[k]))
    return shown


def test_sensors_show_all_of_the_state_exactly_by_default() -> None:
    np.testing.assert_array_equal(read(Sensors())[0], STATE[:5])


@pytest.mark.parametrize("measured", [("theta_m",), ("theta_l",), POSITIONS, ("current", "theta_l"), STATE_NAMES])
def test_signals_that_are_not_measured_are_nan(measured: tuple[str, ...]) -> None:
    (shown,) = read(Sensors(measured=measured))
    for name, value, true in zip(STATE_NAMES, shown, STATE, strict=False):
        assert value == true if name in measured else math.isnan(value)


@pytest.mark.parametrize("measured", [(), ("omega_m", "omega_l", "current"), ("theta_m", "angle")])
def test_sensors_without_an_angle_or_of_an_unknown_name_are_refused(measured: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"sensors\.measured must be of .*, with theta_m or theta_l, got \["):
        Sensors(measured=measured)


@settings(deadline=None)  # compiles
@given(ANGLES, ANGLES, st.integers(4, 2**20), st.integers(4, 2**20))
def test_counted_angle_is_the_nearest_count(theta_m: float, theta_l: float, motor: int, load: int) -> None:
    (shown,) = read(Sensors(motor_counts=float(motor), load_counts=float(load)), [at(theta_m, theta_l)])
    for value, true, counts in ((shown[THETA_M], theta_m, motor), (shown[THETA_L], theta_l, load)):
        count = 2 * math.pi / counts
        assert abs(value - true) <= 0.5 * count * (1 + 1e-9)
        assert value / count == pytest.approx(round(value / count), abs=1e-6)


@settings(deadline=None)  # compiles
@given(ANGLES, st.floats(-10, 10), st.sampled_from([0.0, 4096.0]))
def test_offset_is_what_is_shown_at_zero(theta: float, offset: float, counts: float) -> None:
    sensors = Sensors(motor_offset=offset, load_offset=-offset, motor_counts=counts, load_counts=counts)
    (shown,) = read(sensors, [at(theta, theta)])
    within = math.pi / counts if counts else 1e-12
    assert shown[THETA_M] == pytest.approx(theta + offset, abs=within * (1 + 1e-9))
    assert shown[THETA_L] == pytest.approx(theta - offset, abs=within * (1 + 1e-9))


@settings(deadline=None)  # compiles
@given(ANGLES, st.floats(1e-4, 0.1), st.floats(-math.pi, math.pi))
def test_eccentricity_is_an_error_once_per_turn(theta: float, amplitude: float, phase: float) -> None:
    sensors = Sensors(motor_eccentricity=amplitude, load_eccentricity=2 * amplitude, eccentricity_phase=phase)
    turn = [at(theta + part * math.pi, theta + part * math.pi) for part in (0.0, 0.5, 1.0, 1.5, 2.0)]
    shown = read(sensors, turn)
    for angle, size in ((THETA_M, amplitude), (THETA_L, 2 * amplitude)):
        errors = shown[:, angle] - [state[angle] for state in turn]
        assert errors[0] == pytest.approx(size * math.sin(theta + phase), abs=1e-12)
        assert errors[2] == pytest.approx(-errors[0], abs=1e-12)
        assert errors[4] == pytest.approx(errors[0], abs=1e-12)
        assert math.hypot(errors[0], errors[1]) == pytest.approx(size, abs=1e-12)


@settings(deadline=None)  # compiles
@given(ANGLES, st.floats(1e-4, 0.1), st.floats(-math.pi, math.pi))
def test_ellipticity_is_an_error_of_the_load_twice_per_turn(theta: float, amplitude: float, phase: float) -> None:
    turn = [at(theta + part * math.pi, theta + part * math.pi) for part in (0.0, 0.25, 0.5, 1.0)]
    shown = read(Sensors(load_ellipticity=amplitude, eccentricity_phase=phase), turn)
    errors = shown - np.array([[state[k] for k in range(5)] for state in turn])
    assert np.all(errors[:, THETA_M] == 0.0)
    load = errors[:, THETA_L]
    assert load[0] == pytest.approx(amplitude * math.sin(2 * theta + phase), abs=1e-12)
    assert load[2] == pytest.approx(-load[0], abs=1e-12)
    assert load[3] == pytest.approx(load[0], abs=1e-12)
    assert math.hypot(load[0], load[1]) == pytest.approx(amplitude, abs=1e-12)


def test_perfect_encoder_of_the_same_zero_is_what_noise_and_counts_are_held_against() -> None:
    sensors = Sensors(load_offset=0.3, load_eccentricity=0.01, load_ellipticity=0.003, eccentricity_phase=0.7)
    angles = np.linspace(-7.0, 7.0, 50)
    shown = read(sensors, [at(0.0, angle) for angle in angles])[:, THETA_L]
    np.testing.assert_allclose(sensors.load_zero(angles), shown, rtol=0, atol=1e-14)


@pytest.mark.parametrize("elapsed", [PERIOD, 3 * PERIOD])
def test_speeds_from_positions_are_counted_positions_over_the_time_between(elapsed: float) -> None:
    sensors = Sensors(speeds_from_positions=True, motor_counts=1000.0, load_counts=500.0)
    shown = read(sensors, [at(0.0, 0.0), at(0.02, 0.05), at(0.02, 0.05), at(-0.5, -0.05)], elapsed=elapsed)
    motor, load = 2 * math.pi / 1000, 2 * math.pi / 500
    np.testing.assert_allclose(shown[:, OMEGA_M] * elapsed / motor, [0, 3, 0, -83], atol=1e-9)
    np.testing.assert_allclose(shown[:, OMEGA_L] * elapsed / load, [0, 4, 0, -8], atol=1e-9)


def test_speeds_from_positions_have_the_noise_of_the_positions() -> None:
    sensors = Sensors(speeds_from_positions=True, load_noise=0.01)
    shown = read(sensors, [STATE] * 100)
    np.testing.assert_allclose(shown[1:, OMEGA_L], np.diff(shown[:, THETA_L]) / PERIOD, atol=1e-9)


NOISY = Sensors(motor_noise=0.2, load_noise=0.05)


def noise(seed: int, count: int = 1, first: int = 0) -> np.ndarray:
    """Return the noise on both angles in units of its bound, shape (count, 2)."""
    shown = read(NOISY, [STATE] * count, seed=seed, first=first)[:, [THETA_M, THETA_L]]
    return (shown - STATE[[THETA_M, THETA_L]]) / [0.2, 0.05]


@settings(deadline=None)  # compiles
@given(st.integers(0, 2**31), st.integers(0, 10**6), st.integers(1, 20))
def test_noise_depends_on_seed_and_sample_alone(seed: int, sample: int, before: int) -> None:
    """Not on what was read before, nor on the state, nor on how large the noise is."""
    alone = noise(seed, 1, sample)
    np.testing.assert_array_equal(alone[0], noise(seed, before + 1, sample - before)[-1])
    (elsewhere,) = read(NOISY, [at(1.0, 2.0)], seed=seed, first=sample)
    np.testing.assert_allclose((elsewhere[[THETA_M, THETA_L]] - [1.0, 2.0]) / [0.2, 0.05], alone[0], atol=1e-12)
    (smaller,) = read(Sensors(load_noise=1e-3), seed=seed, first=sample)
    assert (smaller[THETA_L] - STATE[THETA_L]) / 1e-3 == pytest.approx(alone[0, 1], abs=1e-11)
    assert smaller[THETA_M] == STATE[THETA_M]


@pytest.mark.parametrize("seed", [0, 1, 2009, 2**31])
def test_noise_is_even_within_its_bound(seed: int) -> None:
    """Mean, spread and every tenth of the range, to five standard deviations of 20 000 samples."""
    count = 20_000
    seen = noise(seed, count)
    assert np.max(np.abs(seen)) <= 1.0
    assert np.max(seen) > 0.999
    assert np.min(seen) < -0.999
    np.testing.assert_allclose(np.mean(seen, axis=0), 0.0, atol=5 * math.sqrt(1 / 3 / count))
    np.testing.assert_allclose(np.var(seen, axis=0), 1 / 3, atol=5 * math.sqrt(4 / 45 / count))
    for column in seen.T:
        shares = np.histogram(column, bins=10, range=(-1, 1))[0] / count
        np.testing.assert_allclose(shares, 0.1, atol=5 * math.sqrt(0.09 / count))


def test_noise_of_samples_signals_and_seeds_has_nothing_in_common() -> None:
    count = 20_000
    motor, load = noise(1, count).T
    _, other = noise(2, count).T
    for a, b in ((motor, load), (load, other), (load[1:], load[:-1]), (load[10:], load[:-10])):
        assert abs(float(np.corrcoef(a, b)[0, 1])) < 5 / math.sqrt(count)


@settings(deadline=None)  # compiles
@given(ANGLES, ANGLES, st.floats(-1, 1), st.floats(-3, 3), st.sampled_from([0.0, 1024.0]), st.booleans())
def test_mirrored_state_is_shown_mirrored(
    theta_m: float, theta_l: float, offset: float, phase: float, counts: float, from_positions: bool
) -> None:
    """With the zero and the phase mirrored too, bit for bit."""

    def shown(sign: int) -> np.ndarray:
        sensors = Sensors(
            speeds_from_positions=from_positions,
            motor_counts=counts,
            load_counts=counts,
            motor_offset=sign * offset,
            load_offset=sign * offset,
            motor_eccentricity=0.02,
            load_eccentricity=0.01,
            eccentricity_phase=sign * phase,
        )
        return read(sensors, [sign * STATE, sign * at(theta_m, theta_l)])

    np.testing.assert_array_equal(shown(-1), -shown(1))
