"""Where the motor is in the gap, and where teeth at rest carry a torque."""

import math
from typing import NamedTuple

from backlash_ros.control.laws.planned.constants import TABLE_SIZE, Constants
from backlash_ros.control.laws.planned.memory import Memory
from backlash_ros.foundation.compiled import compiled

_APART = 0.36
"""Share of the gap, to either side of its middle, in which the teeth are apart with any contact law."""


@compiled
def contact_distance(constants: Constants, torque: float) -> float:
    """Return abs(g) at which teeth at rest carry a torque (N m) of either sign, rad; at least the table's first."""
    size, torques, distances = abs(torque), constants.teeth_torques, constants.teeth_distances
    if size <= torques[0]:
        return float(distances[0])
    for k in range(TABLE_SIZE - 1):
        if size <= torques[k + 1]:
            share = (size - torques[k]) / (torques[k + 1] - torques[k])
            return float(distances[k] + share * (distances[k + 1] - distances[k]))
    return float(distances[TABLE_SIZE - 1])


@compiled
def light_contact_distance(constants: Constants, torque: float) -> float:
    """Return the same also below the table's first torque, by the power law through its first two."""
    size, first = abs(torque), constants.teeth_torques[0]
    if size >= first:
        return contact_distance(constants, size)
    distances, least = constants.teeth_distances, 1e-3 * first
    power = math.log(distances[1] / distances[0]) / math.log(constants.teeth_torques[1] / first)
    return float(distances[0] * (max(size, least) / first) ** power)


class GapPosition(NamedTuple):
    """Where a motor that crosses is in the gap."""

    position: float  # g, rad
    speed: float  # rad/s, of g


@compiled
def on_the_way(begin: float, end: float, speed: float, duration: float, u: float) -> GapPosition:
    """Return where a motor is at a share ``u`` of its crossing: a quintic from g and its speed to rest at the end."""
    left, distance = 1.0 - u, end - begin
    position = begin + distance * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
    closing = distance * 30.0 * u * u * left * left / duration
    position += speed * duration * u * left**3 * (1.0 + 3.0 * u)
    closing += speed * left * left * (left * (1.0 + 6.0 * u) - 3.0 * u * (1.0 + 3.0 * u))
    return GapPosition(position, closing)


@compiled
def gap_position(memory: Memory) -> float:
    """Return g, where the motor is in the gap, rad."""
    return memory.motor.estimated.angle - memory.load.angle - memory.middle


@compiled
def teeth_are_apart(constants: Constants, memory: Memory) -> bool:
    """Return whether no flank touches the load."""
    return abs(gap_position(memory)) < _APART * constants.gap
