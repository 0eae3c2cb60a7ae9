"""Recordings of simulated drives, in memory and as the files that other people's machines leave."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from plain_bag import EVENT, in_use_event
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from backlash_ros.control import Servo
from backlash_ros.foundation.signals import THETA_L, THETA_M
from backlash_ros.identification.recording import Recording
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.evaluation.task import settings_for

SEED = 20261122
_FINE = 8


def true_gap(member: Member) -> float:
    """Return the gap where the load is at first, rad."""
    return member.drive.gear.backlash_at(0.0)


@cache
def probed(number: int, population: str = "core") -> tuple[Member, Recording]:
    """Return a drive and all that the gap probe made it do."""
    member = draw_member(SEED, number, population)
    model = told_model(member, "nominal")
    servo = Servo(model, settings_for(model, member))
    plant = SimulatedDrive(member.drive, 1.0 / member.rate, sensors=member.sensors, delay=member.delay)
    servo.start_experiment("gap_probe")
    rows = []
    while servo.take_outcome() is None:
        shown = plant.sample()
        command = servo.update(shown, plant.elapsed)
        rows.append((plant.time, shown[THETA_M] * member.drive.gear.ratio, shown[THETA_L], command))
        plant.advance(command, member.load_torque)
    return member, Recording.of(*(column.copy() for column in np.array(rows).T))


@cache
def stepped(
    number: int, population: str = "core", *, step: float = 0.4, length: float = 5.0, uneven: bool = False
) -> tuple[Member, Recording]:
    """Return a drive and its motion under the two-region law, to and fro by steps (rad) of half a second each.

    ``uneven``: samples come after 6 to 10 eighths of the period.
    """
    member = draw_member(SEED, number, population)
    model = told_model(member, "nominal")
    settings = replace(settings_for(model, member), backlash_angle=member.drive.gear.backlash_angle)
    servo = Servo(model, settings)
    fine = settings.period / _FINE
    plant = SimulatedDrive(member.drive, fine, sensors=member.sensors, delay=member.delay)
    random = np.random.default_rng(number)
    rows: list[tuple[float, float, float, float]] = []
    home, side, before = math.nan, 1.0, 0.0
    while plant.time < length:
        shown = plant.sample()
        home = float(shown[THETA_L]) if math.isnan(home) else home
        if rows and int(2.0 * plant.time) != int(2.0 * before):
            servo.set_reference(home + 0.5 * side * step)
            side = -side
        command = servo.update(shown, plant.time - before if rows else settings.period)
        before = plant.time
        rows.append((before, shown[THETA_M] * member.drive.gear.ratio, shown[THETA_L], command))
        for _ in range(int(random.integers(6, 11)) if uneven else _FINE):
            plant.sample()
            plant.advance(command, member.load_torque)
    return member, Recording.of(*(column.copy() for column in np.array(rows).T))


def without(recording: Recording, share: float, seed: int = 0) -> Recording:
    """Return a recording that lacks a share of its samples."""
    kept = np.random.default_rng(seed).random(recording.time.size) >= share
    kept[0] = True
    return Recording(*(values[kept] for values in recording))


def write_drive(path: Path, member: Member) -> Path:
    """Write the data sheet of a drive: motor and reduction."""
    motor = member.drive.motor
    names = ("resistance", "inductance", "torque_constant", "inertia", "viscous_friction", "voltage_limit")
    content = {
        "motor": {name: float(getattr(motor, name)) for name in names},
        "gear": {"reduction": float(member.drive.gear.reduction)},
        "load": {},
    }
    path.write_text(yaml.safe_dump(content))
    return path


def _angle(unit: str, counts: float, angle: np.ndarray) -> list[str]:
    turns = angle / (2.0 * math.pi)
    if unit == "counts":
        return [f"{value:.0f}" for value in turns * counts]
    scale, digits = {"rad": (2.0 * math.pi, 17), "deg": (360.0, 12), "turns": (1.0, 15)}[unit]
    return [f"{value:.{digits}g}" for value in scale * turns]


def write_csv(
    path: Path,
    member: Member,
    recording: Recording,
    *,
    motor: str = "rad",
    load: str = "rad",
    header: str = "time,motor,load,command",
    wrapped: bool = False,
    offset: float = 0.0,
    edit: Callable[[list[list[str]]], object] = list,
) -> Path:
    """Write a recording as a table, with the motor's angle before the gear; angles may begin again after a turn."""
    shaft, output = recording.motor / member.drive.gear.ratio, recording.load
    if wrapped:
        shaft, output = np.mod(shaft + 1e-6, 2.0 * math.pi), np.mod(output + 1e-6, 2.0 * math.pi)
    separator = next(mark for mark in ";\t," if mark in header)
    rows = [
        [f"{time + offset:.9f}", motor_angle, load_angle, repr(float(command))]
        for time, motor_angle, load_angle, command in zip(
            recording.time,
            _angle(motor, member.sensors.motor_counts, shaft),
            _angle(load, member.sensors.load_counts, output),
            recording.command,
            strict=True,
        )
    ]
    edit(rows)
    path.write_text("\n".join([header, *(separator.join(row) for row in rows)]) + "\n")
    return path


def write_bag(
    path: Path,
    member: Member,
    recording: Recording,
    *,
    storage: str = "mcap",
    labels: bool = True,
    joints: tuple[str, str] = ("motor", "load"),
    topics: tuple[str, str] = ("/joint_states", "/command"),
    unseen: frozenset[int] = frozenset(),
    command_type: str = "std_msgs/msg/Float64MultiArray",
    in_use: Mapping[str, Mapping[str, float]] | None = None,
) -> Path:
    """Write a recording as a rosbag2; of the ``unseen`` samples there is the answer alone.

    ``in_use``: parameters of numbers of each node, which publishes them in two versions, the older one of zeros.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = store.types
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    start = 1_700_000_000_000_000_000
    nothing = np.empty(0)
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        states = writer.add_connection(topics[0], "sensor_msgs/msg/JointState", typestore=store)
        commands = writer.add_connection(topics[1], command_type, typestore=store)
        for node, numbers in (in_use or {}).items():
            told = writer.add_connection(f"{node}/parameters_in_use", EVENT, typestore=store)
            for version in (2, 1):  # a recorder may hear the newer one first
                values = {name: value if version == 2 else 0.0 for name, value in numbers.items()}
                at = types["builtin_interfaces/msg/Time"](sec=start // 10**9 + version, nanosec=0)
                writer.write(told, start, store.serialize_cdr(in_use_event(at, version, values, node), EVENT))
        for k, (time, motor, load, command) in enumerate(zip(*recording[:4], strict=True)):
            seconds, nanoseconds = divmod(start + round(1e9 * time), 10**9)
            received = start + 5_000_000_000 + round(1e9 * time)
            stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
            if k not in unseen:
                message = types["sensor_msgs/msg/JointState"](
                    header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
                    name=["other", *joints],
                    position=np.array([0.5, motor / member.drive.gear.ratio, load]),
                    velocity=nothing,
                    effort=nothing,
                )
                writer.write(states, received, store.serialize_cdr(message, states.msgtype))
            label = f"{seconds}.{nanoseconds:09d}" if labels else ""
            dimension = types["std_msgs/msg/MultiArrayDimension"](label=label, size=1, stride=1)
            if command_type.endswith("MultiArray"):
                layout = types["std_msgs/msg/MultiArrayLayout"](dim=[dimension], data_offset=0)
                answer = types[command_type](layout=layout, data=np.array([command]))
            else:
                answer = types[command_type](data=float(command))
            writer.write(commands, received + 500_000, store.serialize_cdr(answer, commands.msgtype))
    return path
