"""Equations of a drive with effects, written down once more for scipy; both shafts slide all the time, or have no dry
friction."""

import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array

MOTOR, MOTOR_SPEED, LOAD, LOAD_SPEED, CURRENT, WHEEL, WHEEL_SPEED, OUTER, OUTER_SPEED = range(9)


def teeth(drive: Drive, twist: float, rate: float, gap: float) -> float:
    """Return the torque of teeth of Hunt and Crossley at the output, N m, for a ``gap`` in rad."""
    law: Any = drive.gear.contact
    depth = abs(twist) - gap / 2
    if depth <= 0:
        return 0.0
    side = math.copysign(1.0, twist)
    return side * law.torque * (depth / law.wind_up) ** law.exponent * max(0.0, 1 + law.dissipation * rate * side)


def dry(drive: Drive, coulomb: float, speed_at_load: float) -> float:
    """Return the dry friction of a sliding shaft, N m."""
    effects, way = drive.effects, math.copysign(1.0, speed_at_load)
    static = 1 + (effects.static_friction - 1) * math.exp(-((speed_at_load / effects.stribeck_speed) ** 2))
    return way * coulomb * static * (1 + way * effects.friction_asymmetry)


def slope(drive: Drive, t: float, x: Array, voltage: float, load_torque: float) -> list[float]:
    """Return d(state)/dt of motor, load, current, wheel and outer part."""
    motor, gear, load, effects = drive.motor, drive.gear, drive.load, drive.effects
    n, drift = gear.ratio, min(t / effects.drift_time, 1.0)
    gap, rub = gear.backlash_angle * (1 + effects.gap_growth * drift), 1 - effects.friction_fall * drift
    angle, speed = n * x[MOTOR], n * x[MOTOR_SPEED]
    if effects.first_gap < 1:
        first = teeth(drive, angle - x[WHEEL], speed - x[WHEEL_SPEED], effects.first_gap * gap)
        second = teeth(drive, x[WHEEL] - x[LOAD], x[WHEEL_SPEED] - x[LOAD_SPEED], (1 - effects.first_gap) * gap)
    else:
        first = second = teeth(drive, angle - x[LOAD], speed - x[LOAD_SPEED], gap)
    constant = motor.torque_constant * (
        1 + effects.torque_ripple * math.cos(effects.torque_ripple_cycles * x[MOTOR] + effects.torque_ripple_phase)
    )
    stall = motor.voltage_limit / motor.resistance
    sagged = voltage * (1 - effects.supply_sag * abs(x[CURRENT]) / stall)
    cogging = effects.cogging * math.sin(effects.cogging_cycles * x[MOTOR] + effects.cogging_phase)
    on_motor = constant * x[CURRENT] - cogging - n * first
    on_motor -= rub * (motor.viscous_friction * x[MOTOR_SPEED] + dry(drive, motor.coulomb_friction, speed))
    outer = effects.outer_share * load.inertia
    omega = 2 * math.pi * effects.outer_frequency
    twist = outer * omega**2 * (x[LOAD] - x[OUTER])
    twist += 2 * effects.outer_damping * omega * outer * (x[LOAD_SPEED] - x[OUTER_SPEED])
    on_load = second + load_torque - twist - load.gravity_torque * math.sin(x[LOAD] + load.gravity_offset)
    on_load -= rub * (load.viscous_friction * x[LOAD_SPEED] + dry(drive, load.coulomb_friction, x[LOAD_SPEED]))
    return [
        x[MOTOR_SPEED],
        on_motor / motor.inertia,
        x[LOAD_SPEED],
        on_load / (load.inertia - outer),
        (sagged - motor.resistance * x[CURRENT] - constant * x[MOTOR_SPEED]) / motor.inductance,
        x[WHEEL_SPEED],
        (first - second) / (effects.wheel_inertia * load.inertia),
        x[OUTER_SPEED],
        twist / outer if outer else 0.0,
    ]


def by_scipy(drive: Drive, pieces: list[tuple[float, float]], period: float, start: list[float] | None = None) -> Array:
    """Return the five states after each of the pieces, voltage and load torque, from the middle of every gap."""
    state = np.zeros(9)
    state[:5] = start or 0.0
    share = drive.effects.first_gap
    for wheel, motor, load in ((WHEEL, MOTOR, LOAD), (WHEEL_SPEED, MOTOR_SPEED, LOAD_SPEED)):
        state[wheel] = (1 - share) * drive.gear.ratio * state[motor] + share * state[load]
    state[OUTER], state[OUTER_SPEED] = state[LOAD], state[LOAD_SPEED]
    rows = []
    for k, (voltage, torque) in enumerate(pieces):
        span = k * period, (k + 1) * period
        done = solve_ivp(
            lambda t, x, *inputs: slope(drive, t, x, *inputs),
            *(span, state),
            method="DOP853",
            args=(voltage, torque),
            rtol=1e-11,
            atol=1e-13,
            max_step=2e-4,
        )
        state = done.y[:, -1]
        rows.append(state[:5])
    return np.array(rows)
