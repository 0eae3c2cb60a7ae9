"""What the machine keeps from processes: a watchdog that trips meanwhile says nothing of who else held them up."""

import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

_WINDOW = 0.5
_TICK = 0.01


class Machine:
    """Watches how long processes wait for the machine, as the kernel counts it; `look` is to be called often."""

    def __init__(self, pids: Sequence[int]) -> None:
        self._pids = pids
        self._seen: deque[tuple[float, float]] = deque()

    def look(self) -> None:
        self._seen.append((time.monotonic(), self._waited()))
        while self._seen[-1][0] - self._seen[0][0] > _WINDOW:
            self._seen.popleft()

    def kept_waiting(self) -> float:
        """Return for how long, in the last half second, threads waited for a core or nobody could look, s."""
        waited = max(later[1] - self._seen[0][1] for later in self._seen)
        unseen = max((after[0] - before[0] for before, after in pairwise(self._seen)), default=_WINDOW)
        return max(waited, unseen)

    def _waited(self) -> float:
        """Return for how long threads could run and had no core, all in all, and cores were taken by others, s."""
        nanoseconds = 0
        for pid in self._pids:
            for thread in Path(f"/proc/{pid}/task").glob("*/schedstat"):
                with suppress(OSError):  # it has ended
                    nanoseconds += int(thread.read_text().split()[1])
        stolen = int(Path("/proc/stat").read_text().split(maxsplit=9)[8])
        return 1e-9 * nanoseconds + _TICK * stolen
