"""How PlotJuggler and Foxglove name what a bag has.

PlotJuggler 3: plotjuggler_plugins/ParserROS/ros_parser.cpp, for joint states, diagnostics and plain messages; Foxglove:
docs.foxglove.dev, "message path syntax", with texts as numbers in plots (panels/Plot/datum.ts of its open version).
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

_PART = re.compile(r"""\.(?P<field>\w+)|\[(?P<index>\d*|:)\]|\{(?P<key>\w+)==["'](?P<value>[^"']*)["']\}""")


def messages(bag: Path) -> Iterator[tuple[str, str, Any]]:
    """Yield topic, type and content of each message."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            yield connection.topic, connection.msgtype, reader.deserialize(raw, connection.msgtype)


def plotjuggler_names(topic: str, kind: str, message: Any) -> set[str]:
    """Return the names of the series that PlotJuggler makes of a message."""
    if kind == "sensor_msgs/msg/JointState":
        fields = ("position", "velocity", "effort")
        return {
            f"{topic}/{joint}/{field}" for joint in message.name for field in fields if len(getattr(message, field))
        }
    if kind == "diagnostic_msgs/msg/DiagnosticArray":
        places = [(f"{topic}/{s.hardware_id}" if s.hardware_id else topic, s) for s in message.status]
        return {f"{place}/{s.name}/{entry.key}" for place, s in places for entry in s.values}
    if kind == "std_msgs/msg/Float64MultiArray":
        return {f"{topic}/data[{k}]" for k in range(len(message.data))}
    return {f"{topic}/data"} if kind == "std_msgs/msg/Float64" else set()


def foxglove_values(path: str, topic: str, message: Any) -> list[float]:
    """Return the numbers that a path has in a message of its topic."""
    found, rest = [message], path.removeprefix(topic)
    while rest:
        part = _PART.match(rest)
        assert part, f"{path}: {rest} cannot be read"
        rest = rest[part.end() :]
        if part["field"]:
            found = [getattr(each, part["field"]) for each in found]
        elif part["index"] == ":":
            found = [item for each in found for item in each]
        elif part["index"] is not None:
            found = [each[int(part["index"])] for each in found]
        else:
            found = [each for each in found if getattr(each, part["key"]) == part["value"]]
    return [float(each) for each in found]
