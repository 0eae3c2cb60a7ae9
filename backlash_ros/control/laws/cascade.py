"""What industry uses: a P position loop on the load with a dead band, around a PI speed loop on the motor.

The dead band is the backlash: within it the position loop asks for nothing. The speed loop has the inertia of motor
and load as its plant and cancels the back-EMF.
"""

import numpy as np

from backlash_ros.control.command import within
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, Array, ControlLaw, NamedLaw
from backlash_ros.control.observer import OMEGA_M, THETA_L
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.compiled import compiled_as

_INTEGRAL = 1
_POSITION_GAIN, _DEAD_BAND, _SPEED_GAIN, _RESET, _BACK_EMF, _PERIOD = range(6)

SPEED_BANDWIDTH = 100.0
POSITION_BANDWIDTH = 25.0
"""Bandwidths of the loops, rad/s: where the rise time is that of the fast state feedback on the nominal drive."""


@compiled_as(LAW_SIGNATURE)
def cascade_step(law: Array, memory: Array, estimate: Array, reference: float, low: float, high: float) -> float:
    """Position error beyond the dead band to motor speed, speed error to voltage; the integrator stops at the limit."""
    error = reference - estimate[THETA_L]
    beyond = max(error - law[_DEAD_BAND], 0.0) + min(error + law[_DEAD_BAND], 0.0)
    speed_error = law[_POSITION_GAIN] * beyond - estimate[OMEGA_M]
    integral = memory[_INTEGRAL] + law[_RESET] * law[_PERIOD] * speed_error
    wanted = law[_SPEED_GAIN] * (speed_error + integral) + law[_BACK_EMF] * estimate[OMEGA_M]
    voltage = within(wanted, low, high)
    if voltage == wanted:
        memory[_INTEGRAL] = integral
    return voltage


def cascade(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Design the cascade: K_m i = n^2 J_e domega_m/dt with i = V/R past the electrical pole."""
    inertia = drive.gear.ratio**2 * drive.effective_inertia
    constants = [
        POSITION_BANDWIDTH / drive.gear.ratio,
        0.5 * settings.backlash_angle,
        SPEED_BANDWIDTH * inertia * drive.motor.resistance / drive.motor.torque_constant,
        0.25 * SPEED_BANDWIDTH,
        drive.motor.torque_constant,
        settings.period,
    ]
    return ControlLaw(cascade_step, np.array(constants, dtype=float), np.array([float(FAST_REGION), 0.0]))


LAWS = {"cascade": NamedLaw("P/PI cascade with dead band", cascade)}
