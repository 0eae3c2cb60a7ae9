"""`backlash export-c`: the controller of an axis as C, for a ros2_control plugin or firmware."""

import argparse
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.command import DONE, Command
from backlash_ros.commands.output import say
from backlash_ros.control import AUTO, LAWS
from backlash_ros.drive_file.drive_file import (
    law_parameters_of,
    read_axis,
    read_parameters,
    read_start,
    read_surroundings,
)
from backlash_ros.export.c.files import Controller, files_of
from backlash_ros.export.c.object_file import TARGETS
from backlash_ros.foundation.reading.parameter_files import named
from backlash_ros.foundation.staging import staging

DESCRIPTION = (
    "Writes the controller that parameter files describe as C: its tick as an object file, a header, the constants of "
    "the drive, a self-test that replays a recording bit for bit, and an example. README.md in the folder says more."
)
EXAMPLE = "example: backlash export-c config/nominal_drive.yaml --law cascade --out my_axis"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    add = parser.add_argument
    text = "ROS parameter files, such as `backlash identify` writes; later ones override earlier ones"
    add("drive", type=Path, nargs="+", metavar="DRIVE", help=text)
    add("--out", type=Path, required=True, metavar="DIR", help="folder to write to, new or empty")
    add("--law", choices=sorted([AUTO, *LAWS]), help=f"by default that of DRIVE, or {AUTO}")
    add(
        "--name", default="axis", help="with which all names in C begin, a different one for each axis; by default axis"
    )
    add("--target", choices=list(TARGETS), default=next(iter(TARGETS)), help="by default %(default)s")


def export_c(given: argparse.Namespace, console: Console) -> int:
    """Write the folder, all of it or nothing.

    Raises
    ------
    OSError, ValueError
        If a file cannot be read, the folder has something in it, the controller does not start, or its law cannot be
        exported.
    """
    if given.out.is_dir() and any(given.out.iterdir()):
        raise ValueError(f"argument --out: must be a new or an empty folder, got '{given.out}', which has files in it")
    choice, drive = read_start(*given.drive), read_axis(*given.drive).drive
    if given.law is not None:
        own = None if given.law == AUTO else law_parameters_of(read_parameters(*given.drive), given.law)
        choice = choice._replace(settings=choice.settings.with_law(given.law, own))
    around = read_surroundings(*given.drive)
    controller = Controller(choice, drive, around, named(given.drive), given.name, given.target)
    files = files_of(controller)
    with staging(given.out / "README.md") as folder:
        for name, content in files.items():
            (folder / name).write_bytes(content)
        for name in files:
            (folder / name).replace(given.out / name)
    say(console, f"law {controller.law} at {around.rate:g} Hz for {given.target}: {', '.join(sorted(files))}")
    say(console, f"written: {given.out}; {given.out / 'README.md'} says how to build and to use it")
    return DONE


COMMAND = Command(export_c, add_arguments, folders=("out",))
