"""`backlash measure`: lets a running controller measure its drive."""

import argparse
import shlex
import sys
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.argument_types import entry_of, number_of
from backlash_ros.commands.command import NOTHING, Command, with_ros
from backlash_ros.control import AUTO, EXPERIMENTS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.epilog = "example: backlash measure --out my_axis --experiment gap_probe"
    add = parser.add_argument
    text = "new folder for recording, drive file and certificate; by default named by the time"
    add("--out", type=Path, metavar="DIR", help=text)
    add("--namespace", default="/", metavar="NS", help="namespace of the controller and its topics, such as /axis_1")
    add("--experiment", type=entry_of(EXPERIMENTS, AUTO), metavar="NAME", help="by default the controller's own")
    text = "N m at the output; lost motion is given at 3 %% of it; by default half the standstill torque"
    add("--rated-torque", type=number_of(0.0, above=True), default=0.0, metavar="T", help=text)


def measure(given: argparse.Namespace, console: Console) -> int:
    """Measure; return 1 if nothing was found, or if no controller answers, which is said.

    Raises
    ------
    ImportError
        Without ROS.
    OSError, ValueError
        If the folder or an option cannot be used.
    """
    measuring, client = (with_ros(f"backlash_ros.{name}") for name in ("measure.command", "ros.client"))
    out = given.out or measuring.folder_of_now()
    namespace = f"/{given.namespace.strip('/')}"
    request = measuring.Measurement(out, namespace, given.experiment or "", given.rated_torque)
    try:
        code: int = measuring.measure(request, shlex.join(["backlash", *given.words]), console)
    except (client.ClientError, ValueError) as error:
        print(f"{given.parser.prog}: {error}", file=sys.stderr)
        return NOTHING
    return code


COMMAND = Command(measure, add_arguments)
