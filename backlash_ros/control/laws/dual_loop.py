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

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import LAW_SIGNATURE, ControlLaw, LawState, NamedLaw
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled, compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array, Record, row_of, view_of
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

_FASTER = 4.0
"""The speed loop's bandwidth over the position loop's, as in ServoProject."""
_RESET_SHARE = 0.25
"""Rate at which the speed loop's integral resets, as a share of its bandwidth. Tuned."""
_NO_TORQUE = 5e-4
"""Share of the least torque below which a planned torque has no sign: the motion is over. Tuned."""
_TURNS = 0.2
"""Speed, rad/s, from which on a shaft has all of its dry friction. Tuned."""
_QUICKEST = 0.5
"""Largest reference bandwidth times the period. Tuned."""


class DualLoopConstants(Record):
    """The loops and the identified drive, as the compiled step reads them."""

    period: float  # s
    ratio: float  # of the gear, n
    gap: float  # rad
    reference_bandwidth: float  # rad/s
    position_gain: float  # 1/s
    speed_gain: float  # V s/rad
    reset_rate: float  # 1/s, of the speed loop's integral
    load_gain: float  # 1/s, of the loop that shifts the motor's target
    least_torque: float  # N m, beyond the dry friction, that decides the flank
    load_inertia: float  # kg m^2
    load_friction: float  # N m s/rad
    load_coulomb: float  # N m
    inertia: float  # kg m^2, of both shafts
    friction: float  # N m s/rad, of both shafts
    coulomb: float  # N m, of both shafts
    volts_per_torque: float  # V/(N m)
    volts_per_speed: float  # V s/rad


class DualLoopState(LawState):
    """The smooth motion, the shift of the motor's target and the speed loop's integral."""

    started: float = 0.0  # 1 once a sample has been seen
    reference: float = 0.0  # rad, of the smooth motion
    speed: float = 0.0  # rad/s, of the smooth motion
    shift: float = 0.0  # rad, of the motor's target from the smooth motion
    flank: float = 0.0  # 1 or -1; 0: not known
    integral: float = 0.0  # V


_constants_at, dual_loop_state_at = view_of(DualLoopConstants), view_of(DualLoopState)


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
def _start(constants: DualLoopConstants, memory: DualLoopState, estimate: Estimate) -> None:
    """Start where both shafts are."""
    memory.reference, memory.speed = estimate[THETA_L], estimate[OMEGA_L]
    memory.shift = constants.ratio * estimate[THETA_M] - estimate[THETA_L]
    memory.flank, memory.started = 0.0, 1.0


@compiled
def _choose_flank(
    constants: DualLoopConstants, memory: DualLoopState, acceleration: float, turning: float, load_torque: float
) -> None:
    """Choose the flank that gives the load the planned torque, and shift the motor's target there."""
    hidden = constants.load_coulomb + constants.least_torque
    planned = constants.load_inertia * acceleration + constants.load_friction * memory.speed
    planned += constants.load_coulomb * turning
    # Dry friction hides so much of the load torque.
    planned -= load_torque - clamp(load_torque, -hidden, hidden)
    decides = abs(planned) > _NO_TORQUE * constants.least_torque
    flank = math.copysign(1.0, planned) if decides else memory.flank
    # By half the gap from a flank that is not known: where the teeth are between them is not known either.
    memory.shift += 0.5 * (flank - memory.flank) * constants.gap
    memory.flank = flank


@compiled_as(LAW_SIGNATURE)
def dual_loop_step(law: Array, state: Array, estimate: Estimate, path: Array, low: float, high: float) -> float:
    """Smooth the setpoint, shift the motor's target by the load's error and the gap, and move the motor there."""
    constants, memory = _constants_at(law), dual_loop_state_at(state)
    if memory.started == 0.0:
        _start(constants, memory, estimate)
    period, bandwidth, speed = constants.period, constants.reference_bandwidth, memory.speed
    behind = bandwidth * (path[0, POSITION] - memory.reference) + 2.0 * (path[0, VELOCITY] - speed)
    acceleration = bandwidth * behind
    acceleration += path[0, ACCELERATION]
    turning = clamp(speed / _TURNS, -1.0, 1.0)
    _choose_flank(constants, memory, acceleration, turning, estimate[LOAD_TORQUE])
    motor, motor_speed = constants.ratio * estimate[THETA_M], constants.ratio * estimate[OMEGA_M]
    speed_error = speed + constants.position_gain * (memory.reference + memory.shift - motor) - motor_speed
    integral = memory.integral + constants.speed_gain * constants.reset_rate * period * speed_error
    torque = constants.inertia * acceleration + constants.friction * speed + constants.coulomb * turning
    wanted = constants.speed_gain * speed_error + integral
    wanted += constants.volts_per_torque * torque + constants.volts_per_speed * motor_speed
    voltage = clamp(wanted, low, high)
    if voltage == wanted:
        memory.integral = integral
        memory.shift += constants.load_gain * period * (memory.reference - estimate[THETA_L])
    else:  # the reference accelerates no more than the drive can
        possible = acceleration + (voltage - wanted) / (constants.volts_per_torque * constants.inertia)
        acceleration = clamp(possible, min(acceleration, 0.0), max(acceleration, 0.0))
    memory.speed += period * acceleration
    memory.reference += period * memory.speed
    return voltage


def _take_over(law: Array, state: Array, estimate: Estimate, _setpoint: Setpoint, holding: float) -> None:
    constants, memory = _constants_at(law), dual_loop_state_at(state)
    _start(constants, memory, estimate)
    memory.integral = holding
    torque = holding / constants.volts_per_torque
    memory.flank = math.copysign(1.0, torque) if abs(torque) > constants.least_torque else 0.0


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
    constants = row_of(
        DualLoopConstants,
        period=settings.period,
        ratio=n,
        gap=settings.backlash_angle,
        reference_bandwidth=parameters.reference_bandwidth,
        position_gain=parameters.position_bandwidth,
        speed_gain=speed_bandwidth * inertia * volts_per_torque,
        reset_rate=_RESET_SHARE * speed_bandwidth,
        load_gain=parameters.load_bandwidth,
        least_torque=parameters.least_torque * drive.standstill_torque(),
        load_inertia=load.inertia,
        load_friction=load.viscous_friction,
        load_coulomb=load.coulomb_friction,
        inertia=inertia,
        friction=drive.effective_friction,
        coulomb=load.coulomb_friction + motor.coulomb_friction / n,
        volts_per_torque=volts_per_torque,
        volts_per_speed=motor.torque_constant / n,
    )
    return ControlLaw(dual_loop_step, constants, row_of(DualLoopState), _take_over)


LAWS = {
    "dual_loop": NamedLaw(
        "dual loop (after ServoProject)", dual_loop, DualLoopParameters(), both_encoders=True, identified=True
    )
}
