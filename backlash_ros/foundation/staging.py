"""Results that appear complete or not at all: made in a folder beside their place, put there when they are done."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp


def _made(target: Path, parents: list[Path]) -> Path:
    """Make a folder beside ``target``, and what leads to it, which is added to ``parents``."""
    for parent in reversed(target.parents):
        if not parent.is_dir():
            parent.mkdir()
            parents.append(parent)
    with suppress(FileNotFoundError):
        target.lstat()  # a name that cannot be is told here
    return Path(mkdtemp(prefix=".backlash.", dir=target.parent))


@contextmanager
def staging(target: Path) -> Iterator[Path]:
    """Yield a new folder beside ``target`` for what shall be put there; in the end it is gone with what is in it.

    Folders that lead to ``target`` are made, and removed again where nothing was put into them.

    Raises
    ------
    OSError
        At once, if nothing can be put there: no permission, a name that is too long, a file on the way. It names
        ``target``.
    """
    parents: list[Path] = []
    try:
        try:
            folder = _made(Path(os.path.abspath(target)), parents)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(target)) from error
        try:
            yield folder
        finally:
            rmtree(folder, ignore_errors=True)
    finally:
        with suppress(OSError):  # the first that is not empty is needed, and those above it too
            for parent in reversed(parents):
                parent.rmdir()


def write_text(target: Path, text: str, *, overwrite: bool) -> None:
    """Write a whole file, or nothing.

    Raises
    ------
    FileExistsError
        If there is a file and it shall not be overwritten.
    OSError
        As `staging`, or if the disk is full.
    """
    if not overwrite and os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    with staging(target) as folder:
        made = folder / "text"
        made.write_text(text, encoding="utf-8")
        made.replace(target)
