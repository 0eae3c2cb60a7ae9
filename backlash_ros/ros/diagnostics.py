"""Diagnostics as values: statistics of the last second, and statuses with their levels."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

RATE_WARN, RATE_ERROR = 0.05, 0.2
"""Relative deviations of the measured rate from the nominal one that are a warning and an error."""


CLOCKS_DIFFER = 10.0
"""Age of a sample beyond which the clocks must differ, s."""


class Window:
    """Values collected since the last report."""

    def __init__(self) -> None:
        self._values: list[float] = []
        self.add = self._values.append

    def __len__(self) -> int:
        return len(self._values)

    def take(self) -> tuple[float, float, float]:
        """Return mean, 99th percentile and maximum, nan without values, and start again."""
        values = sorted(self._values) or [math.nan]
        self._values.clear()
        return sum(values) / len(values), values[math.ceil(0.99 * len(values)) - 1], values[-1]


class Since:
    """Growth of counts since the last report."""

    def __init__(self) -> None:
        self._seen: dict[str, float] = {}

    def look(self, **counts: float) -> dict[str, float]:
        """Return the growth of each count; all of it the first time."""
        grown = {name: count - self._seen.get(name, 0) for name, count in counts.items()}
        self._seen = counts
        return grown


def milliseconds(statistics: Sequence[float]) -> str:
    """Return mean, p99 and maximum in words, from seconds."""
    mean, p99, largest = (1e3 * value for value in statistics)
    return f"mean {mean:.3f}, p99 {p99:.3f}, max {largest:.3f} ms"


def rate_level(measured: float, nominal: float) -> tuple[bytes, str]:
    """Return level and text for a measured rate, Hz."""
    deviation = abs(measured / nominal - 1.0)
    level = ERROR if not deviation <= RATE_ERROR else WARN if deviation > RATE_WARN else OK
    return level, f"{measured:.1f} Hz, nominal {nominal:g} Hz"


UNSTAMPED = "the drive does not stamp its samples"


def age_level(age: Sequence[float], longest: float, *, unstamped: bool = False) -> tuple[bytes, str]:
    """Return level and text for the age of samples, s: mean, 99th percentile and maximum; nan if unknown."""
    if unstamped and math.isnan(age[0]):
        return WARN, UNSTAMPED
    if abs(age[0]) > CLOCKS_DIFFER:
        return WARN, f"joint_states are {age[0]:.3g} s old: the clocks or use_sim_time differ"
    return (WARN if age[1] > longest else OK), f"joint_states are {age[1]:.3g} s old"


def status(
    name: str, hardware: str, judgements: Sequence[tuple[bytes, str]], values: Mapping[str, Any]
) -> DiagnosticStatus:
    """Return a status with the worst level of its judgements, and the texts of all that are not OK."""
    level = max((level for level, _ in judgements), default=OK)
    return DiagnosticStatus(
        level=level,
        name=name,
        hardware_id=hardware,
        message="; ".join(text for at, text in judgements if at != OK or level == OK),
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
