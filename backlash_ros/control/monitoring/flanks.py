"""The distance between both flanks, from where the teeth rest: whether the gap has grown."""

import math

_GROWN = 1.5
"""A gap has grown beyond this multiple of the backlash in use: eccentric encoders and a varying gap show less."""
_STILL = 0.05
"""Largest motion in the gap between two samples while teeth rest on a flank, as a share of the backlash. Tuned."""
_SOONEST = 0.1
"""A gap has grown if this is seen twice, no sooner than this time apart, s: consecutive wrong samples are no gap.
Tuned."""
_FEWEST = 24
"""The same in samples. Tuned."""
_LATEST = 60.0
"""It is seen again within this time, s. Tuned."""
_RATIO_ERROR = 0.02
"""Tolerance of the gear ratio: share of the travel by which the shafts may drift apart."""


class Flanks:
    """Where the teeth have rested; ``grown``: whether the gap is larger than the backlash in use."""

    def __init__(self) -> None:
        self.grown = False
        self._place, self._seen_at = math.nan, -math.inf
        self._begin()

    def _begin(self) -> None:
        """Forget where the teeth have rested."""
        self._near, self._far = math.inf, -math.inf

    @property
    def gap(self) -> float:
        """The distance between both flanks, rad at the output."""
        return max(0.0, self._far - self._near)

    def pause(self) -> None:
        """Take the next place for one that does not follow the last one."""
        self._place = math.nan

    def look(self, place: float, moved: float, step: float, backlash_angle: float, *, gentle: bool) -> None:
        """Take the difference of both shafts while the teeth rest on a flank.

        Parameters
        ----------
        place : that difference, rad at the output
        moved : by the motor since the last sample, rad at the output; nan if that is not known
        step : the larger one of both encoders' counts, rad
        backlash_angle : in use, rad
        gentle : whether the command is small
        """
        before, self._place = self._place, place
        if not math.isnan(moved):
            self._near += _RATIO_ERROR * moved
            self._far -= _RATIO_ERROR * moved
        if gentle and abs(place - before) <= max(_STILL * backlash_angle, step):
            self._near, self._far = min(self._near, place), max(self._far, place)

    def judge(self, backlash_angle: float, time: float, period: float) -> None:
        """Believe a gap that is wider than the backlash in use once it is seen again; times in s."""
        if self.grown:
            return
        since = time - self._seen_at
        if since < max(_SOONEST, _FEWEST * period):
            self._begin()
        elif 0.0 < _GROWN * backlash_angle < self.gap:
            self.grown, self._seen_at = since < _LATEST, time
            if not self.grown:
                self._begin()
