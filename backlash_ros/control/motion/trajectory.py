"""A trajectory: where the load is to be at which times, as trajectory_msgs/JointTrajectory says it for one joint.

It means what it means to ros2_control's joint_trajectory_controller: positions alone are joined by straight lines, with
velocities by cubics, with accelerations too by quintics. It begins with the setpoint that there is, wherever the load
may be, so that a trajectory that replaces another one in flight does not leap. Points whose time has passed are left
out, and the last point is held.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from backlash_ros.control.motion.setpoint import DURATION, joined
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY, Setpoint

START = 0.05
"""Largest distance from the setpoint to a first point that is due at once, rad: five times what MoveIt allows."""
_FIELDS = "positions", "velocities", "accelerations"


class TrajectoryError(ValueError):
    """A trajectory that cannot be followed; the text names point, field, value and bound."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Points of one joint, as a source of setpoints.

    Parameters
    ----------
    times : s from the trajectory's start, shape (points,), >= 0 and increasing
    states : position, rad, then velocity, rad/s, and acceleration, rad/s^2, if given; shape (points, 1 to 3)
    age : time that has passed since the trajectory's start, s; negative if it starts later

    Raises
    ------
    TrajectoryError
        If there is no point, a number is not finite, times do not increase, it does not end at rest, or its end has
        passed.
    """

    times: Array
    states: Array
    age: float = 0.0

    def __post_init__(self) -> None:
        times, states = self.times, self.states
        if states.ndim != 2 or not 1 <= states.shape[1] <= 3 or times.shape != states.shape[:1]:
            raise TrajectoryError(f"a trajectory has times (points,) and states (points, 1 to 3), got {states.shape}")
        if not times.size:
            raise TrajectoryError("trajectory must have at least one point, got none")
        for field, values in (("time_from_start", times), *zip(_FIELDS, states.T, strict=False)):
            if not np.all(np.isfinite(values)):
                k = int(np.argmin(np.isfinite(values)))
                raise TrajectoryError(f"{field} of point {k} must be finite, got {values[k]:g}")
        if times[0] < 0.0:
            raise TrajectoryError(f"time_from_start of point 0 must be >= 0 s, got {times[0]:g}")
        if np.any(np.diff(times) <= 0.0):
            k = 1 + int(np.argmax(np.diff(times) <= 0.0))
            raise TrajectoryError(
                f"time_from_start of point {k} must be > {times[k - 1]:g} s, that of the point before, "
                f"got {times[k]:g} s"
            )
        if states.shape[1] > 1 and states[-1, 1] != 0.0:
            raise TrajectoryError(f"velocities of the last point must be 0 rad/s, got {states[-1, 1]:g}")
        if not math.isfinite(self.age):
            raise TrajectoryError(f"the start of a trajectory must be finite, got {-self.age:g} s from now")
        if times[-1] < self.age or (times[-1] == self.age and times.size > 1):
            raise TrajectoryError(f"trajectory must not end in the past, got an end {self.age - times[-1]:.3g} s ago")

    def segments(self, start: Setpoint) -> Array:
        """Return the plan from the setpoint ``start`` on, see `setpoint.Source`.

        Raises
        ------
        TrajectoryError
            If the first point is due at once, and further than `START` from ``start``.
        """
        due = self.times - self.age
        first = int(np.searchsorted(due, 0.0, side="right"))
        if due[0] == 0.0 and abs(self.states[0, 0] - start[POSITION]) > START:
            raise TrajectoryError(
                f"positions of point 0, which is due at once, must be within {START:g} rad of the setpoint, "
                f"{start[POSITION]:g} rad, got {self.states[0, 0]:g}; give the point a time > 0 to go there"
            )
        ends, left = self.states[first:], due[first:]
        if not left.size:  # a single point, due at once: it is held
            return np.array([[self.states[-1, 0], 0.0, 0.0, 0.0, 0.0, 0.0, math.inf]])
        begins = np.vstack([start[[POSITION, VELOCITY, ACCELERATION]][: ends.shape[1]], ends[:-1]])
        durations = np.diff(left, prepend=0.0)
        rows = np.zeros((left.size, DURATION + 1))
        rows[:, : 2 * ends.shape[1]] = joined(begins, ends, durations)
        rows[:, DURATION] = durations
        return rows


def trajectory_of(message: Any, joint: str, now: int) -> Trajectory:
    """Return what a trajectory_msgs/JointTrajectory says for one joint.

    Parameters
    ----------
    message : or anything with its fields
    joint : whose points are taken; the other joints belong to other axes
    now : time on the clock of the message's stamp, ns; a stamp of 0 means now

    Raises
    ------
    TrajectoryError
        If the joint is not named once, or its points cannot be followed.
    """
    times, states = points_of(message, joint)
    stamp = stamp_ns(message.header.stamp)
    return Trajectory(times, states, 1e-9 * (now - stamp) if stamp else 0.0)


def points_of(message: Any, joint: str) -> tuple[Array, Array]:
    """Return the points that such a message has for one joint: times and states, as `Trajectory` takes them.

    Raises
    ------
    TrajectoryError
        If the joint is not named once, there is no point, or the sizes of its points do not fit.
    """
    names = list(message.joint_names)
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise TrajectoryError(f"joint_names must name each joint once, got {', '.join(doubled)} more than once")
    if joint not in names:
        raise TrajectoryError(f"joint_names must contain {joint!r}, got {names}")
    points = list(message.points)
    if not points:
        raise TrajectoryError("trajectory must have at least one point, got none")
    kinds = _kinds(points, len(names))
    index = names.index(joint)
    times = np.array([_seconds(point.time_from_start) for point in points])
    states = np.array([[getattr(point, kind)[index] for kind in kinds] for point in points], dtype=np.float64)
    return times, states


def _seconds(time: Any) -> float:
    return float(time.sec) + 1e-9 * float(time.nanosec)


def _kinds(points: Sequence[Any], joints: int) -> tuple[str, ...]:
    """Return the fields that every point has for every joint, positions first; TrajectoryError where sizes differ."""
    present = tuple(kind for kind in _FIELDS if len(getattr(points[0], kind)))
    if present != _FIELDS[: max(len(present), 1)]:
        raise TrajectoryError(f"points must have positions, and velocities to have accelerations, got {list(present)}")
    for k, point in enumerate(points):
        if len(point.effort):
            raise TrajectoryError(
                f"effort of point {k} must be empty: the controller finds it, got {list(point.effort)}"
            )
        for kind in _FIELDS:
            size, due = len(getattr(point, kind)), joints if kind in present else 0
            if size != due:
                raise TrajectoryError(f"{kind} of point {k} must have {due} values, got {size}")
    return present
