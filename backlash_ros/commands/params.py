"""`backlash params`: a parameter file with every parameter and its default."""

import argparse
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.command import DONE, Command, with_ros
from backlash_ros.commands.output import print_or_write

_NODES = ("plant_simulator", "controller")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.description = "Writes a commented parameter file with every parameter and its default."
    parser.epilog = "example: backlash params --out my_drive.yaml"
    add = parser.add_argument
    add("node", nargs="?", choices=_NODES, help="by default both in one file")
    add("--out", type=Path, metavar="FILE", help="file to write; by default the text is printed")
    add("--force", action="store_true", help="overwrite an existing file")


def params(given: argparse.Namespace, _: Console) -> int:
    """Print or write the file; ImportError without ROS."""
    nodes = with_ros("backlash_ros.nodes.parameter_file")
    print_or_write(given, nodes.parameter_file([given.node] if given.node else _NODES))
    return DONE


COMMAND = Command(params, add_arguments, written=("out",))
