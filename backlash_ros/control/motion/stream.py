"""Setpoints that come one by one, from who plans elsewhere, as one plan that grows while it is followed.

Each setpoint says where the load is to be at its time, and is reached a fixed delay later: a law that crosses a gap
must see the turn of a motion before it comes. So each one makes a new plan, from the setpoint in use through those that
are still due. After the last one the plan goes on at its speed for the timeout, then comes to rest before the end of
the travel. So the load stops if no other one comes, and nobody has to notice for that.
"""

import numpy as np

from backlash_ros.control.motion.setpoint import DURATION, ORDER, SHORTEST_STOP, Polynomials, joined, top_speed
from backlash_ros.control.motion.trajectory import START
from backlash_ros.control.servo import Servo
from backlash_ros.control.tick import tick_constants_at
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, VELOCITY

INTERVALS = 5.0
"""Intervals between setpoints that a timeout has; the delay leaves time for one."""

_EARLIEST = 1.0
"""Time by which a setpoint may be ahead, s."""
_RESTS = 1e-6
"""Speed below which a setpoint is at rest, rad/s."""
_SPARE = 1e-9
"""Distance from an end of the travel at which a stop ends, rad, so that rounding does not pass it."""


class Stream:
    """The setpoints of one servo.

    Parameters
    ----------
    timeout : time without a setpoint after which a stream has ended, s
    """

    def __init__(self, servo: Servo, timeout: float) -> None:
        self._servo, self.timeout = servo, timeout
        self.delay = 0.0
        """By which the stream that runs is followed later than its stamps say, s."""
        self._rows: Array | None = None  # the plan of the newest stream
        self._due: list[int] = []  # times at which its last setpoints are to be reached, ns
        self._states: list[Array] = []
        self._last = self._heard = 0  # time of the newest setpoint, and when a message came, ns
        self._ends = 0.0  # time in the plan at which the stream ends unless another setpoint comes, s

    @property
    def runs(self) -> bool:
        """Whether the servo follows setpoints, and the last one came in time."""
        ours = self._rows is not None and self._rows is self._servo.segments
        return ours and self._servo.memory.plan_time < self._ends

    @property
    def stops(self) -> bool:
        """Whether the servo comes to rest, or has, since no setpoint came any more while it moved."""
        ours = self._rows is not None and self._rows is self._servo.segments
        return ours and not self.runs and abs(self._states[-1][VELOCITY]) > _RESTS

    def take(self, time: int, state: Array, now: int) -> str:
        """Follow one more setpoint; return an empty text, or change nothing and return why it is refused.

        Parameters
        ----------
        time : of the setpoint, ns
        state : position, rad, velocity, rad/s, and, if known, acceleration, rad/s^2
        now : time of the newest sample on the same clock, ns
        """
        pause, self._heard = 1e-9 * (now - self._heard), now
        if why := self._servo.hindrance:
            return f"it came {why}"
        runs = self.runs
        if self._rows is not None and not runs:
            if pause < self.timeout:
                return f"the stream has ended; another one begins after a pause of {self.timeout:g} s"
            self._rows = None
        if not runs:
            self._due, self._states = [], []
            periods = float(tick_constants_at(self._servo.constants).motion.ahead)
            self.delay = periods * self._servo.settings.period + self.timeout / INTERVALS
        return self._rejection(time, state, now) or self._follow(time, state, now)

    def _rejection(self, time: int, state: Array, now: int) -> str:
        """Return what is wrong with a setpoint by itself, or after the one before; empty if nothing is."""
        if not np.all(np.isfinite(state)):
            return f"position, velocity and acceleration must be finite, got {state.tolist()}"
        late = 1e-9 * (now - time)
        if not -_EARLIEST <= late < self.delay:
            seen = f"{late:.3g} s behind" if late > 0.0 else f"{-late:.3g} s ahead of"
            return f"it must be less than {self.delay:.3g} s late and {_EARLIEST:g} s early, got {seen} the clock"
        if self._states:
            if time <= self._last:
                return (
                    f"its time must be later than that of the one before, got {1e-9 * (self._last - time):.3g} s less"
                )
            return ""
        present = float(self._servo.setpoint[POSITION])
        if not abs(state[POSITION] - present) <= START:
            return (
                f"the first one must be within {START:g} rad of the setpoint in use, {present:.6g} rad, "
                f"got {state[POSITION]:.6g}"
            )
        return ""

    def _follow(self, time: int, state: Array, now: int) -> str:
        to_rest = self._to_rest(state)
        if not to_rest.size:
            return f"it must be possible to stop before the end of the travel, got {state[VELOCITY]:.4g} rad/s there"
        first = int(np.searchsorted(self._due, now, side="right"))
        due = [*self._due[first:], time + round(1e9 * self.delay)]
        states = [*self._states[first:], state]
        known = min(each.size for each in states)
        ends = np.array([each[:known] for each in states])
        times = 1e-9 * (np.array(due) - now)
        durations = np.diff(times, prepend=0.0)
        rows = np.zeros((times.size, DURATION + 1))
        rows[:, : 2 * known] = joined(np.vstack([self._servo.setpoint[:known], ends[:-1]]), ends, durations)
        rows[:, DURATION] = durations
        rows = np.vstack([rows, to_rest])
        able, needed = self._acceleration, _top_acceleration(rows)
        if not needed <= able:  # nan, too
            return f"it must be within reach: the drive accelerates with {able:.4g} rad/s^2, it needs {needed:.4g}"
        if refusal := self._servo.follow(Polynomials(rows), at_once=True):
            return refusal
        self._rows, self._due, self._states, self._last = self._servo.segments, due, states, time
        self._ends = float(times[-1]) + self.timeout
        return ""

    @property
    def _acceleration(self) -> float:
        """What the drive can do with the load, rad/s^2."""
        servo = self._servo
        return servo.drive.standstill_torque(servo.limits.command) / servo.drive.effective_inertia

    def _to_rest(self, state: Array) -> Array:
        """Return how the plan goes on after the last setpoint: at its speed, then smoothly to rest within the travel.

        Empty if there is no way left.
        """
        position, velocity = float(state[POSITION]), float(state[VELOCITY])
        if abs(velocity) <= _RESTS:
            return np.array([[position, 0.0, 0.0, 0.0, 0.0, 0.0, self.timeout]])
        limits, speed = self._servo.limits, abs(velocity)
        way = (limits.position_upper - position if velocity > 0.0 else position - limits.position_lower) - _SPARE
        if way <= 0.0:
            return np.empty((0, DURATION + 1))
        # A quintic from a steady speed to rest takes twice as long as that speed would, and up to 1.5 times the mean
        # deceleration.
        deceleration = float(tick_constants_at(self._servo.constants).motion.acceleration)
        stop = min(max(1.5 * speed / deceleration, SHORTEST_STOP), 2.0 * way / speed)
        steady = min(self.timeout, way / speed - 0.5 * stop)
        begin = position + steady * velocity
        end = begin + 0.5 * stop * velocity
        path = joined(np.array([[begin, velocity, 0.0]]), np.array([[end, 0.0, 0.0]]), np.array([stop]))
        rows = np.array([[position, velocity, 0.0, 0.0, 0.0, 0.0, steady], [*path[0], stop]])
        return rows if steady > 0.0 else rows[1:]


def _top_acceleration(rows: Array) -> float:
    """Return the largest acceleration of a plan, rad/s^2."""
    rates = np.zeros_like(rows)
    rates[:, :ORDER] = rows[:, 1:DURATION] * np.arange(1, DURATION)
    rates[:, DURATION] = rows[:, DURATION]
    return top_speed(rates)
