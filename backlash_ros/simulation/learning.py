"""A learning run offline: the servo with its learner against the simulated drive."""

import math
from collections.abc import Sequence

import numpy as np

from backlash_ros.control import BacklashEstimate, Servo, ServoSettings
from backlash_ros.drivetrain import Drive, Plant
from backlash_ros.simulation.closed_loop import encoder_step

ALL_MEASURED = (True, True, True, True, True)


def learn_backlash(
    drive: Drive,
    settings: ServoSettings,
    *,
    load_torque: float = 0.0,
    measured: Sequence[bool] = ALL_MEASURED,
    encoder_bits: int | None = None,
) -> BacklashEstimate:
    """Let the learner measure a simulated drive and return what it found.

    Parameters
    ----------
    drive, settings : as for the controller node
    load_torque : on the output shaft throughout, N m
    measured : which of theta_m, omega_m, i, theta_l, omega_l the drive measures
    encoder_bits : resolution of both encoders, counts per turn as a power of two; None for exact angles

    Examples
    --------
    >>> from backlash_ros.control import GainSet, design_gains
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> gains = GainSet(
    ...     fast=design_gains("fast", NOMINAL_DRIVE, [1000, 1]),
    ...     overdamped=design_gains("overdamped", NOMINAL_DRIVE, [4, 0]),
    ... )
    >>> estimate = learn_backlash(NOMINAL_DRIVE, ServoSettings(gains))
    >>> estimate.valid, round(estimate.angle, 3)
    (True, 0.02)
    """
    servo, plant = Servo(drive, settings), Plant(drive)
    missing = np.array([0.0 if seen else math.nan for seen in measured])
    step = encoder_step(encoder_bits)
    servo.start_learning()
    while True:
        theta_m, omega_m, theta_l, omega_l, current = plant.state
        if step:
            theta_m, theta_l = round(theta_m / step) * step, round(theta_l / step) * step
        command = servo.update(np.array([theta_m, omega_m, current, theta_l, omega_l]) + missing)
        estimate = servo.take_learned()
        if estimate is not None:
            return estimate
        plant.advance(command, load_torque, settings.period)
