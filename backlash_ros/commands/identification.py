"""The work of `backlash identify`: reads, identifies, prints, writes."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.command import DONE, NOTHING
from backlash_ros.commands.identification_results import content_of, show
from backlash_ros.commands.output import json_text, say_written
from backlash_ros.control import HysteresisSettings
from backlash_ros.drive_file.drive_file import Axis, axis_of, read_axis
from backlash_ros.drive_file.drive_text import drive_text
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.foundation.reading.parameter_files import in_sections
from backlash_ros.foundation.staging import write_text
from backlash_ros.identification.recordings.identify import Identified, identify
from backlash_ros.identification.recordings.places import map_findings
from backlash_ros.identification.recordings.slow_torque import hysteresis_findings, hysteresis_of
from backlash_ros.identification.teeth import LOST_MOTION_SHARE, lost_motion_of
from backlash_ros.recordings.bag_topics import Topics, read_topics
from backlash_ros.recordings.csv_file import ColumnNames, is_table, read_csv
from backlash_ros.recordings.samples import Columns, Reading, began, drive_for, recording_of
from backlash_ros.recordings.subject import Subject

_WHOLE = 0.01
"""Largest deviation of the counts per turn from a whole number that is rounded away."""


@dataclass(frozen=True)
class Request:
    """What to read and how, and what to write; ``drive`` None is the bag's, or else the nominal one.

    ``rated_torque`` in N m at the output, 0 for half of the motor's at standstill; ``command`` is the command line.
    """

    recording: Path
    reading: Reading = field(default_factory=Reading)
    columns: ColumnNames = field(default_factory=ColumnNames)
    topics: Topics = field(default_factory=Topics)
    drive: Path | None = None
    json: Path | None = None
    drive_file: Path | None = None
    certificate: Path | None = None
    rated_torque: float = 0.0
    command: str = ""


def _read(request: Request) -> Columns:
    path = request.recording
    return read_csv(path, request.columns) if is_table(path) else read_topics(path, request.topics)


def _axis_in(recording: Path, columns: Columns) -> tuple[Axis, str]:
    """Return the axis as the bag's controller was told, and who says so; the nominal drive and nobody without one."""
    if not columns.in_use:
        return Axis(NOMINAL_DRIVE), ""
    try:
        return axis_of(in_sections(columns.in_use)), f"{columns.controller} in {recording}"
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{recording}: the parameters in use describe no drive ({error}); give one with --drive"
        ) from error


def _joints(request: Request, axis: Axis) -> tuple[str, str]:
    """Return the names of both joints: from the bag, or for a table from the drive file."""
    if is_table(request.recording):
        return axis.motor_joint, axis.load_joint
    return request.topics.motor_joint, request.topics.load_joint


def counts_of(found: Identified, reading: Reading, drive: Drive) -> tuple[float, float]:
    """Return the counts of both encoders per turn of their shafts: as given, else as seen; 0 without counts."""
    seen = found.fit.counts if found.fit is not None else (0.0, 0.0)
    result = []
    for encoder, count in ((reading.motor, seen[0] / drive.gear.ratio), (reading.load, seen[1])):
        turn = 2.0 * math.pi / count if count > 0.0 else 0.0
        result.append(encoder.counts or (float(round(turn)) if abs(turn - round(turn)) < _WHOLE else 0.0))
    return result[0], result[1]


def identify_recording(request: Request, console: Console) -> int:
    """Identify, print and write; return the exit code: 0 if something was found, else 1.

    Raises
    ------
    OSError, ValueError
        If a file cannot be read or written, or does not fit the arguments.
    """
    told = (read_axis(request.drive), str(request.drive)) if request.drive else None
    columns = _read(request)
    axis, sheet = told or _axis_in(request.recording, columns)
    drive = drive_for(axis.drive, request.reading)
    recording, notes = recording_of(columns, request.reading, drive)
    found = identify(drive, recording)
    rated = request.rated_torque or HysteresisSettings().rated(drive)
    around, slow = found.around.map, hysteresis_of(drive, recording, LOST_MOTION_SHARE * rated)
    derived = hysteresis_findings(slow) if slow.valid else lost_motion_of(found, rated)
    counts = counts_of(found, request.reading, drive)
    subject = Subject(
        str(request.recording),
        _joints(request, axis),
        recording,
        drive,
        sheet,
        request.command,
        counts,
        tuple(notes),
        began(columns, request.reading),
        (*derived, *(map_findings(around) if around is not None else ())),
        (rated, request.rated_torque > 0.0),
        slow,
    )
    show(subject, found, console)
    texts = {}
    if request.json is not None:
        texts[request.json] = json_text(content_of(subject, found))
    if request.drive_file is not None and found.valid:
        texts[request.drive_file] = drive_text(found, axis, counts, subject.source)
    if request.certificate is not None:
        from backlash_ros.pages.certificate.page import certificate  # noqa: PLC0415 - matplotlib takes a second

        texts[request.certificate] = certificate(subject, found)
    for place, text in texts.items():
        write_text(place, text, overwrite=True)
    say_written(console, texts)
    return DONE if found.valid or around is not None or slow.valid else NOTHING
