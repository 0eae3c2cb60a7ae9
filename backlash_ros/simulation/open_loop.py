"""The drive driven by a motor torque, without a controller: what the paper's fig 7 shows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.dynamics import CURRENT, contact_of, gap_of
from backlash_ros.drivetrain.integrator import DEFAULT_TOLERANCE, DONE, REASONS, advance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OpenLoop:
    """Arrays of shape (N + 1,): ``time`` (s), contact ``force`` (N), ``gap`` (m) and ``gap_rate`` (m/s)."""

    time: Array
    force: Array
    gap: Array
    gap_rate: Array


def drive_with_torque(drive: Drive, torque: Array, load_torque: float, period: float) -> OpenLoop:
    """Apply motor torques (N m), each for ``period`` seconds, from rest in the middle of the gap.

    The current is imposed, as a current-controlled amplifier does: an infinite inductance keeps it.
    """
    plant = plant_constants(drive)._replace(L=np.inf)
    state, step = np.zeros(7), np.zeros(2)
    rows = np.zeros((torque.size + 1, 3))
    for k, value in enumerate(torque):
        state[CURRENT] = value / drive.motor.torque_constant
        status, passed = advance(plant, state, step, 0.0, load_torque, period, DEFAULT_TOLERANCE)
        if status != DONE:
            raise IntegrationError(REASONS[status], k * period + passed, state)
        gap, rate = gap_of(plant, state)
        rows[k + 1] = contact_of(plant, state)[0], gap, rate
    return OpenLoop(np.arange(torque.size + 1, dtype=np.float64) * period, *np.ascontiguousarray(rows.T))
