"""The arguments of `backlash identify`."""

import argparse
import math
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from backlash_ros.commands.identify import Request, identify_recording
from backlash_ros.recordings.bag_topics import STAMPS, Topics
from backlash_ros.recordings.csv_file import ColumnNames, is_table
from backlash_ros.recordings.encoder import UNITS, Encoder
from backlash_ros.recordings.samples import COMMAND_UNITS, TIME_UNITS, Reading

EXAMPLE = """example: an axis recorded as a table, the motor's encoder counted before the gear, the load's in degrees

  backlash identify axis.csv --drive my_axis.yaml --motor-unit counts --motor-counts 4096 --load-unit deg \\
      --load-column angle --command-column volts --drive-file identified.yaml

docs/identification.md has the rules."""
DESCRIPTION = (
    "The load's inertia and friction, load torque, delay, gap and encoder offset of a drive, with standard "
    "uncertainties, from any recording of both encoders and the command. What the recording cannot tell is named."
)
WRITTEN = ("json", "drive_file", "certificate")
"""Options that name files to write."""
_OF_TABLES = ("time_column", "motor_column", "load_column", "command_column", "time_unit")
_OF_BAGS = ("joint_topic", "motor_joint", "load_joint", "command_topic", "command_index", "stamps")


def number_of(least: float, *, above: bool = False) -> Callable[[str], float]:
    """Return a parser of a finite number that is at least, or if ``above`` more than, the least."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or value < least or (above and value == least):
            raise argparse.ArgumentTypeError(f"must be a number {'>' if above else '>='} {least:g}, got {text!r}")
        return value

    return parse


def _index(text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"must be a whole number >= 0, got {text!r}")
    return int(text)


def add_identification(parser: argparse.ArgumentParser) -> None:
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


def add_units(parser: argparse.ArgumentParser) -> Any:
    """Add the arguments for units of angles and commands; return their group."""
    units = add_angles(parser, "angles and command")
    add = units.add_argument
    add("--command-unit", choices=COMMAND_UNITS, default="", help="by default that of the drive")
    add("--supply", type=number_of(0.0, above=True), default=0.0, metavar="V", help="voltage of a duty cycle of 1")
    return units


def add_angles(parser: argparse.ArgumentParser, title: str) -> Any:
    """Add the arguments for units of angles; return their group, which has a title."""
    units = parser.add_argument_group(title)
    add = units.add_argument
    for shaft in ("motor", "load"):
        add(f"--{shaft}-unit", choices=list(UNITS), default="rad")
        add(
            f"--{shaft}-counts",
            type=number_of(0.0, above=True),
            default=0.0,
            metavar="N",
            help="counts of its encoder per turn",
        )
        text = "units after which its angle wraps; detected if that is one turn"
        add(f"--{shaft}-wraps", type=number_of(0.0, above=True), default=0.0, metavar="X", help=text)
    text = "shaft at which the motor's angle is measured; motor (the default) is before the gear"
    add("--motor-at", choices=["motor", "output"], default="motor", help=text)
    return units


def add_topics(parser: argparse.ArgumentParser) -> Any:
    """Add the arguments for the topics of a bag; return their group."""
    bag, topics = parser.add_argument_group("bags"), Topics()
    bag.add_argument("--joint-topic", default="", metavar="TOPIC", help="if several topics have joint states")
    bag.add_argument("--motor-joint", default=topics.motor_joint, metavar="NAME", help="by default motor")
    bag.add_argument("--load-joint", default=topics.load_joint, metavar="NAME", help="by default load")
    bag.add_argument("--command-topic", default="", metavar="TOPIC", help="by default the one ending with /command")
    bag.add_argument("--command-index", type=_index, default=0, metavar="K", help="index of the number, from 0 on")
    bag.add_argument("--stamps", choices=STAMPS, default=topics.stamps, help="source of a sample's time")
    return bag


def reading_of(given: argparse.Namespace, **more: Any) -> Reading:
    """Return the units of angles and commands; ValueError for contradicting arguments."""
    encoders = []
    for shaft in ("motor", "load"):
        unit, counts, wraps = (getattr(given, f"{shaft}_{name}") for name in ("unit", "counts", "wraps"))
        try:
            encoders.append(Encoder(unit, counts, wraps))
        except ValueError as error:
            raise ValueError(f"argument --{shaft}-counts: {error}") from error
    if given.supply and given.command_unit != "duty":
        raise ValueError("argument --supply: is the voltage of a duty cycle, and needs --command-unit duty")
    return Reading(
        motor=encoders[0],
        load=encoders[1],
        motor_at=given.motor_at,
        command_unit=given.command_unit,
        supply=given.supply,
        **more,
    )


def topics_of(given: argparse.Namespace) -> Topics:
    """Return the topics of samples and commands in a bag."""
    return Topics(
        given.joint_topic,
        given.command_topic,
        given.motor_joint,
        given.load_joint,
        given.command_index,
        given.stamps,
    )


def refuse_unused(given: argparse.Namespace, of_tables: Sequence[str] = _OF_TABLES) -> None:
    """Raise ValueError for an option of tables if a bag is read, and the other way round."""
    table = is_table(given.recording)
    for name in _OF_BAGS if table else of_tables:
        if getattr(given, name) != given.parser.get_default(name):
            kind, other = ("bags", "table") if table else ("tables", "bag")
            raise ValueError(f"argument --{name.replace('_', '-')}: is for {kind}, and {given.recording} is a {other}")


def request_of(given: argparse.Namespace) -> Request:
    """Return the request; OSError without a recording, ValueError for contradicting arguments."""
    answer = given.command_row == "answer"
    reading = reading_of(given, time_unit=given.time_unit, answer=answer, start=given.start, end=given.end)
    refuse_unused(given)
    return Request(
        given.recording,
        reading,
        ColumnNames(given.time_column, given.motor_column, given.load_column, given.command_column),
        topics_of(given),
        given.drive,
        given.json,
        given.drive_file,
        given.force,
        given.certificate,
        given.rated_torque,
        shlex.join(["backlash", *given.words]),
    )


def identify(given: argparse.Namespace, console: Console) -> int:
    """Do the work of `backlash identify`; see `request_of` and `identify_recording`."""
    return identify_recording(request_of(given), console)
