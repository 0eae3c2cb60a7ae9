"""Decides which samples a controller takes, and what to do with the others: a state machine without ROS.

All times are integer nanoseconds. A stamp is when a sample was measured, by the drive's clock, which may jump; ``now``
is the steady clock of the controller, which does not.
"""

from enum import Enum
from typing import NamedTuple

from backlash_ros.gates.faults import Fault

SECOND = 10**9

_STRAYS = 3
"""This many stray samples are taken for a second drive; a single one may come from a clock that was set."""

_MEMORY = 10
"""Stray samples are counted together within this many timeouts."""


class Action(Enum):
    """What to do with a sample."""

    TAKE = "take it: it goes to the tick, whose command answers it"
    REPEAT = "answer it with the command in force"
    REFUSE = "answer it with 0"
    IGNORE = "do not answer it"


class Judged(NamedTuple):
    """What to do with a sample, the time since the previous one (ns, 0 if there is none), and a reason to report."""

    action: Action
    elapsed: int = 0
    reason: str = ""


class SampleGate:
    """Judges order, repeats, clock jumps, appearing and disappearing joints, a second drive, silence, no subscriber.

    A ``fault`` is latched, with its text in ``why``: no sample is taken until `open`. Nor is one taken before the
    commands have a subscriber: otherwise the controller would hold a position without the drive receiving commands.

    Parameters
    ----------
    timeout : silence that is a fault, ns
    late_after : time between two stamps beyond which a sample counts as late, ns
    names : of the joints, for texts
    """

    def __init__(self, timeout: int, late_after: int, names: tuple[str, ...] = ("motor", "load")) -> None:
        self._timeout = timeout
        self._late_after = late_after
        self._names = names
        self.taken = self.dropped = self.late = self.jumps = 0
        self.last_dropped = ""
        self.open()

    def open(self) -> None:
        """Forget the fault and all samples; the counts go on."""
        self.fault = Fault.NONE
        self.why = ""
        self.unheard = False
        self.stamp: int | None = None
        self._arrived: int | None = None
        self._joints: tuple[bool, ...] | None = None
        self._content: bytes | None = None
        self._refused = ""
        self._astray: int | None = None
        self._strays = 0
        self._strayed = -_MEMORY * self._timeout

    @property
    def begun(self) -> bool:
        """Whether a sample was taken since `open`."""
        return self._joints is not None

    @property
    def waiting(self) -> bool:
        """Whether no sample has arrived yet, or none since the last silence."""
        return self._arrived is None

    def sample(
        self,
        stamp: int | None,
        now: int,
        *,
        joints: tuple[bool, ...] = (True, True),
        content: bytes | None = None,
        unusable: str = "",
        heard: bool = True,
    ) -> Judged:
        """Judge a sample that has just arrived.

        Parameters
        ----------
        stamp : when it was measured, ns; None if unknown
        now : of the steady clock, ns
        joints : whether it has the motor's and the load's joint
        content : its values; None to accept any repeat without comparing
        unusable : why it cannot be used; empty if it can
        heard : whether the commands have a subscriber
        """
        self.silent(now)
        if self.fault:
            self._arrived = now
            return Judged(Action.REFUSE)
        self.unheard = not (heard or self.begun)
        if self.unheard:
            return Judged(Action.IGNORE)
        if judged := self._out_of_turn(stamp, now, content):
            return judged
        if unusable or (self.begun and joints != self._joints):
            return self._drop(Action.REFUSE, f"unusable joint_states: {unusable or self._changed(joints)}")
        elapsed, reason = self._elapsed(stamp, now)
        self.stamp, self._arrived, self._content, self._joints = stamp, now, content, joints
        self._refused = ""
        self.taken += 1
        return Judged(Action.TAKE, elapsed, reason)

    def silent(self, now: int) -> bool:
        """Return whether the timeout has passed since the last usable sample; if so, latch the fault."""
        if self._arrived is None or now - self._arrived < self._timeout:
            return False
        self._arrived = None
        why = f", only {self._refused}" if self._refused else ""
        self._fail(Fault.NO_SAMPLES, f"no joint_states for {self._timeout / SECOND:g} s{why}")
        return True

    def _fail(self, fault: Fault, why: str) -> None:
        if not self.fault:
            self.fault, self.why = fault, why

    def drop(self, reason: str) -> None:
        """Count a dropped message, of this or another topic."""
        self.dropped += 1
        self.last_dropped = reason

    def _drop(self, action: Action, reason: str) -> Judged:
        self.drop(reason)
        self._refused = reason
        return Judged(action, 0, reason)

    def _changed(self, joints: tuple[bool, ...]) -> str:
        """Return which joint has appeared or disappeared: the held position relies on those at the start."""
        assert self._joints is not None
        changes = (
            f"joint {name!r} has {'' if there else 'dis'}appeared since the loop started"
            for name, before, there in zip(self._names, self._joints, joints, strict=True)
            if before != there
        )
        return next(changes)

    # Order.

    def _out_of_turn(self, stamp: int | None, now: int, content: bytes | None) -> Judged | None:
        """Judge a sample that is not newer than the newest, or that reveals a second drive; None for all others."""
        if stamp is None or self.stamp is None or self._arrived is None:
            return None
        behind = self.stamp - stamp
        if behind == 0:
            return self._repeated(now, content)
        if behind > 0 and not self._set_back(stamp, behind):
            self._astray = stamp
            return self._drop(Action.IGNORE, f"joint_states out of order, {behind / SECOND:g} s behind the newest")
        if behind < 0 and self._astray is not None:
            # A single clock does not go back for one sample and then continue as before.
            self._suspect(now, "joint_states of two drives alternate")
        self._astray = None
        return Judged(Action.REFUSE) if self.fault else None

    def _repeated(self, now: int, content: bytes | None) -> Judged:
        """Answer again: the drive missed the answer, or stands still; other content may come from another drive."""
        again = "joint_states repeated with the newest sample's stamp"
        differs = content is not None and self._content is not None and content != self._content
        if differs:
            self._suspect(
                now, "joint_states with other values but the newest sample's stamp, or with a stamp that stands still"
            )
        if self.fault:
            return Judged(Action.REFUSE)
        if differs:
            return self._drop(Action.REPEAT, again)
        self._refused = again  # nothing is lost: a drive in lockstep repeats a sample that was answered late
        return Judged(Action.REPEAT)

    def _set_back(self, stamp: int, behind: int) -> bool:
        """Whether the drive's clock was set back: by the timeout or more, or two consecutive samples confirm it."""
        return behind >= self._timeout or (self._astray is not None and self._astray < stamp)

    def _suspect(self, now: int, reason: str) -> None:
        """Count a stray sample, and latch the fault if there are too many within a short time."""
        self._strays = 1 if now - self._strayed > _MEMORY * self._timeout else self._strays + 1
        self._strayed = now
        if self._strays >= _STRAYS:
            self._fail(Fault.SECOND_DRIVE, f"a second drive: {reason}")

    def _elapsed(self, stamp: int | None, now: int) -> tuple[int, str]:
        """Return the time since the last sample, ns, by the stamps unless they jump against the steady clock."""
        if self._arrived is None:
            return 0, ""
        arrived = max(now - self._arrived, 0)
        if stamp is None or self.stamp is None:
            return arrived, ""
        stamped = stamp - self.stamp
        self.late += stamped > self._late_after
        if 0 < stamped < arrived + self._timeout:
            return stamped, ""
        self.jumps += 1
        return arrived, f"the clock of joint_states jumped by {(stamped - arrived) / SECOND:.3g} s"
