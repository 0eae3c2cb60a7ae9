"""What the messages between drive and controller say: joint states, and commands that name the sample they answer."""

import math
import re
import struct

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from backlash_ros.drivetrain.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement

_STAMP = re.compile(r"(-?\d+)\.(\d{9})")
_DOUBLE = struct.Struct("=d")


def stamp_ns(stamp: Time) -> int:
    """Return a stamp in ns; so gates name a sample."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def to_stamp(ns: int) -> Time:
    """Return ns as a stamp."""
    seconds, nanoseconds = divmod(ns, 10**9)
    return Time(sec=seconds, nanosec=nanoseconds)


def stamp_label(stamp: Time) -> str:
    """Return how an answer names the sample that it is for: the sample's stamp."""
    return f"{stamp.sec}.{stamp.nanosec:09d}"


def answer(value: float, label: str = "") -> Float64MultiArray:
    """Return a command; ``label`` names the sample that it answers."""
    message = Float64MultiArray(data=[value])
    if label:
        message.layout.dim = [MultiArrayDimension(label=label, size=1, stride=1)]
    return message


class Answer:
    """The answers of a controller as they go over the wire.

    One is written over the last: to make a message and to serialise it takes longer than all else that a step does.
    """

    def __init__(self) -> None:
        self._data, self._begin, self._length = bytearray(), 0, 0

    def to(self, stamp: Time, value: float) -> bytes:
        """Return the serialised command that answers the sample with a stamp."""
        label = b"%d.%09d" % (stamp.sec, stamp.nanosec)
        if self._length != len(label):
            self._data[:] = serialize_message(answer(0.0, label.decode()))
            self._begin, self._length = self._data.index(label), len(label)
        self._data[self._begin : self._begin + self._length] = label
        _DOUBLE.pack_into(self._data, len(self._data) - 8, value)  # the message's last field
        return bytes(self._data)


def answered_sample(command: Float64MultiArray) -> int | None:
    """Return the stamp of the sample that a command answers, ns; None where it names none."""
    named = _STAMP.fullmatch(command.layout.dim[0].label) if command.layout.dim else None
    return None if named is None else int(named[1]) * 10**9 + int(named[2])


LARGEST = 1e9
"""Beyond this no angle (rad), speed (rad/s) or torque (N m) is one that was measured."""


class BadSampleError(ValueError):
    """A message that cannot be used; the text says why."""


class NotOurJointsError(Exception):
    """A message of other joints: several drives may share a topic."""


def _usable(what: str, joint: str, value: float, unit: str) -> float:
    if not abs(value) <= LARGEST:
        raise BadSampleError(f"{what} of joint {joint!r} must be finite and within +-{LARGEST:g} {unit}, got {value}")
    return value


def read_joint_state(
    message: JointState, motor_joint: str, load_joint: str, torque_constant: float, out: Measurement | None = None
) -> Measurement:
    """Return the measurement in a message, nan where it does not say.

    Joints are found by name, in any order, others ignored; either may be absent. Velocity and effort may be empty, or
    nan where a joint does not measure them, as ros2_control's joint_state_broadcaster has it.

    Parameters
    ----------
    torque_constant : of the motor, N m/A: its effort over this is the current
    out : to write into and return; a new array by default

    Raises
    ------
    NotOurJointsError
        If both joints are absent.
    BadSampleError
        If one stands there twice, an array has the wrong length, a position is not finite or a velocity or effort is
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
            raise BadSampleError(f"joint {joint!r} stands {names.count(joint)} times in one message")
        seen, k = True, names.index(joint)
        measured[angle] = _usable("position", joint, positions[k], "rad")
        if speeds and not math.isnan(speeds[k]):
            measured[speed] = _usable("velocity", joint, speeds[k], "rad/s")
        if efforts and joint == motor_joint and not math.isnan(efforts[k]):
            measured[CURRENT] = _usable("effort", joint, efforts[k], "N m") / torque_constant
    if not seen:
        raise NotOurJointsError
    return measured


def fill_joint_state(
    message: JointState, joints: tuple[str, str], measured: Measurement, torques: tuple[float, float]
) -> None:
    """Write what a drive measures into a message: joints without an angle are left out, nan is what it does not know.

    Parameters
    ----------
    joints : names of the motor's and the load's
    torques : of the motor and on the load, N m
    """
    rows = [
        (name, float(measured[angle]), float(measured[speed]), torque)
        for name, angle, speed, torque in zip(joints, (THETA_M, THETA_L), (OMEGA_M, OMEGA_L), torques, strict=True)
        if not math.isnan(measured[angle])
    ]
    message.name, message.position, message.velocity, message.effort = (
        list(column) for column in zip(*rows, strict=True)
    )
