"""Reading a recorded bag back as arrays."""

import os
import struct
from binascii import crc32
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """Values of a topic: ``time`` (N,), s since the epoch, and ``values`` (N, ...)."""

    time: Array
    values: Array

    def between(self, start: float, end: float) -> "Series":
        """Return the part with start <= time < end."""
        chosen = (self.time >= start) & (self.time < end)
        return Series(self.time[chosen], self.values[chosen])


@dataclass(frozen=True)
class Recording:
    """A recorded session.

    ``joint_states`` at their header's stamps with columns theta_m, omega_m, motor torque, theta_l, omega_l, gear torque
    (rad, rad/s, N m); the scalar topics by name and the changed parameters at their time of receipt; what ``~/state``
    has, at its stamps, by topic and name such as ``/controller/state/error``; ``messages`` counts every topic.
    ``in_use``: from when on the controller used which version of its parameters, and these by name, in that order: to a
    recorder that has just found the controller older versions may come after newer ones; ``simulated``: the same of the
    simulator.
    """

    joint_states: Series
    scalars: dict[str, Series]
    parameters: list[tuple[float, str, Any]]
    messages: dict[str, int]
    in_use: list[tuple[float, int, dict[str, Any]]] = field(default_factory=list)
    simulated: list[tuple[float, int, dict[str, Any]]] = field(default_factory=list)


def _stamp(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


_PARAMETER_FIELDS = (
    "",
    "bool_value",
    "integer_value",
    "double_value",
    "string_value",
    "byte_array_value",
    "bool_array_value",
    "integer_array_value",
    "double_array_value",
    "string_array_value",
)
"""Where a ParameterValue holds its value, by its type."""


def parameters_of(message: Any) -> tuple[float, int, dict[str, Any]]:
    """Return stamp (s), version and values of a message of ``~/parameters_in_use``."""
    values = {p.name: getattr(p.value, _PARAMETER_FIELDS[p.value.type]) for p in message.new_parameters}
    values = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
    return _stamp(message.stamp), values.pop("version"), values


def _joint_row(message: Any, motor: str, load: str) -> list[float]:
    row = []
    for joint in (motor, load):
        k = message.name.index(joint) if joint in message.name else len(message.name)
        fields = (message.position, message.velocity, message.effort)
        row += [float(values[k]) if k < len(values) else float("nan") for values in fields]
    return row


_MAGIC = b"\x89MCAP0\r\n"
_HEADER, _CHUNK, _MESSAGE_INDEX = 0x01, 0x06, 0x07
_END = struct.pack("<BQL", 0x0F, 4, 0) + struct.pack("<BQQQL", 0x02, 20, 0, 0, 0) + _MAGIC  # of data, without a summary


def _is_torn(file: Path) -> bool:
    with file.open("rb") as stream:
        stream.seek(-min(len(_MAGIC), file.stat().st_size), os.SEEK_END)
        return stream.read() != _MAGIC


def _mend(torn: Path, mended: Path) -> None:
    """Copy an mcap file of the recorder that lacks its end as far as it is whole."""
    left = torn.stat().st_size - len(_MAGIC)
    with torn.open("rb") as source, mended.open("wb") as target:
        target.write(source.read(len(_MAGIC)))
        while len(head := source.read(9)) == 9:
            kind, length = struct.unpack("<BQ", head)
            left -= len(head) + length
            if kind not in {_HEADER, _CHUNK, _MESSAGE_INDEX} or left < 0:
                break
            record = source.read(length)
            if kind == _CHUNK and (length < 40 or struct.unpack_from("<L", record, 24)[0] != crc32(record[40:])):
                break
            target.write(head + record)
        target.write(_END)


@contextmanager
def readable(bag: Path) -> Iterator[Path]:
    """Yield the bag, or a passing copy of what can be read where its writer was killed while writing."""
    files = list(bag.glob("*.mcap"))
    if len(files) == 1 and _is_torn(files[0]):
        with TemporaryDirectory() as folder:
            copy = Path(folder, files[0].name)
            _mend(files[0], copy)
            yield copy
    else:
        yield bag


def read_bag(path: str | Path, *, motor_joint: str = "motor", load_joint: str = "load") -> Recording:
    """Read a rosbag2 directory.

    Also one whose recorder was killed: such a bag holds everything up to about the last second.

    Raises
    ------
    rosbags.highlevel.AnyReaderError
        If there is no bag or it cannot be read.
    """
    stamps: list[float] = []
    rows: list[list[float]] = []
    scalars: dict[str, tuple[list[float], list[float]]] = {}
    parameters: list[tuple[float, str, Any]] = []
    in_use: list[tuple[float, int, dict[str, Any]]] = []
    simulated: list[tuple[float, int, dict[str, Any]]] = []
    with (
        readable(Path(path)) as whole,
        AnyReader([whole], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader,
    ):
        messages = {connection.topic: 0 for connection in reader.connections}
        for connection, timestamp, raw in reader.messages():
            messages[connection.topic] += 1
            message: Any = reader.deserialize(raw, connection.msgtype)
            received = 1e-9 * timestamp
            if connection.msgtype == "sensor_msgs/msg/JointState":
                stamps.append(_stamp(message.header.stamp))
                rows.append(_joint_row(message, motor_joint, load_joint))
            elif connection.topic.endswith("/parameters_in_use"):
                (simulated if connection.topic.endswith("/plant_simulator/parameters_in_use") else in_use).append(
                    parameters_of(message)
                )
            elif connection.msgtype == "rcl_interfaces/msg/ParameterEvent":
                parameters += [(received, p.name, p.value) for p in message.changed_parameters]
            elif connection.topic.endswith("/state") and connection.msgtype == "diagnostic_msgs/msg/DiagnosticArray":
                for entry in message.status[0].values:
                    times, values = scalars.setdefault(f"{connection.topic}/{entry.key}", ([], []))
                    times.append(_stamp(message.header.stamp))
                    values.append(float(entry.value))
            elif np.size(data := getattr(message, "data", ())) and np.asarray(data).dtype.kind in "biuf":
                times, values = scalars.setdefault(connection.topic, ([], []))
                times.append(received)
                values.append(float(np.ravel(data)[0]))
    return Recording(
        Series(np.array(stamps), np.array(rows).reshape(-1, 6)),
        {topic: Series(np.array(times), np.array(values)) for topic, (times, values) in scalars.items()},
        parameters,
        messages,
        sorted(in_use, key=itemgetter(0, 1)),
        sorted(simulated, key=itemgetter(0, 1)),
    )
