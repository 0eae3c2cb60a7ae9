"""A law for drives with both encoders: it plans the position of the teeth, so that they neither strike nor rattle.

The motor is controlled on its own encoder alone, so no gap makes the loop unstable. The load's angle only serves the
plans: see `plan` for moves, `step` for holding, `observers` for the estimates. While the gap is unknown, the drive not
identified or an encoder missing, the over-damped gains act: slower, and quiet with any load.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from backlash_ros.control.law import FAST_REGION, REGION, ControlLaw, NamedLaw
from backlash_ros.control.laws.two_encoder.layout import (
    AFTER,
    BACK_EMF,
    BEFORE,
    BRAKE,
    CLEAR,
    CONSTANTS,
    COULOMB,
    CROSSING,
    DAMPING,
    DELAY,
    ELECTRICAL,
    EXPECTED,
    EXPECTED_COSINE,
    EXPECTED_SINE,
    FLANK,
    FRICTION,
    GAIN,
    GAP,
    INERTIA,
    KEPT,
    LOAD_UNEXPLAINED,
    MEMORY,
    MOTOR_COULOMB,
    MOTOR_FRICTION,
    MOTOR_INERTIA,
    MOTOR_UNEXPLAINED,
    NO_LOAD,
    PARKED,
    PERIOD,
    PHASE,
    POINTS,
    PUSH,
    RATIO,
    RESISTANCE,
    STALL,
    STIFFNESS,
    TEETH,
    TRUST,
    VOLTS_PER_SPEED,
    VOLTS_PER_TORQUE,
    WHOLE,
)
from backlash_ros.control.laws.two_encoder.step import begin, two_encoder_step
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.contact import gap_at_rest
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_USUAL_GAP = 0.02
"""Gap, rad, for which `TwoEncoderParameters.crossing_time` holds; the time grows with the root of the gap."""
_ACCELERATION, _CHANGE, _READING = 20.0, 1.2, 4.5e-5
"""Noise of the motor's observer: acceleration at the output, rad/s^2, change of torque per second, N m, and error of a
reading, rad, which includes a count of 14 bit before a 10:1 gear."""
_PROMPT, _FASTER = 6e-3, 2.0
"""Delay of a loop, s, its sampling's included, up to which the bandwidths grow as it is shorter, up to this factor."""
_INSTANT = 2e4
"""Rate, 1/s, with which an imposed current is reached."""
_NO_FRICTION = 2e-4
"""Share of the standstill torque below which dry friction counts as 0: a shaft coasts, and less is not identified."""
_STEEPEST = 0.2
"""Largest growth of the load torque with the load's angle, as a share of the standstill torque, 1/rad."""
_LEAST, _STEP = 2e-3, 1.8
"""First torque of the table of the teeth, N m, and ratio of one torque to the next."""
_PUSHES = 1e-6
"""Torque of the teeth, as a share of the standstill torque, that moves no load."""


@dataclass(frozen=True)
class TwoEncoderParameters(Validated):
    """Times of its moves and bandwidths of its loops."""

    section: ClassVar[str] = "laws.two_encoder"

    crossing_time: float = quantity(
        "time in which the motor crosses a gap of 0.02 rad; longer for a wider gap",
        "s",
        at_least=1e-3,
        at_most=10,
        default=0.022,
    )
    push_time: float = quantity(
        "time for which the load is pushed; longer if the motor is too weak",
        "s",
        at_least=1e-3,
        at_most=10,
        default=0.03,
    )
    brake_time: float = quantity(
        "longest time for which the load is braked", "s", at_least=1e-3, at_most=10, default=0.08
    )
    bandwidth: float = quantity(
        "bandwidth of the motor's own loop; up to twice as much where sampling and delay allow it",
        "rad/s",
        above=0,
        at_most=1e4,
        default=56.6,
    )
    torque_bandwidth: float = quantity(
        "bandwidth of the compensation for torques that the plan did not foresee; grows with bandwidth",
        "rad/s",
        above=0,
        at_most=1e4,
        default=40.0,
    )


def _models(drive: Drive, period: float, rest: float) -> tuple[Array, Array, Array]:
    """Return the motor's model over a period, over the period less ``rest``, and over ``rest`` (s): shape (6, 6).

    States: p (rad), w (rad/s), the torque of the current and a constant disturbance (N m, at the output). Inputs, also
    constant: the command (V or A) and the torque of the teeth, N m.
    """
    motor, n = drive.motor, drive.gear.ratio
    per_ampere, inertia = motor.torque_constant / n, drive.reflected_inertia
    a = np.zeros((6, 6))
    a[0, 1] = 1.0
    a[1, 1:4] = -motor.viscous_friction / n**2 / inertia, 1.0 / inertia, -1.0 / inertia
    a[1, 5] = -1.0 / inertia
    if drive.takes_current:
        a[2, 2], a[2, 4] = -_INSTANT, _INSTANT * per_ampere
    else:
        a[2, 1:3] = -(per_ampere**2) / motor.inductance, -motor.resistance / motor.inductance
        a[2, 4] = per_ampere / motor.inductance
    return expm(a * period), expm(a * (period - rest)), expm(a * rest)


def two_encoder(drive: Drive, settings: "ServoSettings", parameters: TwoEncoderParameters) -> ControlLaw:
    """Design the law for ``drive`` as identified, its delay and the learned gap.

    Raises
    ------
    ValueError
        If the motor's observer cannot be designed, the expected load torque is too steep, or the delay too long.
    """
    motor, gear, load, n = drive.motor, drive.gear, drive.load, drive.gear.ratio
    period, delay, inertia, b = settings.period, settings.loop_delay, drive.reflected_inertia, settings.backlash_angle
    if delay > (KEPT - 2) * period * (1.0 + 1e-9):
        raise ValueError(
            f"loop_delay must be at most {KEPT - 2} periods, {(KEPT - 2) * period:g} s, for law = 'two_encoder', "
            f"got {delay!r}"
        )
    whole = int(delay / period + 1e-9)
    rest = delay - whole * period
    full, after, before = _models(drive, period, rest if rest > 1e-9 * period else 0.0)
    unforeseen = np.diag([0.0, (_ACCELERATION * period) ** 2, 0.0, _CHANGE**2 * period])
    angle, off = np.array([[1.0, 0.0, 0.0, 0.0]]), _READING**2
    try:
        spread = solve_discrete_are(full[:4, :4].T, angle.T, unforeseen, [[off]])
    except ValueError as error:
        raise ValueError(f"law = 'two_encoder' cannot be designed for this drive: {error}") from error
    slope, at = settings.expected_load_torque_slope, settings.expected_load_torque_angle
    if abs(slope) > _STEEPEST * drive.standstill_torque():
        raise ValueError(
            f"expected_load_torque_slope must be within {_STEEPEST * drive.standstill_torque():.3g} N m/rad for "
            f"law = 'two_encoder', a fifth of the standstill torque per rad, got {slope!r}"
        )
    faster = min(max(_PROMPT / (1.5 * period + delay), 1.0), _FASTER)
    law = np.zeros(CONSTANTS)
    law[GAIN : GAIN + 4] = spread[:, 0] / (spread[0, 0] + off)
    law[AFTER : AFTER + 24], law[BEFORE : BEFORE + 24] = after[:4].ravel(), before[:4].ravel()
    dry = motor.coulomb_friction / n, load.coulomb_friction
    motor_dry, load_dry = (torque if torque > _NO_FRICTION * drive.standstill_torque() else 0.0 for torque in dry)
    values = {
        PERIOD: period,
        DELAY: delay,
        WHOLE: whole,
        RATIO: n,
        MOTOR_INERTIA: inertia,
        MOTOR_FRICTION: motor.viscous_friction / n**2,
        MOTOR_COULOMB: motor_dry,
        INERTIA: load.inertia,
        FRICTION: load.viscous_friction,
        COULOMB: load_dry,
        GAP: b,
        STALL: drive.standstill_torque(),
        NO_LOAD: motor.voltage_limit / motor.torque_constant * n,
        VOLTS_PER_TORQUE: motor.resistance * n / motor.torque_constant,
        VOLTS_PER_SPEED: motor.torque_constant / n,
        BACK_EMF: motor.torque_constant if drive.takes_current else 0.0,
        RESISTANCE: motor.resistance if drive.takes_current else 1.0,
        ELECTRICAL: 0.0 if drive.takes_current else motor.inductance / motor.resistance,
        STIFFNESS: inertia * (faster * parameters.bandwidth) ** 2,
        DAMPING: inertia * math.sqrt(2.0) * faster * parameters.bandwidth,
        TRUST: -math.expm1(-faster * parameters.torque_bandwidth * period),
        CROSSING: parameters.crossing_time * max(1.0, math.sqrt(b / _USUAL_GAP)),
        PUSH: parameters.push_time,
        BRAKE: parameters.brake_time,
        EXPECTED: settings.expected_load_torque,
        EXPECTED_SINE: slope * math.cos(at),
        EXPECTED_COSINE: -slope * math.sin(at),
        MOTOR_UNEXPLAINED: settings.unexplained_motor_torque,
        LOAD_UNEXPLAINED: settings.unexplained_load_torque,
    }
    law[list(values)] = list(values.values())
    constants, half_gap = gear.contact.constants(gear.load_radius, drive.contact_mass), 0.5 * b * gear.load_radius

    def reach(torque: float) -> float:
        return gap_at_rest(gear.contact, constants, half_gap, torque / gear.load_radius) / gear.load_radius

    torques = _LEAST * _STEP ** np.arange(POINTS)
    law[TEETH : TEETH + POINTS] = torques
    law[TEETH + POINTS :] = [reach(torque) for torque in torques]
    law[CLEAR] = reach(_PUSHES * drive.standstill_torque())
    state = np.zeros(MEMORY)
    state[REGION], state[PARKED] = FAST_REGION, -1.0
    return ControlLaw(two_encoder_step, law, state, begin, {"phase": PHASE, "flank": FLANK})


LAWS = {
    "two_encoder": NamedLaw(
        "planned for two encoders", two_encoder, TwoEncoderParameters(), both_encoders=True, identified=True
    )
}
