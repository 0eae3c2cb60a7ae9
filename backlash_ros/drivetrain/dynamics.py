"""Equations of motion of the geared servo: five states, voltage and load torque in.

State order: theta_m (rad), omega_m (rad/s), theta_l (rad), omega_l (rad/s), i (A).

    L di/dt        = V - R i - K_m omega_m            eq 7
    J_m domega_m/dt = K_m i - B_m omega_m - R1 F      eqs 2, 8
    J_l domega_l/dt = R2 F - B_l omega_l + tau_l      eq 1, with the dots it lost in print
"""

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain.compiled import compiled
from backlash_ros.drivetrain.contact import power_law
from backlash_ros.drivetrain.parameters import PlantConstants

THETA_M, OMEGA_M, THETA_L, OMEGA_L, CURRENT = range(5)
STATE_NAMES = ("theta_m", "omega_m", "theta_l", "omega_l", "current")

State = NDArray[np.float64]


@compiled
def contact_of(plant: PlantConstants, state: State) -> tuple[float, float, float]:
    """Return the contact's force (N), stiffness (N/m) and damping (N s/m) at ``state``."""
    gap = plant.R1 * state[THETA_M] - plant.R2 * state[THETA_L]
    gap_rate = plant.R1 * state[OMEGA_M] - plant.R2 * state[OMEGA_L]
    return power_law(plant, gap, gap_rate)


@compiled
def derivative(plant: PlantConstants, state: State, voltage: float, load_torque: float, out: State) -> None:
    """Write d(state)/dt into ``out``, shape (5,), for a voltage (V) and a load torque (N m)."""
    force, _, _ = contact_of(plant, state)
    omega_m, omega_l, current = state[OMEGA_M], state[OMEGA_L], state[CURRENT]
    out[THETA_M] = omega_m
    out[OMEGA_M] = (plant.K_m * current - plant.B_m * omega_m - plant.R1 * force) / plant.J_m
    out[THETA_L] = omega_l
    out[OMEGA_L] = (plant.R2 * force - plant.B_l * omega_l + load_torque) / plant.J_l
    out[CURRENT] = (voltage - plant.R * current - plant.K_m * omega_m) / plant.L
