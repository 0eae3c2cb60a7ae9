"""The plan that the setpoint follows: from where it is to a reference, or to the end of another source."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from backlash_ros.control.limits import Limits
from backlash_ros.control.memory import InputRow, TickRow
from backlash_ros.control.motion.profile import MotionLimits, Profile
from backlash_ros.control.motion.setpoint import (
    DURATION,
    AtRest,
    Source,
    extent,
    is_reference,
    plan_rejection,
    top_speed,
)
from backlash_ros.control.tick import NOT_BEGUN
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, VELOCITY, Setpoint

_ROUNDING = 1e-9
"""Distance by which the rows of a profile may pass an end of the travel, rad."""


class Fastest(NamedTuple):
    """Speed that no plan may exceed, rad/s, and what makes it so."""

    speed: float
    by: str

    def rejection_reason(self, speed: float) -> str:
        """Return why a plan is refused whose setpoint has such a speed, rad/s; empty if it is not."""
        if speed <= self.speed:
            return ""
        return f"path must be slower than {self.by} = {self.speed:.4g} rad/s, got {speed:.4g}"


def _with_room(limits: Limits, start: float) -> Limits:
    """Return limits whose travel includes a plan's start, rad, and its rounding: a load found outside may come back."""
    lower, upper = min(limits.position_lower, start) - _ROUNDING, max(limits.position_upper, start) + _ROUNDING
    return replace(limits, position_lower=lower, position_upper=upper)


class Plan:
    """The plan of one servo; its tick evaluates ``segments``.

    Tick and segments count as the load's readings do. All other positions count from ``zero``, a reading, rad.

    Parameters
    ----------
    memory, inputs : of the servo's tick
    """

    segments: Array
    _reach: tuple[float, float] | None
    asked: bool
    """Whether its end was asked for: it is not where the load was found or stopped."""
    zero = 0.0

    def __init__(self, memory: TickRow, inputs: InputRow) -> None:
        self._memory, self._inputs = memory, inputs
        self._profile: Profile | None = None  # the newest
        self._pace, self._paced = 1.0, False
        self._planned: Array | None = None  # its segments
        self.hold()

    @property
    def pace(self) -> float:
        """How fast plans are followed that may be slowed down: 1 as planned, 0 not at all."""
        return self._pace

    @pace.setter
    def pace(self, pace: float) -> None:
        self._pace = pace
        self._inputs.pace = pace if self._paced else 1.0

    def count_from(self, zero: float) -> None:
        """Let positions count from another zero, rad: a plan that is over goes on where it is."""
        if self._end is not None:
            self._end -= zero - self.zero
        self.zero = zero
        self._reach = self._planned = None

    def hold(self) -> None:
        """Hold the position of the next sample."""
        self.segments = AtRest(math.nan).segments(self._memory.setpoint)
        self._end: float | None = None
        self._reach = None
        self.asked = False

    def hold_at(self, angle: float) -> None:
        """Hold a load that is far from its reference at an angle, rad, so that it does not jump back."""
        reading = angle + self.zero
        self.segments = AtRest(reading).segments(self._memory.setpoint)
        self._memory.setpoint[:] = reading, 0.0, 0.0
        self._memory.plan_time = NOT_BEGUN
        self._end = self._reach = None
        self.asked = False

    def follow(
        self,
        source: Source,
        limits: Limits,
        fastest: Fastest,
        hindrance: str,
        *,
        at_once: bool = False,
        paced: bool = False,
    ) -> str:
        """Plan ``source`` from the present setpoint on; return an empty text, or why it is refused.

        Parameters
        ----------
        hindrance : why nothing is followed now, whatever it is; empty if that is not so
        at_once : whether the plan began with the last sample, and not with the next one
        paced : whether it may be slowed down, see `pace`
        """
        segments = np.ascontiguousarray(source.segments(self.setpoint), dtype=np.float64)
        _, end, least, largest = extent(segments)
        reach = least, largest
        if hindrance:
            return f"reference {end:g} rad came {hindrance}"
        # References that keep coming are ahead of the setpoint: each counts from the one that was taken before.
        taken = float(self._memory.motion.reference) - self.zero
        if reason := plan_rejection(segments, limits, self.position if math.isnan(taken) else taken, reach):
            return reason
        if reason := fastest.rejection_reason(top_speed(segments)):
            return reason
        self._begin(segments, end, reach, at_once=at_once, paced=paced)
        return ""

    def _begin(
        self, segments: Array, end: float, reach: tuple[float, float], *, at_once: bool, paced: bool = False
    ) -> None:
        self.segments, self._end, self._reach = segments.copy(), end, reach
        self.segments[:, 0] += self.zero
        # The setpoint has its speed in time as it is: a slower pace is reached from there.
        self._memory.pace.now, self._memory.pace.rate = 1.0, 0.0
        self._paced = paced
        self.pace = self._pace
        self._memory.plan_time = 0.0 if at_once else NOT_BEGUN
        self._memory.cursor.row = self._memory.cursor.begins = 0.0
        self.asked = True

    def go_to(self, reference: float, motion: MotionLimits, limits: Limits, fastest: Fastest, hindrance: str) -> str:
        """Go to a reference, rad, by a profile; return an empty text, or why it is refused.

        While a profile is in use the step counts from its reference: the setpoint may be far behind. A load that is
        held outside of the travel may come back.

        Parameters
        ----------
        motion : limits of the setpoint's motion
        limits, fastest, hindrance : as for `follow`
        """
        if hindrance:
            return f"reference {reference:g} rad came {hindrance}"
        last, begin = self.profile, self.setpoint
        if last is not None and (last.reference, last.limits) == (reference, motion):
            return ""
        if why := limits.rejection_reason(reference, self.position if last is None else last.reference):
            return why
        profile = Profile(begin, reference, motion)
        if last is not None and last.limits == motion:
            profile = last.onward(begin, reference, self._memory.plan_time)
        travel, reach = _with_room(limits, float(begin[POSITION])), profile.reach
        reasons = (
            *(travel.rejection_reason(each, each) for each in reach),
            fastest.rejection_reason(profile.top_speed),
        )
        if why := next(filter(None, reasons), ""):
            return f"the profile to {reference:g} rad is refused: {why}"
        self._begin(profile.rows, reference, reach, at_once=True)
        self._profile, self._planned = profile, self.segments
        return ""

    @property
    def profile(self) -> Profile | None:
        """The profile in use; None if the setpoint follows something else."""
        return self._profile if self._planned is self.segments else None

    @property
    def setpoint(self) -> Setpoint:
        """The last setpoint, with an experiment's offset."""
        setpoint = Setpoint(self._memory.setpoint.copy())
        setpoint[POSITION] -= self.zero
        return setpoint

    @property
    def position(self) -> float:
        """The position of the setpoint, rad, without an experiment's offset."""
        return float(self._memory.setpoint[POSITION] - self._inputs.offset) - self.zero

    @property
    def extremes(self) -> tuple[float, float]:
        """Smallest and largest position, rad, until its end."""
        return (self.end, self.end) if self._reach is None or self._over else self._reach

    @property
    def _over(self) -> bool:
        return bool(self._memory.plan_time >= self.segments[:, DURATION].sum())

    @property
    def arrived(self) -> bool:
        """Whether the setpoint is at its end, at rest."""
        rests = not any(self._memory.setpoint[VELOCITY:].tolist())
        return rests and (self._over or bool(is_reference(self.segments)))

    @property
    def end(self) -> float:
        """Its end, rad: the reference; nan while no position is held."""
        return float(self.segments[0, 0]) - self.zero if self._end is None else self._end

    @property
    def holding(self) -> bool:
        """Whether a sample has been seen since the last `hold`."""
        return not math.isnan(self.segments[0, 0])
