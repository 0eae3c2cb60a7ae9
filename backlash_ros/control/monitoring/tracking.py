"""Watches whether the load leaves its reference: a loop that runs away, whatever the cause.

No law needs this while it works. Within any second the distance between load and reference may grow by the distance
that the reference itself went, by that in which a moving load can stop, by what a load torque explains, and by a
tolerance. More is a fault, also if the law, the estimate or the plan is what is wrong. Pure computation, compiled into
the tick.
"""

import math

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, cells, view_of
from backlash_ros.foundation.signals import OMEGA_L, THETA_L, Estimate

_BLOCK = 0.1
"""Length of a block of time, s, of which only the smallest distance is kept. Tuned."""
_BLOCKS = 10
"""Number of blocks before the present one that are kept: those of the last second."""

_BRAKES = 1.0 / 3.0
"""Share of its acceleration with which a drive surely brakes a load: a plan made in flight lets it coast at first."""

_UNKNOWN = 0.05
"""Time after the start in which the load's speed may not be known yet, s. Tuned."""


class TrackingMemory(Record):
    """What is remembered of load and reference in the last second."""

    reference: float = math.nan  # rad, at the sample before
    travel: float = 0.0  # rad, the distance that the reference went so far
    time: float = -_UNKNOWN  # s, in the present block
    block: float = 0.0  # index of the present block
    smallest: Array = cells(_BLOCKS + 1, initial=math.inf)  # rad, distance in each block that is not explained


tracking_memory_at = view_of(TrackingMemory)


@compiled
def forget_tracking(memory: TrackingMemory) -> None:
    """Begin anew: the load moves for another reason, such as an experiment."""
    memory.reference, memory.travel, memory.time = math.nan, 0.0, -_UNKNOWN
    memory.smallest[:] = math.inf


@compiled
def departure(
    memory: TrackingMemory, reference: float, estimate: Estimate, acceleration: float, period: float
) -> float:
    """Return by how much the load has left its reference within the last second, rad.

    Parameters
    ----------
    memory : updated in place
    reference : rad
    acceleration : of the load by the drive, rad/s^2
    period : since the previous sample, s
    """
    if not math.isnan(memory.reference):
        memory.travel += abs(reference - memory.reference)
    memory.reference = reference
    memory.time += period
    if memory.time > _BLOCK:
        memory.time = 0.0
        memory.block = (memory.block + 1.0) % (_BLOCKS + 1)
        memory.smallest[int(memory.block)] = math.inf
    # Just after the start the load's speed is not known, nor how far it needs to stop.
    if memory.time < 0.0:
        return 0.0
    beyond = abs(reference - estimate[THETA_L]) - memory.travel
    stopping = 0.5 * estimate[OMEGA_L] ** 2 / (_BRAKES * acceleration)
    block, smallest = int(memory.block), memory.smallest
    smallest[block] = min(smallest[block], beyond + stopping)
    least = smallest[block]
    for distance in smallest:
        least = min(least, distance)
    return float(max(beyond - least, 0.0))
