"""Reads a recorded bag as arrays."""

from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backlash_ros.recordings.bag_files import opened

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
    ``in_use``: time, version and parameters by name for each version that the controller used, sorted: a recorder that
    has just found the controller may receive older versions after newer ones; ``simulated``: the same of the simulator.
    """

    joint_states: Series
    scalars: dict[str, Series]
    parameters: list[tuple[float, str, Any]]
    messages: dict[str, int]
    in_use: list[tuple[float, int, dict[str, Any]]] = field(default_factory=list)
    simulated: list[tuple[float, int, dict[str, Any]]] = field(default_factory=list)


def seconds_of(stamp: Any) -> float:
    """Return the stamp of a message, s."""
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
"""The field of a ParameterValue that holds its value, by its type."""


def in_use_of(message: Any) -> tuple[float, int, dict[str, Any]]:
    """Return stamp (s), version and parameters of one message of ``~/parameters_in_use``."""
    values = {p.name: getattr(p.value, _PARAMETER_FIELDS[p.value.type]) for p in message.new_parameters}
    values = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
    return seconds_of(message.stamp), values.pop("version"), values


def joint_values(message: Any, joint: str) -> list[float]:
    """Return position, velocity and effort of a joint in a message, nan if missing."""
    k = message.name.index(joint) if joint in message.name else len(message.name)
    fields = (message.position, message.velocity, message.effort)
    return [float(values[k]) if k < len(values) else float("nan") for values in fields]


def read_bag(path: str | Path, *, motor_joint: str = "motor", load_joint: str = "load") -> Recording:
    """Read a rosbag2 directory.

    A bag whose recorder was killed can be read up to about the last second before.

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
    with opened(Path(path)) as (reader, _):
        messages = {connection.topic: 0 for connection in reader.connections}
        for connection, timestamp, raw in reader.messages():
            messages[connection.topic] += 1
            message: Any = reader.deserialize(raw, connection.msgtype)
            received = 1e-9 * timestamp
            if connection.msgtype == "sensor_msgs/msg/JointState":
                stamps.append(seconds_of(message.header.stamp))
                rows.append([*joint_values(message, motor_joint), *joint_values(message, load_joint)])
            elif connection.topic.endswith("/parameters_in_use"):
                (simulated if connection.topic.endswith("/plant_simulator/parameters_in_use") else in_use).append(
                    in_use_of(message)
                )
            elif connection.msgtype == "rcl_interfaces/msg/ParameterEvent":
                parameters += [(received, p.name, p.value) for p in message.changed_parameters]
            elif connection.topic.endswith("/state") and connection.msgtype == "diagnostic_msgs/msg/DiagnosticArray":
                for entry in message.status[0].values:
                    times, values = scalars.setdefault(f"{connection.topic}/{entry.key}", ([], []))
                    times.append(seconds_of(message.header.stamp))
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
