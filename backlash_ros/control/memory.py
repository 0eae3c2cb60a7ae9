"""A tick's memory and inputs as Python reads and sets them, beside the compiled tick."""

from typing import Any

from backlash_ros.control.tick import Inputs, Results, TickMemory, tick_memory_at
from backlash_ros.foundation.record import Array, cell_of, row_of
from backlash_ros.foundation.signals import Estimate, Measurement, Setpoint


class _Cell:
    """A cell of ``row`` as an attribute, for what is read or set at every sample.

    It takes 0.1 us. In Python an attribute of a record takes ten times as long.
    """

    def __init__(self, cell: int) -> None:
        self._cell = cell

    def __get__(self, owner: Any, kind: type[Any]) -> float:
        value: float = owner.row.item(self._cell)
        return value

    def __set__(self, owner: Any, value: float) -> None:
        owner.row[self._cell] = value


def _result(name: str) -> _Cell:
    return _Cell(cell_of(TickMemory, "results") + cell_of(Results, name))


class TickRow:
    """The memory of a tick: one array, ``row``, laid out as `TickMemory`, and what Python needs of it.

    ``used`` is the last `Measurement` as used, ``setpoint`` the last `Setpoint`, ``monitor``, ``motion`` and
    ``plausibility``, ``cursor`` and ``pace`` are parts of the memory: all are views. The others are `Results` by name.
    """

    command = _result("command")
    fault = _result("fault")
    plan_time = _result("plan_time")
    low = _result("low")
    high = _result("high")

    def __init__(self) -> None:
        self.row: Array = row_of(TickMemory)
        memory = tick_memory_at(self.row)
        self.used, self.setpoint = Measurement(memory.used), Setpoint(memory.setpoint)
        self.estimate = Estimate(memory.observer.estimate)
        self.observer, self.monitor, self.motion = memory.observer, memory.monitor, memory.motion
        self.plausibility = memory.plausibility
        self.cursor, self.pace = memory.cursor, memory.pace
        self.details = memory.results.details

    def forget(self) -> None:
        """Forget everything but the last sample and the setpoint."""
        kept = self.used.copy(), self.setpoint.copy()
        self.row[:] = row_of(TickMemory)
        self.used[:], self.setpoint[:] = kept


class InputRow:
    """The inputs of a tick beside the sample: one array, ``row``, and the `Inputs` by name."""

    elapsed = _Cell(cell_of(Inputs, "elapsed"))
    offset = _Cell(cell_of(Inputs, "offset"))
    torque = _Cell(cell_of(Inputs, "torque"))
    experimenting = _Cell(cell_of(Inputs, "experimenting"))
    pace = _Cell(cell_of(Inputs, "pace"))

    def __init__(self) -> None:
        self.row: Array = row_of(Inputs)
