"""The observer: measured signals pass, missing ones are found from position, the load torque from momentum."""

import math

import numpy as np
import pytest
from samples import EVERYTHING, sample_of

from backlash_ros.control import GainSet, ServoSettings
from backlash_ros.control.observer import ObserverMemory, observer_memory_at, observer_step
from backlash_ros.drivetrain import NOMINAL_DRIVE, Plant
from backlash_ros.drivetrain.sensors import POSITIONS
from backlash_ros.foundation.record import Array, row_of
from backlash_ros.foundation.signals import CURRENT, LOAD_TORQUE, OMEGA_L, OMEGA_M, THETA_L
from backlash_ros.simulation import Scenario, run

LOAD_ONLY = ("theta_l",)


def new_memory() -> ObserverMemory:
    return observer_memory_at(row_of(ObserverMemory))


def follow(measured: tuple[str, ...], gains: GainSet, voltage: float, load_torque: float) -> tuple[Plant, Array]:
    """Run the plant at constant inputs for 0.4 s with the observer looking on."""
    settings = ServoSettings(gains, period=0.001)
    constants, memory, plant = settings.observer(NOMINAL_DRIVE), new_memory(), Plant(NOMINAL_DRIVE)
    for _ in range(400):
        observer_step(constants, memory, sample_of(plant.state, measured), voltage, 0.001, constants.torque_bandwidth)
        plant.advance(voltage, load_torque, 0.001)
    return plant, memory.estimate


def test_measured_signals_pass_unchanged(gains: GainSet) -> None:
    constants = ServoSettings(gains).observer(NOMINAL_DRIVE)
    memory = new_memory()
    for k in range(3):
        sample = np.array([1.0, 2.0, 0.1, 0.2, 0.3]) * (k + 1)
        observer_step(constants, memory, sample, 0.0, 0.004, constants.torque_bandwidth)
        np.testing.assert_array_equal(memory.estimate[:5], sample)


@pytest.mark.parametrize("measured", [POSITIONS, LOAD_ONLY])
def test_speeds_and_current_follow_from_position(gains: GainSet, measured: tuple[str, ...]) -> None:
    plant, estimate = follow(measured, gains, 4.0, 0.0)
    assert estimate[OMEGA_L] == pytest.approx(plant.load_speed, rel=0.02)
    assert estimate[OMEGA_M] == pytest.approx(plant.motor_speed, rel=0.02)
    assert estimate[CURRENT] == pytest.approx(plant.motor_torque / 0.05, rel=0.05, abs=0.01)


@pytest.mark.parametrize("measured", [EVERYTHING, POSITIONS])
@pytest.mark.parametrize("torque", [0.0, 0.1, -0.3])
def test_load_torque_is_found_from_momentum(gains: GainSet, measured: tuple[str, ...], torque: float) -> None:
    _, estimate = follow(measured, gains, 3.0, torque)
    assert estimate[LOAD_TORQUE] == pytest.approx(torque, abs=0.01)


def test_load_torque_is_found_while_the_teeth_do_not_touch(gains: GainSet) -> None:
    """In the limit cycle the contact comes and goes 60 times a second; the momentum of both shafts does not mind."""
    settings = ServoSettings(gains, law="fast", period=0.001)
    result = run(NOMINAL_DRIVE, settings, Scenario(np.ones(2000), np.array(0.0)))
    assert np.ptp(result.load_angle[1000:]) > 0.7 * 0.02
    assert np.max(np.abs(result.load_torque_estimate)) < 0.01


def test_load_encoder_alone_gives_no_load_torque(gains: GainSet) -> None:
    _, estimate = follow(LOAD_ONLY, gains, 3.0, 0.2)
    assert estimate[LOAD_TORQUE] == 0.0


def test_missing_load_encoder_is_the_motor_through_the_rigid_gear(gains: GainSet) -> None:
    memory = new_memory()
    constants = ServoSettings(gains).observer(NOMINAL_DRIVE)
    observer_step(constants, memory, np.array([2.0, 3.0, math.nan, math.nan, 0.0]), 0.0, 0.004, 40.0)
    np.testing.assert_allclose(memory.estimate[[THETA_L, OMEGA_L]], [0.2, 0.3])
