"""Equations of motion of a drive with effects: those of `motion.dynamics`, and what each effect adds.

    L di/dt          = V (1 - sag abs(i)/i_stall) - R i - K(theta_m) omega_m
    J_m domega_m/dt  = K(theta_m) i - B_m omega_m - tau_m - cogging(theta_m) - R1 F
    J_w domega_w/dt  = R2 F - R2 F2                                                    with two stages; else F2 = F
    J_i domega_l/dt  = R2 F2 - B_l omega_l - tau_c - m g l sin(theta_l + offset) - dU/dh h' - T - S + tau_l
    J_o domega_o/dt  = T = k (theta_l - theta_o) + c (omega_l - omega_o)               with a load that is not rigid

J_i is the load's inertia without its outer part. S is the torque of a stop at an end of the travel, which pushes and
never pulls. With two stages the first gap is between motor and wheel, the second one between wheel and load; both have
the same contact law. The half gap h grows with time, and friction falls.

The functions here are templates, plain Python; `real_equations` compiles them for a contact law. The state is that of
`effects.state`, and a command is one that `amplifier.amplified` returned.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import (
    Contact,
    EnergyFunction,
    ForceFunction,
    PieceFunction,
    SlopesFunction,
    ToothForce,
)
from backlash_ros.drivetrain.effects.amplifier import sagged
from backlash_ros.drivetrain.effects.constants import effects_in
from backlash_ros.drivetrain.effects.friction import drifted, dry_friction, held, left_of_friction
from backlash_ros.drivetrain.effects.motor import cogging_energy, cogging_torque, torque_constant
from backlash_ros.drivetrain.effects.state import WHOLE, whole_at
from backlash_ros.drivetrain.motion.dynamics import Acting, Held, HeldTorque, SpeedSlopes, half_gap_of, mesh_of
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOST, OMEGA_L, OMEGA_M, SUPPLIED, THETA_L, THETA_M

_contact_force: ForceFunction = unbound
_contact_energy: EnergyFunction = unbound
_contact_slopes: SlopesFunction = unbound
_contact_piece: PieceFunction = unbound


@compiled
def grown(plant: PlantConstants, age: float) -> float:
    """Return the half gap after ``age`` seconds over that at the start."""
    return 1.0 + effects_in(plant.effects).growth * drifted(plant, age)


Gaps = tuple[float, float, float, float, float, float]
"""Gap, its rate and half the backlash, of the first stage and of the second, m and m/s."""


@compiled
def gaps_of(plant: PlantConstants, state: Array) -> Gaps:
    """Return the gaps of both stages; with one stage, twice its own."""
    half_gap, _, _ = half_gap_of(plant, state[THETA_L])
    half_gap *= grown(plant, whole_at(state).age)
    share = effects_in(plant.effects).first_gap
    theta_m, omega_m = plant.R1 * state[THETA_M], plant.R1 * state[OMEGA_M]
    theta_l, omega_l = plant.R2 * state[THETA_L], plant.R2 * state[OMEGA_L]
    if share == 1.0:
        gap, rate = theta_m - theta_l, omega_m - omega_l
        return gap, rate, half_gap, gap, rate, half_gap
    whole = whole_at(state)
    wheel, omega_wheel = plant.R2 * whole.wheel_angle, plant.R2 * whole.wheel_speed
    first, second = share * half_gap, (1.0 - share) * half_gap
    return theta_m - wheel, omega_m - omega_wheel, first, wheel - theta_l, omega_wheel - omega_l, second


@compiled
def beyond_stop(plant: PlantConstants, state: Array) -> float:
    """Return how far the load is beyond the stop at an end of its travel, rad; 0 between both."""
    effects, angle = effects_in(plant.effects), state[THETA_L]
    return float(max(angle - effects.upper_stop, 0.0) + min(angle - effects.lower_stop, 0.0))


@compiled
def stop_torque(plant: PlantConstants, state: Array) -> float:
    """Return the torque S with which a stop brakes the load, N m: it pushes, and never pulls."""
    beyond = beyond_stop(plant, state)
    if beyond == 0.0:
        return 0.0
    effects = effects_in(plant.effects)
    torque = effects.k_stop * beyond + effects.c_stop * state[OMEGA_L]
    return float(torque if torque * beyond > 0.0 else 0.0)


def contact_of(plant: PlantConstants, state: Array) -> ToothForce:
    """Return force, stiffness, damping, elastic force and its stiffness of the teeth on the load."""
    _, _, _, gap, gap_rate, half_gap = gaps_of(plant, state)
    return _contact_force(plant.contact, half_gap, gap, gap_rate)


def rate_of(plant: PlantConstants, state: Array) -> float:
    """Return about the fastest rate of the motion at ``state``, 1/s."""
    gap, gap_rate, half_gap, second, second_rate, second_half = gaps_of(plant, state)
    tooth = _contact_force(plant.contact, half_gap, gap, gap_rate)
    stiffness, damping = abs(tooth[1]), abs(tooth[2])
    per_mass = plant.R1 * plant.R1 * plant.per_inertia_m * max(1.0, plant.forward)
    lighter = plant.R2 * plant.R2 * plant.per_inertia_l
    if effects_in(plant.effects).first_gap != 1.0:
        tooth = _contact_force(plant.contact, second_half, second, second_rate)
        stiffness, damping = max(stiffness, abs(tooth[1])), max(damping, abs(tooth[2]))
        lighter += plant.R2 * plant.R2 / effects_in(plant.effects).J_wheel
    per_mass += lighter
    stop = (
        math.sqrt(effects_in(plant.effects).k_stop * plant.per_inertia_l) if beyond_stop(plant, state) != 0.0 else 0.0
    )
    return float(max(plant.rate, damping * per_mass, math.sqrt(stiffness * per_mass), stop))


_gap_torques: Callable[[PlantConstants, Array, Gaps, ToothForce, ToothForce], tuple[float, float]] = unbound


def gap_torques(
    plant: PlantConstants, state: Array, gaps: Gaps, first: ToothForce, second: ToothForce
) -> tuple[float, float]:
    """Return dU/dh h', which brakes the load where the gap narrows (N m), and the power lost as the gap grows, W."""
    moves, grows = plant.variation != 0.0, effects_in(plant.effects).growth != 0.0
    if not (moves or grows):
        return 0.0, 0.0
    half_gap, slope, _ = half_gap_of(plant, state[THETA_L])
    by_half_gap = _contact_slopes(plant.contact, gaps[2], gaps[0], first)[0]
    share = effects_in(plant.effects).first_gap
    if share != 1.0:
        second_slope = _contact_slopes(plant.contact, gaps[5], gaps[3], second)[0]
        by_half_gap = share * by_half_gap + (1.0 - share) * second_slope
    growth = effects_in(plant.effects).growth * effects_in(plant.effects).per_drift_time
    if whole_at(state).age * effects_in(plant.effects).per_drift_time >= 1.0:
        growth = 0.0
    return by_half_gap * slope * grown(plant, whole_at(state).age), -by_half_gap * half_gap * growth


def held_torque(plant: PlantConstants, state: Array, load_torque: float) -> Held:
    """Return the torques on both shafts at rest, and those that friction holds: as `dynamics.held_torque`."""
    gaps = gaps_of(plant, state)
    first = _contact_force(plant.contact, gaps[2], gaps[0], gaps[1])
    second = _contact_force(plant.contact, gaps[5], gaps[3], gaps[4])
    on_load = plant.R2 * second[0] + load_torque - _gap_torques(plant, state, gaps, first, second)[0]
    on_load -= plant.gravity * math.sin(state[THETA_L] + plant.gravity_offset) + twist_torque(plant, state)
    on_load -= stop_torque(plant, state)
    teeth = plant.R1 * first[0]
    forward, backward = plant.forward * teeth, plant.backward * teeth
    least, most = held(plant, plant.coulomb_m, whole_at(state).age)
    load_least, load_most = held(plant, plant.coulomb_l, whole_at(state).age)
    on_motor = torque_constant(plant, state[THETA_M]) * state[CURRENT] - cogging_torque(plant, state[THETA_M])
    return on_motor, min(forward, backward) + least, max(forward, backward) + most, on_load, load_least, load_most


@compiled
def twist_torque(plant: PlantConstants, state: Array) -> float:
    """Return the torque T that the outer part of the load takes from the rest, N m."""
    effects = effects_in(plant.effects)
    if effects.J_outer == 0.0:
        return 0.0
    whole = whole_at(state)
    twist, rate = state[THETA_L] - whole.outer_angle, state[OMEGA_L] - whole.outer_speed
    return float(effects.k_outer * twist + effects.c_outer * rate)


def derivative(plant: PlantConstants, state: Array, acting: Acting, out: Array) -> float:
    """Write d(state)/dt into ``out``, both of shape (WHOLE,); return the largest force of the teeth, N."""
    command, load_torque, slip_m, slip_l = acting
    effects = effects_in(plant.effects)
    omega_m, omega_l, current = state[OMEGA_M], state[OMEGA_L], state[CURRENT]
    constant, left = torque_constant(plant, state[THETA_M]), left_of_friction(plant, whole_at(state).age)
    voltage = sagged(plant, command, current)
    out[CURRENT] = (voltage - plant.R * current - constant * omega_m) * plant.per_inductance
    gaps = gaps_of(plant, state)
    first = _contact_force(plant.contact, gaps[2], gaps[0], gaps[1])
    second = first
    if effects.first_gap != 1.0:
        second = _contact_force(plant.contact, gaps[5], gaps[3], gaps[4])
    narrowing, worn = _gap_torques(plant, state, gaps, first, second)
    twist = twist_torque(plant, state)
    teeth = mesh_of(plant, first[0], slip_m) * plant.R1 * first[0]
    rub_m = left * (plant.B_m * omega_m + dry_friction(plant, plant.coulomb_m, effects.per_stribeck_m, omega_m, slip_m))
    rub_l = left * (plant.B_l * omega_l + dry_friction(plant, plant.coulomb_l, effects.per_stribeck_l, omega_l, slip_l))
    on_motor = constant * current - cogging_torque(plant, state[THETA_M]) - rub_m - teeth
    weight = plant.gravity * math.sin(state[THETA_L] + plant.gravity_offset) if plant.gravity != 0.0 else 0.0
    stop, beyond = stop_torque(plant, state), beyond_stop(plant, state)
    on_load = plant.R2 * second[0] + load_torque - rub_l - weight - narrowing - twist - stop
    out[THETA_M], out[THETA_L] = omega_m, omega_l
    out[OMEGA_M] = on_motor * plant.per_inertia_m if slip_m != 0.0 else 0.0
    out[OMEGA_L] = on_load * plant.per_inertia_l if slip_l != 0.0 else 0.0
    whole, change = whole_at(state), whole_at(out)
    change.wheel_angle = change.wheel_speed = change.outer_angle = change.outer_speed = 0.0
    lost = rub_m * omega_m + rub_l * omega_l + worn + plant.R * current * current
    lost += (teeth - plant.R1 * first[0]) * omega_m + (first[0] - first[3]) * gaps[1]
    if effects.first_gap != 1.0:
        change.wheel_angle = whole.wheel_speed
        change.wheel_speed = plant.R2 * (first[0] - second[0]) / effects.J_wheel
        lost += (second[0] - second[3]) * gaps[4]
    if effects.J_outer != 0.0:
        change.outer_angle = whole.outer_speed
        change.outer_speed = twist / effects.J_outer
        lost += effects.c_outer * (omega_l - whole.outer_speed) ** 2
    lost += (stop - effects.k_stop * beyond) * omega_l
    change.age = 1.0
    if math.isinf(plant.L):
        voltage = plant.R * current + constant * omega_m
    out[SUPPLIED], out[LOST] = voltage * current + load_torque * omega_l, lost
    return float(max(abs(first[0]), abs(second[0])))


Derivative = Callable[[PlantConstants, Array, Acting, Array], float]
_derivative: Derivative = unbound


def speed_slopes(plant: PlantConstants, state: Array, acting: Acting) -> SpeedSlopes:
    """Return how the speeds of motor and load change: of `derivative`."""
    work = np.empty(WHOLE)
    _derivative(plant, state, acting, work)
    return work[OMEGA_M], work[OMEGA_L]


def piece_of(plant: PlantConstants, state: Array, slip_m: float) -> tuple[int, float]:
    """Return in which smooth piece of the equations a state is, and the rate of the gap, m/s.

    The piece is that of both contacts, and which way power flows.
    """
    gap, gap_rate, half_gap, second, second_rate, second_half = gaps_of(plant, state)
    piece = 2 * _contact_piece(plant.contact, half_gap, gap, gap_rate)
    if plant.forward != 1.0 or plant.backward != 1.0:
        piece += 1 if _contact_force(plant.contact, half_gap, gap, gap_rate)[0] * slip_m > 0.0 else 0
    if effects_in(plant.effects).first_gap != 1.0:
        piece += 100 * _contact_piece(plant.contact, second_half, second, second_rate)
    return piece + (10000 if stop_torque(plant, state) != 0.0 else 0), gap_rate


def stored_energy(plant: PlantConstants, state: Array) -> float:
    """Return the kinetic, magnetic, elastic and potential energy, J: as `dynamics.stored_energy`."""
    effects = effects_in(plant.effects)
    gap, _, half_gap, second, _, second_half = gaps_of(plant, state)
    energy = 0.5 * (plant.J_m * state[OMEGA_M] ** 2 + plant.J_l * state[OMEGA_L] ** 2)
    energy += 0.0 if math.isinf(plant.L) else 0.5 * plant.L * state[CURRENT] ** 2
    energy += plant.gravity * (1.0 - math.cos(state[THETA_L] + plant.gravity_offset))
    energy += cogging_energy(plant, state[THETA_M]) + _contact_energy(plant.contact, half_gap, gap)
    if effects.first_gap != 1.0:
        energy += _contact_energy(plant.contact, second_half, second)
        energy += 0.5 * effects.J_wheel * whole_at(state).wheel_speed ** 2
    if effects.J_outer != 0.0:
        twist = state[THETA_L] - whole_at(state).outer_angle
        energy += 0.5 * (effects.J_outer * whole_at(state).outer_speed ** 2 + effects.k_outer * twist * twist)
    energy += 0.5 * effects.k_stop * beyond_stop(plant, state) ** 2
    return float(energy)


class RealEquations(NamedTuple):
    """The functions of this file, compiled for one contact law; each is described at its template."""

    contact_of: Callable[[PlantConstants, Array], ToothForce]
    rate_of: Callable[[PlantConstants, Array], float]
    held_torque: HeldTorque
    derivative: Derivative
    speed_slopes: Callable[[PlantConstants, Array, Acting], SpeedSlopes]
    piece_of: Callable[[PlantConstants, Array, float], tuple[int, float]]
    stored_energy: Callable[[PlantConstants, Array], float]


@cache
def real_equations(law: type[Contact]) -> RealEquations:
    """Return the equations of motion of drives with effects, compiled for a contact law."""
    force: dict[str, Any] = {"_contact_force": law.force}
    narrowing: dict[str, Any] = {"_gap_torques": specialize(gap_torques, _contact_slopes=law.half_gap_slopes)}
    slopes = specialize(derivative, **force, **narrowing)
    return RealEquations(
        contact_of=specialize(contact_of, **force),
        rate_of=specialize(rate_of, **force),
        held_torque=specialize(held_torque, **force, **narrowing),
        derivative=slopes,
        speed_slopes=specialize(speed_slopes, _derivative=slopes),
        piece_of=specialize(piece_of, _contact_piece=law.piece, **force),
        stored_energy=specialize(stored_energy, _contact_energy=law.energy),
    )
