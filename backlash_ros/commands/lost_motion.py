"""`backlash lost-motion`: arguments, and the work: reads, measures, prints, writes."""

import argparse
import math
import shlex
from dataclasses import asdict, replace
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.argument_types import number_of
from backlash_ros.commands.command import DONE, NOTHING, Command
from backlash_ros.commands.identification_results import show_findings
from backlash_ros.commands.output import json_text, say, say_written
from backlash_ros.commands.recording_arguments import add_angles, add_topics, reading_of, refuse_unused, topics_of
from backlash_ros.drive_file.drive_file import read_axis
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.foundation.staging import write_text
from backlash_ros.identification.locked_output.ramps import Ramps, ramps_of
from backlash_ros.identification.recordings.slow_torque import ramps_findings
from backlash_ros.identification.teeth import LOST_MOTION_SHARE
from backlash_ros.recordings.bag_topics import read_topics
from backlash_ros.recordings.csv_file import ColumnNames, is_table, read_csv
from backlash_ros.recordings.locked_output import curve_of
from backlash_ros.recordings.samples import TIME_UNITS, Columns, Reading, drive_for

_NAMES = ColumnNames(command="torque", kinds=("time", "motor", "load", "torque"))
_OF_TABLES = ("time_column", "motor_column", "load_column", "torque_column", "time_unit")
_DESCRIPTION = (
    "The lost motion of a gear whose output is locked while a torque goes slowly up and down on its motor: at zero "
    "torque and at +-3 % of the rated torque, with breakaway torque, stiffness, and how well the ramps repeat. An "
    "angle on one side is enough."
)
_EXAMPLE = """example: a table of a test bench, the angle from the motor's encoder computed at the output

  backlash lost-motion bench.csv --motor-column position --motor-unit turns --motor-at output --torque-column torque \\
      --rated-torque 40 --certificate gear.html

docs/lost_motion.md has the rules."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description, parser.epilog = _DESCRIPTION.replace("%", "%%"), _EXAMPLE
    add, above = parser.add_argument, number_of(0.0, above=True)
    add("recording", type=Path, metavar="RECORDING", help="folder or file of a rosbag2 (mcap, sqlite3), or a CSV table")
    add("--drive", type=Path, metavar="FILE", help="drive file, for its gear, and for its motor if V or A is recorded")
    add("--reduction", type=above, default=0.0, metavar="N", help="reduction of the gear, without a drive file")
    text = "N m at the output; lost motion is given at 3 %% of it; by default the torque of the ramps"
    add("--rated-torque", type=above, default=0.0, metavar="T", help=text)
    add("--json", type=Path, metavar="FILE", help="file for all figures")
    add("--certificate", type=Path, metavar="FILE.html", help="file for a page with results and the curve")
    add("--force", action="store_true", help="overwrite existing files")
    add("--from", type=number_of(0.0), default=0.0, dest="start", metavar="S", help="use samples from this time on, s")
    add("--to", type=above, default=math.inf, dest="end", metavar="S", help="use samples up to here, s")
    add("--reversed", action="store_true", help="the torque is positive where the angle falls")
    units = add_angles(parser, "angles and torque")
    text = (
        "Nm at the output, or the motor's voltage or current; by default Nm in a table, and in a bag that of the drive"
    )
    units.add_argument("--torque-unit", choices=["Nm", "V", "A"], default="", help=text)
    table = parser.add_argument_group("tables")
    for kind, name in zip(_NAMES.kinds, _NAMES.all(), strict=True):
        table.add_argument(f"--{kind}-column", default=name, metavar="NAME", help=f"by default {name}")
    table.add_argument("--time-unit", choices=list(TIME_UNITS), default="s")
    add_topics(parser)


def _columns(given: argparse.Namespace) -> Columns:
    """Return the columns of the recording; a default name that a table does not have is one that was not recorded."""
    if not is_table(given.recording):
        return read_topics(given.recording, topics_of(given))
    names = {kind: getattr(given, f"{kind}_column") for kind in _NAMES.kinds}
    by_default = {kind for kind, name in zip(_NAMES.kinds, _NAMES.all(), strict=True) if names[kind] == name}
    optional = frozenset(by_default & {"time", "motor", "load"})
    return read_csv(
        given.recording,
        ColumnNames(names["time"], names["motor"], names["load"], names["torque"], _NAMES.kinds, optional),
    )


def _drive(given: argparse.Namespace, reading: Reading) -> Drive | None:
    """Return the drive as told, or None."""
    if given.drive is not None and given.reduction:
        raise ValueError("argument --reduction: has no use beside --drive, which has one")
    if given.drive is not None:
        return drive_for(read_axis(given.drive).drive, reading)
    if reading.command_unit:
        raise ValueError(
            f"argument --drive: must be given, for the motor whose torque is recorded in {reading.command_unit}"
        )
    if given.reduction:
        return replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, reduction=given.reduction))
    return None


def measure(given: argparse.Namespace, console: Console) -> int:
    """Measure, print and write; return the exit code: 0 if some ramps have a result, else 1.

    Raises
    ------
    OSError, ValueError
        If a file cannot be read or written, or does not fit the arguments.
    """
    refuse_unused(given, _OF_TABLES)
    unit = given.torque_unit
    if not unit and not is_table(given.recording):
        unit = read_axis(given.drive).drive.command_unit if given.drive else "V"
    given.command_unit, given.supply = "" if unit == "Nm" else unit, 0.0
    reading = reading_of(given, time_unit=getattr(given, "time_unit", "s"), start=given.start, end=given.end)
    drive = _drive(given, reading)
    torque, angle, notes, why = curve_of(_columns(given), reading, drive, given.recording)
    torque = -torque if given.reversed else torque
    at = LOST_MOTION_SHARE * given.rated_torque
    found = [Ramps(valid=False, reason=why)] if why else ramps_of(torque, angle, at, LOST_MOTION_SHARE)
    say(console, f"{given.recording}")
    for text in [f"  {note}" for note in notes]:
        say(console, text)
    for ramps in found:
        text = f"\n{ramps.in_words()}." if ramps.valid else f"Nothing can be told: {ramps.reason}."
        say(console, text)
        if ramps.valid:
            show_findings(ramps_findings(ramps), console)
    if given.json is not None:
        content = {"recording": str(given.recording), "notes": notes, "ramps": [content_of(each) for each in found]}
        write_text(given.json, json_text(content), overwrite=given.force)
    if given.certificate is not None:
        from backlash_ros.pages.certificate.locked_output import page  # noqa: PLC0415 - matplotlib takes a second

        command = shlex.join(["backlash", *given.words])
        write_text(given.certificate, page(str(given.recording), found, notes, command), overwrite=given.force)
    say_written(console, [place for place in (given.json, given.certificate) if place is not None])
    return DONE if any(each.valid for each in found) else NOTHING


def content_of(ramps: Ramps) -> dict[str, object]:
    """Return all figures for JSON, without the curve; an angle is in rad, a torque in N m at the output."""
    content = asdict(ramps)
    for name in ("torques", "angles", "begins"):
        del content[name]
    return content


COMMAND = Command(measure, add_arguments, written=("json", "certificate"))
