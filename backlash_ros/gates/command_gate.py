"""What a drive does with commands: which sample they answer, how old they are, and when the motor gets 0.

A state machine without ROS, for the simulator and for any adapter of a real drive. All times are integer nanoseconds
of a steady clock, ``now``; a sample is named by its stamp, also in nanoseconds, of any clock.
"""

import math
from collections import OrderedDict
from collections.abc import Sequence

from backlash_ros.gates.faults import Fault

SECOND = 10**9

_KEPT = 16
"""Smallest number of samples that are remembered, however old they are."""


class _Sent:
    """A sample that was sent: when, whether it was answered, and whether it was sent again."""

    def __init__(self, at: int) -> None:
        self.at = at
        self.answered = self.repeated = False


class CommandGate:
    """Takes commands and decides what the motor gets: no stale command, and no mixture of two publishers' commands.

    A command names the sample that it answers, and is as old as that sample; a command that names no sample ages from
    its arrival. A ``fault`` is latched, with its text in ``why``: the motor gets 0 until `reset`. A command of 0 is
    always obeyed, however old.

    Parameters
    ----------
    timeout : age above which a command is not obeyed, and silence after which the motor gets 0, ns
    unit : of the command, for texts
    lockstep : time stands still until the newest sample is answered: no command is too old, but answers to other
        samples are ignored
    """

    def __init__(self, timeout: int, unit: str = "V", *, lockstep: bool = False) -> None:
        self._timeout = timeout
        self._unit = unit
        self._lockstep = lockstep
        self.rejected = self.answered = self.answered_late = 0
        self._first: int | None = None
        self._last = 0
        self.fault = Fault.NONE
        self.why = ""
        self.open()

    def open(self) -> None:
        """Start: forget commands and samples, but not the fault."""
        self._value = 0.0
        self._since = 0
        self._sent: OrderedDict[int, _Sent] = OrderedDict()
        self._newest: int | None = None
        self._last_answer: int | None = None
        self._outdated = False
        self.waiting = False

    def reset(self) -> None:
        """Forget the fault; the motor gets the next command."""
        self.fault, self.why, self._value = Fault.NONE, "", 0.0

    def fail(self, fault: Fault, why: str) -> None:
        """Latch a fault, unless one is latched: the motor gets 0."""
        self._value = 0.0
        if not self.fault:
            self.fault, self.why = fault, why

    # What the drive does.

    def sent(self, sample: int, now: int) -> None:
        """Note that a sample is sent now."""
        self._sent.pop(sample, None)
        self._sent[sample] = _Sent(now)
        self._newest, self.waiting = sample, True
        self._first = sample if self._first is None else min(self._first, sample)
        self._last = max(self._last, sample)
        while len(self._sent) > _KEPT and next(iter(self._sent.values())).at < now - self._timeout:
            self._sent.popitem(last=False)

    def sent_again(self) -> None:
        """Note that the newest sample is sent again: one controller may answer it twice."""
        if self._newest is not None:
            self._sent[self._newest].repeated = True

    @property
    def value(self) -> float:
        """The command that the motor last got."""
        return self._value

    @property
    def expires(self) -> int | None:
        """When the command in force becomes too old, ns; None if the motor gets 0, and in lockstep."""
        return self._since + self._timeout if self._value and not self._lockstep else None

    def output(self, now: int) -> float:
        """Return the motor's command now; silence latches the fault."""
        if self.expires is not None and now >= self.expires:
            only = ", only answers to older samples" if self._outdated else ""
            self.fail(Fault.NO_COMMANDS, f"no command for {self._timeout / SECOND:g} s{only}")
        return self._value

    # What comes.

    def command(self, values: Sequence[float], answers: int | None, now: int) -> str:
        """Take a command that has just arrived; return why it is not obeyed, empty if it is or a fault says why.

        Parameters
        ----------
        values : the first one is the command, in the drive's unit
        answers : the sample that the command names; None if it names none
        now : of the steady clock, ns
        """
        self.output(now)
        sample = None if answers is None else self._sent.get(answers)
        if self._lockstep and not (self.waiting and sample is not None and answers == self._newest):
            if sample is not None and sample.answered and not sample.repeated:
                self._two_answers()
            return ""
        why = self._obey(values, answers, sample, now)
        self._note_answer(sample, answers)
        return why

    def _obey(self, values: Sequence[float], answers: int | None, sample: _Sent | None, now: int) -> str:
        forgotten = sample is None and self._forgotten(answers)
        value = values[0] if len(values) else math.nan
        if not math.isfinite(value):
            self.rejected += 1
            self.fail(
                Fault.BAD_COMMAND, f"the first value of command must be finite, in {self._unit}, got {list(values)}"
            )
        elif sample is not None and sample.answered and not sample.repeated:
            self._two_answers()
        elif sample is None and not forgotten and value and self._between_answers(now):
            self.fail(
                Fault.SECOND_CONTROLLER,
                f"a second publisher on command: {value:g} {self._unit} between a controller's answers",
            )
        elif value and (forgotten or self._too_old(sample, now)):
            self._outdated = True
            self.rejected += 1
            return f"command answers a sample that is older than command_timeout = {self._timeout / SECOND:g} s"
        elif value and sample is not None and self._last_answer is not None and sample.at < self._last_answer:
            self.rejected += 1
            return "command answers an older sample than the command in force does"
        elif not self.fault:
            self._value, self._since, self._outdated = value, now if sample is None else sample.at, False
        return ""

    def _note_answer(self, sample: _Sent | None, answers: int | None) -> None:
        self.waiting = False
        if sample is None:
            return
        sample.answered = True
        self._last_answer = sample.at if self._last_answer is None else max(self._last_answer, sample.at)
        self.answered += answers == self._newest
        self.answered_late += answers != self._newest

    def _two_answers(self) -> None:
        self.fail(Fault.SECOND_CONTROLLER, "two controllers publish command: one sample was answered twice")

    def _forgotten(self, answers: int | None) -> bool:
        """Return whether the named sample is too old to be remembered; a name outside of all stamps means nothing."""
        return answers is not None and self._first is not None and self._first <= answers <= self._last

    def _between_answers(self, now: int) -> bool:
        return self._last_answer is not None and now - self._last_answer < self._timeout

    def _too_old(self, sample: _Sent | None, now: int) -> bool:
        return sample is not None and not self._lockstep and now - sample.at >= self._timeout
