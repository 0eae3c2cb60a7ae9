"""A command of `backlash`, as its module offers it to the command line, and how it reaches what needs ROS."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rich.console import Console

DONE, NOTHING, STOPPED = 0, 1, 130
"""Exit codes: done, there is no result, and stopped by Ctrl-C; 2 is argparse's for what cannot be used."""


@dataclass(frozen=True)
class Command:
    """The arguments of a command, and what it does.

    Parameters
    ----------
    run : does the work and returns the exit code. The arguments also have ``words``, the command line, which results
        repeat, and ``parser``, that of the command
    add_arguments : adds them to the parser of the command, with description and example
    written : options of files to write; they are refused before any work if they cannot be written
    folders : options of folders to write to
    own_parser : it is a program that reads all words after its name itself
    """

    run: Callable[[argparse.Namespace, Console], int]
    add_arguments: Callable[[argparse.ArgumentParser], None] = lambda _: None
    written: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    own_parser: bool = False


def with_ros(module: str) -> Any:
    """Import a module of the rooms that know ROS, which lie above this one; ImportError says what is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(f"needs ROS 2: {error}") from error


def program(module: str) -> Command:
    """Return the command that runs a program with a ``main`` of its own, which needs ROS."""

    def run(given: argparse.Namespace, _: Console) -> int:
        code: int = with_ros(module).main(given.words[1:])
        return code

    return Command(run, own_parser=True)
