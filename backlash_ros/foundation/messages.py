"""The content of the messages between drive and controller, deserialised by rclpy or by a reader of bags."""

import math
import re
from typing import Any

import numpy as np

from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement

_STAMP = re.compile(r"(-?\d+)\.(\d{9})")


def stamp_ns(stamp: Any) -> int:
    """Return a stamp in ns, by which the gates name a sample."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def answered_sample(command: Any) -> int | None:
    """Return the stamp of the sample that a command answers, ns; None if it names none."""
    layout = getattr(command, "layout", None)
    named = _STAMP.fullmatch(layout.dim[0].label) if layout is not None and layout.dim else None
    return None if named is None else int(named[1]) * 10**9 + int(named[2])


def number_in(text: str) -> float:
    """Return the number that a text says, as the values of ``~/state`` are texts; nan if it says none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


LARGEST = 1e9
"""Largest magnitude of an angle (rad), speed (rad/s) or torque (N m) that is believed."""


class BadSampleError(ValueError):
    """A message that cannot be used; the text says why."""


class NotOurJointsError(Exception):
    """A message about other joints: several drives may share a topic."""


def _usable(what: str, joint: str, value: float, unit: str) -> float:
    if not abs(value) <= LARGEST:
        raise BadSampleError(f"{what} of joint {joint!r} must be finite and within +-{LARGEST:g} {unit}, got {value}")
    return value


def read_joint_state(
    message: Any,
    motor_joint: str,
    load_joint: str,
    torque_constant: float,
    out: Measurement | None = None,
    *,
    nan_is_absent: bool = False,
) -> Measurement:
    """Return the measurement in a message, nan where a value is missing.

    Joints are found by name, in any order; others are ignored, and either may be absent. Velocity and effort may be
    empty, or nan for a joint that does not measure them, as with ros2_control's joint_state_broadcaster.

    Parameters
    ----------
    torque_constant : of the motor, N m/A: its effort over this is the current
    out : to write into and return; a new array by default
    nan_is_absent : whether a position of nan says that the joint is absent; one of them must be there

    Raises
    ------
    NotOurJointsError
        If both joints are absent.
    BadSampleError
        If a joint appears twice, an array has the wrong length, a position is not finite or a velocity or effort is
        infinite.
    """
    names, positions, speeds, efforts = message.name, message.position, message.velocity, message.effort
    count = len(names)
    if len(positions) != count:
        raise BadSampleError(f"{count} names but {len(positions)} positions")
    for field, values in (("velocity", speeds), ("effort", efforts)):
        if len(values) not in (0, count):
            raise BadSampleError(f"{count} names but {len(values)} values of {field}")
    measured = Measurement(np.empty(5)) if out is None else out
    measured.fill(math.nan)
    seen = False
    for joint, angle, speed in ((motor_joint, THETA_M, OMEGA_M), (load_joint, THETA_L, OMEGA_L)):
        if joint not in names:
            continue
        if names.count(joint) > 1:
            raise BadSampleError(f"joint {joint!r} appears {names.count(joint)} times in one message")
        seen, k = True, names.index(joint)
        if nan_is_absent and math.isnan(positions[k]):
            continue
        measured[angle] = _usable("position", joint, positions[k], "rad")
        if len(speeds) and not math.isnan(speeds[k]):
            measured[speed] = _usable("velocity", joint, speeds[k], "rad/s")
        if len(efforts) and joint == motor_joint and not math.isnan(efforts[k]):
            measured[CURRENT] = _usable("effort", joint, efforts[k], "N m") / torque_constant
    if not seen:
        raise NotOurJointsError
    if nan_is_absent and math.isnan(measured[THETA_M]) and math.isnan(measured[THETA_L]):
        raise BadSampleError("no position of our joints is a number")
    return measured
