"""The regular beat of the samples: the number of periods between two samples, and the lateness of answers.

On a busy machine stamps and answers are late, but the drive's period is not. The two clocks need not agree, nor run at
exactly the same rate: a stamp or an answer is compared only with earlier ones.
"""

import math
from collections import deque

LATE = 0.25
"""An answer is late beyond the usual time from a sample to its answer plus this share of a period."""
_WINDOW = 100
"""Number of samples that define what is usual."""


class _Usual:
    """Times, s, with the excess of the next one over their median."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=_WINDOW)

    def excess(self, time: float) -> float:
        """Take a time, and return its excess over the median of the earlier ones; 0 for the first."""
        usual = sorted(self._times)[len(self._times) // 2] if self._times else time
        self._times.append(time)
        return time - usual


class Beat:
    """Counts periods and judges answers; an answer without a time counts as usual.

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
        """Take a sample that was stamped ``elapsed`` s after the previous one; nan means one period.

        Returns the number of periods since the previous sample, and how late that one was answered, s.
        """
        elapsed = elapsed if math.isfinite(elapsed) else self._period
        periods = max(1, round((elapsed + self._stamped_late) / self._period))
        self._count, self._stamp = self._count + periods, self._stamp + elapsed
        self._stamped_late = self._stamps.excess(self._stamp - self._count * self._period)
        # A drive that is itself late may have received the answer late, whenever it was sent.
        late, self._late = max(self._late, self._beyond(self._stamped_late)), 0.0
        return periods, late

    def answered(self, at: float) -> None:
        """Note when the newest sample was answered, s of a steady clock."""
        self._late = self._beyond(self._answers.excess(at - self._count * self._period))

    def _beyond(self, excess: float) -> float:
        return excess if excess > LATE * self._period else 0.0
