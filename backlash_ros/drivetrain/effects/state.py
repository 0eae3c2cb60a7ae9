"""The whole state of a drive with effects: that of every drive, then what the effects add.

The integrator's memory keeps the rest, so that a drive with effects is played as any other one.
"""

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.effects.constants import effects_in
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, cells, size_of, view_of
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M


class WholeState(Record):
    """The whole state; angles and speeds as seen at the output."""

    drive: Array = cells(7)  # of `signals.PlantState`
    wheel_angle: float = 0.0  # of the wheel between both stages, rad
    wheel_speed: float = 0.0  # rad/s
    outer_angle: float = 0.0  # of the outer part of the load, rad
    outer_speed: float = 0.0  # rad/s
    age: float = 0.0  # time since the start, s


WHOLE = size_of(WholeState)
whole_at = view_of(WholeState)


@compiled
def begin(plant: PlantConstants, state: Array, whole: Array) -> None:
    """Write into ``whole``, shape (WHOLE,), how a drive starts whose ``state``, shape (7,), is given.

    The wheel stands where both gaps are taken up alike; the outer part of the load is at rest on its spring.
    """
    start = whole_at(whole)
    start.drive[:] = state
    share, ratio = effects_in(plant.effects).first_gap, plant.R1 / plant.R2
    start.wheel_angle = (1.0 - share) * ratio * state[THETA_M] + share * state[THETA_L]
    start.wheel_speed = (1.0 - share) * ratio * state[OMEGA_M] + share * state[OMEGA_L]
    start.outer_angle, start.outer_speed, start.age = state[THETA_L], state[OMEGA_L], 0.0
