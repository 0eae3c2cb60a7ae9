"""Dry friction in time: where in a step a shaft stops or breaks away, and how it continues.

A *slip* says what a shaft does, as in `dynamics`: 1 and -1 slide, 0 sticks. An event changes the slip, and the
integrator ends a step at each event. The slip follows from the state without memory: a shaft slides in the direction
in which it turns, and a shaft whose speed is exactly 0 sticks unless the torque on it exceeds what friction can hold.

The functions with a plant are templates, plain Python; `friction_with` compiles them for a contact law.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.motion.dynamics import (
    SLIDES,
    Acting,
    Held,
    HeldTorque,
    SpeedSlopes,
    equations_with,
    load_rubs,
    motor_rubs,
)
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import LOST, OMEGA_L, OMEGA_M


@compiled
def first_zero(before: float, after: float, slope_before: float, slope_after: float) -> float:
    """Return where in a step, 0 to 1, the cubic through values and slopes first goes below 0; 2 if it does not.

    ``before`` is not below 0; slopes are changes over a whole step.
    """
    bend = 3.0 * (after - before) - 2.0 * slope_before - slope_after
    twist = slope_before + slope_after - 2.0 * (after - before)
    low, high = 0.0, 1.0
    if after >= 0.0:
        if slope_before >= 0.0 or slope_after <= 0.0:
            return 2.0
        # Down and up again: is the lowest point between below 0?
        root = math.sqrt(max(0.0, bend * bend - 3.0 * twist * slope_before))
        high = (root - bend) / (3.0 * twist) if bend < 0.0 else -slope_before / (bend + root)
        if not (0.0 < high < 1.0 and before + high * (slope_before + high * (bend + high * twist)) < 0.0):
            return 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if before + middle * (slope_before + middle * (bend + middle * twist)) < 0.0:
            high = middle
        else:
            low = middle
    return high


@compiled
def rest_slip(torque: float, least: float, most: float, allowance: float) -> float:
    """Return the slip of a shaft at rest: 0 if friction can hold ``torque``, else the direction of breaking away."""
    if torque > most + allowance:
        return 1.0
    return -1.0 if torque < least - allowance else 0.0


@compiled
def _broken_away(excess: float, beyond: float, allowance: float) -> float:
    """Return where in a step, 0 to 1, a shaft that sticks breaks away; 1 means at its end, 2 not in this step.

    ``excess`` and ``beyond`` are the torques beyond what friction can hold, before and after the step, N m. The shaft
    breaks away between one allowance and two.
    """
    if beyond <= allowance:
        return 2.0
    if beyond <= 2.0 * allowance:
        return 1.0
    return max(0.0, (1.5 * allowance - excess) / (beyond - excess))


@compiled
def _stopped(before: float, after: float, slope_before: float, slope_after: float, speed: float) -> float:
    """Return where in a step, 0 to 1, a shaft that slides comes to rest; 1 means at its end, 2 not in this step.

    Speeds are in the direction of the slip, slopes are changes over a whole step; below ``speed`` the shaft is at rest.
    """
    if abs(after) <= speed and (after < 0.0 or (slope_after < 0.0 and after < before)):
        return 1.0
    return first_zero(before, after, slope_before, slope_after)


_held_torque: HeldTorque = unbound


@compiled
def _allowances(plant: PlantConstants, held: Held, tolerance: float) -> tuple[float, float]:
    """Return the tolerance of the torque at which motor and load break away, N m, from `dynamics.held_torque`."""
    torque_m, least, most, torque_l, _, load_most = held
    stall = plant.K_m * plant.current_scale
    allowance_m = tolerance * (1e-3 * stall + max(abs(torque_m), abs(least), abs(most)))
    allowance_l = tolerance * (1e-3 * stall * plant.R2 / plant.R1 + max(abs(torque_l), load_most))
    return allowance_m, allowance_l


def slips(plant: PlantConstants, state: Array, load_torque: float, tolerance: float) -> tuple[float, float]:
    """Return the slip of motor and load in ``state``."""
    slip_m = math.copysign(1.0, state[OMEGA_M]) if motor_rubs(plant) else SLIDES
    slip_l = math.copysign(1.0, state[OMEGA_L]) if load_rubs(plant) else SLIDES
    rests_m = motor_rubs(plant) and state[OMEGA_M] == 0.0
    rests_l = load_rubs(plant) and state[OMEGA_L] == 0.0
    if rests_m or rests_l:
        held = _held_torque(plant, state, load_torque)
        torque_m, least, most, torque_l, load_least, load_most = held
        allowance_m, allowance_l = _allowances(plant, held, tolerance)
        if rests_m:
            slip_m = rest_slip(torque_m, least, most, allowance_m)
        if rests_l:
            slip_l = rest_slip(torque_l, load_least, load_most, allowance_l)
    return slip_m, slip_l


def first_event(
    plant: PlantConstants,
    before: Array,
    after: Array,
    slopes_before: SpeedSlopes,
    slopes_after: SpeedSlopes,
    acting: Acting,
    used: float,
    tolerance: float,
) -> tuple[float, bool, bool]:
    """Find the first event of friction in a step.

    Returns
    -------
    (share, motor, load) : where in the step the event is, 0 to 1, or 2 if there is none; and for each shaft whether its
        event has come by the end of the step: its speed is 0 or has changed sign, or friction no longer holds it. A
        speed or a torque within its tolerance counts, so that steps towards an event end with 1.
    """
    _, load_torque, slip_m, slip_l = acting
    allowance_m = allowance_l = excess_m = excess_l = beyond_m = beyond_l = 0.0
    if slip_m == 0.0 or slip_l == 0.0:
        torque, least, most, load, load_least, load_most = _held_torque(plant, before, load_torque)
        excess_m, excess_l = max(torque - most, least - torque), max(load - load_most, load_least - load)
        held = _held_torque(plant, after, load_torque)
        torque, least, most, load, load_least, load_most = held
        beyond_m, beyond_l = max(torque - most, least - torque), max(load - load_most, load_least - load)
        allowance_m, allowance_l = _allowances(plant, held, tolerance)
    speed = 1e-3 * tolerance * plant.speed_scale
    share_m = share_l = 2.0
    if motor_rubs(plant):
        if slip_m == 0.0:
            share_m = _broken_away(excess_m, beyond_m, allowance_m)
        else:
            slopes = used * slip_m * slopes_before[0], used * slip_m * slopes_after[0]
            share_m = _stopped(slip_m * before[OMEGA_M], slip_m * after[OMEGA_M], slopes[0], slopes[1], speed)
    if load_rubs(plant):
        if slip_l == 0.0:
            share_l = _broken_away(excess_l, beyond_l, allowance_l)
        else:
            slopes = used * slip_l * slopes_before[1], used * slip_l * slopes_after[1]
            speed *= plant.R1 / plant.R2
            share_l = _stopped(slip_l * before[OMEGA_L], slip_l * after[OMEGA_L], slopes[0], slopes[1], speed)
    come_m = share_m == 1.0 or (beyond_m > allowance_m if slip_m == 0.0 else slip_m * after[OMEGA_M] < 0.0)
    come_l = share_l == 1.0 or (beyond_l > allowance_l if slip_l == 0.0 else slip_l * after[OMEGA_L] < 0.0)
    return min(share_m, share_l), motor_rubs(plant) and come_m, load_rubs(plant) and come_l


def switch(plant: PlantConstants, state: Array, acting: Acting, come_m: bool, come_l: bool, tolerance: float) -> Acting:
    """Return what acts, with the slips after an event of friction; stop, in ``state``, a shaft that has come to rest.

    ``come_m`` and ``come_l`` say whose event it is: a sliding shaft stops, a sticking one breaks away. The rest of the
    speed is lost.
    """
    command, load_torque, slip_m, slip_l = acting
    if come_m and slip_m != 0.0:
        state[LOST] += 0.5 * plant.J_m * state[OMEGA_M] ** 2
        state[OMEGA_M] = 0.0
    if come_l and slip_l != 0.0:
        state[LOST] += 0.5 * plant.J_l * state[OMEGA_L] ** 2
        state[OMEGA_L] = 0.0
    held = _held_torque(plant, state, load_torque)
    torque, least, most, load, load_least, load_most = held
    allowance_m, allowance_l = _allowances(plant, held, tolerance)
    if come_m:
        slip_m = rest_slip(torque, least, most, allowance_m)
    if come_l:
        slip_l = rest_slip(load, load_least, load_most, allowance_l)
    return Acting(command, load_torque, slip_m, slip_l)


Slips = Callable[[PlantConstants, Array, float, float], tuple[float, float]]
FirstEvent = Callable[
    [PlantConstants, Array, Array, SpeedSlopes, SpeedSlopes, Acting, float, float],
    tuple[float, bool, bool],
]
Switch = Callable[[PlantConstants, Array, Acting, bool, bool, float], Acting]


class Friction(NamedTuple):
    """The functions of this file, compiled for one contact law; each is described at its template."""

    slips: Slips
    first_event: FirstEvent
    switch: Switch


@cache
def friction_with(law: type[Contact]) -> Friction:
    """Return the events of friction, compiled for a contact law."""
    return friction_by(equations_with(law).held_torque)  # type: ignore[arg-type]


def friction_by(held_torque: HeldTorque) -> Friction:
    """Return the events of friction, compiled with the torques that it must hold."""
    held: dict[str, Any] = {"_held_torque": held_torque}
    return Friction(
        slips=specialize(slips, inlined=True, **held),
        first_event=specialize(first_event, inlined=True, **held),
        switch=specialize(switch, inlined=True, **held),
    )
