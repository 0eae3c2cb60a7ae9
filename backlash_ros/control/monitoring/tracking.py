"""Watches whether the load leaves its reference: a loop that runs away, whatever the cause.

No law needs this while it works. Within any second the distance between load and reference may grow by the way that
the reference itself went, by the way on which a moving load can stop, by what a load torque explains, and by a
tolerance. More is a fault, also if the
law, the estimate or the plan is what is wrong. Pure computation, compiled into the tick.
"""

import math

import numpy as np

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, THETA_L, Estimate

_BLOCK, _BLOCKS = 0.1, 10
"""The last second as so many blocks of this time, s, of which the smallest value counts."""

_BRAKES = 1.0 / 3.0
"""Share of its acceleration with which a drive surely brakes a load: a plan made in flight lets it coast at first."""

_UNKNOWN = 0.05
"""Time after the start in which the load's speed may not be known yet, s."""

_REFERENCE, _WAY, _TIME, _AT, _LEAST = range(5)
"""Of the memory: the reference of the sample before, rad; the way that it went, rad; time in the present block, s; its
index; then the least of each block, rad."""


def tracking_memory() -> Array:
    """Return the initial memory."""
    memory = np.zeros(_LEAST + _BLOCKS + 1)
    forget_tracking(memory)
    return memory


@compiled
def forget_tracking(memory: Array) -> None:
    """Begin anew: the load moves for another reason, such as an experiment."""
    memory[_REFERENCE], memory[_WAY], memory[_TIME], memory[_LEAST:] = math.nan, 0.0, -_UNKNOWN, math.inf


@compiled
def departure(memory: Array, reference: float, estimate: Estimate, acceleration: float, period: float) -> float:
    """Return by how much the load has left its reference within the last second, rad.

    Parameters
    ----------
    memory : from `tracking_memory`, updated in place
    reference : rad
    acceleration : of the load by the drive, rad/s^2
    period : since the previous sample, s
    """
    if not math.isnan(memory[_REFERENCE]):
        memory[_WAY] += abs(reference - memory[_REFERENCE])
    memory[_REFERENCE] = reference
    memory[_TIME] += period
    if memory[_TIME] > _BLOCK:
        memory[_TIME] = 0.0
        memory[_AT] = (memory[_AT] + 1.0) % (_BLOCKS + 1)
        memory[_LEAST + int(memory[_AT])] = math.inf
    if memory[_TIME] < 0.0:
        return 0.0
    beyond = abs(reference - estimate[THETA_L]) - memory[_WAY]
    stops = 0.5 * estimate[OMEGA_L] ** 2 / (_BRAKES * acceleration)
    at = _LEAST + int(memory[_AT])
    memory[at] = min(memory[at], beyond + stops)
    return float(max(beyond - np.min(memory[_LEAST:]), 0.0))
