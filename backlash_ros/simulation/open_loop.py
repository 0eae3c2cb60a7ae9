"""The drive under a motor torque, without a controller, as in the paper's fig 7."""

from dataclasses import dataclass, replace

import numpy as np

from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.effects.views import force_view
from backlash_ros.drivetrain.motion.dynamics import gap_of
from backlash_ros.drivetrain.motion.integrator import (
    DEFAULT_TOLERANCE,
    DONE,
    REASONS,
    integration_memory,
    integrator_for,
)
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import at_rest


@dataclass(frozen=True)
class OpenLoop:
    """Arrays of shape (N + 1,): ``time`` (s), contact ``force`` (N), ``gap`` (m) and ``gap_rate`` (m/s).

    ``motor_torque`` (N,) and ``load_torque`` are what drove it, N m, each on its own shaft.
    """

    time: Array
    force: Array
    gap: Array
    gap_rate: Array
    motor_torque: Array
    load_torque: float


def drive_with_torque(drive: Drive, torque: Array, load_torque: float, period: float) -> OpenLoop:
    """Apply motor torques (N m), each for ``period`` seconds, from rest in the middle of the gap.

    The current is imposed, with any command interface, and not limited.
    """
    plant = plant_constants(replace(drive, command_interface="current"))
    advance, force_of = integrator_for(drive), force_view(drive)
    state, step = at_rest(), integration_memory()
    rows = np.zeros((torque.size + 1, 3))
    for k, value in enumerate(torque):
        current = value / drive.motor.torque_constant
        status, passed = advance(plant, state, step, current, load_torque, period, DEFAULT_TOLERANCE)
        if status != DONE:
            raise IntegrationError(REASONS[status], k * period + passed, state)
        gap, rate = gap_of(plant, state)
        rows[k + 1] = force_of(plant, state, step), gap, rate
    time = np.arange(torque.size + 1, dtype=np.float64) * period
    forces, gaps, gap_rates = np.ascontiguousarray(rows.T)
    return OpenLoop(time, forces, gaps, gap_rates, torque, load_torque)
