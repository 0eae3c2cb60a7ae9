"""Bags built message by message, as any machine may leave them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES: dict[str, Any] = STORE.types
START = 1_700_000_000.0
"""When the bags begin, s since the epoch: 2023-11-14 22:13:20 UTC."""
EVENT = "rcl_interfaces/msg/ParameterEvent"
_NOTHING = {
    "bool_value": False,
    "integer_value": 0,
    "double_value": 0.0,
    "string_value": "",
    "string_array_value": [],
    "byte_array_value": np.empty(0, np.uint8),
    "bool_array_value": np.empty(0, np.bool_),
    "integer_array_value": np.empty(0, np.int64),
    "double_array_value": np.empty(0),
}
_KINDS = {bool: (1, "bool_value"), int: (2, "integer_value"), float: (3, "double_value"), str: (4, "string_value")}


def _stamp(seconds: float) -> Any:
    whole, rest = divmod(round(1e9 * (START + seconds)), 10**9)
    return TYPES["builtin_interfaces/msg/Time"](sec=whole, nanosec=rest)


def _parameter(name: str, value: Any) -> Any:
    if isinstance(value, list):
        kind, place = (9, "string_array_value") if isinstance(value[0], str) else (8, "double_array_value")
    else:
        kind, place = _KINDS[type(value)]
    filled = np.array(value, dtype=float) if kind == 8 else value
    given = TYPES["rcl_interfaces/msg/ParameterValue"](type=kind, **{**_NOTHING, place: filled})
    return TYPES["rcl_interfaces/msg/Parameter"](name, given)


def in_use_event(stamp: Any, version: int, values: Mapping[str, object], node: str = "") -> Any:
    """Return the message of ``~/parameters_in_use``; ``stamp``: a message, too."""
    told = [_parameter(name, value) for name, value in {"version": version, **values}.items()]
    return TYPES[EVENT](stamp, node, told, [], [])


class PlainBag:
    """Takes messages with times in s from `START`, and writes them in their order."""

    def __init__(self) -> None:
        self._messages: list[tuple[float, str, str, Any]] = []

    def _add(self, time: float, topic: str, kind: str, **fields: Any) -> None:
        self._messages.append((time, topic, kind, TYPES[kind](**fields)))

    def _header(self, stamp: float) -> Any:
        return TYPES["std_msgs/msg/Header"](stamp=_stamp(stamp), frame_id="")

    def sample(
        self,
        topic: str,
        stamp: float,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float] = (),
        effort: Sequence[float] = (),
        *,
        received: float | None = None,
    ) -> None:
        """Add joint states."""
        columns = (np.array(values, dtype=float) for values in (position, velocity, effort))
        fields = dict(zip(("position", "velocity", "effort"), columns, strict=True))
        time = stamp if received is None else received
        self._add(time, topic, "sensor_msgs/msg/JointState", header=self._header(stamp), name=list(names), **fields)

    def number(self, topic: str, time: float, value: float) -> None:
        """Add a number."""
        self._add(time, topic, "std_msgs/msg/Float64", data=float(value))

    def numbers(self, topic: str, time: float, values: Sequence[float], *, answers: float | None = None) -> None:
        """Add a row of numbers, which may name the stamp of the sample that it answers."""
        named = "" if answers is None else "{0.sec}.{0.nanosec:09d}".format(_stamp(answers))
        dimension = TYPES["std_msgs/msg/MultiArrayDimension"](label=named, size=len(values), stride=len(values))
        layout = TYPES["std_msgs/msg/MultiArrayLayout"](dim=[dimension], data_offset=0)
        self._add(time, topic, "std_msgs/msg/Float64MultiArray", layout=layout, data=np.array(values, dtype=float))

    def status(
        self,
        topic: str,
        time: float,
        name: str,
        values: Mapping[str, object] | None = None,
        level: int = 0,
        text: str = "",
    ) -> None:
        """Add a diagnostic status, such as ``~/state`` has."""
        pair = TYPES["diagnostic_msgs/msg/KeyValue"]
        said = [pair(key=key, value=str(value)) for key, value in (values or {}).items()]
        kind = TYPES["diagnostic_msgs/msg/DiagnosticStatus"]
        status = kind(level=level, name=name, message=text, hardware_id="", values=said)
        self._add(time, topic, "diagnostic_msgs/msg/DiagnosticArray", header=self._header(time), status=[status])

    def in_use(self, topic: str, time: float, version: int, values: Mapping[str, object]) -> None:
        """Add the parameters in use."""
        self._messages.append((time, topic, EVENT, in_use_event(_stamp(time), version, values)))

    def write(self, path: Path, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
        """Write the bag, and make what leads to it."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with Writer(path, version=9, storage_plugin=storage) as writer:
            topics: dict[str, Any] = {}
            for time, topic, kind, message in sorted(self._messages, key=lambda entry: entry[0]):
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=STORE)
                writer.write(topics[topic], round(1e9 * (START + time)), STORE.serialize_cdr(message, kind))
        return path
