"""Reads a path of the load: from a table with a row for each point, or a trajectory_msgs/JointTrajectory in YAML."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import yaml

from backlash_ros.control.motion.trajectory import Trajectory, TrajectoryError, trajectory_of
from backlash_ros.foundation.messages import LARGEST
from backlash_ros.foundation.reading.yaml_text import values_in
from backlash_ros.recordings.csv_file import ColumnNames, is_table, read_csv

COLUMNS = "time", "position", "velocity", "acceleration"
"""Columns of a table: s, rad, rad/s, rad/s^2; the last two may be missing."""
JOINED = "straight lines", "cubics", "quintics"
"""What joins the points, by how many columns there are beside the time."""
_REMEDIES = {
    "must be finite": "give each point a number, or leave the whole column out",
    "time_from_start": "sort the points, and count the time in s from the start of the path",
    "last point": "add a point at which the load is at rest",
}
"""What to do about a refusal, by words in it."""
_FIELDS = {"positions", "velocities", "accelerations", "effort"}


@dataclass(frozen=True)
class PathFile:
    """The path that is in a file, and how it was read, in words."""

    trajectory: Trajectory
    notes: tuple[str, ...] = ()


def read_trajectory(path: Path, joint: str) -> PathFile:
    """Return the path in a file; YAML if its name says so, otherwise a table with `COLUMNS`.

    Parameters
    ----------
    joint : of the load; a table has no other, and of a JointTrajectory its points are taken

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        Names the file, the row or line, what cannot be followed, and a remedy.
    """
    return _from_yaml(path, joint) if path.suffix.lower() in {".yaml", ".yml"} else _from_table(path)


def _from_table(path: Path) -> PathFile:
    if not is_table(path):
        raise ValueError(f"{path}: must be a table with the columns {', '.join(COLUMNS)}, or a YAML file")
    columns = read_csv(path, ColumnNames(*COLUMNS, kinds=COLUMNS, optional=frozenset(COLUMNS[2:]), remedy="rename it"))
    if columns.dated:
        raise ValueError(f"{path}: column 'time' must be in s from the start of the path, and has dates: subtract it")
    velocity, acceleration = (not np.all(np.isnan(values)) for values in (columns.load, columns.command))
    if acceleration and not velocity:
        raise ValueError(f"{path}: column 'acceleration' needs a column 'velocity': add it, or leave both out")
    states = np.stack([columns.motor, columns.load, columns.command][: 1 + velocity + acceleration], axis=1)

    def place(k: int) -> str:
        return columns.place(k).removeprefix("in ")

    for name, values in zip(COLUMNS, (columns.time, *states.T), strict=False):
        for k in np.flatnonzero(np.abs(values) > LARGEST):
            raise ValueError(_too_large(f"{path}, {place(int(k))}: {name}", values[k]))
    try:
        return PathFile(Trajectory(np.round(columns.time, 9), states), columns.notes)
    except TrajectoryError as error:
        raise _placed(error, path, columns.time.size, place) from None


def _too_large(what: str, value: float) -> str:
    return f"{what} must be within +-{LARGEST:g}, in SI units, got {value:g}"


def _placed(error: TrajectoryError, path: Path, points: int, place: Callable[[int], str]) -> ValueError:
    """Return a refusal with the place of its point in the file, and a remedy."""
    text = str(error)
    found = re.search(r"of point (\d+)|of the last point", text)
    at = f", {place(int(found[1] or points - 1))}" if found and points else ""
    remedy = next((f": {remedy}" for words, remedy in _REMEDIES.items() if words in text), "")
    return ValueError(f"{path}{at}: {text}{remedy}")


def _from_yaml(path: Path, joint: str) -> PathFile:
    text = path.read_bytes().rstrip().removesuffix(b"---")  # as `ros2 topic echo` ends a message
    try:
        content = values_in(text)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    points = content.get("points") if isinstance(content, Mapping) else None
    if not isinstance(points, list):
        raise ValueError(f"{path}: must have points, each with positions and time_from_start, as a JointTrajectory has")
    names = content.get("joint_names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{path}: joint_names must be a list with the load's joint, such as [{joint}], got {names!r}")
    lines = _lines_of_points(text)

    def place(k: int) -> str:
        return f"line {lines[k]}"

    read = [_point(f"{path}, {place(k)}: ", k, point) for k, point in enumerate(points)]
    unstamped = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0))
    message = SimpleNamespace(header=unstamped, joint_names=names, points=read)
    try:
        return PathFile(trajectory_of(message, joint, 0))
    except TrajectoryError as error:
        raise _placed(error, path, len(points), place) from None


def _lines_of_points(text: bytes) -> list[int]:
    """Return the line of each point of YAML that has been read."""
    root: Any = yaml.compose(text, yaml.SafeLoader)
    points = next(value for key, value in root.value if key.value == "points")
    return [point.start_mark.line + 1 for point in points.value]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _point(where: str, k: int, point: Any) -> SimpleNamespace:
    """Return a point as a message has it; ValueError names what is none."""
    if not isinstance(point, Mapping):
        raise ValueError(f"{where}point {k} must have positions and time_from_start, got {point!r}")
    if unknown := sorted(str(name) for name in point if name not in _FIELDS | {"time_from_start"}):
        there = ", ".join(("positions", "velocities", "accelerations", "time_from_start"))
        raise ValueError(f"{where}{unknown[0]} is nothing that point {k} may have; there are {there}")
    fields = {}
    for name in _FIELDS:
        values = fields[name] = point.get(name, [])
        if not isinstance(values, list) or not all(map(_is_number, values)):
            raise ValueError(f"{where}{name} of point {k} must be a list of numbers, got {values!r}")
        for value in values:
            if abs(value) > LARGEST:
                raise ValueError(_too_large(f"{where}{name} of point {k}", value))
    time = point.get("time_from_start")
    parts: list[Any] = [time.get("sec", 0), time.get("nanosec", 0)] if isinstance(time, Mapping) else [time, 0]
    if not all(map(_is_number, parts)) or not all(abs(part) <= LARGEST for part in parts):
        raise ValueError(f"{where}time_from_start of point {k} must be {{sec: ..., nanosec: ...}}, got {time!r}")
    seconds = parts[0] + 1e-9 * parts[1]
    whole = math.floor(seconds)
    stamp = SimpleNamespace(sec=whole, nanosec=round(1e9 * (seconds - whole)))
    return SimpleNamespace(**fields, time_from_start=stamp)
