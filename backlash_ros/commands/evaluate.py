"""`backlash evaluate`: judges learning and laws on a random population of drives."""

import argparse
from pathlib import Path

from rich.console import Console

from backlash_ros.commands.argument_types import entry_of, whole
from backlash_ros.commands.command import DONE, STOPPED, Command
from backlash_ros.commands.evaluation import evaluate, replay
from backlash_ros.commands.evaluation_effects import EFFECT_NAMES, evaluate_effects, with_effect
from backlash_ros.commands.evaluation_motion import evaluate_motions
from backlash_ros.control import AUTO, EXPERIMENTS, LAWS
from backlash_ros.drive_file.drive_file import read_start
from backlash_ros.drivetrain import Drive
from backlash_ros.studies.evaluation.population import ENCODERS, MODELS, POPULATIONS
from backlash_ros.studies.evaluation.task import DESIGNED, Task

SUITES = "steps", "motion"
"""What the drives do."""
_EXAMPLE = "example: backlash evaluate --seed 1 --drives 20 --json results/evaluation.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.epilog = _EXAMPLE
    add, default = parser.add_argument, Task(0)
    add("--seed", type=whole(0), required=True, metavar="S", help="seed of the population")
    add("--drives", type=whole(1), metavar="N", help="number of drives to judge, from the first on")
    add("--json", type=Path, metavar="FILE", help="file for the summary")
    text = "by default auto, what ~/learn runs; with --model identified identify, what ~/identify runs"
    add("--experiments", nargs="+", type=entry_of(EXPERIMENTS, AUTO), default=(), metavar="NAME", help=text)
    text = "by default the three of the paper and the default law, which comes last and is judged"
    add("--laws", nargs="+", type=entry_of(LAWS, DESIGNED, AUTO), default=(), metavar="NAME", help=text)
    add("--model", choices=MODELS, default=default.model, help="the drive as the controller knows it")
    add("--population", choices=POPULATIONS, help="by default full; core with --effects")
    text = "put each of these effects of real axes alone on every drive; without a NAME, each that there is"
    add("--effects", nargs="*", choices=EFFECT_NAMES, metavar="NAME", help=f"{text}: {', '.join(EFFECT_NAMES)}")
    text = "steps: 1 rad, five gaps, and a hold; motion: paths, beside laws as drives have them"
    add("--suite", choices=SUITES, default=SUITES[0], help=text)
    add("--encoders", choices=list(ENCODERS), default=default.encoders)
    add("--drive", type=Path, metavar="FILE", help="draw the population around the drive of a ROS parameter file")
    add("--out", type=Path, metavar="DIR", help="folder for the table of all runs and the pictures")
    add("--scheduler", default="", metavar="ADDRESS", help="run on the workers of a Dask scheduler")
    add("--only", type=whole(0), metavar="K", help="run only drive K and print its details")
    add("--plot", type=Path, metavar="FILE", help="with --only: draw its runs")


def _refuse_contradictions(given: argparse.Namespace) -> None:
    """Refuse options that have no use together; ValueError names the option."""
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
    if given.suite == "motion":
        for name in ("only", "effects", "out"):
            if getattr(given, name) is not None:
                raise ValueError(f"argument --{name}: has no use with --suite motion")
    if given.effects is not None and given.out is not None:
        raise ValueError("argument --out: has no use with --effects, which writes a report for each effect")


def task_of(given: argparse.Namespace) -> Task:
    """Return what is evaluated, without an effect; OSError or ValueError if the drive file cannot be used."""
    around = Drive.read(given.drive) if given.drive else None
    if given.drive:
        read_start(given.drive)  # refused like the controller
    laws = tuple(dict.fromkeys(given.laws))
    experiments = tuple(dict.fromkeys(given.experiments))
    population = given.population or ("full" if given.effects is None else "core")
    return Task(given.seed, population, given.model, given.encoders, experiments, laws, around)


def run(given: argparse.Namespace, console: Console) -> int:
    """Evaluate and write, or run one drive again.

    Raises
    ------
    OSError, ValueError, ImportError
        For contradicting options, as `task_of`, and as `evaluate`.
    """
    _refuse_contradictions(given)
    task = task_of(given)
    if given.only is not None:
        alone = task if given.effects is None else with_effect(task, *given.effects)
        replay(alone, given.only, given.plot, console)
        return DONE
    drive, scheduler = str(given.drive or ""), given.scheduler
    try:
        if given.suite == "motion":
            evaluate_motions(task, given.drives, given.json, console, scheduler=scheduler, drive=drive)
        elif given.effects is None:
            evaluate(task, given.drives, given.json, given.out, console, scheduler=scheduler, drive=drive)
        else:
            names = list(dict.fromkeys(given.effects or EFFECT_NAMES))
            evaluate_effects(task, names, given.drives, given.json, console, scheduler=scheduler, drive=drive)
    except KeyboardInterrupt:
        given.parser.exit(STOPPED, "\nstopped: run the same command to continue\n")
    return DONE


COMMAND = Command(run, add_arguments, written=("json", "plot"), folders=("out",))
