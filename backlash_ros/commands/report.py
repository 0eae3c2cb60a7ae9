"""`backlash report`: its arguments; reads a bag, prints a line for each axis, writes page and numbers."""

import argparse
import math
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.argument_types import number_of
from backlash_ros.commands.command import DONE, Command
from backlash_ros.commands.output import json_text, say
from backlash_ros.commands.recording_arguments import add_topics, add_units, reading_of, topics_of
from backlash_ros.foundation.staging import write_text
from backlash_ros.pages.report.page import page_of
from backlash_ros.pages.report.report import AxisReport, content_of, report_of
from backlash_ros.recordings.axes.options import EFFORT_UNITS, VELOCITY_UNITS, Options
from backlash_ros.recordings.encoder import UNITS
from backlash_ros.recordings.rounding import counted

DESCRIPTION = (
    "One page about a recording, to look at, to send and to print: steps, learning runs, changes of gains, faults, "
    "the backlash, and the timing, with charts to zoom. The page needs no network."
)
EXAMPLE = """examples: the demo's recording; a drive of somebody else's, in degrees and revolutions per minute

  backlash report results/demo/bag --out report.html
  backlash report their_bag --joint-topic /arm/states --motor-joint m1 --load-joint j1 --motor-unit deg \\
      --load-unit deg --velocity-unit rpm --reference-topic /arm/target --drive their_drive.yaml

docs/report.md says what each figure means."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    add = parser.add_argument
    add("bag", type=Path, metavar="BAG", help="folder or file of a rosbag2 (mcap, sqlite3)")
    text = "file for the page; by default named like the bag"
    add("--out", type=Path, metavar="FILE.html", help=text)
    add("--json", type=Path, metavar="FILE", help="file for all numbers")
    add("--drive", type=Path, metavar="FILE", help="drive file with motor and gear; by default as in the bag")
    text = "backlash, rad at the output, if the bag has none: the unit of the figures"
    add("--backlash-angle", type=number_of(0.0, above=True), default=0.0, metavar="B", help=text)
    add("--force", action="store_true", help="overwrite existing files")
    units = add_units(parser)
    text = "unit of speeds, by default rad/s"
    units.add_argument("--velocity-unit", choices=list(VELOCITY_UNITS), default="rad/s", help=text)
    text = "unit of the motor's effort, by default Nm; A uses the torque constant of --drive"
    units.add_argument("--effort-unit", choices=list(EFFORT_UNITS), default="Nm", help=text)
    text = "unit of the reference, by default the load's"
    units.add_argument("--reference-unit", choices=[unit for unit in UNITS if unit != "counts"], help=text)
    bag = add_topics(parser)
    bag.add_argument("--reference-topic", default="", metavar="TOPIC", help="by default the one that was followed")
    parser.set_defaults(motor_joint="", load_joint="")


def options_of(given: argparse.Namespace) -> Options:
    """Return how to read the bag; ValueError for contradicting arguments."""
    reading = reading_of(given)
    reference = replace(reading.load, unit=given.reference_unit) if given.reference_unit else reading.load
    return Options(
        reading,
        topics_of(given),
        given.reference_topic,
        reference,
        given.velocity_unit,
        given.effort_unit,
        given.backlash_angle,
        given.drive,
    )


def _line(report: AxisReport) -> str:
    """Return a summary of an axis in one line."""
    said = [counted(len(report.steps), "step")]
    if report.paths:
        said.append(counted(len(report.paths), "path"))
    said += [counted(len(report.events.runs), "learning run"), counted(len(report.events.faults), "fault")]
    if report.b > 0.0:
        said.append(f"b = {report.b:.5g} rad from {report.b_source}")
    if report.gap.told:
        said.append(f"b from this recording {report.gap.angle:.5g} +- {report.gap.uncertainty:.2g} rad")
    if report.timing is not None and math.isfinite(report.timing.rate):
        said.append(f"{report.timing.rate:.4g} Hz, {counted(report.timing.lost, 'sample')} missing")
    name = "axis" if report.axis.name == "/" else f"axis {report.axis.name}"
    return f"{name}: {'; '.join(said)}"


def _cycles(report: AxisReport) -> Sequence[str]:
    """Return a line for each limit cycle, after a step or while the reference stood still."""
    lines = []
    for step in sorted((*report.steps, *report.holds), key=lambda step: step.start):
        if math.isfinite(step.amplitude):
            often = "unevenly" if math.isnan(step.frequency) else f"at {step.frequency:.3g} Hz"
            in_b = f" (peak to peak {step.amplitude / report.b:.3g} b)" if report.b > 0.0 else ""
            lines.append(
                f"limit cycle: +-{0.5 * step.amplitude:.3g} rad{in_b} {often} about "
                f"{step.target:.5g} rad, {step.start:.2f} to {step.end:.2f} s"
            )
    return lines


def write_report(given: argparse.Namespace, console: Console) -> int:
    """Read the bag, print and write.

    Raises
    ------
    OSError, ValueError
        If the bag cannot be read, a file cannot be written, or an option does not fit the bag.
    """
    given.bag.stat()  # says that there is none
    out = given.out or Path(f"{given.bag.resolve().stem}.html")
    if out.exists() and not given.force:
        raise ValueError(f"argument --out: '{out}' exists; --force overwrites it")
    report = report_of(given.bag, options_of(given), shlex.join(["backlash", *given.words]))
    for what in report.contents.damage:
        say(console, f"the bag is not whole: {what}")
    for axis in report.axes:
        say(console, _line(axis))
        for cycle in _cycles(axis):
            say(console, f"  {cycle}")
        for missing in axis.axis.missing:
            say(console, f"  not in this recording: {missing}")
    texts = {out: page_of(report)}
    if given.json is not None:
        texts[given.json] = json_text(content_of(report))
    for place, text in texts.items():
        write_text(place, text, overwrite=given.force)
    say(console, f"written: {', '.join(map(str, texts))}")
    return DONE


COMMAND = Command(write_report, add_arguments, written=("out", "json"))
