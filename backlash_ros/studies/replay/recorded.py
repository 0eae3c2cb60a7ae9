"""Reads one controller from a bag: samples, commands by the sample that they answer, parameters, state."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from backlash_ros.foundation.messages import answered_sample, stamp_ns
from backlash_ros.recordings.bag import in_use_of
from backlash_ros.recordings.bag_files import messages_of, reading

_LINGERS = 10**8
"""Time for which the last answers of a controller that is no longer active are still recorded, ns."""
_JOINT_STATES, _COMMANDS = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"

Found = Mapping[int, Sequence[tuple[int, Any]]]
"""Messages with their times of receipt (ns), by a number that may repeat: stamps begin anew with a simulator, versions
with a controller."""


def nearest(found: Found, number: int, received: int) -> Any:
    """Return the message with that number that was received closest to a time, ns, or None."""
    return min(found.get(number, [(0, None)]), key=lambda each: abs(each[0] - received))[1]


class Answered(NamedTuple):
    """A command: its time of receipt and the stamp of its sample, ns, and its value, V or A."""

    received: int
    stamp: int
    command: float


@dataclass(frozen=True)
class Activation:
    """The recording from one activation of the controller until the next.

    ``received``: time of the activation, ns; ``told``: the values of ``~/state`` by the stamp of their sample.
    """

    received: int
    answers: Sequence[Answered]
    told: Found


@dataclass(frozen=True)
class Recorded:
    """One controller in a bag; joint states by their stamps (ns), parameters in use by their version.

    ``damage`` describes what is wrong with the files.
    """

    controller: str
    damage: Sequence[str]
    samples: Found
    in_use: Found
    activations: Sequence[Activation]


def _telling(message: Any) -> dict[str, float]:
    return {entry.key: float(entry.value) for entry in message.status[0].values}


def _topic_of(kind: str, name: str, controller: str, topics: Mapping[str, str], path: Path) -> str:
    """Return the topic of a type that belongs to a controller: the one with the usual name, or the only one."""
    usual = str(PurePosixPath(controller).parent / name)
    found = sorted(topic for topic, its in topics.items() if its == kind)
    if usual in found:
        return usual
    if len(found) != 1:
        raise ValueError(f"{path}: there is no '{usual}' ({kind}); of that type there are {found}")
    return found[0]


def _controller_of(wanted: str, topics: Mapping[str, str], path: Path) -> str:
    """Return the requested controller, or the only one: it publishes both its state and its parameters."""
    ending = "/parameters_in_use"
    names = [topic.removesuffix(ending) for topic in topics if topic.endswith(ending)]
    there = sorted(name for name in names if f"{name}/state" in topics)
    name = f"/{wanted.strip('/')}" if wanted else ""
    if name in there:
        return name
    if wanted:
        raise ValueError(f"{path}: there is no controller '{name}'; there are {there}")
    if not there:
        raise ValueError(f"{path}: there is no controller: '~/state' and '~{ending}' of one must be in the bag")
    if len(there) > 1:
        raise ValueError(f"{path}: --controller must be given: there are {there}")
    return there[0]


def _activations(
    told: Sequence[tuple[int, int, dict[str, float]]], answers: Sequence[Answered], path: Path
) -> list[Activation]:
    """Return the recording after each activation, found by the first sample on which the controller held."""
    begun: list[int] = []
    before: dict[str, float] = {"active": 0.0, "samples": 0.0}
    for k, (_, _, values) in enumerate(told):
        if values["samples"] < before["samples"]:  # another controller of that name
            before = {"active": 0.0, "samples": 0.0}
        began = not values["holding"] or values["samples"] <= before["samples"] + 1
        if values["active"] and not before["active"] and began:
            begun.append(k)
        before = values
    if not begun:
        raise ValueError(f"{path}: no activation of the controller is in the bag: begin to record before it is active")
    found = []
    for begin, end in zip(begun, [*begun[1:], len(told)], strict=True):
        by_stamp: dict[int, list[tuple[int, dict[str, float]]]] = defaultdict(list)
        for received, stamp, values in told[begin:end]:
            if not math.isnan(values["elapsed"]):  # else it is about no sample
                by_stamp[stamp].append((received, values))
        over = next((each[0] + _LINGERS for each in told[begin:end] if not each[2]["active"]), None)
        later = told[end][0] if end < len(told) else None
        until = min((each for each in (over, later) if each is not None), default=None)
        first = next(((r, s) for s, each in by_stamp.items() for r, values in each if values["holding"]), None)
        if first is None:
            continue  # nothing was held: there is nothing to replay
        mine = [each for each in answers if until is None or each.received <= until]
        start = min(
            (k for k, each in enumerate(mine) if each.stamp == first[1]),
            key=lambda k: abs(mine[k].received - first[0]),
            default=None,
        )
        if start is None:
            raise ValueError(f"{path}: the command that answers the first sample of an activation is not in the bag")
        found.append(Activation(told[begin][0], mine[start:], by_stamp))
    return found


def read_recorded(path: Path, controller: str = "") -> Recorded:
    """Read a rosbag2, even one whose recorder was killed.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        Names what it lacks.
    """
    samples: dict[int, list[tuple[int, Any]]] = defaultdict(list)
    in_use: dict[int, list[tuple[int, Any]]] = defaultdict(list)
    told: list[tuple[int, int, dict[str, float]]] = []
    answers: list[Answered] = []
    commands = 0
    with reading(path) as (reader, damage):
        topics = {connection.topic: connection.msgtype for connection in reader.connections}
        name = _controller_of(controller, topics, path)
        source = _topic_of(_JOINT_STATES, "joint_states", name, topics, path)
        target = _topic_of(_COMMANDS, "command", name, topics, path)
        wanted = {source, target, f"{name}/state", f"{name}/parameters_in_use"}
        for topic, received, message in messages_of(reader, wanted, path):
            if topic == source:
                samples[stamp_ns(message.header.stamp)].append((received, message))
            elif topic == target:
                commands += 1
                stamp = answered_sample(message)
                if stamp is not None and len(message.data) == 1:
                    answers.append(Answered(received, stamp, float(message.data[0])))
            elif topic.endswith("/state"):
                told.append((received, stamp_ns(message.header.stamp), _telling(message)))
            else:
                _, version, values = in_use_of(message)
                in_use[version].append((received, values))
    if not commands:
        raise ValueError(f"{path}: there is no message on '{target}'")
    if not answers:
        raise ValueError(f"{path}: no command on '{target}' names the sample that it answers: they are another node's")
    for topic, messages in ((f"{name}/parameters_in_use", in_use), (f"{name}/state", told), (source, samples)):
        if not messages:
            raise ValueError(f"{path}: there is no message on '{topic}'")
    return Recorded(name, damage, samples, in_use, _activations(told, answers, path))
