"""Notices wear while the drive works, without an experiment: a gap that has grown, or a load that rattles while held.

Two encoders show the gap when the teeth rest on one flank and later on the other; a rattle is a motion to and fro that
does not die out while the setpoint stands still. Plain Python beside the tick, run after each answer.
"""

import math
from collections import deque
from typing import NamedTuple

from backlash_ros.control.laws import LAWS
from backlash_ros.control.servo import Servo
from backlash_ros.foundation.signals import THETA_L, THETA_M, VELOCITY, Measurement

_GROWN = 1.5
"""A gap has grown beyond this multiple of the backlash in use: eccentric encoders and a varying gap show less."""
_GENTLE, _STILL = 0.15, 0.05
"""When teeth rest on a flank: share of the largest command, and largest motion in the gap between two samples as a
share of the backlash."""
_SOONEST, _FEWEST, _LATEST = 0.1, 24, 60.0
"""A gap has grown if this is seen twice: no sooner than this time (s) and this many samples apart, since consecutive
wrong samples are no gap, and within the last time, s."""
_RATIO_ERROR = 0.02
"""Tolerance of the gear ratio: share of the travel by which the shafts may drift apart."""
_HELD, _REVERSALS, _SLOWEST = 0.3, 12, 2.0
"""Time for which the setpoint must stand still, s; number of reversals in a rattle; longest time for each, s."""
_LASTS = 0.7
"""Smallest ratio of the later to the earlier half of the swings: a motion that dies out is not a rattle."""
_NO_STEP = 1e-9
"""Rad."""
_SHARE, _LEAST, _COUNTS = 0.1, 2e-4, 3.0
"""Smallest swing that counts: as a share of the backlash, in rad, and in counts."""
_REST, _AGAIN, _TRIES = 1.0, 60.0, 3
"""Time for which the load is held before it is learned again, s; time until the next try, s; number of tries."""


class Rattle(NamedTuple):
    """A motion to and fro while held: peak-to-peak swing of the load, rad; frequency, Hz; duration, s."""

    swing: float
    frequency: float
    duration: float


class _Turn(NamedTuple):
    """A reversal: time, s; distance since the previous one; range of the load's angle meanwhile, rad."""

    time: float
    way: float
    least: float
    most: float


class WearWatch:
    """Observes one servo, answers a rattle with the over-damped gains, and says when to learn again.

    ``grown``: whether the gap is larger than the backlash in use. ``rattle``: the present rattle, or the one that made
    the over-damped gains act, if any.
    """

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self.forget()

    def forget(self) -> None:
        """Start again, as for new settings."""
        self._in_use = self._servo.settings
        self.rattle: Rattle | None = None
        self._time = self._since = 0.0
        self._tries, self._next = 0, 0.0
        self._reference = self._apart = math.nan
        self._motor, self._load = math.nan, math.nan
        self._count_m = self._count_l = 0.0
        self._both = False
        self._once, self.grown = -math.inf, False
        self._begin_range()
        self._await_turns(math.nan, math.nan)

    def _begin_range(self) -> None:
        """Forget where the teeth have rested."""
        self._near, self._far = math.inf, -math.inf

    def _await_turns(self, x: float, load: float) -> None:
        """Forget the reversals, and a rattle that had no consequence."""
        if not self._servo.calmed:
            self.rattle = None
        self._turns: deque[_Turn] = deque(maxlen=_REVERSALS)
        self._begun, self._way, self._whole = self._time, 0, False
        self._low = self._high = x
        self._least = self._most = load

    @property
    def gap(self) -> float:
        """The distance between both flanks, rad at the output."""
        return max(0.0, self._far - self._near)

    @property
    def kind(self) -> tuple[bool, bool]:
        """Whether the gap has grown, and whether the load rattles, or did until it was calmed."""
        return self.grown, self.rattle is not None

    @property
    def finding(self) -> str:
        """What was noticed and its likely cause, in words; empty for nothing."""
        told, found = self._servo.settings.backlash_angle, []
        if self.grown:
            found.append(
                f"the gap has grown: the two flanks were {self.gap:.3g} rad apart, {self.gap / told:.1f} times "
                f"backlash_angle = {told:.3g} rad: learn again"
            )
        if self.rattle is not None:
            swing, frequency, duration = self.rattle
            found.append(
                f"the load rattled while it was held, by {swing:.3g} rad peak to peak at {frequency:.3g} Hz for "
                f"{duration:.1f} s: {self._cause(swing)}"
                f"{'; the over-damped gains act until then' if self._servo.calmed else ''}"
            )
        return "; ".join(found)

    def _cause(self, swing: float) -> str:
        settings, law = self._servo.settings, self._servo.law
        if not LAWS[law].adapts:
            return f"law {law!r} does not adapt to the backlash"
        if settings.backlash_angle == 0.0:
            return "the backlash is not known yet: call learn"
        if swing > 2.0 * max(settings.backlash_angle, self.gap):
            return "more than the gap: samples or commands may be late, or the gains too high for the load"
        return (
            "the gap may have grown, or the load may be lighter than load.inertia says: learn again; "
            "a load heavier than half the motor, seen from the output, also rattles: call identify, for law two_encoder"
        )

    def look(self, measured: Measurement, elapsed: float) -> bool:
        """Take an answered sample; return whether to learn the backlash again now.

        Parameters
        ----------
        measured : as received; nan where not measured
        elapsed : since the previous sample, s
        """
        servo = self._servo
        if servo.settings is not self._in_use:
            self.forget()
        if servo.latched or servo.experimenting or not servo.holding:
            self._reference = self._apart = math.nan
            return False
        self._time += elapsed
        motor, load = servo.drive.gear.ratio * float(measured[THETA_M]), float(measured[THETA_L])
        moved = abs(motor - self._motor)
        self._count_m = _smaller(self._count_m, moved)
        self._count_l = _smaller(self._count_l, abs(load - self._load))
        self._motor, self._load = motor, load
        both, before = not math.isnan(motor - load), self._both
        self._both = both
        x = motor - load if both else load if math.isnan(motor) else motor
        load = motor if math.isnan(load) else load
        if both:
            self._look_at_the_gap(x, moved)
        if servo.memory.setpoint[VELOCITY] != 0.0 or servo.reference != self._reference or both != before:
            self._reference, self._since = servo.reference, self._time
            self._await_turns(x, load)
        elif self._time - self._since > _HELD:
            self._look_for_turns(x, load)
        return self._due()

    def _look_at_the_gap(self, x: float, moved: float) -> None:
        """Take the difference of both shafts (rad) while the teeth rest on a flank."""
        servo, before = self._servo, self._apart
        self._apart = x
        if not math.isnan(moved):
            self._near += _RATIO_ERROR * moved
            self._far -= _RATIO_ERROR * moved
        still = abs(x - before) <= max(_STILL * servo.settings.backlash_angle, self._count_m, self._count_l)
        if still and abs(servo.command) <= _GENTLE * servo.limits.command:
            self._near, self._far = min(self._near, x), max(self._far, x)
        if not self.grown:
            self._look_whether_it_has_grown()

    def _look_whether_it_has_grown(self) -> None:
        """Believe a gap that is wider than the backlash in use once it is seen again."""
        settings, since = self._servo.settings, self._time - self._once
        if since < max(_SOONEST, _FEWEST * settings.period):
            self._begin_range()
        elif 0.0 < _GROWN * settings.backlash_angle < self.gap:
            self.grown, self._once = since < _LATEST, self._time
            if not self.grown:
                self._begin_range()

    def _look_for_turns(self, x: float, load: float) -> None:
        """Follow x (rad) up and down; it reverses where it goes back by more than the smallest swing."""
        told = self._servo.settings.backlash_angle
        smallest = max(_SHARE * told, _LEAST, _COUNTS * (self._count_m + self._count_l))
        self._low, self._high = min(self._low, x), max(self._high, x)
        self._least, self._most = min(self._least, load), max(self._most, load)
        up, down = x - self._low > smallest, self._high - x > smallest
        if (up and self._way <= 0) or (down and self._way >= 0):
            if self._whole:
                self._turns.append(_Turn(self._time, self._high - self._low, self._least, self._most))
                self._judge()
            # The first swing was seen only in part.
            self._whole, self._way = self._way != 0, -1 if down and self._way >= 0 else 1
            self._low = self._high = x
            self._least = self._most = load
        if self._turns and self._time - self._turns[-1].time > _SLOWEST:
            self._await_turns(x, load)

    def _judge(self) -> None:
        """Check whether the reversals are a rattle."""
        turns = self._turns
        if len(turns) == _REVERSALS and self._lasts():
            half = (turns[-1].time - turns[0].time) / (_REVERSALS - 1)
            swing = max(turn.most for turn in turns) - min(turn.least for turn in turns)
            self.rattle = Rattle(swing, 0.5 / half, self._time - self._begun)
            self._answer()

    def _lasts(self) -> bool:
        """Return whether the later half of the swings is about as large as the earlier half."""
        ways, half = [turn.way for turn in self._turns], _REVERSALS // 2
        return sum(ways[half:]) >= _LASTS * sum(ways[:half])

    def _answer(self) -> None:
        """Answer a rattle that the law in use should not have."""
        if LAWS[self._servo.law].adapts and self._servo.settings.backlash_angle > 0.0:
            self._servo.calm()

    def _due(self) -> bool:
        """Return whether to learn again now: at rest, if allowed, and not over and over."""
        if not self._servo.settings.renew or not (self.grown or self._servo.calmed):
            return False
        if self._time - self._since < _REST or self._time < self._next or self._tries >= _TRIES:
            return False
        self._tries += 1
        self._next = self._time + _AGAIN
        return True


def _smaller(count: float, step: float) -> float:
    """Return an encoder's count, rad: its smallest step so far; 0 while it made none."""
    return step if step > _NO_STEP and not 0.0 < count <= step else count
