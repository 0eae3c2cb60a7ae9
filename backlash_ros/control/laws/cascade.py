"""The usual industrial cascade: a P position loop on the load with a dead band, around a PI speed loop on the motor.

The dead band is the backlash: within it the position loop asks for no speed. The speed loop is designed for the inertia
of motor and load, and cancels the back-EMF. The setpoint's speed is fed forward. The integral is stored in volts, so
that new gains cause no step.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, ControlLaw, NamedLaw
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_M, POSITION, THETA_L, VELOCITY, Estimate, Setpoint

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_INTEGRAL = 1
_POSITION_GAIN, _DEAD_BAND, _SPEED_GAIN, _RESET, _BACK_EMF, _PERIOD, _TO_MOTOR = range(7)


@dataclass(frozen=True)
class CascadeParameters(Validated):
    """Bandwidths; by default the rise time is that of the fast state feedback on the nominal drive."""

    section: ClassVar[str] = "laws.cascade"

    position_bandwidth: float = quantity("bandwidth of the position loop", "rad/s", above=0, at_most=1e4, default=25.0)
    speed_bandwidth: float = quantity("bandwidth of the speed loop", "rad/s", above=0, at_most=1e4, default=100.0)
    dead_band: float = quantity(
        "error, of either sign, that is ignored, in units of backlash_angle", "", at_least=0, at_most=10, default=0.5
    )


@compiled_as(LAW_SIGNATURE)
def cascade_step(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, low: float, high: float) -> float:
    """Position error beyond the dead band to motor speed, speed error to voltage; the integrator stops at the range."""
    error = setpoint[POSITION] - estimate[THETA_L]
    beyond = max(error - law[_DEAD_BAND], 0.0) + min(error + law[_DEAD_BAND], 0.0)
    speed_error = law[_POSITION_GAIN] * beyond + law[_TO_MOTOR] * setpoint[VELOCITY] - estimate[OMEGA_M]
    integral = state[_INTEGRAL] + law[_SPEED_GAIN] * law[_RESET] * law[_PERIOD] * speed_error
    wanted = law[_SPEED_GAIN] * speed_error + integral + law[_BACK_EMF] * estimate[OMEGA_M]
    voltage = clamp(wanted, low, high)
    if voltage == wanted:
        state[_INTEGRAL] = integral
    return voltage


def _take_over(_law: Array, state: Array, _estimate: Estimate, _setpoint: Setpoint, holding: float) -> None:
    state[_INTEGRAL] = holding


def cascade(drive: Drive, settings: "ServoSettings", parameters: CascadeParameters) -> ControlLaw:
    """Design the cascade: K_m i = n^2 J_e domega_m/dt with i = V/R past the electrical pole."""
    inertia = drive.gear.ratio**2 * drive.effective_inertia
    constants = [
        parameters.position_bandwidth / drive.gear.ratio,
        parameters.dead_band * settings.backlash_angle,
        parameters.speed_bandwidth * inertia * drive.motor.resistance / drive.motor.torque_constant,
        0.25 * parameters.speed_bandwidth,
        drive.motor.torque_constant,
        settings.period,
        1.0 / drive.gear.ratio,
    ]
    return ControlLaw(cascade_step, np.array(constants, dtype=float), np.array([float(FAST_REGION), 0.0]), _take_over)


LAWS = {"cascade": NamedLaw("P/PI cascade with dead band", cascade, CascadeParameters())}
