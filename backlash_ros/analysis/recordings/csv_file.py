"""Reads a table of samples: text with a header and one sample per row."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from backlash_ros.analysis.recordings.samples import Columns

NOTHING = {"", "nan", "none", "null", "na", "n/a"}
"""Texts for a missing number, in upper or lower case."""


@dataclass(frozen=True)
class ColumnNames:
    """Names of the columns to read."""

    time: str = "time"
    motor: str = "motor"
    load: str = "load"
    command: str = "command"

    def all(self) -> tuple[str, str, str, str]:
        """Return them in their order."""
        return self.time, self.motor, self.load, self.command


def _number(text: str, path: Path, line: int, name: str) -> float:
    text = text.strip()
    if text.lower() in NOTHING:
        return math.nan
    try:
        value = float(text)
    except ValueError as error:
        raise ValueError(f"{path}, row {line}: column '{name}' must be a number, got {text!r}") from error
    return value if math.isfinite(value) else math.nan


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_csv(path: Path, names: ColumnNames) -> Columns:
    """Return four columns of a table; the separator is a comma, a semicolon or a tab, ``#`` begins a comment.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        Names file, row, column and value that cannot be used.
    """
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: must be text in UTF-8, byte {error.start} is not") from error
    used = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not used:
        raise ValueError(f"{path}: there is nothing in it")
    separator = max(",;\t", key=used[0][1].count)
    rows = csv.reader((line for _, line in used), delimiter=separator)
    header = [name.strip() for name in next(rows)]
    if all(_is_number(name) for name in header):
        raise ValueError(f"{path}, row {used[0][0]}: must be a header with the names of the columns, got {header}")
    for name in names.all():
        if header.count(name) != 1:
            raise ValueError(f"{path}: must have one column '{name}', has {header.count(name)}; columns: {header}")
    places = [header.index(name) for name in names.all()]
    numbers = [line for line, _ in used[1:]]
    content = np.empty((len(numbers), 4))
    for k, (line, row) in enumerate(zip(numbers, rows, strict=True)):
        if len(row) != len(header):
            raise ValueError(f"{path}, row {line}: must have {len(header)} cells as the header, has {len(row)}")
        for column, (place, name) in enumerate(zip(places, names.all(), strict=True)):
            content[k, column] = _number(row[place], path, line, name)
    time, motor, load, command = (content[:, column].copy() for column in range(4))
    said = (f"column '{names.time}'", f"column '{names.motor}'", f"column '{names.load}'", f"column '{names.command}'")
    return Columns(time, motor, load, command, said, lambda k: f"in row {numbers[k]}")
