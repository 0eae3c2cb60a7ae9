"""`backlash design`: its arguments; reads a drive file, designs, prints and writes."""

import argparse
from dataclasses import fields, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from backlash_ros.commands.command import DONE, NOTHING, Command
from backlash_ros.commands.output import json_text, say, say_written, staged
from backlash_ros.control.design.stability import LONGEST_DELAY
from backlash_ros.control.design.start import RATE
from backlash_ros.drive_file.drive_file import read_axis, read_parameters, read_surroundings, start_of
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.studies.design.report import content_of, gain_text, show
from backlash_ros.studies.design.search import Design, NothingQuietError, design
from backlash_ros.studies.design.trial import Loop
from backlash_ros.studies.design.uncertainty import Uncertainty

DESCRIPTION = (
    "Designs over-damped gains of the two-region law and the width of their region, so that the load comes to rest on "
    "every drive of a range around the described drive, as fast as possible."
)
EXAMPLE = "example: backlash design config/nominal_drive.yaml --inertia 0.7 1.3 --out gains.yaml --plot design.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    add, default = parser.add_argument, Uncertainty()
    add("drive", type=Path, metavar="DRIVE", help="ROS parameter file, such as `backlash identify` writes")
    words = {
        "inertia": "the load's inertia",
        "viscous_friction": "the load's viscous friction",
        "dry_friction": "the dry friction of both sides",
        "gap": "the gap",
    }
    for name, what in words.items():
        low, high = getattr(default, name)
        text = f"range of {what}, as factors on the file's value; by default {low:g} {high:g}"
        option = f"--{name.replace('_', '-')}"
        add(option, type=float, nargs=2, metavar=("LOWER", "UPPER"), default=(low, high), help=text)
    text = "largest load torque in either direction, as a share of the standstill torque; by default %(default)s"
    add("--load-torque", type=float, metavar="SHARE", default=default.load_torque, help=text)
    add("--rate", type=float, metavar="HZ", help="sample rate; by default the file's")
    add("--delay", type=float, metavar="S", help="from the measurement to the command's effect; by default the file's")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="parameter file for the controller, with gains and width",
    )
    add("--json", type=Path, metavar="FILE", help="file for all figures")
    add("--plot", type=Path, metavar="FILE", help="file for a picture, such as design.png or design.svg")
    add("--force", action="store_true", help="overwrite existing files")


def loop_of(given: argparse.Namespace) -> Loop:
    """Return the loop that drive file and options describe.

    Raises
    ------
    OSError, ValueError
        If the file cannot be read or is no drive file, or if an option is out of bounds.
    """
    parameters, axis, around = read_parameters(given.drive), read_axis(given.drive), read_surroundings(given.drive)
    rate = around.rate if given.rate is None else given.rate
    RATE.check("--rate", rate)
    delay = around.delay if given.delay is None else Delay(command=given.delay)
    delay.check_line(1.0 / rate)
    if not delay.mean <= (longest := LONGEST_DELAY / rate):
        raise ValueError(f"delay must be >= 0 s and at most {LONGEST_DELAY} periods, {longest:g} s, got {delay.mean!r}")
    start = start_of(parameters, axis.drive, replace(around, rate=rate, delay=delay))
    return Loop(start.drive, start.settings.gains.fast, rate, around.sensors, delay)


def design_gains_for(given: argparse.Namespace, console: Console) -> int:
    """Design, print and write; return the exit code: 0 if gains were found, 1 if none are quiet.

    If none are quiet, the best of them are written, and the file says so. Files appear complete or not at all.

    Raises
    ------
    OSError, ValueError
        As `loop_of`, `Uncertainty` and `search.design`.
    """
    uncertainty = Uncertainty(**{field.name: getattr(given, field.name) for field in fields(Uncertainty)})
    loop = loop_of(given)
    with staged(given.out, given.json, given.plot) as files:
        try:
            found = _designed(loop, uncertainty)
        except NothingQuietError as error:
            say(console, str(error))
            return NOTHING
        content = content_of(found, str(given.drive))
        show(content, console)
        if given.out is not None:
            text = gain_text(loop, found.choice, str(given.drive), found.refusal)
            files[given.out].write_text(text, encoding="utf-8")
        if given.json is not None:
            files[given.json].write_text(json_text(content), encoding="utf-8")
        if given.plot is not None:
            from backlash_ros.studies.design.picture import draw  # noqa: PLC0415 - matplotlib takes a second

            draw(found, files[given.plot])
    say_written(console, files)
    if found.refusal:
        say(console, f"not quiet: {found.refusal}")
        return NOTHING
    return DONE


def _designed(loop: Loop, uncertainty: Uncertainty) -> Design:
    """Design; show on the terminal what is done, for how long, and the time left if the search takes its longest."""
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("left, at most:")
    bar = Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), speed_estimate_period=600)
    with bar:
        shown = bar.add_task("trying gains", total=1.0)
        found = design(loop, uncertainty, lambda what, share: bar.update(shown, description=what, completed=share))
        bar.update(shown, description="designed", completed=1.0)
    return found


COMMAND = Command(design_gains_for, add_arguments, written=("out", "json", "plot"))
