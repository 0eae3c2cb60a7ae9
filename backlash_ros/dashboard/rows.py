"""Messages as rows of numbers, and many rows as one frame of bytes for the page."""

import math
from collections.abc import Sequence
from itertools import takewhile

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from backlash_ros.control.telemetry import TELEMETRY
from backlash_ros.foundation.messages import number_in

JOINT_COLUMNS = ("time", "motor", "load", "gear_torque")
"""Columns of a joint state: s; angles of the motor at the output and of the load, rad; N m at the output."""

STATE_COLUMNS = ("time", *TELEMETRY)
"""Columns of a message of ``~/state``."""

Table = npt.NDArray[np.float64]
_Bytes = npt.NDArray[np.uint8]

_HEAD = 4
"""Size of the header of a serialized message, bytes. Fields are aligned relative to its end."""
_PLAIN = b"\x00\x01"
"""Beginning of the header: little-endian CDR."""
_STAMP = 8
"""Size of a time, bytes: two whole numbers, s and ns."""


class _Pattern:
    """Serialized joint states that differ from ``sample`` only in their numbers."""

    def __init__(self, sample: bytes) -> None:
        self._same = np.zeros(len(sample), bool)  # its bytes that are the same in all; what fills gaps may be anything
        self._same[: len(_PLAIN)] = True
        self._names: list[str] = []
        self._sample = np.frombuffer(sample, np.uint8)
        self._end = _HEAD + _STAMP
        self._text()  # the frame
        self._names = [self._text() for _ in range(self._count())]
        self._positions, _, self._efforts = (self._numbers() for _ in range(3))

    def _count(self) -> int:
        first = self._end + -self._end % 4
        self._end = first + 4
        self._same[first : self._end] = True
        return int(self._sample[first : self._end].view(np.uint32)[0])

    def _text(self) -> str:
        length = self._count()
        first, self._end = self._end, self._end + length
        self._same[first : self._end] = True
        return self._sample[first : self._end - 1].tobytes().decode()

    def _numbers(self) -> list[int]:
        """Return where each number begins."""
        count = self._count()
        if count:
            self._end += (_HEAD - self._end) % 8 + 8 * count
        return [self._end - 8 * left for left in range(count, 0, -1)]

    def read(self, messages: Sequence[bytes], motor: str, load: str) -> Table:
        """Return the rows, shape (count, 4), of the first messages that are like the sample."""
        size = self._sample.size
        run = list(takewhile(lambda message: len(message) == size, messages))
        table: _Bytes = np.frombuffer(b"".join(run), np.uint8).reshape(-1, size)
        alike = (table[:, self._same] == self._sample[self._same]).all(axis=1)
        table = table[np.logical_and.accumulate(alike)]

        def column(places: Sequence[int], joint: str) -> Table:
            index = self._names.index(joint) if joint in self._names else len(places)
            if index >= len(places):
                return np.full(len(table), math.nan)
            return table[:, places[index] : places[index] + 8].copy().view(np.float64)[:, 0]

        stamps = table[:, _HEAD : _HEAD + _STAMP].copy().view(np.int32)
        time = stamps[:, 0] + 1e-9 * stamps[:, 1]
        places = self._positions
        return np.column_stack([time, column(places, motor), column(places, load), column(self._efforts, load)])


class JointReader:
    """Reads many serialized joint states at once: at 1 kHz, one by one costs too much beside a drive.

    Usually the messages of a topic differ only in their numbers; others are read one by one.
    """

    def __init__(self) -> None:
        self._patterns: dict[int, _Pattern] = {}

    def rows(self, messages: Sequence[bytes], motor: str, load: str, reduction: float) -> Table:
        """Return the rows of `JOINT_COLUMNS`, shape (messages, 4); nan for missing values.

        Parameters
        ----------
        messages : of type ``sensor_msgs/msg/JointState``, serialized
        motor, load : names of the joints
        reduction : turns of the motor for one of the load
        """
        waiting = list(messages)
        tables = [np.empty((0, len(JOINT_COLUMNS)))]
        while waiting:
            pattern = self._patterns.get(len(waiting[0]))
            rows = pattern.read(waiting, motor, load) if pattern else tables[0]
            if not len(rows):
                if waiting[0][: len(_PLAIN)] != _PLAIN:
                    waiting[0] = serialize_message(deserialize_message(waiting[0], JointState))
                self._patterns[len(waiting[0])] = pattern = _Pattern(waiting[0])
                rows = pattern.read(waiting, motor, load)
            tables.append(rows)
            del waiting[: len(rows)]
        table = np.concatenate(tables)
        table[:, JOINT_COLUMNS.index("motor")] /= reduction
        return table


def state_rows(messages: Sequence[DiagnosticArray]) -> Table:
    """Return the rows of `STATE_COLUMNS`, shape (messages, columns); nan for missing values."""
    rows = []
    for message in messages:
        stamp = message.header.stamp
        values = {entry.key: entry.value for status in message.status for entry in status.values}
        rows.append([stamp.sec + 1e-9 * stamp.nanosec, *(number_in(values.get(name, "")) for name in TELEMETRY)])
    return np.array(rows).reshape(-1, len(STATE_COLUMNS))


def frame(samples: Table, states: Table) -> bytes:
    """Return numbers of 8 bytes: the size of the samples in bytes, the samples, and the states."""
    return np.concatenate([[samples.nbytes], samples.ravel(), states.ravel()]).tobytes()
