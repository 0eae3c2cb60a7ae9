"""The gates, driven through 100,000 steps each: whatever comes in whatever order, what must not happen does not.

Each machine keeps a model of its own, made from what was put in and not from what the gate remembers.
"""

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from backlash_ros.gates import FAULTS, Action, CommandGate, Fault, SampleGate
from backlash_ros.gates.sample_gate import Judged

STEPS = 100_000
"""Samples or commands that each gate is given."""

MS = 10**6
PERIOD, TIMEOUT = 4 * MS, 100 * MS
BOTH = (True, True)

THOROUGH = settings(
    max_examples=2_000,
    stateful_step_count=50,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)

waits = st.sampled_from([0, 1, MS, PERIOD, 10 * MS, TIMEOUT - 1, TIMEOUT, 3 * TIMEOUT, 3600 * 10**9])
short_waits = st.sampled_from([0, 1, MS, PERIOD, 10 * MS])
jumps = st.sampled_from(
    [sign * jump for jump in (1, PERIOD, TIMEOUT // 2, TIMEOUT - 1, TIMEOUT, 10**9, 10**18) for sign in (-1, 1)]
)


# Named, since older versions of hypothesis read the source of a lambda again and again.
def sample_was_taken(machine: "Samples") -> bool:
    return machine.taken_stamp is not None


def sample_was_sent(machine: "Commands") -> bool:
    return machine.newest is not None


class CountedSampleGate(SampleGate):
    steps = 0

    def sample(self, *given: Any, **what: Any) -> Judged:
        type(self).steps += 1
        return super().sample(*given, **what)


class CountedCommandGate(CommandGate):
    steps = 0

    def command(self, *given: Any) -> str:
        type(self).steps += 1
        return super().command(*given)


class Samples(RuleBasedStateMachine):
    """A drive whose clock jumps, with its bad samples, a second drive, and a watchdog that may come late."""

    def __init__(self) -> None:
        super().__init__()
        self.gate = CountedSampleGate(TIMEOUT, PERIOD * 3 // 2)
        self.now, self.stamp = 1_000 * MS, 50_000 * MS
        self.opened()

    def opened(self) -> None:
        self.taken_at: int | None = None
        self.taken_stamp: int | None = None
        self.joints: tuple[bool, ...] | None = None
        self.strangers = 0

    def put(self, stamp: int | None, **what: object) -> Judged:
        """Put a sample in, and check what holds for any."""
        fault, joints = self.gate.fault, what.get("joints", BOTH)
        silence = self.taken_at is not None and self.now - self.taken_at >= TIMEOUT
        judged = self.gate.sample(stamp, self.now, **what)
        if fault or silence:
            assert judged.action is Action.REFUSE
            assert self.gate.fault
        if judged.action is Action.TAKE:
            assert not self.gate.fault
            assert not what.get("unusable")
            assert what.get("heard", True) or self.joints is not None
            assert self.joints in (None, joints)
            arrived = 0 if self.taken_at is None else self.now - self.taken_at
            assert 0 <= judged.elapsed <= arrived + TIMEOUT
            assert bool(judged.reason) <= (self.taken_at is not None)
            self.taken_at, self.taken_stamp, self.joints = self.now, stamp, joints
        elif judged.action is Action.REPEAT:
            assert stamp == self.taken_stamp
        if self.gate.fault is Fault.SECOND_DRIVE and not fault:
            assert self.strangers >= 3
        return judged

    def regular(self) -> Judged:
        self.now += PERIOD
        self.stamp += PERIOD
        return self.put(self.stamp, joints=self.joints or BOTH)

    @rule(wait=waits)
    def time_passes(self, wait: int) -> None:
        self.now += wait
        self.stamp += wait

    @rule()
    def sample(self) -> None:
        before = self.gate.waiting
        judged = self.regular()
        assert before or judged.action is not Action.REPEAT

    @rule(count=st.integers(1, 40))
    def samples(self, count: int) -> None:
        judged = [self.regular().action for _ in range(count)]
        assert self.gate.fault or count < 3 or judged[-1] is Action.TAKE

    @rule(jump=jumps)
    def clock_jumps(self, jump: int) -> None:
        """Whatever it does, two samples later the loop goes on, and nobody is taken for a second drive."""
        self.stamp += jump
        judged = [self.regular().action for _ in range(3)]
        assert self.gate.fault or judged[-1] is Action.TAKE

    @rule()
    def sample_without_a_stamp(self) -> None:
        self.now += PERIOD
        assert self.gate.fault or self.put(None, joints=self.joints or BOTH).action in (Action.TAKE, Action.REFUSE)

    @precondition(sample_was_taken)
    @rule(wait=short_waits)
    def repeat(self, wait: int) -> None:
        self.now += wait
        before = self.gate.dropped
        judged = self.put(self.taken_stamp, joints=self.joints)
        assert judged.action in (Action.REPEAT, Action.REFUSE) or self.gate.stamp is None
        if judged.action is Action.REPEAT:  # nothing is lost, and nobody is warned
            assert (judged.reason, self.gate.dropped) == ("", before)

    @rule(why=st.sampled_from(["unusable", "joints"]))
    def bad_sample(self, why: str) -> None:
        self.now += PERIOD
        self.stamp += PERIOD
        if why == "unusable":
            judged = self.put(self.stamp, unusable="position is not finite")
        else:
            judged = self.put(self.stamp, joints=(False, True) if (self.joints or BOTH) == BOTH else BOTH)
        assert judged.action is not Action.TAKE or self.joints == (False, True) or why == "joints"

    @rule(lag=st.integers(1, TIMEOUT - 1), count=st.integers(1, 6))
    def second_drive(self, lag: int, count: int) -> None:
        """Another drive answers to the same names, its clock a little behind."""
        lag = min(lag, PERIOD - 1)
        begun = self.gate.begun and not self.gate.waiting
        for _ in range(count):
            self.regular()
            self.strangers += 1
            self.put(self.stamp - lag, joints=self.joints or BOTH)
        self.regular()
        assert not begun or count < 4 or self.gate.fault

    @precondition(sample_was_taken)
    @rule()
    def same_stamp_other_values(self) -> None:
        self.strangers += 1
        self.gate.sample(self.stamp + 1, self.now, joints=self.joints, content=b"a")
        before = self.gate.dropped
        judged = self.gate.sample(self.stamp + 1, self.now, joints=self.joints, content=b"b")
        if judged.action is Action.REPEAT:
            assert judged.reason
            assert self.gate.dropped == before + 1
        assert judged.action in (Action.REPEAT, Action.REFUSE) or self.gate.waiting
        self.stamp += 1
        if self.gate.stamp == self.stamp:
            self.taken_at, self.taken_stamp = self.now, self.stamp

    @rule()
    def nobody_listens(self) -> None:
        self.now += PERIOD
        self.stamp += PERIOD
        begun = self.gate.begun
        judged = self.put(self.stamp, joints=self.joints or BOTH, heard=False)
        assert begun or self.gate.fault or judged.action is Action.IGNORE

    @rule()
    def watchdog(self) -> None:
        silence = self.taken_at is not None and self.now - self.taken_at >= TIMEOUT
        self.gate.silent(self.now)
        assert not silence or self.gate.fault

    @rule()
    def reset(self) -> None:
        """After it the next sample is taken, whatever was."""
        self.gate.open()
        self.opened()
        assert self.regular().action is Action.TAKE

    @invariant()
    def a_fault_says_why(self) -> None:
        assert bool(self.gate.fault) == bool(self.gate.why)


class Commands(RuleBasedStateMachine):
    """A drive that sends samples, a controller whose answers may come late, lost or wrong, and others beside it.

    Every command has a value of its own, by which the model knows where the motor's came from.
    """

    lockstep = False

    def __init__(self) -> None:
        super().__init__()
        self.gate = CountedCommandGate(TIMEOUT, lockstep=self.lockstep)
        self.gate.open()
        self.now, self.stamp, self.value = 1_000 * MS, 50_000 * MS, 0.0
        self.born: dict[float, int] = {}
        self.sent: dict[int, int] = {}
        self.answers: dict[int, int] = {}
        self.newest: int | None = None
        self.last_answer: int | None = None
        self.in_force = 0.0

    def new_value(self, born: int) -> float:
        self.value += 1.0
        self.born[self.value] = born
        return self.value

    def send(self) -> None:
        self.stamp += PERIOD
        self.gate.sent(self.stamp, self.now)
        self.sent[self.stamp], self.newest = self.now, self.stamp
        self.answers[self.stamp] = 0

    def note(self, sample: int) -> None:
        """Take down an answer, of whatever value, in so far as it counts."""
        if not self.lockstep or (sample == self.newest and self.gate.waiting):
            self.answers[sample] += 1
            self.last_answer = max(self.last_answer or 0, self.sent[sample])

    def answer(self, sample: int) -> None:
        expired = self.in_force and not self.lockstep and self.now - self.born[self.in_force] >= TIMEOUT
        again = self.answers[sample] > 0
        self.note(sample)
        self.gate.command([self.new_value(self.sent[sample])], sample, self.now)
        assert not expired or self.gate.fault
        assert self.gate.fault or not again or self.now - self.sent[sample] >= TIMEOUT
        self.in_force = self.gate.output(self.now)

    @rule(wait=waits)
    def time_passes(self, wait: int) -> None:
        self.now += wait

    @rule()
    def sample(self) -> None:
        self.now += PERIOD
        self.send()

    @rule(count=st.integers(1, 60), late=short_waits)
    def exchange(self, count: int, late: int) -> None:
        for _ in range(count):
            self.now += PERIOD
            self.send()
            self.now += late
            self.answer(self.newest)
            assert self.gate.output(self.now) == (0.0 if self.gate.fault else self.value)

    @precondition(sample_was_sent)
    @rule(back=st.integers(0, 30))
    def old_answer(self, back: int) -> None:
        """An answer to an older sample, or a second one."""
        self.answer_that_waited(list(self.sent)[-1 - min(back, len(self.sent) - 1)])

    @rule(wait=waits)
    def late_answer(self, wait: int) -> None:
        self.now += PERIOD
        self.send()
        self.now += wait
        self.answer_that_waited(self.newest)

    def answer_that_waited(self, sample: int) -> None:
        newest_answered = self.last_answer
        nothing_else = not self.gate.fault and self.in_force == 0.0 and not self.answers[sample]
        self.answer(sample)
        if nothing_else and not self.lockstep and self.now - self.sent[sample] >= TIMEOUT:
            assert not self.gate.fault  # it was refused, and that is all
        if self.gate.output(self.now) == self.value and not self.lockstep:
            assert self.now - self.sent[sample] < TIMEOUT
            assert newest_answered is None or self.sent[sample] >= newest_answered

    @rule()
    def command_without_a_name(self) -> None:
        value = self.new_value(self.now)
        self.gate.command([value], None, self.now)
        if self.lockstep:
            assert self.gate.output(self.now) != value
        else:
            recently = self.last_answer is not None and self.now - self.last_answer < TIMEOUT
            assert self.gate.fault or not recently

    @rule(wrong=st.sampled_from([[math.nan], [math.inf], [-math.inf], [], [math.nan, 1.0]]))
    def bad_command(self, wrong: list[float]) -> None:
        waiting = self.gate.waiting
        if self.newest is not None:
            self.note(self.newest)
        self.gate.command(wrong, self.newest, self.now)
        if not self.lockstep or waiting:
            assert self.gate.fault
            assert self.gate.output(self.now) == 0.0

    @precondition(sample_was_sent)
    @rule(back=st.integers(0, 30))
    def zero(self, back: int) -> None:
        """Nothing is too old for 0."""
        sample = list(self.sent)[-1 - min(back, len(self.sent) - 1)]
        obeyed = not self.lockstep or (sample == self.newest and self.gate.waiting)
        self.note(sample)
        self.gate.command([0.0], sample, self.now)
        assert not obeyed or self.gate.output(self.now) == 0.0

    @rule(jump=jumps)
    def clock_jumps(self, jump: int) -> None:
        self.stamp += jump

    @precondition(sample_was_sent)
    @rule()
    def sent_again(self) -> None:
        """In lockstep, where an answer may have been lost: the second one is no second controller's."""
        self.gate.sent_again()
        self.answers[self.newest] = -1_000

    @rule()
    def reset(self) -> None:
        """After it the next answer is obeyed, whatever was."""
        self.gate.reset()
        self.in_force = self.gate.output(self.now)
        assert self.in_force == 0.0
        self.now += PERIOD
        self.send()
        self.answer(self.newest)
        assert self.gate.output(self.now) == self.value

    @rule()
    def opened(self) -> None:
        self.gate.open()
        self.sent.clear()
        self.answers.clear()
        self.newest = self.last_answer = None
        self.in_force = self.gate.output(self.now)
        assert self.in_force == 0.0

    @invariant()
    def motor(self) -> None:
        """Nothing under a fault, and never what is older than the timeout, or was never commanded."""
        self.in_force = output = self.gate.output(self.now)
        assert bool(self.gate.fault) == bool(self.gate.why)
        assert output == 0.0 or not self.gate.fault
        if output and not self.lockstep:
            assert self.now - self.born[output] < TIMEOUT
            assert self.gate.expires == self.born[output] + TIMEOUT


class LockstepCommands(Commands):
    """The same while time stands still until the newest sample is answered."""

    lockstep = True


@pytest.mark.parametrize("machine", [Samples, Commands])
@pytest.mark.parametrize("steps", [STEPS // 40, pytest.param(STEPS, marks=pytest.mark.grid)])
def test_gate_through_so_many_steps(machine: type[RuleBasedStateMachine], steps: int) -> None:
    gate = CountedSampleGate if machine is Samples else CountedCommandGate
    before = gate.steps
    run_state_machine_as_test(machine, settings=settings(THOROUGH, max_examples=steps // 50))
    assert gate.steps - before >= steps


def test_gate_in_lockstep() -> None:
    run_state_machine_as_test(LockstepCommands, settings=settings(THOROUGH, max_examples=50))


def test_answers_are_obeyed_when_the_clock_of_the_stamps_is_set_back() -> None:
    """By less than the loop has run, so that the new stamps are among the old ones, which are forgotten by now."""
    gate, now = CommandGate(TIMEOUT), 0
    for second in (*range(100, 200), 150):
        now += 10 * MS
        gate.sent(second * 10**9, now)
        assert gate.command([float(second)], second * 10**9, now) == ""
        assert gate.output(now) == second
    assert gate.rejected == 0


def test_answer_from_before_the_clock_of_the_stamps_was_set_back_is_not_obeyed_later() -> None:
    gate, now = CommandGate(TIMEOUT), 0
    for second in (*range(100, 120), *range(20, 40)):
        now += 10**9
        gate.sent(second * 10**9, now)
    assert "older than command_timeout" in gate.command([1.0], 110 * 10**9, now)
    assert gate.output(now) == 0.0


def test_command_without_a_name_after_a_new_start_is_no_second_controller_s() -> None:
    """The answers of the controller before it do not count any more."""
    gate = CommandGate(TIMEOUT)
    gate.sent(0, 0)
    assert gate.command([1.0], 0, 0) == ""
    gate.open()
    assert gate.command([2.0], None, MS) == ""
    assert (gate.fault, gate.output(MS)) == (Fault.NONE, 2.0)


def test_every_fault_is_in_the_table_with_a_meaning_and_a_remedy() -> None:
    assert set(FAULTS) == set(Fault) - {Fault.NONE}
    for meaning, remedy in FAULTS.values():
        assert meaning.endswith(".")
        assert remedy.endswith(".")
