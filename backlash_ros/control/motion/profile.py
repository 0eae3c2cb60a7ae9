"""A profile: the way of the setpoint to a reference, within limits of its speed, acceleration and jerk.

A raw motion goes to rest at the reference as fast as speed and acceleration allow, from any speed: its own speed is a
line with corners. The setpoint is the mean of the raw motion over the last moments, the window. So its speed and its
acceleration stay within the same limits; the acceleration turns round in no less than a window, which limits the jerk;
the setpoint goes no further than the raw motion does, and rests at the reference a window later.

Another reference may come at any sample. The raw motion goes on from there, and the window still has what it did
before. A setpoint that moved for another reason is taken for the mean of an even acceleration: so it goes on with the
speed and the acceleration that it has.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from backlash_ros.control.motion.setpoint import DURATION
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY, Setpoint

_SHORTEST_WINDOW = 1e-4
"""Shortest window, s: less than a period, so that no sample shows it."""
_INSTANT = 1e-12
"""Time that is rounding, s."""
_STRAIGHT = 1e-6
"""Change of the raw acceleration, as a share of its limit, that is rounding."""
_REST = 1e-3
"""Duration of the last row, which has the reference to the last bit, s."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a setpoint's motion, all > 0: rad/s, rad/s^2, rad/s^3."""

    velocity: float
    acceleration: float
    jerk: float

    @property
    def used_acceleration(self) -> float:
        """Acceleration of the raw motion, rad/s^2: a larger one would take longer to build up than it saves."""
        return min(self.acceleration, math.sqrt(0.5 * self.velocity * self.jerk))

    @property
    def window(self) -> float:
        """Time over which the raw motion is averaged, s: in so long it may turn its acceleration round."""
        return max(2.0 * self.used_acceleration / self.jerk, _SHORTEST_WINDOW)


class Raw(NamedTuple):
    """A raw motion: its speed, rad/s, at times from now, s, both of shape (corners,); straight in between.

    It begins a window ago and ends at rest.
    """

    times: Array
    speeds: Array

    def at(self, times: Array) -> Array:
        """Return the speed at times."""
        return np.interp(times, self.times, self.speeds)


def _fastest(distance: float, speed: float, limits: MotionLimits) -> Raw:
    """Return the fastest motion over a distance, rad, to rest, from a speed now, rad/s.

    It brakes first if it has to turn or is too fast.
    """
    acceleration = limits.used_acceleration
    way = math.copysign(1.0, distance - 0.5 * speed * abs(speed) / acceleration)
    now, left = way * speed, way * distance
    peak = min(math.sqrt(max(acceleration * left + 0.5 * now * now, 0.0)), limits.velocity)
    first, last = abs(peak - now) / acceleration, peak / acceleration
    left -= 0.5 * (first * (now + peak) + last * peak)
    steady = max(left, 0.0) / peak if peak > 0.0 else 0.0
    return Raw(np.cumsum([0.0, first, steady, last]), way * np.array([now, peak, peak, 0.0]))


def _without_false_corners(raw: Raw, limits: MotionLimits) -> Raw:
    """Return the same motion with its corners alone."""
    apart = np.diff(raw.times, prepend=-math.inf) > _INSTANT
    times, speeds = raw.times[apart], raw.speeds[apart]
    bends = np.abs(np.diff(np.diff(speeds) / np.diff(times))) > _STRAIGHT * limits.used_acceleration
    corners = np.concatenate([[True], bends, [True]])
    return Raw(times[corners], speeds[corners])


@dataclass(frozen=True, eq=False)
class Profile:
    """A profile as a source.

    Parameters
    ----------
    begin : the setpoint where it begins, wherever the load is
    reference : where it ends, rad
    limits : of its motion
    past : the raw motion of the last window; by default an even acceleration
    """

    begin: Setpoint
    reference: float
    limits: MotionLimits
    past: Raw | None = None

    def onward(self, begin: Setpoint, reference: float, time: float) -> "Profile":
        """Return the profile to another reference, from ``time`` of this one on, s, where the setpoint is ``begin``."""
        if time == 0.0:  # nothing has moved: as if this profile had not been
            return Profile(begin, reference, self.limits, self.past)
        raw, window = self.raw, self.limits.window
        times = raw.times - time
        inside = (times > -window) & (times < 0.0)
        first, last = raw.at(np.array([time - window, time]))
        past = Raw(np.array([-window, *times[inside], 0.0]), np.array([first, *raw.speeds[inside], last]))
        return Profile(begin, reference, self.limits, past)

    @cached_property
    def raw(self) -> Raw:
        """The raw motion, from a window before the begin on."""
        window, speed = self.limits.window, float(self.begin[VELOCITY])
        change = 0.5 * window * float(self.begin[ACCELERATION])
        past = self.past or Raw(np.array([-window, 0.0]), np.array([speed - change, speed + change]))
        # How far it is ahead of its mean; Simpson's rule is exact.
        middles = 0.5 * (past.times[1:] + past.times[:-1])
        weighted, between = past.speeds * (past.times + window), past.at(middles) * (middles + window)
        ahead = np.diff(past.times) @ (weighted[1:] + 4.0 * between + weighted[:-1]) / (6.0 * window)
        distance = self.reference - float(self.begin[POSITION] + ahead)
        future = _fastest(distance, float(past.speeds[-1]), self.limits)
        whole = Raw(np.append(past.times, future.times[1:]), np.append(past.speeds, future.speeds[1:]))
        return _without_false_corners(whole, self.limits)

    @cached_property
    def rows(self) -> Array:
        """The mean of the raw motion over the window, then the reference at rest, as `Source.segments` returns them."""
        window, raw = self.limits.window, self.raw
        times = np.unique(np.concatenate([[0.0], raw.times, raw.times + window]))
        times = times[times >= 0.0]
        accelerations = (raw.at(times) - raw.at(times - window)) / window
        lasts, begins, ends = np.diff(times), accelerations[:-1], accelerations[1:]
        speeds = self.begin[VELOCITY] + np.cumsum(np.append(0.0, 0.5 * lasts * (begins + ends)))[:-1]
        ways = lasts * (speeds + lasts * (2.0 * begins + ends) / 6.0)
        positions = self.begin[POSITION] + np.cumsum(np.append(0.0, ways))[:-1]
        jerks = (ends - begins) / np.maximum(lasts, _INSTANT)
        rows = np.zeros((times.size, DURATION + 1))
        rows[:-1, :4] = np.stack([positions, speeds, begins / 2.0, jerks / 6.0], axis=-1)
        rows[:-1, DURATION] = lasts
        rows[-1, [POSITION, DURATION]] = self.reference, _REST
        return rows[rows[:, DURATION] > _INSTANT]

    def segments(self, start: Setpoint) -> Array:  # noqa: ARG002  it says itself where it starts
        """Return the rows."""
        return self.rows

    @property
    def reach(self) -> tuple[float, float]:
        """The smallest and the largest position, rad: at the ends of rows, and where the setpoint turns within one."""
        position, speed, half, sixth, *_, lasts = self.rows.T
        acceleration, jerk = 2.0 * half, 6.0 * sixth
        with np.errstate(divide="ignore", invalid="ignore"):  # where there is no turn
            root = -(acceleration + np.copysign(np.sqrt(acceleration**2 - 2.0 * jerk * speed), acceleration))
            turns = np.stack([np.zeros_like(root), root / jerk, 2.0 * speed / root])
        turns = np.where((turns > 0.0) & (turns < lasts), turns, 0.0)
        places = position + turns * (speed + turns * (half + turns * sixth))
        return float(np.min(places)), float(np.max(places))

    @property
    def top_speed(self) -> float:
        """The largest speed of the raw motion, rad/s: the setpoint is no faster."""
        return float(np.max(np.abs(self.raw.speeds)))
