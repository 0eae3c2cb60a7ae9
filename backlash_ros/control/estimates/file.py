"""The estimate file on the disk: read and checked at the start, always replaced as a whole."""

import os
import stat
from contextlib import suppress
from pathlib import Path

from backlash_ros.control.estimates.record import DriveIdentity, History, parse, render

_LARGEST = 1_000_000
"""Bytes; a hundred estimates take 20 kB."""


class EstimateFile:
    """The file of one drive; a missing file is created without estimates, so that it belongs to this drive.

    ``history``: its content when it was opened. `write` may be called from another thread.

    Parameters
    ----------
    path : "~" is the home folder; relative paths start at the working folder; links are followed

    Raises
    ------
    ValueError
        If it cannot be read or written, or belongs to another drive; the file is left unchanged.
    """

    def __init__(self, path: str, drive: DriveIdentity) -> None:
        self.path = Path(os.path.realpath(os.path.expanduser(path)))
        try:
            if not self.path.parent.is_dir():
                raise ValueError(f"there is no folder {self.path.parent}")
            content = self._read()
            if content is None:
                self.history = History(drive)
                self._replace(render(self.history).encode())
            else:
                self._content = content
                self.history = parse(content, drive)
                self._try_to_write()
        except OSError as error:
            raise ValueError(f"learning.estimate_file {self.path}: it cannot be used: {error.strerror}") from error
        except ValueError as error:
            raise ValueError(f"learning.estimate_file {self.path}: {error}") from error

    def _read(self) -> bytes | None:
        """Return the content; None if there is no file. Never waits for the other end of a pipe."""
        try:
            descriptor = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            return None
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise ValueError("it is not a regular file")
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                content = file.read(_LARGEST + 1)
        finally:
            os.close(descriptor)
        if len(content) > _LARGEST:
            raise ValueError(f"it is larger than {_LARGEST} bytes, so it is not an estimate file")
        return content

    @property
    def _beside(self) -> Path:
        return self.path.with_name(f".{self.path.name}.{os.getpid()}.new")

    def _open_beside(self) -> int:
        return os.open(self._beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)

    def _try_to_write(self) -> None:
        """Raise OSError if an existing file could not be replaced."""
        os.close(os.open(self.path, os.O_WRONLY | os.O_CLOEXEC))
        os.close(self._open_beside())
        self._beside.unlink()

    def write(self, history: History) -> None:
        """Replace the file; returns when it is on the disk.

        Raises
        ------
        OSError
            If that fails; the old file stays.
        ValueError
            If another program has changed it since it was last read or written here; it is left unchanged.
        """
        content = self._read()
        if content is not None and content != self._content:
            raise ValueError("another program has changed it since it was read; it was left unchanged")
        self._replace(render(history).encode())

    def _replace(self, content: bytes) -> None:
        try:
            with os.fdopen(self._open_beside(), "wb") as file:
                with suppress(FileNotFoundError):
                    os.fchmod(file.fileno(), stat.S_IMODE(self.path.stat().st_mode))
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(self._beside, self.path)
        except BaseException:
            with suppress(OSError):
                self._beside.unlink()
            raise
        self._content = content
        with suppress(OSError):  # some file systems do not support it
            folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
