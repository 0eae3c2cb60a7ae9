"""The dual loop: the motor is controlled on its own encoder, and the load's encoder shifts the motor's target.

After adamb314/ServoProject, a servo for small gear motors: a P position loop around a PI speed loop of the motor, four
times as fast; an integral of the load's error that shifts the motor's target; and a jump of this target by the gap when
the torque on the load is to change its sign. There a host sends smooth motions and their torques. Here a critically
damped reference of the second order makes a smooth motion of any setpoint, and the identified drive gives its torque.

All angles are at the output: the motor's is n theta_m. The integral of the speed loop is stored in volts.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, REGION, ControlLaw, NamedLaw
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled, compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import (
    ACCELERATION,
    LOAD_TORQUE,
    OMEGA_L,
    OMEGA_M,
    POSITION,
    THETA_L,
    THETA_M,
    VELOCITY,
    Estimate,
    Setpoint,
)

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

# fmt: off
(
    _PERIOD, _RATIO, _GAP,  # s, n, b in rad
    _MOVE, _POSITION_GAIN, _SPEED_GAIN, _RESET,  # 1/s, 1/s, V s/rad, 1/s
    _LOAD_GAIN, _LEAST,  # 1/s, N m
    _INERTIA, _FRICTION, _COULOMB,  # of the load: kg m^2, N m s/rad, N m
    _ALL_INERTIA, _ALL_FRICTION, _ALL_COULOMB,  # of both shafts
    _VOLTS_PER_TORQUE, _VOLTS_PER_SPEED,  # V/(N m), V s/rad
) = range(17)
_STARTED, REFERENCE, SPEED, SHIFT, FLANK, _INTEGRAL = range(1, 7)
# fmt: on
_FASTER = 4.0
"""The speed loop's bandwidth over the position loop's."""
_NONE = 5e-4
"""Share of the least torque below which a planned torque has no sign: the motion is over."""
_TURNS = 0.2
"""Speed, rad/s, from which on a shaft has all of its dry friction."""
_QUICKEST = 0.5
"""Largest reference bandwidth times the period."""


@dataclass(frozen=True)
class DualLoopParameters(Validated):
    """Bandwidths of the reference and of the loops, and the least load torque that counts; found on random drives."""

    section: ClassVar[str] = "laws.dual_loop"

    reference_bandwidth: float = quantity(
        "bandwidth of the smooth motion that a setpoint becomes", "rad/s", above=0, at_most=1e4, default=20.0
    )
    position_bandwidth: float = quantity(
        "bandwidth of the motor's position loop; its speed loop is four times as fast",
        "rad/s",
        above=0,
        at_most=1e4,
        default=27.0,
    )
    load_bandwidth: float = quantity(
        "bandwidth of the loop that shifts the motor's target until the load is at its own",
        "rad/s",
        at_least=0,
        at_most=1e4,
        default=1.5,
    )
    least_torque: float = quantity(
        "load torque beyond the dry friction, as a share of the standstill torque, from which on it decides the flank",
        "",
        above=0,
        at_most=1,
        default=0.01,
    )


@compiled
def _start(law: Array, state: Array, estimate: Estimate) -> None:
    """Start where both shafts are."""
    state[REFERENCE], state[SPEED] = estimate[THETA_L], estimate[OMEGA_L]
    state[SHIFT] = law[_RATIO] * estimate[THETA_M] - estimate[THETA_L]
    state[FLANK], state[_STARTED] = 0.0, 1.0


@compiled_as(LAW_SIGNATURE)
def dual_loop_step(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, low: float, high: float) -> float:
    """Smooth the setpoint, shift the motor's target by the load's error and the gap, and move the motor there."""
    if state[_STARTED] == 0.0:
        _start(law, state, estimate)
    period, move, speed = law[_PERIOD], law[_MOVE], state[SPEED]
    acceleration = move * (move * (setpoint[POSITION] - state[REFERENCE]) + 2.0 * (setpoint[VELOCITY] - speed))
    acceleration += setpoint[ACCELERATION]
    turning = clamp(speed / _TURNS, -1.0, 1.0)
    pull, hidden = estimate[LOAD_TORQUE], law[_COULOMB] + law[_LEAST]
    takes = law[_INERTIA] * acceleration + law[_FRICTION] * speed + law[_COULOMB] * turning
    takes -= pull - clamp(pull, -hidden, hidden)
    flank = math.copysign(1.0, takes) if abs(takes) > _NONE * law[_LEAST] else state[FLANK]
    # By half the gap from a flank that is not known: where the teeth are between them is not known either.
    state[SHIFT] += 0.5 * (flank - state[FLANK]) * law[_GAP]
    state[FLANK] = flank
    motor, motor_speed = law[_RATIO] * estimate[THETA_M], law[_RATIO] * estimate[OMEGA_M]
    missing = speed + law[_POSITION_GAIN] * (state[REFERENCE] + state[SHIFT] - motor) - motor_speed
    integral = state[_INTEGRAL] + law[_SPEED_GAIN] * law[_RESET] * period * missing
    torque = law[_ALL_INERTIA] * acceleration + law[_ALL_FRICTION] * speed + law[_ALL_COULOMB] * turning
    wanted = law[_SPEED_GAIN] * missing + integral
    wanted += law[_VOLTS_PER_TORQUE] * torque + law[_VOLTS_PER_SPEED] * motor_speed
    voltage = clamp(wanted, low, high)
    if voltage == wanted:
        state[_INTEGRAL] = integral
        state[SHIFT] += law[_LOAD_GAIN] * period * (state[REFERENCE] - estimate[THETA_L])
    else:  # the reference accelerates no more than the drive can
        possible = acceleration + (voltage - wanted) / (law[_VOLTS_PER_TORQUE] * law[_ALL_INERTIA])
        acceleration = clamp(possible, min(acceleration, 0.0), max(acceleration, 0.0))
    state[SPEED] += period * acceleration
    state[REFERENCE] += period * state[SPEED]
    return voltage


def _take_over(law: Array, state: Array, estimate: Estimate, _setpoint: Setpoint, holding: float) -> None:
    _start(law, state, estimate)
    state[_INTEGRAL] = holding
    torque = holding / law[_VOLTS_PER_TORQUE]
    state[FLANK] = math.copysign(1.0, torque) if abs(torque) > law[_LEAST] else 0.0


def dual_loop(drive: Drive, settings: "ServoSettings", parameters: DualLoopParameters) -> ControlLaw:
    """Design the law for ``drive`` as identified and the learned gap.

    Raises
    ------
    ValueError
        If the reference is too fast for the sample period.
    """
    motor, load, n = drive.motor, drive.load, drive.gear.ratio
    inertia, volts_per_torque = drive.effective_inertia, motor.resistance * n / motor.torque_constant
    if (most := _QUICKEST / settings.period) < parameters.reference_bandwidth:
        raise ValueError(
            f"laws.dual_loop.reference_bandwidth must be at most {most:g} rad/s at this rate, "
            f"got {parameters.reference_bandwidth:g}"
        )
    speed_bandwidth = _FASTER * parameters.position_bandwidth
    law = np.zeros(_VOLTS_PER_SPEED + 1)
    values = {
        _PERIOD: settings.period,
        _RATIO: n,
        _GAP: settings.backlash_angle,
        _MOVE: parameters.reference_bandwidth,
        _POSITION_GAIN: parameters.position_bandwidth,
        _SPEED_GAIN: speed_bandwidth * inertia * volts_per_torque,
        _RESET: 0.25 * speed_bandwidth,
        _LOAD_GAIN: parameters.load_bandwidth,
        _LEAST: parameters.least_torque * drive.standstill_torque(),
        _INERTIA: load.inertia,
        _FRICTION: load.viscous_friction,
        _COULOMB: load.coulomb_friction,
        _ALL_INERTIA: inertia,
        _ALL_FRICTION: drive.effective_friction,
        _ALL_COULOMB: load.coulomb_friction + motor.coulomb_friction / n,
        _VOLTS_PER_TORQUE: volts_per_torque,
        _VOLTS_PER_SPEED: motor.torque_constant / n,
    }
    law[list(values)] = list(values.values())
    state = np.zeros(_INTEGRAL + 1)
    state[REGION] = FAST_REGION
    return ControlLaw(dual_loop_step, law, state, _take_over)


LAWS = {
    "dual_loop": NamedLaw(
        "dual loop (after ServoProject)", dual_loop, DualLoopParameters(), both_encoders=True, identified=True
    )
}
