"""`backlash export`: a drive as text for another simulator."""

import argparse
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.command import DONE, Command
from backlash_ros.commands.output import print_or_write
from backlash_ros.drive_file.drive_file import read_axis
from backlash_ros.export import FORMATS

_EXAMPLE = "example: backlash export config/nominal_drive.yaml --format mujoco --out drive.xml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.epilog = _EXAMPLE
    add = parser.add_argument
    add("drive", type=Path, metavar="DRIVE", help="ROS parameter file, such as config/nominal_drive.yaml")
    add("--format", choices=list(FORMATS), required=True)
    add("--out", type=Path, metavar="FILE", help="file to write; by default the text is printed")
    add("--torque", type=float, metavar="T", help="output torque, N m, at which the limit is fitted to the teeth")
    add("--force", action="store_true", help="overwrite an existing file")


def export(given: argparse.Namespace, _: Console) -> int:
    """Print or write the drive.

    Raises
    ------
    OSError, ValueError
        If the drive file cannot be read, or the torque is out of bounds or has no use.
    """
    if given.torque is not None and given.format == "urdf":
        raise ValueError("argument --torque: a URDF has no teeth to fit, leave it out")
    print_or_write(given, FORMATS[given.format](read_axis(given.drive), given.torque))
    return DONE


COMMAND = Command(export, add_arguments, written=("out",))
