"""The four signals that pass between plant, sensors, observer and law: one type and one order each, defined only here.

Plant state, measurement and estimate begin alike, so one index finds the same quantity in all three:

    index       quantity                            unit
    THETA_M     motor angle, before the gear        rad
    OMEGA_M     motor speed                         rad/s
    THETA_L     load angle, behind the gear         rad
    OMEGA_L     load speed                          rad/s
    CURRENT     motor current                       A

    `PlantState`   (7,)  these five, then the energy account: SUPPLIED and LOST since the start, J
    `Measurement`  (5,)  these five, nan where the drive does not measure; never all of them
    `Estimate`     (6,)  these five, then LOAD_TORQUE on the output shaft, N m
    `Setpoint`     (3,)  POSITION, VELOCITY, ACCELERATION of the wanted load angle: rad, rad/s, rad/s^2

The types are arrays of float64 to numba and at run time; mypy does not take one for another.
"""

from typing import NewType

import numpy as np

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array

THETA_M, OMEGA_M, THETA_L, OMEGA_L, CURRENT = range(5)
SUPPLIED, LOST = 5, 6
LOAD_TORQUE = 5
POSITION, VELOCITY, ACCELERATION = range(3)

STATE_NAMES = ("theta_m", "omega_m", "theta_l", "omega_l", "current")
"""Names of what the first three signals have in common, in their order."""

PlantState = NewType("PlantState", np.ndarray[tuple[int, ...], np.dtype[np.float64]])
Measurement = NewType("Measurement", np.ndarray[tuple[int, ...], np.dtype[np.float64]])
Estimate = NewType("Estimate", np.ndarray[tuple[int, ...], np.dtype[np.float64]])
Setpoint = NewType("Setpoint", np.ndarray[tuple[int, ...], np.dtype[np.float64]])


# How compiled code says that a row of numbers is a signal: NewType is not to be called there. Each returns a view, as
# numba does not take an array inside a record for an array of its own.


@compiled
def as_measurement(row: Array) -> Measurement:
    """Return ``row``, shape (5,), as a measurement."""
    return row[:]  # type: ignore[return-value]


@compiled
def as_estimate(row: Array) -> Estimate:
    """Return ``row``, shape (6,), as an estimate."""
    return row[:]  # type: ignore[return-value]


@compiled
def as_setpoint(row: Array) -> Setpoint:
    """Return ``row``, shape (3,), as a setpoint."""
    return row[:]  # type: ignore[return-value]


def at_rest(load_angle: float = 0.0, motor_angle: float = 0.0) -> PlantState:
    """Return the state of a drive that stands still without current: angles in rad, each at its own shaft."""
    state = np.zeros(7)
    state[THETA_M], state[THETA_L] = motor_angle, load_angle
    return PlantState(state)
