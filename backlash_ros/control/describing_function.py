"""Harmonic balance: the limit cycle that state feedback keeps up in the gap, predicted without simulating it.

The teeth are the nonlinearity. For a sinusoidal gap of amplitude A and frequency w the fundamental of the contact
force is N(A, w) times the gap (describing function; Slotine & Li, Applied Nonlinear Control, ch. 5). Everything else is
linear: G(jw) from contact force to gap, through both shafts, the motor and the sampled feedback with its hold. A limit
cycle has G(jw) N(A, w) = 1. It assumes that the gap is close to a sinusoid.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from backlash_ros.control.gains import Gains
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.constants import plant_constants

_POINTS = 400
_BOUNDS = (np.log([0.5, 10.0]), np.log([20.0, 3000.0]))
"""Of the gap's amplitude over d/2 and of the frequency in rad/s, as logarithms."""


@dataclass(frozen=True)
class PredictedCycle:
    """A predicted limit cycle: load amplitude peak to peak (rad), gap travel (m), period (s)."""

    amplitude: float
    gap_travel: float
    period: float


def describing_function(drive: Drive, amplitude: float, frequency: float) -> complex:
    """Return N(A, w) in N/m of the drive's contact law: amplitude of the gap in m, frequency in rad/s."""
    plant = plant_constants(drive)
    phase = 2 * np.pi * (np.arange(_POINTS) + 0.5) / _POINTS
    contact = drive.gear.contact.force
    force = np.array(
        [
            contact(plant.contact, plant.half_gap, amplitude * math.sin(p), amplitude * frequency * math.cos(p))[0]
            for p in phase
        ]
    )
    in_phase, quadrature = np.mean(force * np.sin(phase)), np.mean(force * np.cos(phase))
    return complex(2 * in_phase / amplitude, 2 * quadrature / amplitude)


def _linear_part(drive: Drive, gains: Gains, period: float, frequency: float) -> NDArray[np.complex128]:
    """Return theta_m, omega_m, theta_l, omega_l, i per newton of contact force, under sampled state feedback."""
    motor, gear, load = drive.motor, drive.gear, drive.load
    s = 1j * frequency
    hold = (1 - np.exp(-s * period)) / (s * period)
    if drive.takes_current:  # the whole answer is held, and k3 sees the one before
        back_emf, winding = hold * motor.torque_constant, motor.resistance + np.exp(-s * period) * gains.k3
    else:
        back_emf, winding = motor.torque_constant, s * motor.inductance + motor.resistance + hold * gains.k3
    balance = np.array(
        [
            [s, -1.0, 0.0, 0.0, 0.0],
            [0.0, s * motor.inertia + motor.viscous_friction, 0.0, 0.0, -motor.torque_constant],
            [0.0, 0.0, s, -1.0, 0.0],
            [0.0, 0.0, 0.0, s * load.inertia + load.viscous_friction, 0.0],
            [0.0, back_emf, hold * gains.k1, hold * gains.k2, winding],
        ]
    )
    push = np.array([0.0, -gear.motor_radius, 0.0, gear.load_radius, 0.0], dtype=complex)
    return np.asarray(np.linalg.solve(balance, push))


def predict_limit_cycle(drive: Drive, gains: Gains, period: float) -> PredictedCycle | None:
    """Return the limit cycle of largest amplitude that harmonic balance finds, or None.

    Parameters
    ----------
    drive, gains : the drive and the state feedback that acts throughout
    period : of the controller's samples, s
    """
    gear, half = drive.gear, 0.5 * drive.gear.backlash

    def residual(x: NDArray[np.float64]) -> list[float]:
        amplitude, frequency = half * math.exp(x[0]), math.exp(x[1])
        states = _linear_part(drive, gains, period, frequency)
        loop = (gear.motor_radius * states[0] - gear.load_radius * states[2]) * describing_function(
            drive, amplitude, frequency
        )
        return [loop.real - 1.0, loop.imag]

    found: list[PredictedCycle] = []
    for amplitude in (1.05, 1.5):
        for frequency in np.geomspace(40.0, 800.0, 5):
            solution = least_squares(residual, [math.log(amplitude), math.log(frequency)], bounds=_BOUNDS)
            if solution.cost > 1e-12:
                continue
            gap, omega = half * math.exp(solution.x[0]), math.exp(solution.x[1])
            states = _linear_part(drive, gains, period, omega)
            share = abs(states[2] / (gear.motor_radius * states[0] - gear.load_radius * states[2]))
            found.append(PredictedCycle(2 * gap * share, 2 * gap, 2 * math.pi / omega))
    return max(found, key=lambda cycle: cycle.amplitude, default=None)
