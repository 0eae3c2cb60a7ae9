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
from pathlib import Path
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
    group.addoption(
        "--params-file",
        action="append",
        default=[],
        metavar="FILE",
        help="parameters of the drive, as the controller takes them (default: the nominal drive)",
    )
    group.addoption("--drive-rate", type=_positive, help="rate of joint_states, Hz (default: rate of the file)")
    group.addoption(
        "--command-interface",
        choices=("voltage", "current"),
        help="what a command sets (default: command_interface of the file)",
    )
    group.addoption(
        "--drive-value",
        type=_positive,
        help="command of the test moves; once doubled (default 1.0 V, or 0.05 A)",
    )
    group.addoption("--motor-joint", help="name of the motor's joint; '' if the drive has none (default: of the file)")
    group.addoption("--load-joint", help="name of the load's joint; '' if the drive has none (default: of the file)")
    group.addoption(
        "--whole-turn",
        action="store_true",
        help="move each joint by more than a turn, to see whether its position goes on: the load must be free to turn",
    )
    add("--command-timeout", 0.1, "time without a command after which the motor gets 0 V or 0 A, s")


def expected_of(config: pytest.Config) -> Any:
    """Return the description of the drive, `backlash_ros.contract.bench.Expected`, from the options.

    Raises
    ------
    OSError, ValueError
        If a parameter file cannot be read or used.
    """
    # Imported only in a run of the kit.
    from backlash_ros.contract.bench import described  # noqa: PLC0415

    def option(name: str) -> Any:
        return config.getoption(name)

    return described(
        [Path(file) for file in option("--params-file")],
        option("--drive-command"),
        value=option("--drive-value"),
        command_timeout=option("--command-timeout"),
        interface=option("--command-interface"),
        rate=option("--drive-rate"),
        motor_joint=option("--motor-joint"),
        load_joint=option("--load-joint"),
    )


def pytest_sessionstart(session: pytest.Session) -> None:
    """Refuse to run the kit without a drive."""
    if not _named(session.config.args):
        return
    command = shlex.split(session.config.getoption("--drive-command") or "")
    if not command:
        raise pytest.UsageError('the drive contract kit needs --drive-command "ros2 run my_package my_drive"')
    if shutil.which(command[0]) is None:
        raise pytest.UsageError(f"--drive-command: no such program: {command[0]!r}")
    try:
        expected = expected_of(session.config)
    except (OSError, ValueError) as error:
        raise pytest.UsageError(f"--params-file: {error}") from error
    if not expected.joints:
        raise pytest.UsageError("--motor-joint and --load-joint must not both be ''")
