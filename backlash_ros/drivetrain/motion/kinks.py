"""Where in a step the equations of motion have a kink: teeth that meet or part, or let go, or push the other way.

Between kinks the equations are smooth, and only there is a method of high order worth its price. The integrator ends a
step at each kink.
"""

from collections.abc import Callable
from functools import cache

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact, ForceFunction, PieceFunction
from backlash_ros.drivetrain.motion.dynamics import SpeedSlopes, half_gap_of
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M

_LOOKS = 8
"""Places in a step that are looked at."""
_HALVINGS = 40
_NEARBY = 1e-3
"""Share of a step before which no kink is looked for: what that costs is left to the error of the step."""


@compiled
def between(before: float, after: float, slope_before: float, slope_after: float, share: float) -> float:
    """Return the cubic through values and slopes at the ends of a step; slopes are changes over the whole step."""
    rise = after - before
    bend, twist = 3.0 * rise - 2.0 * slope_before - slope_after, slope_before + slope_after - 2.0 * rise
    return before + share * (slope_before + share * (bend + share * twist))


@compiled
def angle_between(
    before: Array, after: Array, slopes: tuple[float, float], angle: int, used: float, share: float
) -> float:
    """Return an angle at a share of a step of ``used`` s: the quintic through its ends, with their accelerations.

    ``angle``: its index, which that of its speed follows; ``slopes``: of the speed at both ends, rad/s^2.
    """
    start, end = used * before[angle + 1], used * after[angle + 1]
    first, last = used * used * slopes[0], used * used * slopes[1]
    rise, turn, bend = after[angle] - before[angle] - start - 0.5 * first, end - start - first, last - first
    third, fourth, fifth = (
        10.0 * rise - 4.0 * turn + 0.5 * bend,
        -15.0 * rise + 7.0 * turn - bend,
        6.0 * rise - 3.0 * turn + 0.5 * bend,
    )
    more = 0.5 * first + share * (third + share * (fourth + share * fifth))
    return float(before[angle] + share * (start + share * more))


_contact_piece: PieceFunction = unbound
_contact_force: ForceFunction = unbound


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
    theta_m, theta_l, omega_m, omega_l = after[THETA_M], after[THETA_L], after[OMEGA_M], after[OMEGA_L]
    if share < 1.0:
        slopes_m, slopes_l = (slopes_before[0], slopes_after[0]), (slopes_before[1], slopes_after[1])
        theta_m = angle_between(before, after, slopes_m, THETA_M, used, share)
        theta_l = angle_between(before, after, slopes_l, THETA_L, used, share)
        omega_m = between(before[OMEGA_M], after[OMEGA_M], used * slopes_m[0], used * slopes_m[1], share)
        omega_l = between(before[OMEGA_L], after[OMEGA_L], used * slopes_l[0], used * slopes_l[1], share)
    gap, gap_rate = plant.R1 * theta_m - plant.R2 * theta_l, plant.R1 * omega_m - plant.R2 * omega_l
    half_gap, _, _ = half_gap_of(plant, theta_l)
    piece = 2 * _contact_piece(plant.contact, half_gap, gap, gap_rate)
    if plant.forward != 1.0 or plant.backward != 1.0:
        piece += 1 if _contact_force(plant.contact, half_gap, gap, gap_rate)[0] * slip_m > 0.0 else 0
    return piece, gap_rate


def first_kink(
    plant: PlantConstants,
    before: Array,
    after: Array,
    slopes_before: SpeedSlopes,
    slopes_after: SpeedSlopes,
    slip_m: float,
    used: float,
) -> float:
    """Return where in a step, 0 to 1, another smooth piece of the equations begins; 2 where none does.

    Teeth that touch and part between two looks are nearest to each other where the gap turns back.
    """
    piece, rate = _piece(plant, before, after, slopes_before, slopes_after, slip_m, used, _NEARBY)
    for look in range(1, _LOOKS + 1):
        low, high = max(_NEARBY, (look - 1.0) / _LOOKS), look / _LOOKS
        there, later = _piece(plant, before, after, slopes_before, slopes_after, slip_m, used, high)
        if there == piece and rate * later < 0.0:
            start, end = low, high
            for _ in range(_HALVINGS):
                high = 0.5 * (start + end)
                there, closing = _piece(plant, before, after, slopes_before, slopes_after, slip_m, used, high)
                if there != piece:
                    break
                if closing * rate > 0.0:
                    start = high
                else:
                    end = high
        rate = later
        if there != piece:
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                if _piece(plant, before, after, slopes_before, slopes_after, slip_m, used, middle)[0] != piece:
                    high = middle
                else:
                    low = middle
            return high
    return 2.0


FirstKink = Callable[[PlantConstants, Array, Array, SpeedSlopes, SpeedSlopes, float, float], float]


@cache
def kinks_with(law: type[Contact]) -> FirstKink:
    """Return `first_kink` compiled for a contact law."""
    piece = specialize(_piece, _contact_piece=law.piece, _contact_force=law.force)
    return specialize(first_kink, _piece=piece)
