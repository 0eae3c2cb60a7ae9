"""What the law remembers with one encoder alone: the memory of the plans, and both shafts as the model has them."""

from backlash_ros.control.laws.planned.memory import Load, Memory
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, cell_of, cells, part, size_of, view_of


class Shafts(Record):
    """Both shafts, all at the output."""

    angle: float = 0.0  # p, rad, of the motor
    speed: float = 0.0  # w, rad/s
    current_torque: float = 0.0  # N m, of the current
    load_angle: float = 0.0  # rad
    load_speed: float = 0.0  # rad/s
    load_torque: float = 0.0  # N m, at the load's angle


ANGLE, SPEED, CURRENT_TORQUE, LOAD_ANGLE, LOAD_SPEED, TORQUE = (
    cell_of(Shafts, name) for name in ("angle", "speed", "current_torque", "load_angle", "load_speed", "load_torque")
)
"""Rows and columns of a covariance."""
STATES = size_of(Shafts)


@compiled
def gap_variance(covariance: Array) -> float:
    """Return the variance of g, rad^2."""
    apart = covariance[ANGLE, ANGLE] + covariance[LOAD_ANGLE, LOAD_ANGLE] - 2.0 * covariance[ANGLE, LOAD_ANGLE]
    return max(float(apart), 0.0)


class AloneMemory(Record):
    """All that the law remembers."""

    plans: Memory = part(Memory)
    shafts: Shafts = part(Shafts)  # at the sample
    ahead: Shafts = part(Shafts)  # when the next command begins to act
    covariance: Array = cells(STATES, STATES)  # of `shafts`, if the load is measured
    room: Array = cells(STATES, STATES)  # to compute in
    readings: Load = part(Load)  # of the encoder that is there: its last angle, its speed, its count, and doubts
    lost_momentum: float = 0.0  # N m s, that a motor in the gap gains from nothing that is known


alone_memory_at = view_of(AloneMemory)
