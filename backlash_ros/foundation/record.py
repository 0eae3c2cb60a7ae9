"""Records: the cells of a row of numbers by name, in compiled code, in Python and to mypy.

    class Side(Record):
        believed: float = math.nan
        count: float = 0.0

    class Memory(Record):
        motor: Side = part(Side)
        commands: Array = cells(12)

    memory_at = view_of(Memory)
    row = row_of(Memory)
    memory_at(row).motor.count += 1.0

The row is an ordinary array of float64, which Python saves, compares and passes to compiled code; a record is a view of
it. Compiled code reads and writes it through a pointer, which costs what an index does.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, get_type_hints

import numba
import numpy as np
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of numbers."""

_numba: Any = numba
_intrinsic: Any = intrinsic
_NEEDED = object()
"""Marks a field without an initial value."""


class Record:
    """What a row of numbers means: one field for each cell, in order, with its initial value if there is one."""


R = TypeVar("R", bound=Record)


class _Part:
    """A field of a record that is more than one number: records of a kind, or numbers with an initial value."""

    def __init__(self, kind: type[Record] | None, shape: tuple[int, ...], initial: float) -> None:
        self.kind, self.shape, self.initial = kind, shape, initial


def part(kind: type[R]) -> R:
    """Return a field that is a record itself."""
    field: Any = _Part(kind, (), 0.0)
    return field  # type: ignore[no-any-return]


def parts(kind: type[R], count: int) -> Sequence[R]:
    """Return a field that is so many records of a kind."""
    field: Any = _Part(kind, (count,), 0.0)
    return field  # type: ignore[no-any-return]


def cells(*shape: int, initial: float = 0.0) -> Array:
    """Return a field that is an array of numbers."""
    field: Any = _Part(None, shape, initial)
    return field  # type: ignore[no-any-return]


def _fields(kind: type[Record]) -> dict[str, Any]:
    """Return each field's initial value or what it consists of."""
    return {name: getattr(kind, name, _NEEDED) for name in get_type_hints(kind)}


def _layout(kind: type[Record]) -> np.dtype[Any]:
    described: list[Any] = []
    for name, value in _fields(kind).items():
        if not isinstance(value, _Part):
            described.append((name, np.float64))
        else:
            described.append((name, _layout(value.kind) if value.kind else np.float64, value.shape))
    return np.dtype(described)


def size_of(kind: type[Record]) -> int:
    """Return the number of cells of a record."""
    return _layout(kind).itemsize // 8


def cell_of(kind: type[Record], name: str) -> int:
    """Return the index in a row of a field, or of its first cell; KeyError if the record has no such field."""
    fields: Any = _layout(kind).fields
    return int(fields[name][1]) // 8


def _fill(record: Any, kind: type[Record]) -> None:
    for name, value in _fields(kind).items():
        if not isinstance(value, _Part):
            record[name] = math.nan if value is _NEEDED else value
        elif value.kind is None:
            record[name] = value.initial
        elif value.shape:
            for one in record[name]:
                _fill(one, value.kind)
        else:
            _fill(record[name], value.kind)


def row_of(kind: type[Record], **values: Any) -> Array:
    """Return a new row with the initial values of a record, and ``values`` for fields of its own.

    Raises
    ------
    TypeError
        If the record has no field of such a name, or a number has no value.
    """
    fields = _fields(kind)
    if unknown := sorted(values.keys() - fields.keys()):
        raise TypeError(f"{kind.__name__} has no field {', '.join(unknown)}")
    if missing := [name for name, value in fields.items() if value is _NEEDED and name not in values]:
        raise TypeError(f"{kind.__name__} needs a value for {', '.join(missing)}")
    row = np.zeros(size_of(kind))
    record = row.view(_layout(kind))[0]
    _fill(record, kind)
    for name, value in values.items():
        record[name] = value
    return row


def view_of(kind: type[R]) -> Callable[[Array], R]:
    """Return a function that views a row as a record; compiled code and Python call the same one.

    The row has at least as many cells as the record. numba's own way, ``row.view(dtype)[0]``, takes 0.2 us.
    """
    layout = _layout(kind)
    record, named = _numba.from_dtype(layout), np.dtype((np.record, layout))

    def pointer(typingctx: Any, row: Any) -> Any:  # noqa: ARG001 - numba asks for this signature
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            return builder.bitcast(array.data, context.get_value_type(signature.return_type))

        return record(row), generate

    cast = _intrinsic(pointer)

    def view(row: Array) -> R:
        seen: R = row[: layout.itemsize // 8].view(named)[0]
        return seen

    overload(view)(lambda row: lambda row: cast(row))  # noqa: ARG005, PLW0108 - numba asks with the argument's type
    return view
