"""The runs of an evaluation as a parquet file: one row for each law on each drive, with everything that was drawn.

Parquet, because pandas, polars and DuckDB can query it without reading the whole file; written piece by piece with
pyarrow.
"""

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

Row = dict[str, Any]

_PIECE = 1000
"""Rows in memory at a time."""


def rows_of(parameters: Row, value: Row) -> Iterator[Row]:
    """Yield the rows of a drive: its parameters, what `task.evaluate_drive` returned, and each law's verdict."""
    learned = {f"learned_{name}": content for name, content in value["learned"].items()}
    for law, verdict in value["laws"].items():
        flat = {name: content for name, content in verdict.items() if not isinstance(content, dict)}
        for part, figures in verdict.items():
            if isinstance(figures, dict):
                flat |= {f"{part}_{name}": content for name, content in figures.items()}
        yield {**parameters, **learned, "law": law, **flat}


def write_table(rows: Iterable[Row], path: Path) -> None:
    """Write rows that have the same columns; a column's type is that of its first value.

    Raises
    ------
    ImportError
        If pyarrow is not installed: it is an extra, ``backlash_ros[tables]``.
    """
    import pyarrow  # noqa: PLC0415 - an extra
    import pyarrow.parquet  # noqa: PLC0415

    types = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    rest = iter(rows)
    piece = list(islice(rest, _PIECE))
    schema = pyarrow.schema([(name, types[type(value)]) for name, value in piece[0].items()])
    with pyarrow.parquet.ParquetWriter(path, schema) as writer:
        while piece:
            writer.write_table(pyarrow.Table.from_pylist(piece, schema))
            piece = list(islice(rest, _PIECE))
