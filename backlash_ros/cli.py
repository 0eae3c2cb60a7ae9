"""Servo control of geared drives with backlash: try it, measure a drive, choose gains, evaluate, report."""

import argparse
import errno
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from backlash_ros import __version__
from backlash_ros.commands import design as designer
from backlash_ros.commands import lost_motion as locked
from backlash_ros.commands import replay as replaying
from backlash_ros.commands import simulate as simulating
from backlash_ros.commands.check import add_check, check_and_show
from backlash_ros.commands.evaluate import evaluate, replay
from backlash_ros.commands.evaluate_effects import EFFECT_NAMES, evaluate_effects, with_effect
from backlash_ros.commands.identify_arguments import WRITTEN as IDENTIFICATION
from backlash_ros.commands.identify_arguments import add_identification, identify, number_of
from backlash_ros.commands.report import WRITTEN as REPORT
from backlash_ros.commands.report import add_report, write_report
from backlash_ros.control import AUTO, EXPERIMENTS, LAWS
from backlash_ros.control.design.start import CannotStartError
from backlash_ros.drive_file.drive_file import read_axis, read_parameters, read_start
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.motion.integrator import IntegrationError
from backlash_ros.export import FORMATS
from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.foundation.parser import Parser
from backlash_ros.foundation.reading.parameter_files import named
from backlash_ros.foundation.staging import staging, write_text
from backlash_ros.pages.paper import write_page
from backlash_ros.pages.report.library import NoLibraryError
from backlash_ros.simulation.batch import CannotRunError
from backlash_ros.studies.evaluation.population import ENCODERS, MODELS, POPULATIONS
from backlash_ros.studies.evaluation.task import DESIGNED, Task
from backlash_ros.studies.paper import PARTS, reproduce

T = TypeVar("T")

NOTHING, STOPPED = 1, 130
"""Exit codes: there is no result, and stopped by Ctrl-C; 2 is argparse's for what cannot be used."""


def figures(out: Path, page: Path | None, console: Console) -> None:
    """Compute everything; write figures and figures.json into ``out``, and the page to ``page``: all or nothing."""
    from backlash_ros.studies.figures import FIGURES, draw  # noqa: PLC0415 - matplotlib takes a second

    with ExitStack() as stack:
        drawn = stack.enter_context(staging(out / "figures.json"))
        results = {drawn: out}
        if page is not None:
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


def _add_figures(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("of", nargs="?", choices=("paper", "two_encoder"), default="paper", help="by default paper")
    add("--out", type=Path, required=True, help="folder for the figures")
    add("--page", type=Path, help="also write the page that discusses the paper's")


def _figures(given: argparse.Namespace, console: Console) -> None:
    if given.of == "paper":
        figures(given.out, given.page, console)
        return
    if given.page is not None:
        raise ValueError("argument --page: is about the paper's figures")
    from backlash_ros.studies.law_pictures import draw  # noqa: PLC0415 - matplotlib takes a second

    console.print(f"{', '.join(draw(given.out))} in {given.out}", highlight=False)


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
    add(
        "--laws",
        nargs="+",
        type=_entry_of(LAWS, DESIGNED, AUTO),
        default=(),
        metavar="NAME",
        help="by default the three of the paper and the default law, which comes last and is judged",
    )
    add("--model", choices=MODELS, default=default.model, help="the drive as the controller knows it")
    add("--population", choices=POPULATIONS, help="by default full; core with --effects")
    text = "put each of these effects of real axes alone on every drive; without a NAME, each that there is"
    add("--effects", nargs="*", choices=EFFECT_NAMES, metavar="NAME", help=f"{text}: {', '.join(EFFECT_NAMES)}")
    add("--encoders", choices=list(ENCODERS), default=default.encoders)
    add("--drive", type=Path, metavar="FILE", help="draw the population around the drive of a ROS parameter file")
    add("--out", type=Path, metavar="DIR", help="folder for the table of all runs and the pictures")
    add("--scheduler", default="", metavar="ADDRESS", help="run on the workers of a Dask scheduler")
    add("--only", type=_whole(0), metavar="K", help="run only drive K and print its details")
    add("--plot", type=Path, metavar="FILE", help="with --only: draw its runs")


def _add_export(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("drive", type=Path, metavar="DRIVE", help="ROS parameter file, such as config/nominal_drive.yaml")
    add("--format", choices=list(FORMATS), required=True)
    add("--out", type=Path, metavar="FILE", help="file to write; by default the text is printed")
    add("--torque", type=float, metavar="T", help="output torque, N m, at which the limit is fitted to the teeth")
    add("--force", action="store_true", help="overwrite an existing file")


def _export(given: argparse.Namespace, _: Console) -> None:
    if given.torque is not None and given.format == "urdf":
        raise ValueError("argument --torque: a URDF has no teeth to fit, leave it out")
    _print_or_write(given, FORMATS[given.format](read_axis(given.drive), given.torque))


def _print_or_write(given: argparse.Namespace, text: str) -> None:
    """Print a text, or write it to ``--out``."""
    if given.out is None:
        print(text, end="")
    else:
        write_text(given.out, text, overwrite=given.force)


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


def _params(given: argparse.Namespace, _: Console) -> None:
    with _needing_ros():
        from backlash_ros.nodes.parameter_file import parameter_file  # noqa: PLC0415
    _print_or_write(given, parameter_file([given.node] if given.node else _NODES))


@contextmanager
def _needing_ros() -> Iterator[None]:
    """Say of an import what it needs."""
    try:
        yield
    except ImportError as error:
        raise ImportError(f"needs ROS 2: {error}") from error


def _unwritable(place: Path, *, folder: bool) -> str:
    """Return why a file, or files in a folder, cannot be written there; empty if they can."""
    if place.is_dir() and not folder:
        return os.strerror(errno.EISDIR)
    try:
        with staging(place / "file" if folder else place):
            return ""
    except OSError as error:
        return error.strerror or str(error)


def _refuse_unusable(given: argparse.Namespace) -> None:
    """Refuse places that cannot be written and drive files that cannot be used, before anything is computed.

    Raises
    ------
    OSError, ValueError
        Names the option and the place, or as `_refuse_misspelled`.
    """
    places = [(name, place) for name in given.written if (place := getattr(given, name)) is not None]
    for name, place in places:
        option = f"argument --{name.replace('_', '-')}"
        if place.exists() and not getattr(given, "force", True):
            raise ValueError(f"{option}: '{place}' exists; --force overwrites it")
    for name, place in places:
        option = f"argument --{name.replace('_', '-')}"
        if why := _unwritable(place, folder=name in given.folders):
            raise ValueError(f"{option}: must be writable, got '{place}': {why}")
    drive = getattr(given, "drive", None) or ()
    if files := [drive] if isinstance(drive, Path) else drive:
        _refuse_misspelled(*files)


def _refuse_contradictions(given: argparse.Namespace) -> None:
    """Refuse options of `backlash evaluate` that have no use together; ValueError names the option."""
    if given.only is None:
        for name in ("drives", "json"):
            if getattr(given, name) is None:
                raise ValueError(f"argument --{name}: must be given without --only")
        if given.plot is not None:
            raise ValueError("argument --plot: needs --only, since it draws one drive")
    else:
        for name in ("drives", "json", "out", "scheduler"):
            if getattr(given, name):
                raise ValueError(f"argument --{name}: has no use with --only, which prints one drive")
        if given.effects is not None and len(given.effects) != 1:
            raise ValueError(f"argument --effects: needs one name with --only, got {len(given.effects)}")
    if given.effects is not None and given.out is not None:
        raise ValueError("argument --out: has no use with --effects, which writes a report for each effect")


def _evaluate(given: argparse.Namespace, console: Console) -> None:
    _refuse_contradictions(given)
    around = Drive.read(given.drive) if given.drive else None
    if given.drive:
        read_start(given.drive)  # refused like the controller
    laws = tuple(dict.fromkeys(given.laws))
    experiments = tuple(dict.fromkeys(given.experiments))
    population = given.population or ("full" if given.effects is None else "core")
    task = Task(given.seed, population, given.model, given.encoders, experiments, laws, around)
    if given.only is not None:
        alone = task if given.effects is None else with_effect(task, *given.effects)
        replay(alone, given.only, given.plot, console)
        return
    drive, scheduler = str(given.drive or ""), given.scheduler
    try:
        if given.effects is None:
            evaluate(task, given.drives, given.json, given.out, console, scheduler=scheduler, drive=drive)
        else:
            names = list(dict.fromkeys(given.effects or EFFECT_NAMES))
            evaluate_effects(task, names, given.drives, given.json, console, scheduler=scheduler, drive=drive)
    except KeyboardInterrupt:
        given.parser.exit(STOPPED, "\nstopped: run the same command to continue\n")


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


def _measure(given: argparse.Namespace, console: Console) -> int:
    with _needing_ros():
        from backlash_ros.measure.command import Measurement, folder_of_now, measure  # noqa: PLC0415
        from backlash_ros.ros.client import ClientError  # noqa: PLC0415
    out = given.out or folder_of_now()
    request = Measurement(out, f"/{given.namespace.strip('/')}", given.experiment or "", given.rated_torque)
    try:
        return measure(request, shlex.join(["backlash", *given.words]), console)
    except (ClientError, ValueError) as error:
        print(f"{given.parser.prog}: {error}", file=sys.stderr)
        return NOTHING


_WITH_ROS = {
    "demo": (
        "backlash_ros.demo.__main__",
        "run simulator, controller and recorder: learn, step, judge",
    ),
    "live": ("backlash_ros.dashboard.live", "run a simulated drive, its controller and a page in the browser"),
}
"""Commands that are separate programs: module and help."""


def _run_with_ros(given: argparse.Namespace, _: Console) -> int:
    with _needing_ros():
        module = import_module(_WITH_ROS[given.words[0]][0])
    code: int = module.main(given.words[1:])
    return code


def parser_of(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of all commands; ``words`` is the command line, which results repeat."""
    ends = "exit codes: 0 done, 1 no result, 2 the input cannot be used, 130 stopped by Ctrl-C"
    parser = Parser(prog="backlash", description=__doc__, epilog=ends)
    parser.add_argument("--version", action="version", version=f"backlash_ros {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def add(
        name: str,
        text: str,
        run: Callable[[argparse.Namespace, Console], int | None],
        arguments: Callable[[argparse.ArgumentParser], None] = lambda _: None,
        *,
        written: Sequence[str] = (),
        folders: Sequence[str] = (),
        epilog: str | None = None,
    ) -> None:
        """Add a command; ``written`` are the options of places to write, ``folders`` those that are folders."""
        command = commands.add_parser(name, help=text, epilog=epilog)
        arguments(command)
        command.set_defaults(run=run, parser=command, words=words, written=(*written, *folders), folders=folders)

    for name, (_, text) in _WITH_ROS.items():
        add(name, text, _run_with_ros)
    text = "compute and draw the paper's figures, or those that explain law two_encoder"
    example = "examples: backlash figures --out results/figures; backlash figures two_encoder --out results/figures"
    add("figures", text, _figures, _add_figures, written=["page"], folders=["out"], epilog=example)
    text = "simulate one step: figures as JSON, a picture, a table"
    add("simulate", text, simulating.simulate, simulating.add_simulate, written=simulating.WRITTEN)
    text = "judge learning and laws on a random population of drives"
    example = "example: backlash evaluate --seed 1 --drives 20 --json results/evaluation.json"
    add("evaluate", text, _evaluate, _add_evaluation, written=["json", "plot"], folders=["out"], epilog=example)
    text = "export a drive for MuJoCo, or as URDF or SDF"
    example = "example: backlash export config/nominal_drive.yaml --format mujoco --out drive.xml"
    add("export", text, _export, _add_export, written=["out"], epilog=example)
    text = "write a commented file of all parameters, to start from"
    add("params", text, _params, _add_params, written=["out"], epilog="example: backlash params --out my_drive.yaml")
    text = "identify a drive from a recording, with uncertainties"
    add("identify", text, identify, add_identification, written=IDENTIFICATION)
    text = "measure the lost motion of a locked output from ramps of its torque"
    add("lost-motion", text, locked.measure, locked.add_lost_motion, written=locked.WRITTEN)
    text = "write a page about a recording: steps, faults, backlash, timing, charts"
    add("report", text, write_report, add_report, written=REPORT)
    text = "design over-damped gains and their region's width for a range of drives"
    add("design", text, designer.design_gains_for, designer.add_design, written=designer.WRITTEN)
    add("check", "check a drive file and its loop before anything moves", check_and_show, add_check)
    text = "compute a recorded controller's commands again, to the last bit"
    add("replay", text, replaying.replay_bag, replaying.add_replay, written=replaying.WRITTEN)
    text = "let a running controller measure its drive: recording, drive file and certificate"
    example = "example: backlash measure --out my_axis --experiment gap_probe"
    add("measure", text, _measure, _add_measurement, epilog=example)
    return parser


def _in_words(error: Exception) -> str:
    """Return what is wrong in one line: of a file, its name and the system's reason."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def main(args: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code, which means the same for each.

    0: done; 1: there is no result, and why was printed; 2: options, files or what is installed cannot be used, in one
    line; 130: stopped by Ctrl-C.
    """
    words = tuple(sys.argv[1:] if args is None else args)
    ros = bool(words) and words[0] in _WITH_ROS  # these have parsers of their own
    given = parser_of(words).parse_args(words[:1] if ros else words)
    parser: argparse.ArgumentParser = given.parser
    try:
        _refuse_unusable(given)
        return given.run(given, Console()) or 0
    except KeyboardInterrupt:
        parser.exit(STOPPED, "\nstopped\n")
    except CannotStartError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return NOTHING
    except IntegrationError as error:
        print(f"{parser.prog}: cannot be simulated: {error}", file=sys.stderr)
        return NOTHING
    except (OSError, ValueError, ImportError, CannotRunError, NoLibraryError) as error:
        parser.error(_in_words(error))


if __name__ == "__main__":
    raise SystemExit(main())
