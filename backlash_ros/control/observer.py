"""What the law needs and the drive may not measure: speeds, current and load torque, from position if need be.

Each signal is the measured one where there is one. Otherwise
a speed is the difference quotient of its encoder through a first-order low-pass,
the current follows the armature equation (eq 7) under the voltage that was commanded, or is what was commanded, and
a missing encoder is the other one through the rigid gear.

The load torque has no sensor. Adding eq 1 and eq 2 over n cancels the contact force,

    d/dt (J_l omega_l + J_m omega_m / n) = K_m i / n - B_l omega_l - B_m omega_m / n + tau_l,

so the momentum of both shafts gives tau_l whether the teeth touch or not: a momentum observer (De Luca &
Mattone, ICRA 2003) with one bandwidth, written so that it remembers the estimate and the last momentum only: a change
of bandwidth while it runs makes no step. With the load encoder alone the motor's momentum inside the gap is unknown;
an estimate through the rigid gear keeps up a limit cycle by itself, so there is none then, and it stays 0.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain import Drive, compiled

THETA_M, OMEGA_M, CURRENT, THETA_L, OMEGA_L, LOAD_TORQUE = range(6)
"""Order of the estimate. A measurement is its first five, nan where the drive does not measure."""

_STARTED, _MOMENTUM = 6, 7


class ObserverConstants(NamedTuple):
    """The observer as the compiled step reads it.

    ``back_emf`` and ``resistance`` are those of the winding between command and current: K_m and R, or 0 and 1 where
    the command is the current.
    """

    period: float
    ratio: float
    K_m: float
    back_emf: float
    resistance: float
    J_m: float
    B_m: float
    J_l: float
    B_l: float
    decay: float
    weight_before: float
    speed_gain: float
    torque_gain: float


def observer_constants(
    drive: Drive, period: float, *, velocity_bandwidth: float, torque_bandwidth: float
) -> ObserverConstants:
    """Return the observer for one drive, sampled every ``period`` seconds; bandwidths in rad/s."""
    takes_current = drive.takes_current
    electrical = math.inf if takes_current else period * drive.motor.resistance / drive.motor.inductance
    decay = math.exp(-electrical)
    pole = math.exp(-velocity_bandwidth * period)
    return ObserverConstants(
        period=float(period),
        ratio=drive.gear.ratio,
        K_m=float(drive.motor.torque_constant),
        back_emf=0.0 if takes_current else float(drive.motor.torque_constant),
        resistance=1.0 if takes_current else float(drive.motor.resistance),
        J_m=float(drive.motor.inertia),
        B_m=float(drive.motor.viscous_friction),
        J_l=float(drive.load.inertia),
        B_l=float(drive.load.viscous_friction),
        decay=decay,
        # The mean current of a period in which it relaxes with L/R: so much of the sample at its start.
        weight_before=1.0 - (1.0 + math.expm1(-electrical) / electrical) / -math.expm1(-electrical),
        speed_gain=(1.0 - pole) / period,
        torque_gain=-math.expm1(-torque_bandwidth * period) / period,
    )


def observer_memory() -> NDArray[np.float64]:
    """Return an observer that has seen nothing: shape (8,), the estimate and what goes with it."""
    return np.zeros(8)


@compiled
def _track(
    constants: ObserverConstants, memory: NDArray[np.float64], angle: int, speed: int, position: float, measured: float
) -> None:
    """Update one shaft: the measured speed where there is one, else the filtered difference quotient."""
    if math.isnan(measured):
        predicted = memory[angle] + constants.period * memory[speed]
        memory[speed] += constants.speed_gain * (position - predicted)
    else:
        memory[speed] = measured
    memory[angle] = position


@compiled
def observer_step(
    constants: ObserverConstants, memory: NDArray[np.float64], measured: NDArray[np.float64], command: float
) -> None:
    """Take one sample into ``memory``, whose first six entries are then the estimate.

    Parameters
    ----------
    memory : from `observer_memory`, updated in place
    measured : shape (5,), THETA_M to OMEGA_L (rad, rad/s, A), nan where not measured; at least one angle
    command : held since the sample before, V or A
    """
    n = constants.ratio
    theta_m, theta_l = measured[THETA_M], measured[THETA_L]
    omega_m, omega_l = measured[OMEGA_M], measured[OMEGA_L]
    if math.isnan(theta_l):
        theta_l, omega_l = n * theta_m, n * omega_m
    elif math.isnan(theta_m):
        theta_m, omega_m = theta_l / n, omega_l / n
    before = memory[CURRENT]
    speed_before_m, speed_before_l = memory[OMEGA_M], memory[OMEGA_L]
    if memory[_STARTED] == 0.0:
        memory[THETA_M], memory[THETA_L] = theta_m, theta_l
        memory[OMEGA_M] = 0.0 if math.isnan(omega_m) else omega_m
        memory[OMEGA_L] = 0.0 if math.isnan(omega_l) else omega_l
        memory[CURRENT] = 0.0 if math.isnan(measured[CURRENT]) else measured[CURRENT]
        memory[LOAD_TORQUE] = 0.0
        memory[_MOMENTUM] = constants.J_l * memory[OMEGA_L] + constants.J_m * memory[OMEGA_M] / n
        memory[_STARTED] = 1.0
        return
    _track(constants, memory, THETA_M, OMEGA_M, theta_m, omega_m)
    _track(constants, memory, THETA_L, OMEGA_L, theta_l, omega_l)
    if math.isnan(measured[CURRENT]):
        settled = (command - constants.back_emf * 0.5 * (speed_before_m + memory[OMEGA_M])) / constants.resistance
        memory[CURRENT] = constants.decay * before + (1.0 - constants.decay) * settled
    else:
        memory[CURRENT] = measured[CURRENT]
    mean_current = constants.weight_before * before + (1.0 - constants.weight_before) * memory[CURRENT]
    friction = constants.B_l * 0.5 * (speed_before_l + memory[OMEGA_L])
    friction += constants.B_m / n * 0.5 * (speed_before_m + memory[OMEGA_M])
    drive_torque = constants.K_m * mean_current / n
    momentum = constants.J_l * memory[OMEGA_L] + constants.J_m * memory[OMEGA_M] / n
    unexplained = momentum - memory[_MOMENTUM] - constants.period * (drive_torque - friction + memory[LOAD_TORQUE])
    memory[_MOMENTUM] = momentum
    if math.isnan(measured[THETA_M]) or constants.torque_gain == 0.0:
        memory[LOAD_TORQUE] = 0.0
    else:
        memory[LOAD_TORQUE] += constants.torque_gain * unexplained
