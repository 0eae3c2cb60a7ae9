"""Motor and load that come in messages of their own, put together where their stamps agree.

Without ROS. Only values of one stamp make a sample: none is held over from an earlier message.
"""

import math
from collections.abc import MutableSequence

_KEPT = 4
"""Messages of each joint that wait for the other's."""


class Halves:
    """Puts the messages of two joints together, in whatever order they come.

    ``begun`` is whether any two were, ``seen`` which joints have come, ``lost`` how many messages stayed alone.

    ``patience``: time for which a joint that comes alone waits for the other one, ns.
    """

    def __init__(self, patience: int) -> None:
        self._patience = patience
        self.forget()

    def forget(self) -> None:
        """Forget all messages."""
        self._waiting: tuple[dict[int, list[float]], dict[int, list[float]]] = {}, {}
        self.seen, self.begun, self.lost = (False, False), False, 0
        self._since: int | None = None

    def put(self, joint: int, stamp: int | None, values: MutableSequence[float], now: int) -> bool:
        """Take the message of one joint; return whether the sample is complete, and if so complete ``values``.

        Parameters
        ----------
        joint : 0, the motor's, or 1, the load's
        stamp : when it was measured, ns; None if unknown: it then belongs to no other
        values : of the message, nan for what is the other joint's
        now : of the steady clock, ns
        """
        if not self.seen[joint]:
            self.seen, self._since = (self.seen[0] or joint == 0, self.seen[1] or joint == 1), now
        if stamp is None:
            return False
        rest = self._waiting[1 - joint].pop(stamp, None)
        if rest is None:
            mine = self._waiting[joint]
            mine[stamp] = list(values)
            self._drop(mine, list(mine)[:-_KEPT])
            return False
        for k, value in enumerate(rest):
            if not math.isnan(value):
                values[k] = value
        for each in self._waiting:  # what is older comes too late
            self._drop(each, [older for older in each if older <= stamp])
        self.begun = True
        return True

    def waits(self, now: int) -> bool:
        """Whether the other joint, or a stamp of both, may still come."""
        return self.begun or self._since is None or now - self._since < self._patience

    def _drop(self, waiting: dict[int, list[float]], stamps: list[int]) -> None:
        for stamp in stamps:
            del waiting[stamp]
        self.lost += len(stamps)
