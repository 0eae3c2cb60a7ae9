"""Servo control of geared drives with backlash: try it, measure a drive, choose gains, evaluate, report."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from rich.console import Console

from backlash_ros import __version__
from backlash_ros.commands.command import NOTHING, STOPPED, Command
from backlash_ros.commands.places import refuse_unusable
from backlash_ros.foundation.parser import Parser

COMMANDS = {
    "demo": "run simulator, controller and recorder: learn, step, judge",
    "live": "run a simulated drive, its controller and a page in the browser",
    "figures": "compute and draw the paper's figures, or those that explain the law of planned moves",
    "simulate": "simulate one step, or a path: figures as JSON, a picture, a table",
    "evaluate": "judge learning and laws on a random population of drives",
    "export": "export a drive for MuJoCo, or as URDF or SDF",
    "export-c": "write a controller as C: object file, header, self-test, example",
    "params": "write a commented file of all parameters, to start from",
    "identify": "identify a drive from a recording, with uncertainties",
    "lost-motion": "measure the lost motion of a locked output from ramps of its torque",
    "report": "write a page about a recording: steps, faults, backlash, timing, charts",
    "design": "design over-damped gains and their region's width for a range of drives",
    "setup": "ask in the terminal what a drive is, and write and check its file",
    "check": "check a drive file and its loop before anything moves",
    "replay": "compute a recorded controller's commands again, to the last bit",
    "measure": "let a running controller measure its drive: recording, drive file and certificate",
}
"""Name and help of each command. Its module, which takes seconds to import, is imported when it is called."""


def command_of(name: str) -> Command:
    """Return a command from its module."""
    command: Command = import_module(f"backlash_ros.commands.{name.replace('-', '_')}").COMMAND
    return command


def parser_of(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of a command line, ``words``: it knows all commands, but only the called one's arguments."""
    ends = "exit codes: 0 done, 1 no result, 2 the input cannot be used, 130 stopped by Ctrl-C"
    parser = Parser(prog="backlash", description=__doc__, epilog=ends)
    parser.add_argument("--version", action="version", version=f"backlash_ros {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    called = next((word for word in words if not word.startswith("-")), "")
    for name, text in COMMANDS.items():
        own = commands.add_parser(name, help=text)
        if name == called:
            command = command_of(name)
            command.add_arguments(own)
            own.set_defaults(command=command, parser=own, words=tuple(words))
    return parser


def _in_words(error: Exception) -> str:
    """Return what is wrong in one line: of a file, its name and the system's reason."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def _failed(parser: argparse.ArgumentParser, error: Exception) -> int:
    """Say what went wrong in one line and return the exit code, or exit with 2; an unforeseen error is raised again."""
    from backlash_ros.control.design.start import CannotStartError  # noqa: PLC0415 - these take seconds
    from backlash_ros.drivetrain.motion.integrator import IntegrationError  # noqa: PLC0415
    from backlash_ros.simulation.batch import CannotRunError  # noqa: PLC0415

    if isinstance(error, CannotStartError):
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return NOTHING
    if isinstance(error, IntegrationError):
        print(f"{parser.prog}: cannot be simulated: {error}", file=sys.stderr)
        return NOTHING
    if isinstance(error, (OSError, ValueError, ImportError, CannotRunError)):
        parser.error(_in_words(error))
    raise error


def main(args: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code, which means the same for each.

    0: done; 1: there is no result, and why was printed; 2: options, files or what is installed cannot be used, in one
    line; 130: stopped by Ctrl-C.
    """
    words = tuple(sys.argv[1:] if args is None else args)
    by_itself = words and words[0] in COMMANDS and command_of(words[0]).own_parser
    given = parser_of(words).parse_args(words[:1] if by_itself else words)
    parser: argparse.ArgumentParser = given.parser
    command: Command = given.command
    try:
        refuse_unusable(command, given)
        return command.run(given, Console())
    except KeyboardInterrupt:
        parser.exit(STOPPED, "\nstopped\n")
    except Exception as error:
        return _failed(parser, error)


if __name__ == "__main__":
    raise SystemExit(main())
