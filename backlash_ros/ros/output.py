"""Standard output and error that never wait for who reads them: a log line must not stop the loop, nor the stop.

A terminal that was halted with Ctrl-S, or a pipe that nobody reads, blocks whoever writes to it, and a line of the ROS
log is written with Python's lock held: no thread of the process goes on. So both are opened anew without blocking. What
they do not take is dropped there; the log file and /rosout have it.
"""

import atexit
import os
import select
import stat
from contextlib import suppress

from backlash_ros.ros.timer import now

_DESCRIPTORS = (1, 2)


def _open_anew(descriptor: int) -> None:
    """Open the terminal or pipe behind ``descriptor`` once more: others who hold it must not find it changed."""
    anew = os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        os.dup2(anew, descriptor)
    finally:
        os.close(anew)


def never_wait() -> None:
    """Let writing to standard output and error drop what is not taken at once. Files stay as they are."""
    for descriptor in _DESCRIPTORS:
        with suppress(OSError):  # it is closed
            kind = os.fstat(descriptor).st_mode
            if stat.S_ISFIFO(kind) or stat.S_ISCHR(kind):
                try:
                    _open_anew(descriptor)
                except OSError:  # another user's, or nobody has it open any more
                    _share_without_blocking(descriptor)
            elif stat.S_ISSOCK(kind):
                _share_without_blocking(descriptor)


def _share_without_blocking(descriptor: int) -> None:
    """Change what others may hold too, until the process ends."""
    if os.get_blocking(descriptor):
        os.set_blocking(descriptor, False)
        atexit.register(os.set_blocking, descriptor, True)


class Backlog:
    """Whether the output takes anything: looked at now and then, it tells when it takes lines again."""

    def __init__(self) -> None:
        self._since: float | None = None

    def ended(self) -> float:
        """Return for how long nothing was taken, s, once it is taken again; else 0."""
        waiting = select.poll()
        for descriptor in _DESCRIPTORS:
            waiting.register(descriptor, select.POLLOUT)
        blocked = len(waiting.poll(0)) < len(_DESCRIPTORS)
        since, self._since = self._since, (self._since or now()) if blocked else None
        return 0.0 if blocked or since is None else now() - since
