"""Decides which samples a controller takes, and what to do with the others: a state machine without ROS.

All times are integer nanoseconds. A stamp is when a sample was measured, by the drive's clock, which may jump; ``now``
is the steady clock of the controller, which does not.
"""

import math
from collections.abc import MutableSequence
from enum import Enum
from typing import NamedTuple

from backlash_ros.gates.faults import Fault
from backlash_ros.gates.halves import Halves
from backlash_ros.gates.positions import Position

SECOND = 10**9

_STRAYS = 3
"""This many stray samples are taken for a second drive; a single one may come from a clock that was set."""

_MEMORY = 10
"""Stray samples are counted together within this many timeouts."""

_COMPANY = 50_000_000
"""Time for which the only joint so far waits for the other one before it is taken alone, ns."""

_ACQUAINTED = 500_000_000
"""Time for which several publishers are listened to before a position is held, ns."""

_MISSES = 3
"""So many samples in a row without a joint that was there say that its encoder is lost."""

_BOTH = True, True
_SIDES = "motor", "load"


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

    It puts together motor and load that come in messages of their own, and counts on positions that begin again.

    A ``fault`` is latched, with its text in ``why``: no sample is taken until `open`. Nor is one taken before the
    commands have a subscriber: otherwise the controller would hold a position without the drive receiving commands.

    ``may_lose``: whether one joint that disappears for three samples leaves the other one to go on with. ``fastest``:
    speeds of motor and load, each at its own shaft, beyond which no motion explains a jump, rad/s.

    Parameters
    ----------
    timeout : silence that is a fault, ns
    late_after : time between two stamps beyond which a sample counts as late, ns
    names : of the joints, the motor's and the load's, for texts
    wraps : range after which the position of each begins again, rad; 0: it goes on
    angles : places of both positions among a sample's values
    """

    def __init__(
        self,
        timeout: int,
        late_after: int,
        names: tuple[str, str] = ("motor", "load"),
        *,
        wraps: tuple[float, float] = (0.0, 0.0),
        angles: tuple[int, int] = (0, 1),
    ) -> None:
        self._timeout = timeout
        self._late_after = late_after
        self._names = names
        self._angles = angles
        self._positions = [Position(wrap, late_after // 3) for wrap in wraps]
        self._halves = Halves(max(_COMPANY, 2 * late_after))
        self.fastest = math.inf, math.inf
        self.may_lose = False
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
        self._several_since: int | None = None
        self._misses = 0
        self._halves.forget()
        for position in self._positions:
            position.forget()

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
        joints: tuple[bool, bool] = _BOTH,
        values: MutableSequence[float] | None = None,
        content: bytes | None = None,
        unusable: str = "",
        heard: bool = True,
        publishers: int = 1,
    ) -> Judged:
        """Judge a sample that has just arrived.

        Parameters
        ----------
        stamp : when it was measured, ns; None if unknown
        now : of the steady clock, ns
        joints : whether it has the motor's and the load's joint
        values : its values, nan where missing; those of a sample that is taken are completed in place, with positions
            that go on
        content : its values as bytes; None to accept any repeat without comparing
        unusable : why it cannot be used; empty if it can
        heard : whether the commands have a subscriber
        publishers : number of publishers that the graph knows; it matters until a sample is taken
        """
        self.silent(now)
        if self.fault:
            self._arrived = now
            self._go_on(values)
            return Judged(Action.REFUSE)
        self.unheard = not (heard or self.begun)
        if self.unheard or self._unacquainted(publishers, now):
            return Judged(Action.IGNORE)
        judged = None
        if not unusable and joints not in (_BOTH, self._joints):
            judged = self._half(stamp, now, joints, values)
            if self._halves.begun:
                joints, content = _BOTH, None
        if judged := judged or self._out_of_turn(stamp, now, content):
            return judged
        if unusable or (self.begun and joints != self._joints and not self._loses()):
            return self._drop(Action.REFUSE, f"unusable joint_states: {unusable or self._changed(joints)}")
        elapsed, reason = self._elapsed(stamp, now)
        self.stamp, self._arrived, self._content = stamp, now, content
        self._joints = self._joints or joints
        self._refused = ""
        if joints == _BOTH and self._misses < _MISSES:
            self._misses = 0
        if self._go_on(values, elapsed):
            return Judged(Action.REFUSE)
        self.taken += 1
        return Judged(Action.TAKE, elapsed, reason)

    def silent(self, now: int) -> bool:
        """Return whether the timeout has passed since the last usable sample; if so, latch the fault."""
        if self._arrived is None or now - self._arrived < self._timeout:
            return False
        self._arrived = None
        why = f", only {self._refused}" if self._refused else ""
        self.fail(Fault.NO_SAMPLES, f"no joint_states for {self._timeout / SECOND:g} s{why}")
        return True

    def fail(self, fault: Fault, why: str) -> None:
        """Latch a fault, unless one is latched."""
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

    def _loses(self) -> bool:
        """Count a sample without one joint that was there; return whether it is missing for good and may be lost."""
        if self._joints != _BOTH:
            return False
        self._misses += 1
        return self.may_lose and self._misses >= _MISSES

    def _changed(self, joints: tuple[bool, bool]) -> str:
        """Return which joint has appeared or disappeared: the held position relies on those at the start."""
        assert self._joints is not None
        changes = (
            f"joint {name!r} has {'' if there else 'dis'}appeared since the loop started"
            for name, before, there in zip(self._names, self._joints, joints, strict=True)
            if before != there
        )
        return next(changes)

    # Positions, and joints in messages of their own.

    def _go_on(self, values: MutableSequence[float] | None, elapsed: int = 0) -> bool:
        """Let the positions go on where a driver's begin again; latch a fault and return True if one jumps like that.

        Under a fault the turns are counted on, since the shafts may be turned by hand.
        """
        if values is None:
            return False
        for side, position, at, fastest in zip(_SIDES, self._positions, self._angles, self.fastest, strict=True):
            values[at] = position.take(values[at], elapsed, fastest)
            if position.jump:
                fault = Fault.MOTOR_JUMP if side == "motor" else Fault.LOAD_JUMP
                self.fail(fault, f"{side} {position.jump}; publish it continuously, or set {side}_wrap")
        return bool(self.fault)

    def _unacquainted(self, publishers: int, now: int) -> bool:
        """Whether several publishers have not been listened to for long enough: two may send our joints."""
        if self.begun or publishers < 2:
            return False
        if self._several_since is None:
            self._several_since = now
        return now - self._several_since < _ACQUAINTED

    def _half(
        self, stamp: int | None, now: int, joints: tuple[bool, bool], values: MutableSequence[float] | None
    ) -> Judged | None:
        """Judge a message of one joint; None if it is to be judged as a sample, together with the other or alone."""
        side = int(joints[1])
        here, there = self._names[side], self._names[1 - side]
        if self._joints == _BOTH and not self._halves.begun:
            return None  # so far both came in one message: a joint is missing
        if self._joints not in (None, _BOTH):  # the other joint alone
            return self._apart(
                f"joint {here!r} comes in messages of its own, but the loop has begun with {there!r} alone: after "
                "reset_fault it begins with both"
            )
        if stamp is not None and stamp == self.stamp:
            return self._repeated(now, None)
        lost, reason = self._halves.lost, ""
        complete = self._halves.put(side, stamp, [] if values is None else values, now)
        if self._halves.begun and self._halves.lost > lost:
            self._refused = reason = "one of the joints without the other one of the same stamp"
            self.drop(reason)
        if complete:
            return None
        if self._halves.waits(now):
            return Judged(Action.IGNORE, 0, reason)
        return self._apart(self._differ(stamp)) if self._halves.seen == _BOTH else None

    def _differ(self, stamp: int | None) -> str:
        what = "are not stamped" if stamp is None else "have different stamps"
        motor, load = self._names
        return (
            f"joints {motor!r} and {load!r} come in separate messages, which {what}: send both in one message, or with "
            "the stamp of one measurement"
        )

    def _apart(self, why: str) -> Judged:
        self.fail(Fault.JOINTS_APART, why)
        return Judged(Action.REFUSE)

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
            self.fail(Fault.SECOND_DRIVE, f"a second drive: {reason}")

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
