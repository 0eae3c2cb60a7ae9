"""A rattle: a motion to and fro that does not die out while the setpoint stands still."""

from collections import deque
from typing import NamedTuple

_REVERSALS = 12
"""Number of reversals in a rattle. Tuned."""
_SLOWEST = 2.0
"""Longest time from one reversal to the next, s. Tuned."""
_LASTS = 0.7
"""Smallest ratio of the later to the earlier half of the swings: a motion that dies out is not a rattle."""
_SHARE = 0.1
"""Smallest swing that counts, as a share of the backlash. Tuned."""
_LEAST = 2e-4
"""Smallest swing that counts, rad. Tuned."""
_COUNTS = 3.0
"""Smallest swing that counts, in counts of both encoders together. Tuned."""


class Rattle(NamedTuple):
    """A motion to and fro while held: peak-to-peak swing of the load, rad; frequency, Hz; duration, s."""

    swing: float
    frequency: float
    duration: float


class _Turn(NamedTuple):
    """A reversal: time, s; distance since the previous one; range of the load's angle meanwhile, rad."""

    time: float
    distance: float
    least: float
    most: float


def smallest_swing(backlash_angle: float, counts: float) -> float:
    """Return the smallest swing that counts, rad; ``counts`` are those of both encoders together, rad."""
    return max(_SHARE * backlash_angle, _LEAST, _COUNTS * counts)


class Reversals:
    """Follows a motion up and down: it reverses where it goes back by more than the smallest swing.

    Parameters
    ----------
    place : what moves: the place in the gap, or the angle that is measured, rad
    load : the load's angle, or the one that is measured, rad
    time : s
    """

    def __init__(self, place: float, load: float, time: float) -> None:
        self._turns: deque[_Turn] = deque(maxlen=_REVERSALS)
        self._begun = time
        self._direction, self._whole = 0, False
        self._restart(place, load)

    def _restart(self, place: float, load: float) -> None:
        self._low = self._high = place
        self._least = self._most = load

    def follow(self, place: float, load: float, time: float, smallest: float) -> Rattle | None:
        """Take a sample; return the rattle that a reversal completes, if it does."""
        self._low, self._high = min(self._low, place), max(self._high, place)
        self._least, self._most = min(self._least, load), max(self._most, load)
        up, down = place - self._low > smallest, self._high - place > smallest
        if not ((up and self._direction <= 0) or (down and self._direction >= 0)):
            return None
        rattle = None
        if self._whole:
            self._turns.append(_Turn(time, self._high - self._low, self._least, self._most))
            rattle = self._judge(time)
        # The first swing was seen only in part.
        self._whole = self._direction != 0
        self._direction = -1 if down and self._direction >= 0 else 1
        self._restart(place, load)
        return rattle

    def over(self, time: float) -> bool:
        """Return whether the last reversal is too long ago."""
        return bool(self._turns) and time - self._turns[-1].time > _SLOWEST

    def _judge(self, time: float) -> Rattle | None:
        """Return the rattle that the reversals are, if they are one."""
        turns = self._turns
        if len(turns) < _REVERSALS or not self._last():
            return None
        half = (turns[-1].time - turns[0].time) / (_REVERSALS - 1)
        swing = max(turn.most for turn in turns) - min(turn.least for turn in turns)
        return Rattle(swing, 0.5 / half, time - self._begun)

    def _last(self) -> bool:
        """Return whether the later half of the swings is about as large as the earlier half."""
        distances, half = [turn.distance for turn in self._turns], _REVERSALS // 2
        return sum(distances[half:]) >= _LASTS * sum(distances[:half])
