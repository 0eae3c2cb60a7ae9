"""The usual industrial cascade: a P position loop on the load with a dead band, around a PI speed loop on the motor.

The dead band is the backlash: within it the position loop asks for no speed. The speed loop is designed for the inertia
of motor and load, and cancels the back-EMF. The setpoint's speed is fed forward. The integral is stored in volts, so
that new gains cause no step.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import LAW_SIGNATURE, ControlLaw, LawState, NamedLaw
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array, Record, row_of, view_of
from backlash_ros.foundation.signals import OMEGA_M, POSITION, THETA_L, VELOCITY, Estimate, Setpoint

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_RESET_SHARE = 0.25
"""Rate at which the speed loop's integral resets, as a share of its bandwidth. Tuned."""


class CascadeConstants(Record):
    """The loops as the compiled step reads them."""

    position_gain: float  # 1/s, from the load's error to the motor's speed, with the gear in it
    dead_band: float  # rad, of either sign
    speed_gain: float  # V s/rad, at the motor
    reset_rate: float  # 1/s, of the speed loop's integral
    back_emf: float  # V s/rad
    period: float  # s
    to_motor: float  # 1/n, from a speed of the load to the motor's


class CascadeState(LawState):
    """The state of the law."""

    integral: float = 0.0  # V, of the speed loop


_constants_at, cascade_state_at = view_of(CascadeConstants), view_of(CascadeState)


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
def cascade_step(law: Array, state: Array, estimate: Estimate, path: Array, low: float, high: float) -> float:
    """Position error beyond the dead band to motor speed, speed error to voltage; the integrator stops at the range."""
    constants, memory = _constants_at(law), cascade_state_at(state)
    error = path[0, POSITION] - estimate[THETA_L]
    beyond = max(error - constants.dead_band, 0.0) + min(error + constants.dead_band, 0.0)
    wanted_speed = constants.position_gain * beyond + constants.to_motor * path[0, VELOCITY]
    speed_error = wanted_speed - estimate[OMEGA_M]
    integral = memory.integral + constants.speed_gain * constants.reset_rate * constants.period * speed_error
    wanted = constants.speed_gain * speed_error + integral + constants.back_emf * estimate[OMEGA_M]
    voltage = clamp(wanted, low, high)
    # Beyond the range the integral would only grow.
    if voltage == wanted:
        memory.integral = integral
    return voltage


def _take_over(_law: Array, state: Array, _estimate: Estimate, _setpoint: Setpoint, holding: float) -> None:
    cascade_state_at(state).integral = holding


def cascade(drive: Drive, settings: "ServoSettings", parameters: CascadeParameters) -> ControlLaw:
    """Design the cascade: K_m i = n^2 J_e domega_m/dt with i = V/R past the electrical pole."""
    ratio, motor = drive.gear.ratio, drive.motor
    inertia = ratio**2 * drive.effective_inertia
    constants = row_of(
        CascadeConstants,
        position_gain=parameters.position_bandwidth / ratio,
        dead_band=parameters.dead_band * settings.backlash_angle,
        speed_gain=parameters.speed_bandwidth * inertia * motor.resistance / motor.torque_constant,
        reset_rate=_RESET_SHARE * parameters.speed_bandwidth,
        back_emf=motor.torque_constant,
        period=settings.period,
        to_motor=1.0 / ratio,
    )
    return ControlLaw(cascade_step, constants, row_of(CascadeState), _take_over)


LAWS = {"cascade": NamedLaw("P/PI cascade with dead band", cascade, CascadeParameters())}
