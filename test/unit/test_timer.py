"""Beats on a clock of the test's own: none is made up for, phases are kept, and nobody starves."""

import pytest

from backlash_ros.ros import timer
from backlash_ros.ros.timer import Timer, call_due


class Clock:
    """A steady clock that goes where it is put."""

    at = 100.0

    def __call__(self) -> float:
        return self.at


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(timer, "now", made)
    return made


def test_late_calls_are_left_out_and_the_phase_is_kept(clock: Clock) -> None:
    called: list[float] = []
    made = Timer(0.25, lambda: called.append(clock.at))
    for clock.at in (100.1, 100.25, 100.3, 101.1, 101.15, 101.25, 101.5):
        call_due([made])
    assert called == [100.25, 101.1, 101.25, 101.5]


def test_wait_is_until_the_next_call(clock: Clock) -> None:
    timers = [Timer(0.5, lambda: None), Timer(0.25, lambda: None)]
    assert call_due(timers) == 0.25
    clock.at = 100.25
    assert call_due(timers) == 0.0
    clock.at = 100.375
    assert call_due(timers) == 0.125


def test_calls_of_a_phase_stay_on_it_wherever_they_begin(clock: Clock) -> None:
    clock.at = 100.3
    assert Timer(0.25, lambda: None, 0.0625).due == 100.3125
    clock.at = 100.3125
    assert Timer(0.25, lambda: None, 0.0625).due == 100.5625


def test_the_most_overdue_comes_first_and_all_have_their_turn(clock: Clock) -> None:
    called: list[str] = []
    fast, slow = Timer(0.25, lambda: called.append("fast")), Timer(0.5, lambda: called.append("slow"))
    clock.at = 100.75
    while call_due([fast, slow]) <= 0:
        pass
    assert called == ["fast", "slow"]


def test_a_timer_is_due_again_before_it_calls_back(clock: Clock) -> None:
    seen: list[float] = []
    made = Timer(0.25, lambda: seen.append(made.due))
    clock.at = 100.3
    call_due([made])
    assert seen == [100.5]
