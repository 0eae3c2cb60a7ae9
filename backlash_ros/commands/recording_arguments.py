"""Arguments that the commands for recordings share: units of angles and commands, and topics of a bag."""

import argparse
from collections.abc import Sequence
from typing import Any

from backlash_ros.commands.argument_types import number_of, whole
from backlash_ros.recordings.bag_topics import STAMPS, Topics
from backlash_ros.recordings.csv_file import is_table
from backlash_ros.recordings.encoder import UNITS, Encoder
from backlash_ros.recordings.samples import COMMAND_UNITS, Reading

_OF_BAGS = ("joint_topic", "motor_joint", "load_joint", "command_topic", "command_index", "stamps")


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
    bag.add_argument("--command-index", type=whole(0), default=0, metavar="K", help="index of the number, from 0 on")
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


def refuse_unused(given: argparse.Namespace, of_tables: Sequence[str]) -> None:
    """Raise ValueError for an option of tables if a bag is read, and the other way round.

    Parameters
    ----------
    of_tables : the command's options of tables, as `given` names them
    """
    table = is_table(given.recording)
    for name in _OF_BAGS if table else of_tables:
        if getattr(given, name) != given.parser.get_default(name):
            kind, other = ("bags", "table") if table else ("tables", "bag")
            raise ValueError(f"argument --{name.replace('_', '-')}: is for {kind}, and {given.recording} is a {other}")
