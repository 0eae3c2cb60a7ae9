"""The messages between drive and controller: joint states, and commands that name the sample they answer."""

import math
import struct

from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement

_DOUBLE = struct.Struct("=d")


def to_stamp(ns: int) -> Time:
    """Return ns as a stamp."""
    seconds, nanoseconds = divmod(ns, 10**9)
    return Time(sec=seconds, nanosec=nanoseconds)


def stamp_label(stamp: Time) -> str:
    """Return the label by which an answer names its sample: the sample's stamp."""
    return f"{stamp.sec}.{stamp.nanosec:09d}"


def answer(value: float, label: str = "") -> Float64MultiArray:
    """Return a command; ``label`` names the sample that it answers."""
    message = Float64MultiArray(data=[value])
    if label:
        message.layout.dim = [MultiArrayDimension(label=label, size=1, stride=1)]
    return message


class Answer:
    """The serialized answers of a controller.

    Each answer overwrites the last one: creating and serializing a message takes longer than the rest of a step.
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


def fill_joint_state(
    message: JointState, joints: tuple[str, str], measured: Measurement, torques: tuple[float, float]
) -> None:
    """Write a drive's measurement into a message: joints without an angle are left out, unknown values are nan.

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
