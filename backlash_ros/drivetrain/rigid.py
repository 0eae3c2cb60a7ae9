"""Linear models: the drive without backlash (eq 9), from which gains are designed, and the motor inside the gap."""

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain.parameters import Drive


def rigid_model(drive: Drive) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the matrices (A, B) of eq 9.

    States: theta_l (rad), omega_l (rad/s), i (A). Inputs: voltage (V), load torque tau_l (N m). In print the
    second input is tau_m with 1/J; by eq 4 it is the load torque with 1/J_e, which is what stands here.

    Returns
    -------
    (A, B) : arrays of shape (3, 3) and (3, 2)
    """
    motor, n = drive.motor, drive.gear.ratio
    inertia, friction = drive.effective_inertia, drive.effective_friction
    a = np.array(
        [
            [0.0, 1.0, 0.0],
            [0.0, -friction / inertia, motor.torque_constant / (n * inertia)],
            [0.0, -motor.torque_constant / (n * motor.inductance), -motor.resistance / motor.inductance],
        ]
    )
    b = np.array([[0.0, 0.0], [0.0, 1.0 / inertia], [1.0 / motor.inductance, 0.0]])
    return a, b


def motor_model(drive: Drive) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the matrices (A, B) of the motor by itself, as it turns inside the gap (eqs 7, 8 with F = 0).

    States: omega_m (rad/s), i (A). Input: voltage (V).

    Returns
    -------
    (A, B) : arrays of shape (2, 2) and (2, 1)
    """
    motor = drive.motor
    a = np.array(
        [
            [-motor.viscous_friction / motor.inertia, motor.torque_constant / motor.inertia],
            [-motor.torque_constant / motor.inductance, -motor.resistance / motor.inductance],
        ]
    )
    return a, np.array([[0.0], [1.0 / motor.inductance]])
