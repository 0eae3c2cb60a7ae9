"""`backlash identify`: its arguments, and the request that they make."""

import argparse
import math
import shlex
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.argument_types import number_of
from backlash_ros.commands.command import Command
from backlash_ros.commands.identification import Request, identify_recording
from backlash_ros.commands.recording_arguments import add_topics, add_units, reading_of, refuse_unused, topics_of
from backlash_ros.recordings.csv_file import ColumnNames
from backlash_ros.recordings.samples import TIME_UNITS

EXAMPLE = """example: an axis recorded as a table, the motor's encoder counted before the gear, the load's in degrees

  backlash identify axis.csv --drive my_axis.yaml --motor-unit counts --motor-counts 4096 --load-unit deg \\
      --load-column angle --command-column volts --drive-file identified.yaml

docs/identification.md has the rules."""
DESCRIPTION = (
    "The load's inertia and friction, load torque, delay, gap and encoder offset of a drive, with standard "
    "uncertainties, from any recording of both encoders and the command. What the recording cannot tell is named."
)
_OF_TABLES = ("time_column", "motor_column", "load_column", "command_column", "time_unit")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    add = parser.add_argument
    add("recording", type=Path, metavar="RECORDING", help="folder or file of a rosbag2 (mcap, sqlite3), or a CSV table")
    add("--drive", type=Path, metavar="FILE", help="drive file with the motor and the gear, which are kept")
    add("--drive-file", type=Path, metavar="FILE", help="file for the identified drive")
    add("--json", type=Path, metavar="FILE", help="file for all figures")
    add("--certificate", type=Path, metavar="FILE.html", help="file for a page with results and pictures")
    add(
        "--rated-torque",
        type=number_of(0.0, above=True),
        default=0.0,
        metavar="T",
        help="N m at the output; lost motion is given at 3 %% of it; by default half the standstill torque",
    )
    add("--force", action="store_true", help="overwrite existing files")
    add(
        "--from",
        type=number_of(0.0),
        default=0.0,
        dest="start",
        metavar="S",
        help="use samples from this time on, s from the start",
    )
    add(
        "--to",
        type=number_of(0.0, above=True),
        default=math.inf,
        dest="end",
        metavar="S",
        help="use samples up to here",
    )

    units = add_units(parser)
    text = "a row's command: the answer to its angles (the default), or what acted when they were read"
    units.add_argument("--command-row", choices=["answer", "acting"], default="answer", help=text)

    table, names = parser.add_argument_group("tables"), ColumnNames()
    for name in ("time", "motor", "load", "command"):
        default = getattr(names, name)
        table.add_argument(f"--{name}-column", default=default, metavar="NAME", help=f"by default {default}")
    table.add_argument("--time-unit", choices=list(TIME_UNITS), default="s")

    add_topics(parser)


def request_of(given: argparse.Namespace) -> Request:
    """Return the request; OSError without a recording, ValueError for contradicting arguments."""
    answer = given.command_row == "answer"
    reading = reading_of(given, time_unit=given.time_unit, answer=answer, start=given.start, end=given.end)
    refuse_unused(given, _OF_TABLES)
    return Request(
        given.recording,
        reading,
        ColumnNames(given.time_column, given.motor_column, given.load_column, given.command_column),
        topics_of(given),
        given.drive,
        given.json,
        given.drive_file,
        given.certificate,
        given.rated_torque,
        shlex.join(["backlash", *given.words]),
    )


def identify(given: argparse.Namespace, console: Console) -> int:
    """Do the work of `backlash identify`; see `request_of` and `identify_recording`."""
    return identify_recording(request_of(given), console)


COMMAND = Command(identify, add_arguments, written=("json", "drive_file", "certificate"))
