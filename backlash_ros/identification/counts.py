"""The counts of an encoder, from its readings alone."""

import numpy as np

from backlash_ros.foundation.record import Array

_LEAPS = 4
"""Fewest leaps over what is never read to say that a bit is stuck."""


def count_of(angle: Array) -> float:
    """Return an encoder's count, rad: the smallest difference of its readings; close to 0 without quantization."""
    steps = np.diff(np.unique(np.round(angle[np.isfinite(angle)], 11)))
    return float(np.min(steps[steps > 1e-9], initial=1e-2))


def stuck_bit(angle: Array) -> int:
    """Return the value, in counts, of a bit of an encoder that never changes; 0 if each does.

    With a stuck bit, half of the counts are never read, always the same half of twice its value, wherever 0 is; and a
    slow shaft leaps over them.
    """
    read = angle[np.isfinite(angle)]
    codes = np.round((read - np.min(read)) / count_of(angle)).astype(np.int64)
    steps = np.abs(np.diff(codes))
    bit = 2
    while codes.size > _LEAPS and bit < np.max(codes):
        leaps = (steps[1:-1] > bit) & (steps[:-2] < bit / 2) & (steps[2:] < bit / 2)
        places = np.unique(codes % (2 * bit))
        if np.sum(leaps) >= _LEAPS and np.max(np.diff(places, append=places[0] + 2 * bit)) > bit:
            return bit
        bit *= 2
    return 0
