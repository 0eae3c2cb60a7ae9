"""`backlash check`: its arguments, and what it prints."""

import argparse
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.command import DONE, NOTHING, Command
from backlash_ros.commands.output import say
from backlash_ros.foundation.reading.parameter_files import named
from backlash_ros.recordings.rounding import counted
from backlash_ros.studies.check import Checked, check_drive

DESCRIPTION = "Checks a drive file and its loop: prints figures, and warnings with remedies. Nothing moves."
EXAMPLE = "example: backlash check config/nominal_drive.yaml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    text = "ROS parameter files of the drive and its gains; later ones override earlier ones"
    parser.add_argument("drive", type=Path, nargs="+", metavar="DRIVE", help=text)


def check(given: argparse.Namespace, console: Console) -> int:
    """Print figures and warnings; return 1 if a controller would not start with that drive, else 0.

    Raises
    ------
    OSError, ValueError
        As `check_drive`.
    """
    return tell(console, check_drive(*given.drive), named(given.drive))


def tell(console: Console, found: Checked, files: str) -> int:
    """Print what a check found of ``files``; return 1 if a controller would not start, else 0."""
    width = max(map(len, found.figures))
    for name, value in found.figures.items():
        say(console, f"{name:{width}}  {value}")
    for warning in found.warnings:
        say(console, f"warning: {warning.what}\n  -> {warning.remedy}")
    if found.fails:
        say(console, f"fails: {found.fails}" + (f"\n  -> {found.remedy}" if found.remedy else ""))
        return NOTHING
    many = counted(len(found.warnings), "warning") if found.warnings else "no warnings"
    say(console, f"{files}: the loop is stable, {many}")
    return DONE


COMMAND = Command(check, add_arguments)
