"""The design of the law for a drive: its loops, its observer of the motor and the table of its teeth."""

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from backlash_ros.control.law import ControlLaw
from backlash_ros.control.laws.planned.alone.design import alone_constants
from backlash_ros.control.laws.planned.alone.memory import AloneMemory
from backlash_ros.control.laws.planned.alone.start import take_over_alone
from backlash_ros.control.laws.planned.alone.step import alone_step
from backlash_ros.control.laws.planned.constants import FINEST_ERROR, TABLE_SIZE, Constants, constants_at
from backlash_ros.control.laws.planned.memory import REMEMBERED, LoadTorque, Memory
from backlash_ros.control.laws.planned.motor import FULL_FRICTION_SPEED
from backlash_ros.control.laws.planned.parameters import PlannedParameters
from backlash_ros.control.laws.planned.start import take_over
from backlash_ros.control.laws.planned.step import planned_step
from backlash_ros.control.laws.planned.unit import time_unit
from backlash_ros.control.settings import BOTH
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.contact import gap_at_rest
from backlash_ros.foundation.record import Array, cell_of, row_of

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

_USUAL_GAP = 0.02
"""Gap, rad, for which `PlannedParameters.crossing_time` holds; the time grows with the root of the gap."""
_ACCELERATION_NOISE = 20.0
"""Noise of the motor's observer: acceleration at the output, rad/s^2. Tuned on the populations."""
_TORQUE_NOISE = 600.0
"""Noise of the motor's observer: change of torque within a second, as acceleration of the motor, rad/s^2. Tuned on the
populations."""
_PROMPT = 6e-3
"""Delay of a loop, s, its sampling's included, up to which the bandwidths grow as it is shorter. Tuned on the
populations."""
_MOST_FASTER = 2.0
"""Factor by which the bandwidths grow at most. Tuned on the populations."""
_INSTANT = 2e4
"""Rate, 1/s, with which an imposed current is reached: at once."""
_FRICTION_RATE = 40.0
"""Rate, 1/s, with which a motor that dry friction keeps from its target goes there. Tuned on the populations."""
_OVERCOMES = 0.05
"""With one encoder, the largest distance from its target, as a share of the gap, at which dry friction may keep the
motor: there nothing else adds up what is missing. Tuned on the populations."""
_NO_FRICTION = 2e-4
"""Share of the standstill torque below which dry friction counts as 0: a shaft coasts, and less is not identified."""
_LEAST_EXCESS = 1.0
"""Torque beyond the friction, as acceleration of the motor, rad/s^2, from which on a load torque holds the load, if all
torques are explained. Tuned on the populations."""
_MOST_EXCESS = 2.0
"""The same if they are not, or if one encoder cannot tell. Tuned on the populations."""
_DOUBTED = 0.25
"""Share of the load torque that identification could not explain, which is added to the least. Tuned on the
populations."""
_STEEPEST = 0.2
"""Largest growth of the load torque with the load's angle, as a share of the standstill torque, 1/rad: what is steeper
is no weight."""
_FIRST_TORQUE = 1.0
"""First torque of the table of the teeth, as acceleration of the motor, rad/s^2. Tuned on the populations."""
_TORQUE_RATIO = 1.8
"""Ratio of one torque of the table of the teeth to the next. Tuned on the populations."""
_FREE_TORQUE = 1e-6
"""Torque of the teeth, as a share of the standstill torque, that moves no load."""
_MORE_AHEAD = 3
"""Periods of a path that the law wants to see beyond half a crossing and the delay: it looks one further on, and the
torque must keep its new sign."""
_ROUNDING = 1e-9
"""Share of a period that is rounding, where a delay is counted in periods."""


def _models(drive: Drive, constants: Constants) -> tuple[Array, Array, Array]:
    """Return the motor's model over a period, over the period less the rest of the delay, and over it: shape (6, 6).

    States: p (rad), w (rad/s), the torque of the current and a constant disturbance (N m, at the output). Inputs, also
    constant: the command (V or A) and the torque of the teeth, N m.
    """
    period, rest, unit = constants.period, constants.rest_of_delay, constants.unit
    motor, inertia, per_ampere = drive.motor, constants.motor_inertia, drive.motor.torque_constant / drive.gear.ratio
    a = np.zeros((6, 6))
    a[0, 1] = 1.0
    a[1, 1:4] = -constants.motor_friction / inertia, 1.0 / inertia, -1.0 / inertia
    a[1, 5] = -1.0 / inertia
    if drive.takes_current:
        a[2, 2], a[2, 4] = -_INSTANT, _INSTANT * per_ampere
    else:
        a[2, 1:3] = -(per_ampere**2) / motor.inductance, -motor.resistance / motor.inductance * unit
        a[2, 4] = per_ampere / motor.inductance * unit
    return expm(a * period), expm(a * (period - rest)), expm(a * rest)


def _gain(model: Array, period: float, inertia: float, reading_error: float) -> Array:
    """Return the gain of the motor's observer, shape (4,), for its model over a period; the error is in rad."""
    changed = _TORQUE_NOISE * inertia
    unforeseen = np.diag([0.0, (_ACCELERATION_NOISE * period) ** 2, 0.0, changed**2 * period])
    angle, off = np.array([[1.0, 0.0, 0.0, 0.0]]), reading_error**2
    try:
        spread = solve_discrete_are(model[:4, :4].T, angle.T, unforeseen, [[off]])
    except ValueError as error:
        raise ValueError(f"law = 'planned' cannot be designed for this drive: {error}") from error
    gain: Array = spread[:, 0] / (spread[0, 0] + off)
    return gain


def _check(drive: Drive, settings: "ServoSettings") -> None:
    """Refuse a delay that is too long and a load torque that is too steep."""
    period, delay, slope = settings.period, settings.loop_delay, settings.expected_load_torque_slope
    most, steepest = REMEMBERED - 2, _STEEPEST * drive.standstill_torque()
    if delay > most * period * (1.0 + _ROUNDING):
        raise ValueError(
            f"loop_delay must be at most {most} periods, {most * period:g} s, for law = 'planned', got {delay!r}"
        )
    if abs(slope) > steepest:
        raise ValueError(
            f"expected_load_torque_slope must be within {steepest:.3g} N m/rad for "
            f"law = 'planned', a fifth of the standstill torque per rad, got {slope!r}"
        )


def _dry_frictions(drive: Drive) -> tuple[float, float]:
    """Return the dry friction of motor and load at the output, N m; 0 if it is next to none."""
    least = _NO_FRICTION * drive.standstill_torque()
    motor, load = drive.motor.coulomb_friction / drive.gear.ratio, drive.load.coulomb_friction
    return motor if motor > least else 0.0, load if load > least else 0.0


def _loops(period: float, delay: float, inertia: float, parameters: PlannedParameters) -> dict[str, float]:
    """Return stiffness and damping of the motor's loop, and how fast the compensation is."""
    faster = min(max(_PROMPT / (1.5 * period + delay), 1.0), _MOST_FASTER)
    return {
        "stiffness": inertia * (faster * parameters.bandwidth) ** 2,
        "damping": inertia * math.sqrt(2.0) * faster * parameters.bandwidth,
        "compensation_share": -math.expm1(-faster * parameters.torque_bandwidth * period),
    }


def _motor(drive: Drive, largest_command: float, unit: float) -> dict[str, float]:
    """Return what the motor can do, and which voltage that takes; the largest command is in V or A."""
    motor, n = drive.motor, drive.gear.ratio
    voltage = motor.voltage_limit if drive.takes_current else min(motor.voltage_limit, largest_command)
    return {
        "stall_torque": drive.standstill_torque(),
        "available_torque": drive.standstill_torque(largest_command),
        "no_load_speed": voltage / motor.torque_constant * n * unit,
        "volts_per_torque": motor.resistance * n / motor.torque_constant,
        "volts_per_speed": motor.torque_constant / n / unit,
        "back_emf": motor.torque_constant if drive.takes_current else 0.0,
        "resistance": motor.resistance if drive.takes_current else 1.0,
        "electrical_time": 0.0 if drive.takes_current else motor.inductance / motor.resistance / unit,
    }


def _expected(settings: "ServoSettings", motor_inertia: float) -> dict[str, float]:
    """Return the load torque as expected, what nothing explains, and from which torque on the load is held."""
    slope, angle = settings.expected_load_torque_slope, settings.expected_load_torque_angle
    most = _MOST_EXCESS * motor_inertia
    excess = _LEAST_EXCESS * motor_inertia + _DOUBTED * settings.unexplained_load_torque
    return {
        "expected_load_torque": settings.expected_load_torque,
        "expected_sine": slope * math.cos(angle),
        "expected_cosine": -slope * math.sin(angle),
        "unexplained_motor_torque": settings.unexplained_motor_torque,
        "unexplained_load_torque": settings.unexplained_load_torque,
        "holding_excess": min(excess, most) if settings.encoders == BOTH else most,
    }


def _teeth(drive: Drive, gap: float, motor_inertia: float) -> dict[str, Array | float]:
    """Return the table of the teeth, and where they are clear of a free load."""
    gear = drive.gear
    contact, half_gap = gear.contact.constants(gear.load_radius, drive.contact_mass), 0.5 * gap * gear.load_radius

    def distance(torque: float) -> float:
        return gap_at_rest(gear.contact, contact, half_gap, torque / gear.load_radius) / gear.load_radius

    first = _FIRST_TORQUE * motor_inertia
    torques = np.array([first * _TORQUE_RATIO**k for k in range(TABLE_SIZE)])
    return {
        "teeth_torques": torques,
        "teeth_distances": np.array([distance(torque) for torque in torques]),
        "clear_distance": distance(_FREE_TORQUE * drive.standstill_torque()),
    }


def _constants(drive: Drive, settings: "ServoSettings", parameters: PlannedParameters) -> Array:
    """Return the law's constants but for the motor's observer."""
    unit, b = time_unit(drive, settings), settings.backlash_angle
    period, delay = settings.period / unit, settings.loop_delay / unit
    whole = int(delay / period + _ROUNDING)
    rest, (motor_dry, load_dry) = delay - whole * period, _dry_frictions(drive)
    motor_inertia = drive.reflected_inertia / unit**2
    return row_of(
        Constants,
        unit=unit,
        period=period,
        delay=delay,
        whole_periods=whole,
        rest_of_delay=rest if rest > _ROUNDING * period else 0.0,
        ratio=drive.gear.ratio,
        motor_inertia=motor_inertia,
        motor_friction=drive.motor.viscous_friction / drive.gear.ratio**2 / unit,
        motor_dry_friction=motor_dry,
        friction_rate=_FRICTION_RATE
        if settings.encoders == BOTH
        else max(_FRICTION_RATE, FULL_FRICTION_SPEED / (_OVERCOMES * b)),
        load_inertia=drive.load.inertia / unit**2,
        load_friction=drive.load.viscous_friction / unit,
        load_dry_friction=load_dry,
        gap=b,
        crossing_time=parameters.crossing_time * max(1.0, math.sqrt(b / _USUAL_GAP)),
        push_time=parameters.push_time,
        brake_time=parameters.brake_time,
        **_motor(drive, settings.largest_command, unit),
        **_loops(period, delay, motor_inertia, parameters),
        **_expected(settings, motor_inertia),
        **_teeth(drive, b, motor_inertia),
    )


def planned(drive: Drive, settings: "ServoSettings", parameters: PlannedParameters) -> ControlLaw:
    """Design the law for ``drive`` as identified, its delay and the learned gap.

    Raises
    ------
    ValueError
        If the motor's observer cannot be designed, the expected load torque is too steep, or the delay too long.
    """
    _check(drive, settings)
    row = _constants(drive, settings, parameters)
    constants = constants_at(row)
    full, after, before = _models(drive, constants)
    for model, found in ((constants.after, after), (constants.before, before)):
        model.angle[:], model.speed[:], model.current_torque[:] = found[:3]
    for doubled, gain in enumerate(constants.gains):
        gain.angle, gain.speed, gain.current_torque, gain.disturbance = _gain(
            full, constants.period, constants.motor_inertia, FINEST_ERROR * 2.0**doubled
        )
    shown = {name: cell_of(Memory, name) for name in ("phase", "flank", "middle")}
    shown["load_torque"] = cell_of(Memory, "load_torque") + cell_of(LoadTorque, "estimated")
    ahead = math.ceil((0.5 * constants.crossing_time + constants.delay) / constants.period) + _MORE_AHEAD
    if settings.encoders == BOTH:
        return ControlLaw(planned_step, row, row_of(Memory), take_over, shown, ahead)
    alone = alone_constants(drive, settings, constants, row)
    return ControlLaw(alone_step, alone, row_of(AloneMemory), take_over_alone, shown, ahead)
