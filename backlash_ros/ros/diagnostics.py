"""Diagnostics as values: statistics of the last second, and statuses with their levels."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

RATE_WARN, RATE_ERROR = 0.05, 0.2
"""Deviation of the measured rate, relative to the nominal one, that is a warning, and that is an error."""


class Window:
    """Values gathered since the last look."""

    def __init__(self) -> None:
        self._values: list[float] = []
        self.add = self._values.append

    def __len__(self) -> int:
        return len(self._values)

    def take(self) -> tuple[float, float, float]:
        """Return mean, 99th percentile and maximum, nan where there is nothing, and start anew."""
        values = sorted(self._values) or [math.nan]
        self._values.clear()
        return sum(values) / len(values), values[math.ceil(0.99 * len(values)) - 1], values[-1]


def milliseconds(statistics: Sequence[float]) -> str:
    """Return mean, p99 and maximum in words, from seconds."""
    mean, p99, largest = (1e3 * value for value in statistics)
    return f"mean {mean:.3f}, p99 {p99:.3f}, max {largest:.3f} ms"


def rate_level(measured: float, nominal: float) -> tuple[bytes, str]:
    """Return level and text for a measured rate, Hz."""
    deviation = abs(measured / nominal - 1.0)
    level = ERROR if not deviation <= RATE_ERROR else WARN if deviation > RATE_WARN else OK
    return level, f"{measured:.1f} Hz, nominal {nominal:g} Hz"


def status(
    name: str, hardware: str, judgements: Sequence[tuple[bytes, str]], values: Mapping[str, Any]
) -> DiagnosticStatus:
    """Return a status as bad as the worst of its judgements, with the texts of all that are not good."""
    level = max((level for level, _ in judgements), default=OK)
    return DiagnosticStatus(
        level=level,
        name=name,
        hardware_id=hardware,
        message="; ".join(text for at, text in judgements if at != OK or level == OK),
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
