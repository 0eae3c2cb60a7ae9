"""Reads samples and commands of one drive from a rosbag2, and pairs them."""

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from backlash_ros.foundation.messages import answered_sample, stamp_ns
from backlash_ros.recordings.bag import in_use_of, joint_values
from backlash_ros.recordings.bag_files import messages_of, reading
from backlash_ros.recordings.samples import Columns

STAMPS = ("header", "log")
_JOINT_STATE = "sensor_msgs/msg/JointState"
_FASTER = 1.2
"""Commands per sample above which not all of them are answers."""


@dataclass(frozen=True)
class Topics:
    """What to read: topics (by default the only one), joints, the index in the command, and the kind of time.

    ``stamps``: whether the time of a sample is its header's, or that of its recording.
    """

    joint_states: str = ""
    command: str = ""
    motor_joint: str = "motor"
    load_joint: str = "load"
    index: int = 0
    stamps: str = "header"


@dataclass
class Messages:
    """Of samples: both times, ns, and both positions; of commands: time of recording, stamp of the sample, value.

    ``joints``: all joint names. ``in_use``: stamp, version and parameters of the ``controller``, in any order.
    """

    stamps: list[int]
    received: list[int]
    positions: list[tuple[float, float]]
    commands: list[tuple[int, int | None, float]]
    joints: set[str]
    in_use: list[tuple[float, int, Mapping[str, Any]]] = field(default_factory=list)
    controller: str = ""


def _one_of(given: str, found: Sequence[str], what: str, option: str, path: Path) -> str:
    """Return the requested topic, or the only one."""
    if given:
        wanted = given if given.startswith("/") else f"/{given}"
        if wanted not in found:
            raise ValueError(f"{path}: there is no {what} on '{wanted}'; there is on {sorted(found)}")
        return wanted
    if len(found) != 1:
        raise ValueError(f"{path}: {option} must be given: {what} are on {sorted(found)}")
    return found[0]


def controller_of(topics: Sequence[str], command: str, axes: int) -> str:
    """Return the controller that publishes ``command``, in its namespace; empty if none is known.

    In a bag of a single axis it may be in another one: the topic of commands is often renamed.
    """
    found = {t.rpartition("/")[0] for t in topics if t.endswith("/parameters_in_use") and "/plant_simulator/" not in t}
    own = {node for node in found if node.rpartition("/")[0] == command.rpartition("/")[0]}
    if not own and axes == 1:
        own = found
    return own.pop() if len(own) == 1 else ""


def _value(message: Any, topic: str, index: int, path: Path) -> float:
    data = np.ravel(getattr(message, "data", ()))
    if index >= data.size or data.dtype.kind not in "iuf":
        raise ValueError(f"{path}: a message on '{topic}' must have a number data[{index}], has {data.tolist()!r}")
    return float(data[index])


def _messages(path: Path, topics: Topics) -> tuple[Messages, str, str]:
    found = Messages([], [], [], [], set())
    with reading(path) as (reader, _):
        states = sorted({c.topic for c in reader.connections if c.msgtype == _JOINT_STATE})
        others = sorted({c.topic for c in reader.connections if c.msgtype.startswith("std_msgs/msg/")})
        source = _one_of(topics.joint_states, states, "joint states", "--joint-topic", path)
        likely = [topic for topic in others if topic.split("/")[-1] == "command"]
        likely = likely if len(likely) == 1 and not topics.command else others
        target = _one_of(topics.command, likely, "commands (std_msgs)", "--command-topic", path)
        found.controller = controller_of([c.topic for c in reader.connections], target, len(states))
        in_use = f"{found.controller}/parameters_in_use" if found.controller else ""
        for topic, received, message in messages_of(reader, {source, target, in_use}, path):
            if topic == source:
                found.stamps.append(stamp_ns(message.header.stamp))
                found.received.append(received)
                motor, load = (joint_values(message, joint)[0] for joint in (topics.motor_joint, topics.load_joint))
                found.positions.append((motor, load))
                found.joints |= set(message.name)
            elif topic == in_use:
                found.in_use.append(in_use_of(message))
            else:
                value = _value(message, target, topics.index, path)
                found.commands.append((received, answered_sample(message), value))
    return found, source, target


def _pair(found: Messages, *, by_header: bool) -> tuple[list[int], list[int], list[tuple[float, float]], list[float]]:
    """Return stamps, times of recording, positions and commands by sample.

    A command that names its sample belongs to it, even if the sample itself is missing. If commands name none, a sample
    gets the last one recorded before the next sample; without one, the previous command holds.
    """
    named = {stamp: (value, received) for received, stamp, value in found.commands if stamp is not None}
    if len(named) > 0.5 * len(found.commands):
        seen, first, last = set(found.stamps), found.stamps[0], max(found.stamps)
        rows = [
            (stamp, received, both, named.get(stamp, (math.nan, 0))[0])
            for stamp, received, both in zip(found.stamps, found.received, found.positions, strict=True)
        ]
        rows += [
            (stamp, received, (math.nan, math.nan), value)
            for stamp, (value, received) in named.items()
            if by_header and stamp not in seen and first < stamp < last
        ]
        if len(rows) > len(found.stamps):
            rows.sort(key=lambda row: row[0])
        stamps, received, positions, commands = (list(column) for column in zip(*rows, strict=True))
        return stamps, received, positions, commands
    times = [received for received, _, _ in found.commands]
    answers = []
    for follows in (*found.received[1:], math.inf):
        k = bisect_right(times, follows - 1) - 1
        answers.append(found.commands[k][2] if k >= 0 else math.nan)
    return found.stamps, found.received, found.positions, answers


def read_topics(path: Path, topics: Topics) -> Columns:
    """Return the samples and commands of a drive, from a folder, or a file, of a rosbag2.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        Names the topic, joint or clock that cannot be used.
    """
    return columns_of(*_messages(path, topics), topics, path)


def columns_of(found: Messages, source: str, target: str, topics: Topics, path: Path) -> Columns:
    """Return the samples of ``source`` and the commands of ``target``, paired.

    Raises
    ------
    ValueError
        As `read_topics`.
    """
    if not found.stamps or not found.commands:
        empty = source if not found.stamps else target
        raise ValueError(f"{path}: there is no message on '{empty}'")
    for joint in (topics.motor_joint, topics.load_joint):
        if joint and joint not in found.joints:
            raise ValueError(f"{path}: '{source}' has no joint '{joint}'; it has {sorted(found.joints)}")
    meanwhile = sum(found.received[0] <= received <= found.received[-1] for received, *_ in found.commands)
    if meanwhile > _FASTER * len(found.stamps):  # a recorder may hear one of both topics long before the other
        raise ValueError(
            f"{path}: '{target}' has {meanwhile} commands for {len(found.stamps)} samples on '{source}', "
            f"and may have {_FASTER:g} for each: which one acted cannot be told"
        )
    if topics.stamps == "header" and len(set(found.stamps)) == 1:
        raise ValueError(
            f"{path}: all headers of '{source}' have the same stamp; --stamps log takes the recorder's time"
        )
    stamps, received, positions, commands = _pair(found, by_header=topics.stamps == "header")
    clock = stamps if topics.stamps == "header" else received
    time = np.array([1e-9 * (ns - clock[0]) for ns in clock])
    motor, load = np.array(positions).T
    names = (
        f"the {topics.stamps}'s time on '{source}'",
        f"joint '{topics.motor_joint}'",
        f"joint '{topics.load_joint}'",
        f"'{target}'",
    )
    command = np.array(commands)
    command[~np.isfinite(command)] = math.nan
    told = max(found.in_use, key=itemgetter(0, 1))[2] if found.in_use else {}
    zero, place = 1e-9 * clock[0], lambda k: f"in sample {k + 1}"
    return Columns(time, motor.copy(), load.copy(), command, names, place, zero, told, found.controller, dated=True)
