"""Standard output and error that never wait for their reader: a log line must delay neither the loop nor a stop.

A terminal halted with Ctrl-S, or a pipe that nobody reads, blocks its writer, and a line of the ROS log is written with
Python's lock held, so that no thread of the process goes on. Both are therefore reopened without blocking. Output that
they do not take is dropped; it is still in the log file and on /rosout.
"""

import atexit
import os
import select
import stat
from contextlib import suppress

from backlash_ros.ros.timer import now

_DESCRIPTORS = (1, 2)


def _open_anew(descriptor: int) -> None:
    """Open the terminal or pipe behind ``descriptor`` again, so that it does not change for other processes."""
    anew = os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        os.dup2(anew, descriptor)
    finally:
        os.close(anew)


def never_wait() -> None:
    """Make standard output and error drop what is not taken at once. Files are not affected."""
    for descriptor in _DESCRIPTORS:
        with suppress(OSError):  # it is closed
            kind = os.fstat(descriptor).st_mode
            if stat.S_ISFIFO(kind) or stat.S_ISCHR(kind):
                try:
                    _open_anew(descriptor)
                except OSError:  # another user's, or no longer open
                    _share_without_blocking(descriptor)
            elif stat.S_ISSOCK(kind):
                _share_without_blocking(descriptor)


def _share_without_blocking(descriptor: int) -> None:
    """Change a descriptor that other processes may share, until this process ends."""
    if os.get_blocking(descriptor):
        os.set_blocking(descriptor, False)
        atexit.register(os.set_blocking, descriptor, True)


class Backlog:
    """Checks now and then whether the output takes lines, and reports when it does again."""

    def __init__(self) -> None:
        self._since: float | None = None

    def ended(self) -> float:
        """Return for how long the output took nothing, s, once it takes lines again; else 0."""
        waiting = select.poll()
        for descriptor in _DESCRIPTORS:
            waiting.register(descriptor, select.POLLOUT)
        blocked = len(waiting.poll(0)) < len(_DESCRIPTORS)
        since, self._since = self._since, (self._since or now()) if blocked else None
        return 0.0 if blocked or since is None else now() - since
