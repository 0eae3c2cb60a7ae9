"""Options of the drive contract kit, known to pytest only in a run of the kit.

pytest reads the options of a conftest.py only if a path leads to it, not with --pyargs. This plugin is therefore an
entry point of the package (``-p backlash_ros.contract.plugin`` does the same in a source tree), and does not affect any
other run of pytest in the workspace.
"""

import argparse
import math
import os
import shlex
import shutil
from collections.abc import Iterable
from typing import Any

import pytest

KIT = "backlash_ros.contract"


def _named(words: Iterable[object]) -> bool:
    return any(KIT in str(word).replace(os.sep, ".") for word in words)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a finite number > 0, got {text!r}")
    return value


def pytest_load_initial_conftests(parser: pytest.Parser, args: list[str]) -> None:
    """Add the options, as an initial conftest.py of the kit would."""
    if not _named(args):
        return
    group = parser.getgroup("drive contract")

    def add(name: str, default: Any, text: str) -> None:
        kind = _positive if isinstance(default, float) else str
        group.addoption(name, type=kind, default=default, help=f"{text} (default {default!r})")

    group.addoption("--drive-command", help="command line that starts the drive; required")
    add("--drive-rate", 250.0, "rate of joint_states, Hz")
    group.addoption(
        "--command-interface",
        choices=("voltage", "current"),
        default="voltage",
        help="what a command sets (default %(default)r)",
    )
    group.addoption(
        "--drive-value",
        type=_positive,
        help="command of the test moves; once doubled (default 1.0 V, or 0.05 A)",
    )
    add("--motor-joint", "motor", "name of the motor's joint; '' if the drive has none")
    add("--load-joint", "load", "name of the load's joint; '' if the drive has none")
    add("--gear-ratio", 0.1, "load angle divided by motor angle")
    add("--torque-constant", 0.05, "torque constant of the motor, N m/A")
    add("--resistance", 2.0, "resistance of the motor's winding, ohm")
    add("--inertia", 2.5e-5, "inertia of the motor and its load, at the motor's shaft, kg m^2; used with a current")
    add("--command-timeout", 0.1, "time without a command after which the motor gets 0 V or 0 A, s")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Refuse to run the kit without a drive."""
    if not _named(session.config.args):
        return
    command = shlex.split(session.config.getoption("--drive-command") or "")
    if not command:
        raise pytest.UsageError('the drive contract kit needs --drive-command "ros2 run my_package my_drive"')
    if shutil.which(command[0]) is None:
        raise pytest.UsageError(f"--drive-command: no such program: {command[0]!r}")
    if not (session.config.getoption("--motor-joint") or session.config.getoption("--load-joint")):
        raise pytest.UsageError("--motor-joint and --load-joint must not both be ''")
