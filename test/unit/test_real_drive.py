"""The ways in which docs/real_drive.md describes a drive with other units or joints: each closes the same loop."""

from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.control import GainSet, ServoSettings, design_gains
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.simulation import Run, Scenario, run

CURRENT_DRIVE = replace(NOMINAL_DRIVE, command_interface="current")
TIME = np.arange(500) * 0.004
REFERENCE = np.where(TIME < 1.0, 0.5, 0.2)


SMALL_MOTOR = replace(
    CURRENT_DRIVE,
    motor=replace(
        CURRENT_DRIVE.motor, resistance=4.0, torque_constant=0.005, inertia=3e-7, voltage_limit=6.0, current_limit=1.5
    ),
)


def step_of(drive: Drive, weight_scale: float = 1.0) -> Run:
    weights = np.array([[1000.0, 1.0], [4.0, 0.0]]) * weight_scale
    fast, overdamped = (design_gains("gains", drive, list(q)) for q in weights)
    return run(drive, ServoSettings(GainSet(fast, overdamped), backlash_angle=0.02), Scenario(REFERENCE))


@pytest.mark.parametrize("unit", ["N m at the motor", "N m at the joint", "mA"])
@pytest.mark.parametrize("drive", [CURRENT_DRIVE, SMALL_MOTOR], ids=["nominal", "small"])
def test_torque_is_current_counted_in_other_units(drive: Drive, unit: str) -> None:
    motor = drive.motor
    at_motor = motor.torque_constant
    scale = {"N m at the motor": at_motor, "N m at the joint": at_motor / drive.gear.ratio, "mA": 1000.0}[unit]
    in_torque = replace(
        motor,
        torque_constant=motor.torque_constant / scale,
        resistance=motor.resistance / scale**2,
        voltage_limit=motor.voltage_limit / scale,
        current_limit=motor.current_limit * scale,
    )
    expected, result = step_of(drive), step_of(replace(drive, motor=in_torque), 1.0 / scale**2)
    np.testing.assert_allclose(result.load_angle, expected.load_angle, rtol=0, atol=1e-6)
    np.testing.assert_allclose(result.command, expected.command * scale, rtol=0, atol=1e-3 * max(scale, 1.0))


@pytest.mark.parametrize("drive", [NOMINAL_DRIVE, CURRENT_DRIVE], ids=["voltage", "current"])
def test_motor_may_be_described_as_seen_from_the_output(drive: Drive) -> None:
    motor, n = drive.motor, drive.gear.ratio
    reflected = replace(
        drive,
        motor=replace(
            motor,
            torque_constant=motor.torque_constant / n,
            inertia=motor.inertia / n**2,
            viscous_friction=motor.viscous_friction / n**2,
        ),
        gear=replace(drive.gear, reduction=1.0),
    )
    expected, result = step_of(drive), step_of(reflected)
    np.testing.assert_allclose(result.load_angle, expected.load_angle, rtol=0, atol=1e-6)
    np.testing.assert_allclose(result.state[:, 0], n * expected.state[:, 0], rtol=0, atol=1e-5)
