"""Equations of motion of the geared servo: five states, command and load torque in; and the energy account.

State order: theta_m (rad), omega_m (rad/s), theta_l (rad), omega_l (rad/s), i (A), then the energy account:
supplied and lost since the start (J).

    L di/dt         = V - R i - K_m omega_m                             eq 7
    J_m domega_m/dt = K_m i - B_m omega_m - R1 F                        eqs 2, 8
    J_l domega_l/dt = R2 F - B_l omega_l - tau_c(omega_l) + tau_l       eq 1, with the dots it lost in print

Where the command is the current, i is what was commanded and V what an ideal current loop applies for it: the
energy account is that at the terminals either way.

Coulomb friction tau_c is the given torque times tanh(omega_l/omega_0), omega_0 = 1 mrad/s: a load that it holds creeps
instead of sticking, at omega_0 atanh(torque/friction), which is omega_0 at three quarters of the friction.
"""

import math

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain.compiled import compiled
from backlash_ros.drivetrain.contact import Contact, contact, elastic_energy
from backlash_ros.drivetrain.parameters import PlantConstants

THETA_M, OMEGA_M, THETA_L, OMEGA_L, CURRENT, SUPPLIED, LOST = range(7)
STATE_NAMES = ("theta_m", "omega_m", "theta_l", "omega_l", "current")

State = NDArray[np.float64]

_STICTION_SPEED = 1e-3


@compiled
def gap_of(plant: PlantConstants, state: State) -> tuple[float, float]:
    """Return the gap R1 theta_m - R2 theta_l (m) and its rate (m/s)."""
    gap = plant.R1 * state[THETA_M] - plant.R2 * state[THETA_L]
    return gap, plant.R1 * state[OMEGA_M] - plant.R2 * state[OMEGA_L]


@compiled
def contact_of(plant: PlantConstants, state: State) -> Contact:
    """Return force, stiffness, damping, elastic force and its stiffness at ``state``."""
    gap, gap_rate = gap_of(plant, state)
    return contact(plant, gap, gap_rate)


@compiled
def coulomb(plant: PlantConstants, omega_l: float) -> tuple[float, float]:
    """Return the Coulomb friction (N m) that brakes the load at a speed (rad/s), and its slope (N m s/rad)."""
    if plant.coulomb == 0.0:
        return 0.0, 0.0
    share = math.tanh(omega_l / _STICTION_SPEED)
    return plant.coulomb * share, plant.coulomb / _STICTION_SPEED * (1.0 - share * share)


@compiled
def derivative(plant: PlantConstants, state: State, command: float, load_torque: float, out: State) -> None:
    """Write d(state)/dt into ``out``, shape (7,), for a command and a load torque (N m).

    The command is the voltage, V; without effect where the current is imposed.
    """
    _, gap_rate = gap_of(plant, state)
    force, _, _, elastic, _ = contact_of(plant, state)
    omega_m, omega_l, current = state[OMEGA_M], state[OMEGA_L], state[CURRENT]
    friction, _ = coulomb(plant, omega_l)
    voltage = plant.R * current + plant.K_m * omega_m if math.isinf(plant.L) else command
    out[THETA_M] = omega_m
    out[OMEGA_M] = (plant.K_m * current - plant.B_m * omega_m - plant.R1 * force) / plant.J_m
    out[THETA_L] = omega_l
    out[OMEGA_L] = (plant.R2 * force - plant.B_l * omega_l - friction + load_torque) / plant.J_l
    out[CURRENT] = (voltage - plant.R * current - plant.K_m * omega_m) / plant.L
    out[SUPPLIED] = voltage * current + load_torque * omega_l
    rubbed = plant.B_m * omega_m * omega_m + (plant.B_l * omega_l + friction) * omega_l
    out[LOST] = plant.R * current * current + rubbed + (force - elastic) * gap_rate


@compiled
def stored_energy(plant: PlantConstants, state: State) -> float:
    """Return the kinetic, magnetic and elastic energy, J; the magnetic one of an imposed current is the drive's."""
    gap, _ = gap_of(plant, state)
    kinetic = plant.J_m * state[OMEGA_M] ** 2 + plant.J_l * state[OMEGA_L] ** 2
    magnetic = 0.0 if math.isinf(plant.L) else plant.L * state[CURRENT] ** 2
    return float(0.5 * (kinetic + magnetic) + elastic_energy(plant, gap))
