"""Equations of motion of the geared servo: five states, command and load torque in; and the energy account.

State order: `signals.PlantState`.

    L di/dt         = V - R i - K_m omega_m                                                      eq 7
    J_m domega_m/dt = K_m i - B_m omega_m - tau_m - R1 F                                         eqs 2, 8
    J_l domega_l/dt = R2 F - B_l omega_l - tau_c - m g l sin(theta_l + offset) - dU/dh h' + tau_l
                                                              eq 1, with the dots it lost in print

If the command is the current, i is the commanded current and V the voltage that an ideal current loop applies. The
energy account is that at the terminals in both cases.

Friction. A shaft with dry friction slides forward, slides backward or sticks: its *slip* is 1, -1 or 0. A sliding load
is braked by slip tau_c. A sliding motor is braked by its own Coulomb friction and by the friction of the teeth: their
torque at its shaft is R1 F/efficiency_forward while power flows to the load and R1 F efficiency_backward while it flows
to the motor. A shaft that sticks does not move, as long as the torque on it is within the limits of `held_torque`. The
integrator decides when the slip changes: see `integrator`.

Varying backlash. h(theta_l) is half the backlash and U(gap, h) the energy in the teeth. By virtual work, a gap that
narrows as the load turns brakes the load by dU/dh h'.

The functions here are templates, plain Python; `equations_of` compiles them for a contact law.
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
    SlopesFunction,
    ToothForce,
)
from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOST, OMEGA_L, OMEGA_M, SUPPLIED, THETA_L, THETA_M

_PLAIN = False
"""Whether there is no dry friction, no gravity and a gap that does not vary: `equations_with` binds it."""

SLIDES = 1.0
"""The slip given for a shaft without dry friction, where it has no effect."""


@compiled
def gap_of(plant: PlantConstants, state: Array) -> tuple[float, float]:
    """Return the gap R1 theta_m - R2 theta_l (m) and its rate (m/s)."""
    gap = plant.R1 * state[THETA_M] - plant.R2 * state[THETA_L]
    return gap, plant.R1 * state[OMEGA_M] - plant.R2 * state[OMEGA_L]


@compiled
def half_gap_of(plant: PlantConstants, theta_l: float) -> tuple[float, float, float]:
    """Return half the backlash at the load's angle (m) and its first two derivatives by theta_l (m/rad, m/rad^2)."""
    if plant.variation == 0.0:
        return plant.half_gap, 0.0, 0.0
    angle, swing = plant.cycles * theta_l + plant.phase, plant.half_gap * plant.variation
    cosine = math.cos(angle)
    return (
        plant.half_gap + swing * cosine,
        -swing * plant.cycles * math.sin(angle),
        -swing * plant.cycles * plant.cycles * cosine,
    )


@compiled
def motor_rubs(plant: PlantConstants) -> bool:
    """Return whether the motor's shaft has dry friction, of its own or by the teeth."""
    return plant.coulomb_m > 0.0 or plant.forward != 1.0 or plant.backward != 1.0


@compiled
def load_rubs(plant: PlantConstants) -> bool:
    """Return whether the load has dry friction."""
    return plant.coulomb_l > 0.0


_contact_force: ForceFunction = unbound
_contact_energy: EnergyFunction = unbound
_contact_slopes: SlopesFunction = unbound


def contact_of(plant: PlantConstants, state: Array) -> ToothForce:
    """Return force, stiffness, damping, elastic force and its stiffness at ``state``."""
    gap, gap_rate = gap_of(plant, state)
    half_gap, _, _ = half_gap_of(plant, state[THETA_L])
    return _contact_force(plant.contact, half_gap, gap, gap_rate)


class Acting(NamedTuple):
    """What acts on a drive, and the slip of both shafts."""

    command: float  # V, or A where the current is commanded
    load_torque: float  # N m
    slip_m: float = SLIDES
    slip_l: float = SLIDES


Held = tuple[float, float, float, float, float, float]


def held_torque(plant: PlantConstants, state: Array, load_torque: float) -> Held:
    """Return the torques that friction must hold to keep the shafts at rest, and those that it can hold.

    Returns
    -------
    (motor, least, most, load, load_least, load_most) : N m. Torque on the motor's shaft without the teeth, and its
        least and largest values at which the shaft sticks; the same of the load, with the teeth
    """
    gap, gap_rate = gap_of(plant, state)
    half_gap, slope, _ = half_gap_of(plant, state[THETA_L])
    tooth = _contact_force(plant.contact, half_gap, gap, gap_rate)
    on_load = plant.R2 * tooth[0] + load_torque
    if plant.variation != 0.0:
        on_load -= _contact_slopes(plant.contact, half_gap, gap, tooth)[0] * slope
    if plant.gravity != 0.0:
        on_load -= plant.gravity * math.sin(state[THETA_L] + plant.gravity_offset)
    teeth = plant.R1 * tooth[0]
    forward, backward = plant.forward * teeth, plant.backward * teeth
    least, most = min(forward, backward) - plant.coulomb_m, max(forward, backward) + plant.coulomb_m
    return plant.K_m * state[CURRENT], least, most, on_load, -plant.coulomb_l, plant.coulomb_l


Motion = tuple[float, float, float, float, float]
"""Rates of omega_m, omega_l (rad/s^2) and the current (A/s), then the contact force and its elastic part, N."""

_motion: Callable[..., Motion] = unbound


def motion(
    plant: PlantConstants,
    gap: float,
    gap_rate: float,
    theta_l: float,
    omega_m: float,
    omega_l: float,
    current: float,
    acting: Acting,
) -> Motion:
    """Return how the speeds and the current change; the command has no effect if the current is imposed."""
    command, load_torque, slip_m, slip_l = acting
    slope_i = (command - plant.R * current - plant.K_m * omega_m) * plant.per_inductance
    on_motor, on_load = plant.K_m * current - plant.B_m * omega_m, load_torque - plant.B_l * omega_l
    half_gap, slope, mesh = plant.half_gap, 0.0, 1.0
    if not _PLAIN:
        half_gap, slope, _ = half_gap_of(plant, theta_l)
    tooth = _contact_force(plant.contact, half_gap, gap, gap_rate)
    force = tooth[0]
    if not _PLAIN:
        if plant.variation != 0.0:
            on_load -= _contact_slopes(plant.contact, half_gap, gap, tooth)[0] * slope
        if plant.gravity != 0.0:
            on_load -= plant.gravity * math.sin(theta_l + plant.gravity_offset)
        on_motor -= slip_m * plant.coulomb_m
        on_load -= slip_l * plant.coulomb_l
        mesh = mesh_of(plant, force, slip_m)
    # The force comes last, since the next evaluation waits for it.
    slope_m = on_motor * plant.per_inertia_m - (plant.R1 * plant.per_inertia_m * mesh) * force
    slope_l = on_load * plant.per_inertia_l + (plant.R2 * plant.per_inertia_l) * force
    if not _PLAIN:
        slope_m, slope_l = slope_m if slip_m != 0.0 else 0.0, slope_l if slip_l != 0.0 else 0.0
    return slope_m, slope_l, slope_i, force, tooth[3]


@compiled
def mesh_of(plant: PlantConstants, force: float, slip_m: float) -> float:
    """Return the torque of the teeth at the motor's shaft, their friction included, over R1 F."""
    if plant.forward == 1.0 and plant.backward == 1.0:
        return 1.0
    return plant.forward if force * slip_m > 0.0 else plant.backward


@compiled
def motor_friction(plant: PlantConstants, force: float, slip_m: float) -> float:
    """Return the dry friction of the motor's shaft, its own and that of the teeth, N m."""
    return slip_m * plant.coulomb_m + (mesh_of(plant, force, slip_m) - 1.0) * plant.R1 * force


@compiled
def powers(
    plant: PlantConstants,
    omega_m: float,
    omega_l: float,
    current: float,
    force: float,
    elastic: float,
    acting: Acting,
) -> tuple[float, float]:
    """Return the power supplied, at the terminals and by the load torque, and the power lost, W."""
    command, load_torque, slip_m, slip_l = acting
    voltage = plant.R * current + plant.K_m * omega_m if math.isinf(plant.L) else command
    rubbed = (plant.B_m * omega_m + motor_friction(plant, force, slip_m)) * omega_m
    rubbed += (plant.B_l * omega_l + slip_l * plant.coulomb_l) * omega_l
    gap_rate = plant.R1 * omega_m - plant.R2 * omega_l
    return (
        voltage * current + load_torque * omega_l,
        plant.R * current * current + rubbed + (force - elastic) * gap_rate,
    )


SpeedSlopes = tuple[float, float]
"""Rates of omega_m and omega_l, rad/s^2."""


def speed_slopes(plant: PlantConstants, state: Array, acting: Acting) -> SpeedSlopes:
    """Return how the speeds change: of `motion`."""
    gap, gap_rate = gap_of(plant, state)
    omega_m, omega_l, current = state[OMEGA_M], state[OMEGA_L], state[CURRENT]
    slopes = _motion(plant, gap, gap_rate, state[THETA_L], omega_m, omega_l, current, acting)
    return slopes[0], slopes[1]


def derivative(plant: PlantConstants, state: Array, acting: Acting, out: Array) -> None:
    """Write d(state)/dt into ``out``, shape (7,): `motion` and `powers` as arrays."""
    omega_m, omega_l, current = state[OMEGA_M], state[OMEGA_L], state[CURRENT]
    gap, gap_rate = gap_of(plant, state)
    out[THETA_M], out[THETA_L] = omega_m, omega_l
    out[OMEGA_M], out[OMEGA_L], out[CURRENT], force, elastic = _motion(
        plant, gap, gap_rate, state[THETA_L], omega_m, omega_l, current, acting
    )
    out[SUPPLIED], out[LOST] = powers(plant, omega_m, omega_l, current, force, elastic, acting)


class Slopes(NamedTuple):
    """The parts of the Jacobian of the equations of motion; `jacobian` puts them together.

    ``force_*`` are derivatives of F, ``elastic_*`` of its elastic part and ``torque_*`` of the load's own torques, by
    theta_m, theta_l (N/rad, N m/rad) and by the gap rate (N s/m). ``per_force_*``, ``per_torque``, ``per_current`` and
    ``drag_*`` are accelerations for each newton, newton metre, ampere and rad/s: 0 for a shaft that sticks. ``lost_*``
    are derivatives of the power lost.
    """

    force_m: float
    force_l: float
    force_rate: float
    elastic_m: float
    elastic_l: float
    torque_m: float
    torque_l: float
    per_force_m: float
    per_force_l: float
    per_torque: float
    per_current: float
    drag_m: float
    drag_l: float
    lost_m: float
    lost_l: float
    lost_current: float
    lost_force: float
    lost_rate: float
    gap_rate: float


def linearize(plant: PlantConstants, state: Array, slip_m: float, slip_l: float) -> Slopes:
    """Return the parts of the Jacobian at ``state``, for the slip of motor and load."""
    gap, gap_rate = gap_of(plant, state)
    half_gap, slope, bend = half_gap_of(plant, state[THETA_L])
    tooth = _contact_force(plant.contact, half_gap, gap, gap_rate)
    force, stiffness, damping, elastic, elastic_stiffness = tooth
    omega_m, omega_l = state[OMEGA_M], state[OMEGA_L]
    force_l, elastic_l = -plant.R2 * stiffness, -plant.R2 * elastic_stiffness
    torque_m = torque_l = 0.0
    if plant.variation != 0.0:
        energy_h, elastic_h, force_h, energy_hh = _contact_slopes(plant.contact, half_gap, gap, tooth)
        force_l += force_h * slope
        elastic_l += elastic_h * slope
        torque_m -= plant.R1 * elastic_h * slope
        torque_l += plant.R2 * elastic_h * slope - energy_hh * slope * slope - energy_h * bend
    if plant.gravity != 0.0:
        torque_l -= plant.gravity * math.cos(state[THETA_L] + plant.gravity_offset)
    mesh, friction_m = mesh_of(plant, force, slip_m), motor_friction(plant, force, slip_m)
    moves_m, moves_l = abs(slip_m), abs(slip_l)
    return Slopes(
        plant.R1 * stiffness,
        force_l,
        damping,
        plant.R1 * elastic_stiffness,
        elastic_l,
        torque_m,
        torque_l,
        moves_m * plant.R1 * mesh / plant.J_m,
        moves_l * plant.R2 / plant.J_l,
        moves_l / plant.J_l,
        moves_m * plant.K_m / plant.J_m,
        moves_m * plant.B_m / plant.J_m,
        moves_l * plant.B_l / plant.J_l,
        2.0 * plant.B_m * omega_m + friction_m,
        2.0 * plant.B_l * omega_l + slip_l * plant.coulomb_l,
        2.0 * plant.R * state[CURRENT],
        plant.R1 * (mesh - 1.0) * omega_m,
        force - elastic,
        gap_rate,
    )


def jacobian(plant: PlantConstants, state: Array, acting: Acting, out: Array) -> None:
    """Write the derivatives of `derivative`, by the state, into ``out``, shape (7, 7)."""
    s = linearize(plant, state, acting.slip_m, acting.slip_l)
    out[:] = 0.0
    force, elastic, rate = np.zeros(7), np.zeros(7), np.zeros(7)
    rate[OMEGA_M], rate[OMEGA_L] = plant.R1, -plant.R2
    force[THETA_M], force[THETA_L] = s.force_m, s.force_l
    force += s.force_rate * rate
    elastic[THETA_M], elastic[THETA_L] = s.elastic_m, s.elastic_l
    out[THETA_M, OMEGA_M] = out[THETA_L, OMEGA_L] = 1.0
    out[OMEGA_M] = -s.per_force_m * force
    out[OMEGA_M, OMEGA_M] -= s.drag_m
    out[OMEGA_M, CURRENT] += s.per_current
    out[OMEGA_L] = s.per_force_l * force
    out[OMEGA_L, OMEGA_L] -= s.drag_l
    out[OMEGA_L, THETA_M] += s.per_torque * s.torque_m
    out[OMEGA_L, THETA_L] += s.per_torque * s.torque_l
    out[LOST] = s.lost_force * force + s.gap_rate * (force - elastic) + s.lost_rate * rate
    out[LOST, OMEGA_M] += s.lost_m
    out[LOST, OMEGA_L] += s.lost_l
    out[LOST, CURRENT] += s.lost_current
    out[SUPPLIED, OMEGA_L] = acting.load_torque
    if math.isinf(plant.L):
        out[SUPPLIED, CURRENT] = 2.0 * plant.R * state[CURRENT] + plant.K_m * state[OMEGA_M]
        out[SUPPLIED, OMEGA_M] = plant.K_m * state[CURRENT]
    else:
        out[CURRENT, OMEGA_M], out[CURRENT, CURRENT] = -plant.K_m / plant.L, -plant.R / plant.L
        out[SUPPLIED, CURRENT] = acting.command


def stored_energy(plant: PlantConstants, state: Array) -> float:
    """Return the kinetic, magnetic, elastic and potential energy, J; the last is 0 for a weight straight down.

    The magnetic energy of an imposed current is the drive's.
    """
    gap, _ = gap_of(plant, state)
    half_gap, _, _ = half_gap_of(plant, state[THETA_L])
    kinetic = plant.J_m * state[OMEGA_M] ** 2 + plant.J_l * state[OMEGA_L] ** 2
    magnetic = 0.0 if math.isinf(plant.L) else plant.L * state[CURRENT] ** 2
    potential = plant.gravity * (1.0 - math.cos(state[THETA_L] + plant.gravity_offset))
    return float(0.5 * (kinetic + magnetic) + _contact_energy(plant.contact, half_gap, gap) + potential)


ContactOf = Callable[[PlantConstants, Array], ToothForce]
HeldTorque = Callable[[PlantConstants, Array, float], Held]
Derivative = Callable[[PlantConstants, Array, Acting, Array], None]
Linearize = Callable[[PlantConstants, Array, float, float], Slopes]


class Equations(NamedTuple):
    """The functions of this file, compiled for one contact law; each is described at its template."""

    contact_of: ContactOf
    motion: Callable[..., Motion]
    held_torque: HeldTorque
    speed_slopes: Callable[[PlantConstants, Array, Acting], SpeedSlopes]
    derivative: Derivative
    linearize: Linearize
    jacobian: Derivative
    stored_energy: Callable[[PlantConstants, Array], float]


def equations_of(drive: Drive) -> Equations:
    """Return the equations of motion, compiled for the contact law of ``drive``."""
    return equations_with(type(drive.gear.contact))  # type: ignore[arg-type]


def is_plain(drive: Drive) -> bool:
    """Return whether ``drive`` has no dry friction, no gravity, a gap that does not vary, and no effects."""
    gear = drive.gear
    rubs = drive.motor.coulomb_friction or drive.load.coulomb_friction
    loses = gear.efficiency_forward != 1.0 or gear.efficiency_backward != 1.0
    return not (rubs or loses or gear.backlash_variation or drive.load.gravity_torque or drive.effects.acts)


@cache
def equations_with(law: type[Contact], plain: bool = False) -> Equations:
    """Return the equations of motion, compiled for a contact law; ``plain`` (see `is_plain`) gives quicker ones."""
    force: dict[str, Any] = {"_contact_force": law.force}
    both: dict[str, Any] = {**force, "_contact_slopes": law.half_gap_slopes}
    linear, rates = specialize(linearize, **both), specialize(motion, fused=True, _PLAIN=plain, **both)
    return Equations(
        contact_of=specialize(contact_of, **force),
        motion=rates,
        held_torque=specialize(held_torque, **both),
        speed_slopes=specialize(speed_slopes, fused=True, _motion=rates),
        derivative=specialize(derivative, _motion=rates),
        linearize=linear,
        jacobian=specialize(jacobian, linearize=linear),
        stored_energy=specialize(stored_energy, _contact_energy=law.energy),
    )
