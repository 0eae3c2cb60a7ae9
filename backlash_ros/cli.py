"""Servo control of geared drives with backlash: try it, measure a drive, choose gains, evaluate, report."""

import argparse
import errno
import json
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from importlib import import_module
from pathlib import Path
from typing import NoReturn, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from backlash_ros import __version__
from backlash_ros.analysis.checking.command import add_check, check_and_show
from backlash_ros.analysis.design import command as designer
from backlash_ros.analysis.evaluation.command import evaluate, replay
from backlash_ros.analysis.evaluation.drive_file import named, read_axis, read_drive, read_parameters, read_start
from backlash_ros.analysis.evaluation.population import ENCODERS, MODELS, POPULATIONS
from backlash_ros.analysis.evaluation.task import DESIGNED, Task
from backlash_ros.analysis.export import FORMATS
from backlash_ros.analysis.jsonable import jsonable
from backlash_ros.analysis.page import write_page
from backlash_ros.analysis.paper import PARTS, reproduce
from backlash_ros.analysis.recordings.arguments import add_identification, in_the_way, number_of, request_of
from backlash_ros.analysis.recordings.command import identify_recording
from backlash_ros.analysis.replay import command as replaying
from backlash_ros.analysis.report.command import add_report, places_of, write_report
from backlash_ros.analysis.report.library import NoLibraryError
from backlash_ros.analysis.simulating import command as simulating
from backlash_ros.analysis.staging import staging, write_text
from backlash_ros.control import AUTO, EXPERIMENTS, LAWS
from backlash_ros.control.design.start import CannotStartError
from backlash_ros.simulation.batch import CannotRunError

T = TypeVar("T")


def figures(out: Path, page: Path | None, console: Console) -> None:
    """Compute everything; write figures and figures.json into ``out``, and the page to ``page``: all or nothing."""
    from backlash_ros.analysis.figures import FIGURES, draw  # noqa: PLC0415 - matplotlib takes a second

    with ExitStack() as stack:
        drawn = stack.enter_context(staging(out / "figures.json"))
        results = {drawn: out}
        if page is not None:
            if page.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(page))
            written = stack.enter_context(staging(page))
            results[written] = page.parent
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console) as bar:
            task = bar.add_task("the paper", total=PARTS + len(FIGURES))

            def progress(what: str) -> None:
                bar.update(task, advance=1, description=what)

            done = reproduce(progress)
            draw(done, drawn, progress)
        numbers = jsonable(done.numbers)
        (drawn / "figures.json").write_text(json.dumps(numbers, indent=1) + "\n")
        if page is not None:
            (written / page.name).write_text(write_page(numbers))
        for folder, place in results.items():
            for file in folder.iterdir():
                file.replace(place / file.name)
    console.print(f"{len(FIGURES)} figures (PNG, SVG) and figures.json in {out}", highlight=False)
    if page is not None:
        console.print(f"{page}", highlight=False)


def _figures(parser: argparse.ArgumentParser, given: argparse.Namespace, console: Console) -> None:
    if given.of == "paper":
        figures(given.out, given.page, console)
        return
    if given.page is not None:
        parser.error("argument --page: is about the paper's figures")
    from backlash_ros.analysis.simulating.law_pictures import draw  # noqa: PLC0415 - matplotlib takes a second

    console.print(f"{', '.join(draw(given.out))} in {given.out}", highlight=False)


class _Parser(argparse.ArgumentParser):
    """A parser with one-line error messages."""

    def error(self, message: str) -> NoReturn:
        """End with exit code 2."""
        self.exit(2, f"{self.prog}: {message}\n")


def _whole(least: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"must be a whole number >= {least}, got {text!r}")
        return value

    return parse


def _entry_of(registry: Mapping[str, T], *besides: str) -> Callable[[str], str]:
    def parse(text: str) -> str:
        if text not in registry and text not in besides:
            raise argparse.ArgumentTypeError(f"must be one of {sorted([*registry, *besides])}, got {text!r}")
        return text

    return parse


def _add_evaluation(parser: argparse.ArgumentParser) -> None:
    add, default = parser.add_argument, Task(0)
    add("--seed", type=_whole(0), required=True, metavar="S", help="seed of the population")
    add("--drives", type=_whole(1), metavar="N", help="number of drives to judge, from the first on")
    add("--json", type=Path, metavar="FILE", help="file for the summary")
    add("--experiments", nargs="+", type=_entry_of(EXPERIMENTS, AUTO), default=default.experiments, metavar="NAME")
    add("--laws", nargs="+", type=_entry_of(LAWS, DESIGNED, AUTO), default=default.laws, metavar="NAME")
    add("--model", choices=MODELS, default=default.model, help="the drive as the controller knows it")
    add("--population", choices=POPULATIONS, default=default.population)
    add("--encoders", choices=list(ENCODERS), default=default.encoders)
    add("--drive", type=Path, metavar="FILE", help="draw the population around the drive of a ROS parameter file")
    add("--out", type=Path, metavar="DIR", help="folder for the table of all runs and the pictures")
    add("--scheduler", default="", metavar="ADDRESS", help="run on the workers of a Dask scheduler")
    add("--only", type=_whole(0), metavar="K", help="run only drive K and print its details")
    add("--plot", type=Path, metavar="FILE", help="with --only: draw its runs")
    parser.set_defaults(run=lambda a, console: _evaluate(parser, a, console))


def _add_export(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("drive", type=Path, metavar="DRIVE", help="ROS parameter file, such as config/nominal_drive.yaml")
    add("--format", choices=list(FORMATS), required=True)
    add("--out", type=Path, metavar="FILE", help="file to write; by default the text is printed")
    add("--torque", type=float, metavar="T", help="output torque, N m, at which the limit is fitted to the teeth")
    add("--force", action="store_true", help="overwrite an existing file")
    parser.set_defaults(run=lambda a, _: _export(parser, a))


def _export(parser: argparse.ArgumentParser, given: argparse.Namespace) -> None:
    try:
        text = FORMATS[given.format](read_axis(given.drive), given.torque)
        _refuse_misspelled(given.drive)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    _print_or_write(parser, given, text)


def _print_or_write(parser: argparse.ArgumentParser, given: argparse.Namespace, text: str) -> None:
    """Print a text, or write it to ``--out``."""
    if given.out is None:
        print(text, end="")
        return
    try:
        write_text(given.out, text, overwrite=given.force)
    except FileExistsError:
        parser.error(f"argument --out: '{given.out}' exists; --force overwrites it")


def _refuse_misspelled(*files: Path) -> None:
    """Refuse drive files with misspelled parameters, if there is ROS: only the nodes know all names.

    Raises
    ------
    OSError, ValueError
        As `read_parameters`; or names the file, the parameter and the one that was probably meant.
    """
    parameters = read_parameters(*files)
    with suppress(ImportError):
        from backlash_ros.nodes.parameters import refuse_misspelled  # noqa: PLC0415 - needs ROS

        try:
            refuse_misspelled(parameters)
        except ValueError as error:
            raise ValueError(f"{named(files)}: {error}") from error


_NODES = ("plant_simulator", "controller")
"""The nodes for `backlash params`."""


def _add_params(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = "Writes a commented parameter file with every parameter and its default."
    add("node", nargs="?", choices=_NODES, help="by default both in one file")
    add("--out", type=Path, metavar="FILE", help="file to write; by default the text is printed")
    add("--force", action="store_true", help="overwrite an existing file")
    parser.set_defaults(run=lambda a, _: _params(parser, a))


def _params(parser: argparse.ArgumentParser, given: argparse.Namespace) -> None:
    try:
        from backlash_ros.nodes.parameter_file import parameter_file  # noqa: PLC0415 - needs ROS
    except ImportError as error:
        parser.error(f"needs ROS 2: {error}")
    _print_or_write(parser, given, parameter_file([given.node] if given.node else _NODES))


def _unwritable(place: Path, *, folder: bool) -> str:
    """Return why a file, or files in a folder, cannot be written there; empty if they can."""
    if place.is_dir() and not folder:
        return os.strerror(errno.EISDIR)
    try:
        with staging(place / "file" if folder else place):
            return ""
    except OSError as error:
        return error.strerror or str(error)


def _evaluate(parser: argparse.ArgumentParser, given: argparse.Namespace, console: Console) -> None:
    if given.only is None:
        for name in ("drives", "json"):
            if getattr(given, name) is None:
                parser.error(f"argument --{name}: must be given without --only")
        if given.plot is not None:
            parser.error("argument --plot: needs --only, since it draws one drive")
    for name in ("json", "plot", "out"):
        if (place := getattr(given, name)) is not None and (why := _unwritable(place, folder=name == "out")):
            parser.error(f"argument --{name}: must be writable, got '{place}': {why}")
    around = None
    try:
        if given.drive:
            _refuse_misspelled(given.drive)
            around = read_drive(given.drive)
            read_start(given.drive)  # refused like the controller
    except CannotStartError as error:
        parser.exit(1, f"{parser.prog}: {error}\n")
    except (OSError, ValueError) as error:
        parser.error(f"argument --drive: {error}")
    laws = tuple(dict.fromkeys(given.laws))
    experiments = tuple(dict.fromkeys(given.experiments))
    task = Task(given.seed, given.population, given.model, given.encoders, experiments, laws, around)
    if given.only is not None:
        replay(task, given.only, given.plot, console)
        return
    drive = str(given.drive or "")
    try:
        evaluate(task, given.drives, given.json, given.out, console, scheduler=given.scheduler, drive=drive)
    except (ImportError, CannotRunError) as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        parser.exit(130, "\nstopped: run the same command to continue\n")


def _identify(parser: argparse.ArgumentParser, given: argparse.Namespace, console: Console) -> int:
    try:
        request = request_of(given)
    except ValueError as error:
        parser.error(str(error))
    for name, place in in_the_way(request):
        parser.error(f"argument --{name}: '{place}' exists; --force overwrites it")
    for name in ("json", "drive_file", "certificate"):
        if (place := getattr(request, name)) is not None and (why := _unwritable(place, folder=False)):
            option = name.replace("_", "-")
            parser.error(f"argument --{option}: must be writable, got '{place}': {why}")
    try:
        if request.drive:
            _refuse_misspelled(request.drive)
        return identify_recording(request, console)
    except ValueError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1


def _work(
    parser: argparse.ArgumentParser,
    given: argparse.Namespace,
    console: Console,
    work: Callable[[argparse.Namespace, Console], int],
    written: Sequence[str] = (),
) -> int:
    """Do a subcommand's work once its drive files and the places of the options ``written`` have been checked."""
    places = [(name, place) for name in written if (place := getattr(given, name)) is not None]
    for name, place in places:
        if place.exists() and not given.force:
            parser.error(f"argument --{name}: '{place}' exists; --force overwrites it")
    for name, place in places:
        if why := _unwritable(place, folder=False):
            parser.error(f"argument --{name}: must be writable, got '{place}': {why}")
    drive = getattr(given, "drive", None) or ()
    try:
        if files := [drive] if isinstance(drive, Path) else drive:
            _refuse_misspelled(*files)
        return work(given, console)
    except CannotStartError as error:
        parser.exit(1, f"{parser.prog}: {error}\n")
    except ValueError as error:
        parser.error(str(error))


def _report(parser: argparse.ArgumentParser, given: argparse.Namespace, console: Console) -> int:
    for name, place in places_of(given):
        if place.exists() and not given.force:
            parser.error(f"argument --{name}: '{place}' exists; --force overwrites it")
        if why := _unwritable(place, folder=False):
            parser.error(f"argument --{name}: must be writable, got '{place}': {why}")
    try:
        return write_report(given, console)
    except NoLibraryError as error:
        parser.error(str(error))
    except ValueError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1


def _add_measurement(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--out",
        type=Path,
        metavar="DIR",
        help="new folder for recording, drive file and certificate; by default named by the time",
    )
    add("--namespace", default="/", metavar="NS", help="namespace of the controller and its topics, such as /axis_1")
    add("--experiment", type=_entry_of(EXPERIMENTS, AUTO), metavar="NAME", help="by default the controller's own")
    text = "N m at the output; lost motion is given at 3 %% of it; by default half the standstill torque"
    add("--rated-torque", type=number_of(0.0, above=True), default=0.0, metavar="T", help=text)


def _measure(parser: argparse.ArgumentParser, given: argparse.Namespace, console: Console) -> int:
    try:
        from backlash_ros.measure.command import Measurement, folder_of_now, measure  # noqa: PLC0415 - needs ROS
        from backlash_ros.ros.client import ClientError  # noqa: PLC0415
    except ImportError as error:
        parser.error(f"needs ROS 2: {error}")
    out = given.out or folder_of_now()
    try:
        request = Measurement(out, given.namespace, given.experiment or "", given.rated_torque)
        return measure(request, shlex.join(["backlash", *given.words]), console)
    except FileExistsError as error:
        parser.error(f"argument {error}")
    except (ClientError, ValueError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1


_WITH_ROS = {
    "demo": (
        "backlash_ros.demo.__main__",
        "run simulator, controller and recorder: learn, step, judge",
    ),
    "live": ("backlash_ros.dashboard.live", "run a simulated drive, its controller and a page in the browser"),
}
"""Commands that are separate programs: module and help."""


def _run_with_ros(name: str, words: Sequence[str]) -> int:
    try:
        module = import_module(_WITH_ROS[name][0])
    except ImportError as error:
        print(f"backlash {name}: needs ROS 2: {error}", file=sys.stderr)
        return 2
    code: int = module.main(words)
    return code


def parser_of(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of all commands; ``words`` is the command line, which results repeat."""
    parser = _Parser(prog="backlash", description=__doc__)
    parser.add_argument("--version", action="version", version=f"backlash_ros {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (_, text) in _WITH_ROS.items():
        commands.add_parser(name, help=text)
    drawing = commands.add_parser(
        "figures",
        help="compute and draw the paper's figures, or those that explain law two_encoder",
        epilog="examples: backlash figures --out results/figures; backlash figures two_encoder --out results/figures",
    )
    drawing.add_argument("of", nargs="?", choices=("paper", "two_encoder"), default="paper", help="by default paper")
    drawing.add_argument("--out", type=Path, required=True, help="folder for the figures")
    drawing.add_argument("--page", type=Path, help="also write the page that discusses the paper's")
    drawing.set_defaults(run=lambda a, console: _figures(drawing, a, console))
    single = commands.add_parser("simulate", help="simulate one step: figures as JSON, a picture, a table")
    simulating.add_simulate(single)
    single.set_defaults(run=lambda a, console: _work(single, a, console, simulating.simulate, simulating.WRITTEN))
    judging = commands.add_parser(
        "evaluate",
        help="judge learning and laws on a random population of drives",
        epilog="example: backlash evaluate --seed 1 --drives 20 --json results/evaluation.json",
    )
    _add_evaluation(judging)
    exporting = commands.add_parser(
        "export",
        help="export a drive for MuJoCo, or as URDF or SDF",
        epilog="example: backlash export config/nominal_drive.yaml --format mujoco --out drive.xml",
    )
    _add_export(exporting)
    listing = commands.add_parser(
        "params",
        help="write a commented file of all parameters, to start from",
        epilog="example: backlash params --out my_drive.yaml",
    )
    _add_params(listing)
    finding = commands.add_parser(
        "identify",
        help="identify a drive from a recording, with uncertainties",
    )
    add_identification(finding)
    reporting = commands.add_parser(
        "report",
        help="write a page about a recording: steps, faults, backlash, timing, charts",
    )
    add_report(reporting)
    designing = commands.add_parser(
        "design",
        help="design over-damped gains and their region's width for a range of drives",
    )
    designer.add_design(designing)
    checking = commands.add_parser("check", help="check a drive file and its loop before anything moves")
    add_check(checking)
    checking.set_defaults(run=lambda a, console: _work(checking, a, console, check_and_show))
    again = commands.add_parser(
        "replay",
        help="compute a recorded controller's commands again, to the last bit",
    )
    replaying.add_replay(again)
    again.set_defaults(run=lambda a, console: _work(again, a, console, replaying.replay_bag, replaying.WRITTEN))
    designing.set_defaults(
        run=lambda a, console: _work(designing, a, console, designer.design_gains_for, designer.WRITTEN)
    )
    finding.set_defaults(words=words, run=lambda a, console: _identify(finding, a, console))
    reporting.set_defaults(words=words, run=lambda a, console: _report(reporting, a, console))
    measuring = commands.add_parser(
        "measure",
        help="let a running controller measure its drive: recording, drive file and certificate",
        epilog="example: backlash measure --out my_axis --experiment gap_probe",
    )
    _add_measurement(measuring)
    measuring.set_defaults(words=words, run=lambda a, console: _measure(measuring, a, console))
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; the exit code is 2 for unusable arguments, 1 if a recording gives no result."""
    words = tuple(sys.argv[1:] if args is None else args)
    if words and words[0] in _WITH_ROS:
        return _run_with_ros(words[0], words[1:])
    parsed = parser_of(words).parse_args(words)
    command: Callable[[argparse.Namespace, Console], int | None] = parsed.run
    try:
        return command(parsed, Console()) or 0
    except OSError as error:
        print(f"backlash: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main())
