"""Torque and angle of a locked output from the columns of a bag or a table."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.recordings.slow_torque import movement, torque_of
from backlash_ros.recordings.samples import Columns, Reading, check_numbers, times_of


def evenly(time: Array) -> Array:
    """Return times of which equal ones are spread up to the next one: a clock may be coarser than its samples."""
    firsts = np.flatnonzero(np.diff(time, prepend=-np.inf))
    if firsts.size == time.size or firsts.size < 2:
        return time
    last = time[firsts[-1]] + (time[firsts[-1]] - time[firsts[-2]])
    return np.asarray(np.interp(np.arange(time.size), [*firsts, time.size], [*time[firsts], last]))


def curve_of(
    columns: Columns, reading: Reading, drive: Drive | None, path: Path
) -> tuple[Array, Array, list[str], str]:
    """Return torque and angle, N m and rad at the output, and in words how they were made.

    Parameters
    ----------
    columns : an angle, or the time, without any number is one that was not recorded
    reading : with a ``command_unit`` of V or A the command is that of the motor of ``drive``, else a torque
    path : of the recording, for errors

    Returns
    -------
    tuple
        With an empty text last, or why the output was not locked.

    Raises
    ------
    ValueError
        Names the column, its value, the bound, and the unit.
    """
    notes = list(columns.notes)
    seen = {name: bool(np.any(np.isfinite(getattr(columns, name)))) for name in ("time", "motor", "load")}
    _refuse_unusable(columns, seen, reading, drive, path)
    time, used = _used_part(columns, seen, reading, path)
    check_numbers(used, notes)
    whole = np.isfinite(used.motor + used.load + used.command)
    if np.sum(whole) < 2:
        raise ValueError(f"{path}: there must be two samples at least with all numbers, got {np.sum(whole)}")
    time, used = time[whole], _rows(used, np.flatnonzero(whole))
    angles = []
    for encoder, values, name in zip(
        (reading.motor, reading.load), (used.motor, used.load), used.names[1:3], strict=True
    ):
        angle, note = encoder.radians(time, values, name, used.place)
        angles.append(angle)
        notes += [note] if note else []
    motor, load = angles
    if drive is not None and reading.motor_at == "motor":
        motor = motor * drive.gear.ratio
    torque = used.command
    if drive is not None and reading.command_unit:
        torque, _ = torque_of(drive, time, motor, torque)
    if not (seen["motor"] and seen["load"]):
        return torque, motor + load, notes, ""
    if np.ptp(load) > np.ptp(motor):
        notes.append("the motor stood and the output moved: the torque is taken for one on the output")
        return torque, load - motor, notes, movement(motor, load - motor, "motor")
    return torque, motor - load, notes, movement(load, motor - load)


def _refuse_unusable(
    columns: Columns, seen: Mapping[str, bool], reading: Reading, drive: Drive | None, path: Path
) -> None:
    """Raise ValueError where what was recorded is not enough, or the drive that it needs was not given."""
    if not columns.time.size:
        raise ValueError(f"{path}: there must be a row of numbers, and is none")
    if not seen["motor"] and not seen["load"]:
        raise ValueError(
            f"{path}: there must be {columns.names[1]} or {columns.names[2]}, and there are no numbers of either"
        )
    if not seen["time"] and (reading.command_unit == "V" or reading.start > 0.0 or np.isfinite(reading.end)):
        raise ValueError(f"{path}: there must be {columns.names[0]}, for --from, --to and for a voltage")
    if seen["motor"] and reading.motor_at == "motor" and drive is None:
        raise ValueError(
            "argument --reduction: must be given, or --drive, since the motor's angle is before the gear; if not: "
            "--motor-at output"
        )


def _used_part(columns: Columns, seen: Mapping[str, bool], reading: Reading, path: Path) -> tuple[Array, Columns]:
    """Return the times, s, and the rows of the part to use; an angle that was not recorded is 0."""
    nothing = np.zeros(columns.time.size)
    motor, load = (getattr(columns, name) if seen[name] else nothing for name in ("motor", "load"))
    columns = replace(columns, motor=motor, load=load)
    time = evenly(times_of(columns, reading)) if seen["time"] else np.arange(nothing.size, dtype=float)
    kept = (time >= reading.start) & (time <= reading.end)
    if np.sum(kept) < 2:
        raise ValueError(
            f"{path}: there must be two samples at least from {reading.start:g} to {reading.end:g} s, got "
            f"{np.sum(kept)}; the recording is {time[-1]:.3f} s long"
        )
    return time[kept], _rows(columns, np.flatnonzero(kept))


def _rows(columns: Columns, chosen: NDArray[np.intp]) -> Columns:
    """Return some rows, without their times."""
    return replace(
        columns,
        motor=columns.motor[chosen],
        load=columns.load[chosen],
        command=columns.command[chosen],
        place=lambda k: columns.place(int(chosen[k])),
    )
