"""Two linear compensators and a switch on the error, in the manner of Boneh & Yaniv.

J. Dyn. Syst. Meas. Control 121, 1999. Their aim is a smaller limit cycle, not none: near the target the same lead
compensator acts with a lower gain. It sees position and speed of the load only, knows nothing of current and load
torque, and switches without hysteresis.
"""

import numpy as np

from backlash_ros.control.command import within
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, OVERDAMPED_REGION, REGION, Array, ControlLaw, NamedLaw
from backlash_ros.control.observer import OMEGA_L, THETA_L
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.compiled import compiled_as

_K1, _K2, _NEAR, _REDUCTION = range(4)

REDUCTION = 0.3
"""Gain near the target over gain far from it."""


@compiled_as(LAW_SIGNATURE)
def switched_linear_step(
    law: Array, memory: Array, estimate: Array, reference: float, low: float, high: float
) -> float:
    """V = -g (k1 error + k2 omega_l), with the reduced g where the error is within the backlash."""
    error = estimate[THETA_L] - reference
    near = abs(error) < law[_NEAR]
    memory[REGION] = OVERDAMPED_REGION if near else FAST_REGION
    voltage = -(law[_K1] * error + law[_K2] * estimate[OMEGA_L]) * (law[_REDUCTION] if near else 1.0)
    return within(voltage, low, high)


def switched_linear(_drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Design it from the fast gains' position and speed gain."""
    fast = settings.gains.fast
    constants = [fast.position, fast.velocity, settings.backlash_angle, REDUCTION]
    return ControlLaw(switched_linear_step, np.array(constants, dtype=float), np.array([float(FAST_REGION)]))


LAWS = {"switched_linear": NamedLaw("switched linear (after Boneh & Yaniv)", switched_linear)}
