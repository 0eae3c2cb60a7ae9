"""Records name the cells of a row for Python and for compiled code, and refuse what they do not have."""

import math
from collections.abc import Sequence

import numba
import numpy as np
import pytest

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, Record, cell_of, cells, part, parts, row_of, size_of, view_of


class Side(Record):
    believed: float = math.nan
    readings: float = 0.0


class Segment(Record):
    length: float = 0.0
    at: float = 0.0


class Memory(Record):
    motor: Side = part(Side)
    load: Side = part(Side)
    commands: Array = cells(2, 2, initial=1.0)
    plan: Sequence[Segment] = parts(Segment, 3)
    time: float = -1.0


class Constants(Record):
    period: float
    gap: float = 0.02


memory_at, constants_at = view_of(Memory), view_of(Constants)


@compiled
def take(side: Side, angle: float) -> float:
    side.believed = angle
    side.readings += 1.0
    return side.readings


@compiled
def step(row: Array, constants: Array) -> float:
    memory, period = memory_at(row), constants_at(constants).period
    for side in (memory.motor, memory.load):
        take(side, period)
    memory.commands[1, 0] = memory.time
    for k in range(3):
        segment = memory.plan[k]
        segment.length = float(k)
        memory.plan[k].at = 2.0 * segment.length
    memory.time += period
    return take(memory.load, 7.0)


def test_a_row_has_the_initial_values_in_order() -> None:
    row = row_of(Memory)
    assert size_of(Memory) == row.size == 2 * 2 + 4 + 3 * 2 + 1
    np.testing.assert_array_equal(row, [math.nan, 0, math.nan, 0, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, -1])


def test_a_cell_is_found_by_name() -> None:
    assert [cell_of(Memory, name) for name in ("motor", "load", "commands", "plan", "time")] == [0, 2, 4, 8, 14]
    with pytest.raises(KeyError, match="tmie"):
        cell_of(Memory, "tmie")


@pytest.mark.parametrize("function", [step, step.py_func])  # type: ignore[attr-defined]
def test_compiled_code_and_python_write_the_same_cells(function) -> None:  # type: ignore[no-untyped-def]
    row = row_of(Memory)
    assert function(row, row_of(Constants, period=0.5)) == 2.0
    np.testing.assert_array_equal(row, [0.5, 1, 7, 2, 1, 1, -1, 1, 0, 0, 1, 2, 2, 4, -0.5])


def test_a_view_of_python_reads_and_writes_the_row() -> None:
    row = np.append(row_of(Memory), 99.0)  # a row may go on
    memory = memory_at(row)
    memory.load.readings, memory.plan[2].at, memory.commands[0, 1] = 3.0, 4.0, 5.0
    assert (row[3], row[13], row[5], row[15]) == (3.0, 4.0, 5.0, 99.0)
    assert memory.time == -1.0


def test_a_row_needs_its_values_and_takes_no_others() -> None:
    with pytest.raises(TypeError, match="Constants needs a value for period"):
        row_of(Constants)
    with pytest.raises(TypeError, match="Constants has no field priod"):
        row_of(Constants, priod=0.004)
    np.testing.assert_array_equal(row_of(Constants, period=0.004), [0.004, 0.02])


def test_a_field_of_another_record_is_refused_in_compiled_code() -> None:
    @compiled
    def confused(row: Array) -> float:
        return constants_at(row).believed  # type: ignore[attr-defined, no-any-return]

    with pytest.raises((numba.TypingError, KeyError), match="believed"):
        confused(row_of(Constants, period=0.004))
