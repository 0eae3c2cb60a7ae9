"""Turns columns of numbers into a recording that can be fitted: order, clocks, lost samples, units."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.stretch import HOLE
from backlash_ros.recordings.encoder import Encoder

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
COMMAND_UNITS = ("V", "A", "duty")
_PERIODS = 2e-5, 0.05
"""Least and largest time between two samples, s: anything else is a wrong unit or cannot be fitted."""
LARGEST = 1e15
"""Largest reading in any unit: beyond it a double has no whole numbers, and a sensor no such angle."""
_MISSING = 0.2
"""Largest share of the rows without a number."""
_EVEN, _REGULAR = 0.2, 0.9
"""For evenly sampled recordings: largest deviation of a time, as a share of the period, and of how many samples."""
DATES = 946684800.0, 4102444800.0
"""Seconds from 1970 to 2000 and to 2100: clocks in between show a date, others have their own start."""


@dataclass(frozen=True)
class Columns:
    """The columns of a file, unchanged, shapes (N,): nan for missing numbers.

    ``names``: of time, motor, load and command, for errors; ``place`` describes a row. ``epoch``: origin of the time,
    in the clock's own count, s. ``in_use``: the parameters of the drive's ``controller`` by name, if published.
    ``dated``: the time is in s, from dates or stamps, and no unit can be told. ``notes``: how it was read, in words.
    """

    time: Array
    motor: Array
    load: Array
    command: Array
    names: tuple[str, str, str, str]
    place: Callable[[int], str]
    epoch: float = 0.0
    in_use: Mapping[str, Any] = field(default_factory=dict)
    controller: str = ""
    dated: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reading:
    """How to read them: units, the shaft of the motor's angle, and the meaning of a row's command.

    ``motor_at``: ``motor`` or ``output``. ``command_unit``: one of `COMMAND_UNITS`, by default the drive's; a duty
    cycle is -1 to 1 of a ``supply`` (V). ``answer``: a row's command answers the row's angles; otherwise it acted while
    they were read. ``start``, ``end``: the part to use, s after the first row.
    """

    time_unit: str = "s"
    motor: Encoder = field(default_factory=Encoder)
    load: Encoder = field(default_factory=Encoder)
    motor_at: str = "motor"
    command_unit: str = ""
    supply: float = 0.0
    answer: bool = True
    start: float = 0.0
    end: float = math.inf

    def __post_init__(self) -> None:
        if self.command_unit == "duty" and not (math.isfinite(self.supply) and self.supply > 0.0):
            raise ValueError(f"the supply must be > 0 V where the command is a duty cycle, got {self.supply!r}")
        if not self.start < self.end:
            raise ValueError(f"the part that is used must end after it starts, got {self.start:g} to {self.end:g} s")


def times_of(columns: Columns, reading: Reading) -> Array:
    """Return the times from the first row on, s; ValueError where one is missing or goes back."""
    name, time = columns.names[0], columns.time
    if columns.dated and reading.time_unit != "s":
        raise ValueError(f"{name} has dates or stamps, which need no unit: leave --time-unit {reading.time_unit} out")
    if (missing := np.flatnonzero(~np.isfinite(time))).size:
        raise ValueError(f"{name} must have a number in each row, and has none {columns.place(int(missing[0]))}")
    time = (time - time[0]) * TIME_UNITS[reading.time_unit]
    if (back := np.flatnonzero(np.diff(time) < 0.0)).size:
        k = int(back[0])
        raise ValueError(
            f"{name} must not go back, and goes from {time[k]:.6f} to {time[k + 1]:.6f} s {columns.place(k + 1)}: "
            "a clock that was set, or two recordings in one"
        )
    return np.asarray(time)


def _without_repeats(columns: Columns, time: Array, notes: list[str]) -> NDArray[np.bool_]:
    """Return which rows do not repeat the previous one."""
    repeated = np.flatnonzero(np.diff(time) == 0.0) + 1
    for k in repeated:
        for values, name in zip((columns.motor, columns.load), columns.names[1:3], strict=True):
            if np.isfinite(values[k - 1] + values[k]) and values[k - 1] != values[k]:
                raise ValueError(
                    f"{columns.names[0]} has {time[k]:.6f} s twice {columns.place(int(k))}, where {name} has "
                    f"{values[k - 1]:g} and {values[k]:g}: two samples cannot be at one time"
                )
    if repeated.size:
        notes.append(f"{repeated.size} rows repeat the time of the row before, and were left out")
    kept = np.ones(time.size, dtype=bool)
    kept[repeated] = False
    return kept


def check_numbers(columns: Columns, notes: list[str]) -> None:
    """Raise ValueError for a column with too large or too few numbers; add to ``notes`` how many are missing."""
    for values, name in zip((columns.motor, columns.load, columns.command), columns.names[1:], strict=True):
        if (beyond := np.flatnonzero(np.abs(values) > LARGEST)).size:
            k = int(beyond[0])
            raise ValueError(f"{name} must be within +-{LARGEST:g}, got {values[k]:g} {columns.place(k)}")
        missing = np.flatnonzero(~np.isfinite(values))
        if missing.size > _MISSING * values.size:
            raise ValueError(
                f"{name} has no number in {missing.size} of {values.size} rows, first "
                f"{columns.place(int(missing[0]))}, and may lack {100 * _MISSING:g} %"
            )
        if missing.size:
            notes.append(f"{name} has no number in {missing.size} of {values.size} rows: these are not used")


def _with_lost(time: Array, values: tuple[Array, ...], notes: list[str]) -> Recording:
    """Return a recording with a row for each sample that is missing in an even clock; it has only its time."""
    whole, steps = Recording.of(time, *values), np.diff(time)
    period = float(np.median(steps))
    if np.mean(np.abs(steps / period - 1.0) < _EVEN) < _REGULAR:
        return whole
    lost = np.where(steps < HOLE * period, np.maximum(np.round(steps / period) - 1.0, 0.0), 0.0).astype(int)
    if np.any(holes := steps >= HOLE * period):
        first = float(time[int(np.argmax(holes))])
        notes.append(f"{np.sum(holes)} holes of more than {HOLE} periods, the first after {first:.3f} s")
    if not np.any(lost):
        return whole
    notes.append(
        f"{np.sum(lost)} of {np.sum(lost) + time.size} samples are missing: what was commanded then is guessed"
    )
    into = np.repeat(np.arange(1, time.size), lost)
    share = np.concatenate([np.arange(1, n + 1) / (n + 1) for n in lost if n])
    new = time[into - 1] + share * steps[into - 1]
    nothing = np.full(new.size, math.nan)
    return Recording.of(np.insert(time, into, new), *(np.insert(column, into, nothing) for column in values))


def began(columns: Columns, reading: Reading) -> datetime | None:
    """Return when the used part began, UTC; None if its clock does not count from 1970."""
    first = columns.time[0] * TIME_UNITS[reading.time_unit] + columns.epoch + reading.start
    return datetime.fromtimestamp(first, timezone.utc) if DATES[0] <= first <= DATES[1] else None


def command_of(columns: Columns, reading: Reading) -> Array:
    """Return the commands in V or A; ValueError for a duty cycle beyond 1."""
    command = columns.command
    if reading.command_unit == "duty":
        largest = float(np.nanmax(np.abs(command), initial=0.0))
        if largest > 1.02:
            raise ValueError(f"{columns.names[3]} must be a duty cycle from -1 to 1, got {largest:g} at most")
        command = command * reading.supply
    return command if reading.answer else np.append(command[1:], math.nan)


def drive_for(drive: Drive, reading: Reading) -> Drive:
    """Return ``drive`` with the kind of command of the recording: voltage or current."""
    if not reading.command_unit:
        return drive
    interface = "current" if reading.command_unit == "A" else "voltage"
    return Drive(drive.motor, drive.gear, drive.load, interface)


def recording_of(columns: Columns, reading: Reading, drive: Drive) -> tuple[Recording, list[str]]:
    """Return a recording, and how it was made from the file, in words.

    Raises
    ------
    ValueError
        If that is impossible; names column, value, bound, unit and row.
    """
    notes = list(columns.notes)
    if columns.time.size < 2:
        raise ValueError(f"there must be two samples at least, got {columns.time.size}")
    time = times_of(columns, reading)
    kept = _without_repeats(columns, time, notes) & (time >= reading.start) & (time <= reading.end)
    if np.sum(kept) < 2:
        raise ValueError(
            f"there must be two samples at least from {reading.start:g} to {reading.end:g} s, got {np.sum(kept)}; "
            f"the recording is {time[-1]:.3f} s long"
        )
    rows = np.flatnonzero(kept)
    used = Columns(
        time[kept],
        columns.motor[kept],
        columns.load[kept],
        command_of(columns, reading)[kept],
        columns.names,
        lambda k: columns.place(int(rows[k])),
    )
    period = float(np.median(np.diff(used.time)))
    if not _PERIODS[0] <= period <= _PERIODS[1]:
        raise ValueError(
            f"{columns.names[0]} steps by {period:.3g} s (median), and must by {_PERIODS[0]:g} to {_PERIODS[1]:g} s: "
            "check the unit of the time"
        )
    check_numbers(used, notes)
    angles = []
    for encoder, values, name in ((reading.motor, used.motor, used.names[1]), (reading.load, used.load, used.names[2])):
        angle, note = encoder.radians(used.time, values, name, used.place)
        angles.append(angle)
        notes += [note] if note else []
    motor = angles[0] * (drive.gear.ratio if reading.motor_at == "motor" else 1.0)
    return _with_lost(used.time, (motor, angles[1], used.command), notes), notes
