"""Reads a table of samples: text with a header and one sample per row, as loggers and spreadsheets write it."""

import csv
import gzip
import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from backlash_ros.recordings.samples import Columns

NOTHING = {"", "nan", "none", "null", "na", "n/a"}
"""Texts for a missing number, in upper or lower case."""
_OTHERS = {
    b"\x89MCAP0\r\n": "",
    b"SQLite format 3\0": "",
    b"PK": "is a spreadsheet or an archive: save it as CSV, or unpack it",
    b"\x28\xb5\x2f\xfd": "is compressed: unpack it with zstd -d",
    b"BZh": "is compressed: unpack it with bunzip2",
    b"\xfd7zXZ\0": "is compressed: unpack it with unxz",
}
"""How files begin that are no tables, and what to do with them; with nothing to do they are bags."""
_GZIP = b"\x1f\x8b"
_BAGS = {".mcap", ".db3"}
_SEPARATORS = ",;\t"
_HEAD = 1000
"""Number of lines within which the header must be."""
_DATE = re.compile(
    r"(?:(\d{4}-\d\d-\d\d)[T ])?(\d\d:\d\d)(?::(\d\d(?:[.,]\d+)?))? ?(?:Z|UTC|([+-])(\d\d):?(\d\d)?)?", re.ASCII
)
_DECIMAL_COMMA = re.compile(r"[-+]?(\d+,\d*|,\d+)([eE][-+]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class ColumnNames:
    """Names of the columns to read; ``kinds`` name them in options, ``optional`` are those a table need not have.

    ``remedy``: what to do where a column is missing; by default, to name another with an option.
    """

    time: str = "time"
    motor: str = "motor"
    load: str = "load"
    command: str = "command"
    kinds: tuple[str, str, str, str] = ("time", "motor", "load", "command")
    optional: frozenset[str] = frozenset()
    remedy: str = "--{kind}-column names another"

    def all(self) -> tuple[str, str, str, str]:
        """Return them in their order."""
        return self.time, self.motor, self.load, self.command

    def required(self) -> dict[str, str]:
        """Return the names that a table must have, by kind."""
        return {kind: name for kind, name in zip(self.kinds, self.all(), strict=True) if kind not in self.optional}


def is_table(path: Path) -> bool:
    """Return whether a recording is a table rather than a bag, by what is in it; OSError if it cannot be read.

    Raises
    ------
    ValueError
        If it is neither, with a remedy.
    """
    if path.is_dir() or path.suffix.lower() in _BAGS:
        return False
    with path.open("rb") as file:
        begins = file.read(max(map(len, _OTHERS)))
    for begin, why in _OTHERS.items():
        if begins.startswith(begin) and why:
            raise ValueError(f"{path}: {why}")
        if begins.startswith(begin):
            return False
    if path.name == "metadata.yaml":
        raise ValueError(f"{path}: is the list of a bag's files: name its folder, {path.parent}")
    return True


def _lines(path: Path) -> list[str]:
    """Return the lines of a text, packed with gzip or not."""
    content = path.read_bytes()
    if content.startswith(_GZIP):
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error):
            raise ValueError(f"{path}: is packed with gzip and damaged: no part of it is read") from None
        if content.startswith(tuple(_OTHERS)):
            raise ValueError(f"{path}: is no packed table: unpack it with gunzip")
    wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(
            f"{path}, row {line}: must be text in UTF-8, byte {error.start} is not: save it as 'CSV UTF-8', or convert "
            f"it with iconv -f CP1252 -t UTF-8"
        ) from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise ValueError(f"{path}, row {line}: must be text, and has a byte 0: it is neither a table nor a rosbag2")
    return text.splitlines()


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line; a quote may follow a space."""
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:  # one cell of more than 131072 characters
        return [line]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text.lower() in NOTHING or _DECIMAL_COMMA.fullmatch(text) is not None
    return True


def _clock(text: str) -> tuple[float, float] | None:
    """Return a time of day, with or without its date (ISO 8601), as the minute and the seconds in it, s; else None.

    The minute counts from 1970 in UTC, unless the time says otherwise; without a date from midnight.
    """
    if not (found := _DATE.fullmatch(text)):
        return None
    day, minute, seconds, sign, hours, minutes = found.groups()
    try:
        moment = datetime.fromisoformat(f"{day or '1970-01-01'} {minute}").replace(tzinfo=timezone.utc)
    except ValueError:
        return None
    offset = 3600.0 * int(hours or 0) + 60.0 * int(minutes or 0)
    return moment.timestamp() + (offset if sign == "-" else -offset), float((seconds or "0").replace(",", "."))


def _head(lines: Sequence[str], names: ColumnNames, path: Path) -> tuple[int, str, list[str]]:
    """Return the index of the header, which has all columns and may be a comment, the separator, and all names."""
    required = names.required()
    for k, line in enumerate(lines[:_HEAD]):
        for separator in _SEPARATORS:
            header = _cells(line.lstrip("# "), separator)
            if all(header.count(name) == 1 for name in required.values()):
                return k, separator, header
    used = [(k, line) for k, line in enumerate(lines[:_HEAD]) if line.strip() and not line.lstrip().startswith("#")]
    if not used:
        raise ValueError(f"{path}: there is nothing in it")
    split = [(k, _cells(line, max(_SEPARATORS, key=line.count))) for k, line in used]
    at, header = max(split, key=lambda each: (len(set(each[1]) & set(required.values())), len(each[1]), -each[0]))
    if all(map(_is_number, header)):
        raise ValueError(
            f"{path}, row {at + 1}: must be a header with the names of the columns above it, got {header}: add one"
        )
    kind, name = next((kind, name) for kind, name in required.items() if header.count(name) != 1)
    raise ValueError(_not_one(f"{path}, row {at + 1}", kind, name, header, names))


def _not_one(where: str, kind: str, name: str, header: Sequence[str], names: ColumnNames) -> str:
    return (
        f"{where}: must have one column '{name}', has {header.count(name)}; columns: {header}: "
        f"{names.remedy.format(kind=kind)}; a comma, a semicolon or a tab separates them"
    )


class _Reader:
    """Reads cells, and keeps in which row a number first had a decimal comma, and a decimal point."""

    def __init__(self, path: Path, names: Sequence[str], separator: str) -> None:
        self._path, self._names, self._separator = path, names, separator
        self._marks: dict[str, int] = {}

    def number(self, text: str, row: int, column: int) -> float:
        """Return the number in a cell, nan for none."""
        comma = self._separator != "," and _DECIMAL_COMMA.fullmatch(text) is not None
        try:
            value = math.nan if text.lower() in NOTHING else float(text.replace(",", ".") if comma else text)
        except ValueError:
            digits = {",", "."} & set(text) and text.lstrip("+-")[:1].isdigit()
            remedy = ": write it without separators of thousands" if digits else ""
            raise ValueError(
                f"{self._path}, row {row}: column '{self._names[column]}' must be a number, got {text[:40]!r}{remedy}"
            ) from None
        for mark in ",", ".":
            if mark in text and len(self._marks) < 2:
                self._marks.setdefault(mark, row)
        if len(self._marks) > 1:
            raise ValueError(
                f"{self._path}: numbers have a decimal comma in row {self._marks[',']} and a decimal point in row "
                f"{self._marks['.']}: write all with one of them, and without separators of thousands"
            )
        return value if math.isfinite(value) else math.nan

    def time(self, text: str, row: int) -> tuple[float, float]:
        """Return the time of day in a cell, see `_clock`."""
        if (found := _clock(text)) is None:
            raise ValueError(
                f"{self._path}, row {row}: column '{self._names[0]}' must be a time as in the rows before, such as "
                f"2026-01-31T23:59:59.004, got {text[:40]!r}"
            )
        return found

    @property
    def has_commas(self) -> bool:
        """Whether there were decimal commas."""
        return "," in self._marks


def read_csv(path: Path, names: ColumnNames) -> Columns:
    """Return four columns of a table; one that it need not have, and has not, is nan.

    A comma, a semicolon or a tab separates; with the last two, numbers may have a decimal comma. ``#`` begins a
    comment; lines before the header and a row of units below it are passed over. Times may be numbers or ISO 8601.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        Names file, row, column and value that cannot be used, and a remedy.
    """
    lines, notes = _lines(path), []
    head, separator, header = _head(lines, names, path)
    if above := sum(1 for line in lines[:head] if line.strip() and not line.lstrip().startswith("#")):
        were = "line before the header, in row {}, was" if above == 1 else "lines before the header, in row {}, were"
        notes.append(f"{above} {were.format(head + 1)} passed over")
    for kind, name in zip(names.kinds, names.all(), strict=True):
        if header.count(name) > 1:
            raise ValueError(_not_one(f"{path}, row {head + 1}", kind, name, header, names))
    places = [header.index(name) if header.count(name) == 1 else -1 for name in names.all()]
    used = [(k, line) for k, line in enumerate(lines[head + 1 :], head + 2) if line.strip() and line.lstrip()[0] != "#"]
    rows = []
    for k, line in used:
        row = _cells(line, separator)
        if len(row) < len(header) or any(row[len(header) :]):
            remedy = "decimal commas need semicolons or tabs between the cells" if separator == "," else "mend the row"
            raise ValueError(
                f"{path}, row {k}: must have {len(header)} cells as the header, has {len(row)}: {remedy}, or begin it "
                "with # if it is no sample"
            )
        rows.append([row[place] if place >= 0 else "" for place in places])
    filled = [cell for cell, place in zip(rows[0], places, strict=True) if place >= 0] if rows else []
    if rows and not any(_is_number(cell) or _clock(cell) for cell in filled):
        notes.append(f"row {used[0][0]}, which has no number, was taken for units")
        rows, used = rows[1:], used[1:]
    numbers = [k for k, _ in used]
    reader, content = _Reader(path, names.all(), separator), np.empty((len(rows), 4))
    dated, epoch = bool(rows) and _clock(rows[0][0]) is not None, 0.0
    if dated:
        epoch = reader.time(rows[0][0], numbers[0])[0]
        notes.append(f"the times of column '{names.time}' are dates or times of day, in UTC where they name no zone")
    for k, (number, cells) in enumerate(zip(numbers, rows, strict=True)):
        if dated:
            minute, seconds = reader.time(cells[0], number)
            content[k, 0] = minute - epoch + seconds
        for column in range(1 if dated else 0, 4):
            content[k, column] = reader.number(cells[column], number, column)
    if reader.has_commas:
        notes.append("its numbers have decimal commas")
    time, motor, load, command = (content[:, column].copy() for column in range(4))
    said = (f"column '{names.time}'", f"column '{names.motor}'", f"column '{names.load}'", f"column '{names.command}'")
    return Columns(
        time, motor, load, command, said, lambda k: f"in row {numbers[k]}", epoch, dated=dated, notes=tuple(notes)
    )
