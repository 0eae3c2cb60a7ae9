"""The even beat of the samples: how many periods passed between two, and how late answers are.

On a busy machine stamps and answers are late, the drive's period is not. Neither clock has to agree with the other, nor
to run exactly as fast: a stamp, or an answer, is compared with those before it.
"""

import math
from collections import deque

LATE = 0.25
"""Share of a period, beyond the usual time from a sample to its answer, from which on an answer is late."""
_WINDOW = 100
"""Samples that tell what is usual."""


class _Usual:
    """Times, s, and by how much the next one is above their median."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=_WINDOW)

    def excess(self, time: float) -> float:
        """Take a time, and return by how much it is above those before it; 0 for the first."""
        usual = sorted(self._times)[len(self._times) // 2] if self._times else time
        self._times.append(time)
        return time - usual


class Beat:
    """Counts periods and judges answers; one whose time nobody tells is taken to be as usual.

    Parameters
    ----------
    period : of the samples, s
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._count, self._stamp = 0, 0.0
        self._stamps, self._answers = _Usual(), _Usual()
        self._stamped_late = self._late = 0.0

    def sample(self, elapsed: float) -> tuple[int, float]:
        """Take a sample that was stamped ``elapsed`` s after the one before; one period after it where that is nan.

        Returns how many periods it came after that one, and how late that one was answered, s.
        """
        elapsed = elapsed if math.isfinite(elapsed) else self._period
        periods = max(1, round((elapsed + self._stamped_late) / self._period))
        self._count, self._stamp = self._count + periods, self._stamp + elapsed
        self._stamped_late = self._stamps.excess(self._stamp - self._count * self._period)
        # A drive that is late itself may have heard the answer too late, whenever it was sent.
        late, self._late = max(self._late, self._beyond(self._stamped_late)), 0.0
        return periods, late

    def answered(self, at: float) -> None:
        """Take down when the newest sample was answered, s of a steady clock."""
        self._late = self._beyond(self._answers.excess(at - self._count * self._period))

    def _beyond(self, excess: float) -> float:
        return excess if excess > LATE * self._period else 0.0
