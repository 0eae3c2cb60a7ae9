"""Notices wear while the drive works, without an experiment: a gap that has grown, or a load that rattles while held.

Two encoders show the gap when the teeth rest on one flank and later on the other; a rattle is a motion to and fro that
does not die out while the setpoint stands still. Plain Python beside the tick, run after each answer.
"""

import math

from backlash_ros.control.laws import LAWS
from backlash_ros.control.monitoring.flanks import Flanks
from backlash_ros.control.monitoring.rattle import Rattle, Reversals, smallest_swing
from backlash_ros.control.servo import Servo
from backlash_ros.foundation.signals import THETA_L, THETA_M, VELOCITY, Measurement

HEAVY = 0.5
"""J_l/J_r above which the two-region law more often keeps a slow limit cycle: docs/evaluation.md."""
_GENTLE = 0.15
"""Share of the largest command below which teeth rest on a flank without being pressed in. Tuned."""
_HELD = 0.3
"""Time for which the setpoint must stand still before reversals count, s. Tuned."""
_NO_STEP = 1e-9
"""A change of an angle that is none, rad."""
_REST = 1.0
"""Time for which the load is held before it is learned again, s. Tuned."""
_AGAIN = 60.0
"""Time until the next try to learn again, s. Tuned."""
_TRIES = 3
"""Number of tries to learn again. Tuned."""


class WearWatch:
    """Observes one servo, answers a rattle with the over-damped gains, and says when to learn again.

    ``rattle``: the present rattle, or the one that made the over-damped gains act, if any.
    """

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self.forget()

    def forget(self) -> None:
        """Start again, as for new settings."""
        self._in_use = self._servo.settings
        self.rattle: Rattle | None = None
        self._flanks = Flanks()
        self._reversals = Reversals(math.nan, math.nan, 0.0)
        self._time = self._held_since = 0.0
        self._tries, self._next_try = 0, 0.0
        self._reference = self._motor = self._load = math.nan
        self._motor_count = self._load_count = 0.0
        self._both = False

    @property
    def grown(self) -> bool:
        """Whether the gap is larger than the backlash in use."""
        return self._flanks.grown

    @property
    def gap(self) -> float:
        """The distance between both flanks, rad at the output."""
        return self._flanks.gap

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
            "a load heavier than half the motor, seen from the output, also rattles: call identify, for law 'planned'"
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
            self._reference = math.nan
            self._flanks.pause()
            return False
        self._time += elapsed
        motor, load = servo.drive.gear.ratio * float(measured[THETA_M]), float(measured[THETA_L])
        moved, had_both = self._take(motor, load), self._both
        self._both = not math.isnan(motor - load)
        place = motor - load if self._both else load if math.isnan(motor) else motor
        load = motor if math.isnan(load) else load
        if self._both:
            self._look_at_the_gap(place, moved)
        if servo.memory.setpoint[VELOCITY] != 0.0 or servo.reference != self._reference or self._both != had_both:
            self._reference, self._held_since = servo.reference, self._time
            self._await_reversals(place, load)
        elif self._time - self._held_since > _HELD:
            self._look_for_reversals(place, load)
        return self._due()

    def _take(self, motor: float, load: float) -> float:
        """Take both angles, rad at the output; return by how much the motor has moved."""
        moved = abs(motor - self._motor)
        self._motor_count = _smaller(self._motor_count, moved)
        self._load_count = _smaller(self._load_count, abs(load - self._load))
        self._motor, self._load = motor, load
        return moved

    def _look_at_the_gap(self, place: float, moved: float) -> None:
        servo, settings = self._servo, self._servo.settings
        gentle = abs(servo.command) <= _GENTLE * servo.limits.command
        step = max(self._motor_count, self._load_count)
        self._flanks.look(place, moved, step, settings.backlash_angle, gentle=gentle)
        self._flanks.judge(settings.backlash_angle, self._time, settings.period)

    def _await_reversals(self, place: float, load: float) -> None:
        """Forget the reversals, and a rattle that had no consequence."""
        if not self._servo.calmed:
            self.rattle = None
        self._reversals = Reversals(place, load, self._time)

    def _look_for_reversals(self, place: float, load: float) -> None:
        """Follow the motion; answer a rattle that the law in use should not have."""
        servo, backlash_angle = self._servo, self._servo.settings.backlash_angle
        smallest = smallest_swing(backlash_angle, self._motor_count + self._load_count)
        rattle = self._reversals.follow(place, load, self._time, smallest)
        if rattle is not None:
            self.rattle = rattle
            if LAWS[servo.law].adapts and backlash_angle > 0.0:
                servo.calm()
        if self._reversals.over(self._time):
            self._await_reversals(place, load)

    def _due(self) -> bool:
        """Return whether to learn again now: at rest, if allowed, and not over and over."""
        if not self._servo.settings.renew or not (self.grown or self._servo.calmed):
            return False
        if self._time - self._held_since < _REST or self._time < self._next_try or self._tries >= _TRIES:
            return False
        self._tries += 1
        self._next_try = self._time + _AGAIN
        return True


def _smaller(count: float, step: float) -> float:
    """Return an encoder's count, rad: its smallest step so far; 0 while it made none."""
    return step if step > _NO_STEP and not 0.0 < count <= step else count
