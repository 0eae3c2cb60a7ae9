"""Places that commands write to and drive files that they read: refused before anything is computed."""

import argparse
import errno
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from backlash_ros.commands.command import Command, with_ros
from backlash_ros.foundation.staging import staging


def refuse_unusable(command: Command, given: argparse.Namespace) -> None:
    """Refuse places that cannot be written and drive files that cannot be used.

    Raises
    ------
    OSError, ValueError
        Names the option and the place, or as `_refuse_misspelled`.
    """
    places = list(_places(command, given))
    for option, place, _ in places:
        if place.exists() and not getattr(given, "force", True):
            raise ValueError(f"{option}: '{place}' exists; --force overwrites it")
    for option, place, folder in places:
        if why := _unwritable(place, folder=folder):
            raise ValueError(f"{option}: must be writable, got '{place}': {why}")
    drive = getattr(given, "drive", None) or ()
    if files := [drive] if isinstance(drive, Path) else drive:
        _refuse_misspelled(*files)


def _places(command: Command, given: argparse.Namespace) -> Iterator[tuple[str, Path, bool]]:
    """Yield the options with places to write: what messages call them, the place, and whether it is a folder."""
    for name in (*command.written, *command.folders):
        place = getattr(given, name)
        if place is not None:
            yield f"argument --{name.replace('_', '-')}", place, name in command.folders


def _unwritable(place: Path, *, folder: bool) -> str:
    """Return why a file, or files in a folder, cannot be written there; empty if they can."""
    if place.is_dir() and not folder:
        return os.strerror(errno.EISDIR)
    try:
        with staging(place / "file" if folder else place):
            return ""
    except OSError as error:
        return error.strerror or str(error)


def _refuse_misspelled(*files: Path) -> None:
    """Refuse drive files with misspelled parameters, if there is ROS: only the nodes know all names.

    Raises
    ------
    OSError, ValueError
        As `read_parameters`; or names the file, the parameter and the one that was probably meant.
    """
    from backlash_ros.drive_file.drive_file import read_parameters  # noqa: PLC0415 - takes seconds
    from backlash_ros.foundation.reading.parameter_files import named  # noqa: PLC0415

    parameters = read_parameters(*files)
    with suppress(ImportError):
        nodes = with_ros("backlash_ros.nodes.fixed_parameters")
        try:
            nodes.refuse_misspelled(parameters)
        except ValueError as error:
            raise ValueError(f"{named(files)}: {error}") from error
