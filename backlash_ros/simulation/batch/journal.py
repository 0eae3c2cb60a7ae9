"""The journal of a batch: one line per run in a file that only grows, so that a kill loses nothing written.

A truncated line is dropped when the file is opened again. The lines are in the order in which runs ended; they are read
in the order of the runs' numbers.
"""

import fcntl
import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple


class Entry(NamedTuple):
    """How a run ended: with a JSON value, or with a failure in words."""

    number: int
    value: Any = None
    failure: str = ""


class Journal:
    """The journal of one batch, to be used in a ``with`` statement; an empty one leaves no file.

    Raises
    ------
    OSError
        If the file cannot be written, or another process writes to it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._file)
            raise OSError(error.errno, "another process runs this batch", str(path)) from error
        self._places: dict[int, int] = {}
        self._end = 0
        with path.open("rb") as lines:
            for line in lines:
                number = _number(line)
                if number is None:
                    break
                self._places.setdefault(number, self._end)
                self._end += len(line)
        os.ftruncate(self._file, self._end)

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if not self._places:
            self.remove()
        os.close(self._file)

    def __contains__(self, number: int) -> bool:
        return number in self._places

    def __len__(self) -> int:
        return len(self._places)

    def add(self, entry: Entry) -> None:
        """Record how a run ended; earlier lines stay."""
        if entry.number in self._places:
            return
        line = json.dumps(entry._asdict()).encode() + b"\n"
        written = os.write(self._file, line)
        if written < len(line):  # a full disk takes a part
            os.ftruncate(self._file, self._end)
            raise OSError(28, "no space left", str(self.path))
        self._places[entry.number] = self._end
        self._end += len(line)

    def remove(self) -> None:
        """Remove the file, once its content has been saved elsewhere."""
        self.path.unlink(missing_ok=True)

    def entries(self) -> Iterator[Entry]:
        """Yield the runs that have ended, by number, one at a time in memory."""
        with self.path.open("rb") as lines:
            for number in sorted(self._places):
                lines.seek(self._places[number])
                yield Entry(**json.loads(lines.readline()))


def _number(line: bytes) -> int | None:
    """Return the number of the run in a line; None for a truncated line."""
    try:
        return int(json.loads(line)["number"]) if line.endswith(b"\n") else None
    except (ValueError, KeyError, TypeError):
        return None
