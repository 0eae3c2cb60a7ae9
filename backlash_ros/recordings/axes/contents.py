"""Everything that a report needs from a bag, by topic, read in one pass; and what is wrong with the bag."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader

from backlash_ros.foundation.messages import answered_sample, number_in
from backlash_ros.recordings.bag import in_use_of, seconds_of
from backlash_ros.recordings.bag_files import opened, reason_of
from backlash_ros.recordings.csv_file import is_table

_JOINT_STATE = "sensor_msgs/msg/JointState"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_PARAMETERS = "rcl_interfaces/msg/ParameterEvent"
_STD = "std_msgs/msg/"


class Sample(NamedTuple):
    """A message of joint states: its stamp and when it was recorded, s; names, positions, velocities, efforts."""

    stamp: float
    received: float
    names: tuple[str, ...]
    position: Any
    velocity: Any
    effort: Any


class Numbers(NamedTuple):
    """A message of numbers: when it was recorded, s; its numbers; the stamp of the sample that it answers, s."""

    received: float
    values: Any
    answers: float


class Told(NamedTuple):
    """One status of ``/diagnostics``: time, s, name, level (0 good, 1 warning, 2 error) and text."""

    received: float
    name: str
    level: int
    text: str


@dataclass
class Contents:
    """A bag by topic.

    ``topics``: type and number of messages of each; ``states``: stamps (s) and values of ``~/state``; ``in_use`` and
    ``simulated``: stamp, version and parameters of each message of ``~/parameters_in_use``. ``start`` and ``end``: when
    the first and the last message were recorded, s since the epoch, nan without messages. ``damage`` describes what is
    wrong with the bag.
    """

    topics: dict[str, tuple[str, int]] = field(default_factory=dict)
    samples: dict[str, list[Sample]] = field(default_factory=dict)
    numbers: dict[str, list[Numbers]] = field(default_factory=dict)
    states: dict[str, list[tuple[float, dict[str, float]]]] = field(default_factory=dict)
    in_use: dict[str, list[tuple[float, int, dict[str, Any]]]] = field(default_factory=dict)
    told: list[Told] = field(default_factory=list)
    start: float = float("nan")
    end: float = float("nan")
    damage: list[str] = field(default_factory=list)


def _answered(message: Any) -> float:
    """Return the stamp of the sample that a command names in its label, s; nan if it names none."""
    if (stamp := answered_sample(message)) is None:
        return float("nan")
    seconds, ns = divmod(stamp, 10**9)
    return seconds + 1e-9 * ns


def _take(contents: Contents, topic: str, kind: str, received: float, message: Any) -> None:
    """Put a message where it belongs."""
    if kind == _JOINT_STATE:
        row = tuple(message.name), message.position, message.velocity, message.effort
        contents.samples.setdefault(topic, []).append(Sample(seconds_of(message.header.stamp), received, *row))
    elif kind == _PARAMETERS and topic.endswith("/parameters_in_use"):
        contents.in_use.setdefault(topic, []).append(in_use_of(message))
    elif kind == _DIAGNOSTICS and topic.endswith("/state"):
        values = {entry.key: number_in(entry.value) for status in message.status[:1] for entry in status.values}
        contents.states.setdefault(topic, []).append((seconds_of(message.header.stamp), values))
    elif kind == _DIAGNOSTICS:
        contents.told += [Told(received, status.name, int(status.level), status.message) for status in message.status]
    else:
        data = np.ravel(getattr(message, "data", ()))
        if data.size and data.dtype.kind in "iuf":
            contents.numbers.setdefault(topic, []).append(Numbers(received, data, _answered(message)))


def _wanted(kind: str) -> bool:
    return kind in {_JOINT_STATE, _DIAGNOSTICS, _PARAMETERS} or kind.startswith(_STD)


def _messages(reader: AnyReader, contents: Contents) -> Iterator[tuple[str, str, int, Any]]:
    """Yield topic, type, time (ns) and content of every readable message; the content of unused topics is None."""
    messages, broken = reader.messages(), 0
    while True:
        try:
            connection, time, raw = next(messages)
        except StopIteration:
            break
        except Exception as error:  # whatever a reader raises on damaged bytes
            contents.damage.append(f"what was recorded after this part cannot be read: {reason_of(error)}")
            break
        try:
            wanted = _wanted(connection.msgtype)
            content = reader.deserialize(raw, connection.msgtype) if wanted else None
        except Exception:
            broken += 1
            continue
        yield connection.topic, connection.msgtype, time, content
    if broken:
        contents.damage.append(f"{broken} messages cannot be read and were left out")


def _read(path: Path, *, damaged: bool) -> Contents:
    contents = Contents()
    with opened(path, damaged=damaged) as (reader, damage):
        contents.damage += damage
        contents.topics = {connection.topic: (connection.msgtype, 0) for connection in reader.connections}
        for topic, kind, time, content in _messages(reader, contents):
            received = 1e-9 * time
            contents.topics[topic] = kind, contents.topics[topic][1] + 1
            contents.start = np.fmin(contents.start, received)
            contents.end = np.fmax(contents.end, received)
            if content is not None:
                _take(contents, topic, kind, received, content)
    for states in contents.states.values():
        states.sort(key=lambda state: state[0])
    for versions in contents.in_use.values():
        versions.sort(key=lambda told: told[:2])
    return contents


def read_contents(path: Path) -> Contents:
    """Return the content of a bag, as far as it can be read.

    Raises
    ------
    OSError
        If there is no such bag.
    ValueError
        If it is no rosbag2 (mcap, sqlite3).
    """
    if is_table(path):
        raise ValueError(
            f"{path}: is a table, not a rosbag2: backlash identify reads it, with --certificate for a page"
        )
    found, why = [], ""
    for damaged in (False, True):
        try:
            found.append(_read(path, damaged=damaged))
        except OSError:
            raise
        except Exception as error:  # whatever a reader raises on damaged bytes
            why = why or reason_of(error)
        if found and not found[0].damage:
            break
    if not found:
        raise ValueError(f"{path}: is no rosbag2 that can be read: {why}")
    return max(found, key=lambda contents: sum(count for _, count in contents.topics.values()))
