"""Where in a step the equations of a drive with effects have a kink: as in `motion.kinks`, in both stages."""

from collections.abc import Callable
from functools import cache

import numpy as np

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.effects.equations import real_equations
from backlash_ros.drivetrain.effects.state import WHOLE, whole_at
from backlash_ros.drivetrain.motion.dynamics import SpeedSlopes
from backlash_ros.drivetrain.motion.kinks import FirstKink, angle_between, between, first_kink
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M


@compiled
def _wheel_speed(before: Array, after: Array, used: float, share: float) -> float:
    """Return the slope of the cubic through the wheel's angles and speeds."""
    first, last = whole_at(before), whole_at(after)
    rise = last.wheel_angle - first.wheel_angle
    start, end = used * first.wheel_speed, used * last.wheel_speed
    bend, twist = 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise
    return float((start + share * (2.0 * bend + 3.0 * share * twist)) / used)


_piece_of: Callable[[object, Array, float], tuple[int, float]] = unbound


def _piece(
    plant: PlantConstants,
    before: Array,
    after: Array,
    slopes_before: SpeedSlopes,
    slopes_after: SpeedSlopes,
    slip_m: float,
    used: float,
    share: float,
) -> tuple[int, float]:
    """Return in which smooth piece of the equations the drive is at a share of a step, and how fast the gap closes."""
    if share >= 1.0:
        return _piece_of(plant, after, slip_m)
    state = np.zeros(WHOLE)
    slopes_m, slopes_l = (slopes_before[0], slopes_after[0]), (slopes_before[1], slopes_after[1])
    state[THETA_M] = angle_between(before, after, slopes_m, THETA_M, used, share)
    state[THETA_L] = angle_between(before, after, slopes_l, THETA_L, used, share)
    state[OMEGA_M] = between(before[OMEGA_M], after[OMEGA_M], used * slopes_m[0], used * slopes_m[1], share)
    state[OMEGA_L] = between(before[OMEGA_L], after[OMEGA_L], used * slopes_l[0], used * slopes_l[1], share)
    first, last, here = whole_at(before), whole_at(after), whole_at(state)
    here.wheel_angle = between(
        first.wheel_angle, last.wheel_angle, used * first.wheel_speed, used * last.wheel_speed, share
    )
    here.wheel_speed = _wheel_speed(before, after, used, share)
    here.age = first.age + share * used
    return _piece_of(plant, state, slip_m)


@cache
def real_kinks(law: type[Contact]) -> FirstKink:
    """Return `kinks.first_kink` for drives with effects, compiled for a contact law."""
    return specialize(first_kink, _piece=specialize(_piece, _piece_of=real_equations(law).piece_of))  # type: ignore[arg-type]
