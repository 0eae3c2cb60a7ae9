"""Finds out whether two publishers send the same joint, from the numbers of their messages; without ROS."""

from collections.abc import Iterable

SECOND = 10**9

_FALLS, _MEMORY = 2, 10 * SECOND
"""This many falls within this time, ns: a driver that starts again makes one."""


class Publishers:
    """Judges by joint: each publisher numbers its own messages upwards, so numbers of two publishers fall."""

    def __init__(self, names: Iterable[str]) -> None:
        self._names = tuple(names)
        self.forget()

    def forget(self) -> None:
        """Forget all messages."""
        self._last: dict[str, int] = {}
        self._falls: dict[str, list[int]] = {}

    def heard(self, names: Iterable[str], number: int | None, now: int) -> str:
        """Take a message and return which of its joints two publishers send; empty if none.

        Parameters
        ----------
        names : of the joints in the message, in whatever order
        number : that its publisher gave it; None if the middleware does not tell
        now : of the steady clock, ns
        """
        if number is None:
            return ""
        for name in (name for name in self._names if name in names):
            if number <= self._last.get(name, -1):
                falls = [at for at in self._falls.get(name, []) if now - at < _MEMORY]
                self._falls[name] = [*falls, now]
                if len(falls) + 1 >= _FALLS:
                    return name
            self._last[name] = number
        return ""
