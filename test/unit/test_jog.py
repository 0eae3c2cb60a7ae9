"""Jogging: what is sent while a hand holds a button, how far one press goes, and what ends it."""

import asyncio
import itertools
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from backlash_ros.control.design.choice import Tuning, given_sets
from backlash_ros.dashboard.axis import Answer, Axis, Told
from backlash_ros.dashboard.jog import HELD, SHARES, Hand, abilities, jog
from backlash_ros.drivetrain import NOMINAL_DRIVE

START = Tuning(given_sets({}), 250.0).start({}, NOMINAL_DRIVE).values
VALUES = {**START, "rate": 250.0, "setpoint_timeout": 0.1}
TURN = math.tau  # limits.step by default


@dataclass
class Follower:
    """An axis whose setpoint is what was sent for now, or for a moment ago, and stands where nothing was."""

    told: Told = field(default_factory=lambda: Told(1, dict(VALUES)))
    at: float = 0.0
    follows: bool = True
    held: float = math.nan
    aimed: float = -math.inf
    silent: float = 0.0
    unused: float = 0.0
    lifecycle: str = "active"
    simulated: bool = False
    changes: dict[str, float] = field(default_factory=dict)
    sent: list[tuple[float, list[float]]] = field(default_factory=list)

    @property
    def time(self) -> float:
        return time.monotonic()

    @property
    def last_state(self) -> dict[str, float]:
        past = [state for when, state in self.sent if when <= self.time]
        goes_on = bool(self.sent) and self.sent[-1][0] > self.time and math.isnan(self.held)
        position, velocity = (past[-1][0], past[-1][1] if goes_on else 0.0) if past and self.follows else (self.at, 0.0)
        state = {"time": self.time, "holding": 1.0, "experiment": 0.0, "setpoint": position}
        return {**state, "setpoint_velocity": velocity, **self.changes}

    def aim(self, when: float, setpoint: list[float]) -> None:
        over = bool(self.sent) and self.time > self.sent[-1][0]
        pause, self.aimed = self.time - self.aimed, self.time
        if not over or (pause > VALUES["setpoint_timeout"] and setpoint[1] == 0.0):
            self.sent.append((when, setpoint))

    async def call(self, service: str) -> Answer:
        assert service == "hold"
        self.held = self.time
        return Answer(True, "")


Play = Callable[..., str]


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch) -> Play:
    """Hold a button, in a time that goes on where the jog sleeps; return why it ended.

    ``each`` is called then, with the time since the press, s, and returns whether the page says that it holds. It holds
    until ``lets_go``. ``stalls``: time for which the page's process stands still, s, by the number of the sleep.
    """
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])

    def played(
        axis: Follower,
        way: int = 1,
        share: float = 0.1,
        *,
        each: Callable[[float], bool] = lambda _: True,
        lets_go: Callable[[], bool] = lambda: False,
        stalls: Mapping[int, float] | None = None,
    ) -> str:
        hand, begun, count = Hand(), now[0], 0

        async def sleep(seconds: float) -> None:
            nonlocal count
            count += 1
            now[0] += (stalls or {}).get(count, seconds)
            assert now[0] < begun + 60.0
            if lets_go():
                hand.let_go()
            elif each(now[0] - begun):
                hand.sign()

        monkeypatch.setattr(asyncio, "sleep", sleep)
        return asyncio.run(jog(cast("Axis", axis), way, share, hand))

    return played


@pytest.mark.parametrize("way", [1, -1])
def test_it_moves_while_it_is_held_and_is_held_where_it_is_let_go(play: Play, way: int) -> None:
    axis = Follower(at=0.7)
    assert play(axis, way, lets_go=lambda: way * (axis.last_state["setpoint"] - 0.7) > 0.5) == ""
    assert axis.held == pytest.approx(axis.aimed, abs=0.05)
    speeds = [way * velocity for _, (_, velocity, _) in axis.sent]
    assert speeds[0] == 0.0  # from rest
    assert max(speeds) == pytest.approx(0.1 * abilities(VALUES).velocity)
    assert min(speeds) >= 0.0
    assert max(when for when, _ in axis.sent) < axis.held + 0.3  # no more is known to the controller


@pytest.mark.parametrize("what", ["the page", "the drive", "a fault", "an experiment", "parameters"])
def test_whatever_is_lost_ends_it(play: Play, what: str) -> None:
    axis = Follower()

    def each(passed: float) -> bool:
        if passed < 0.3:
            return True
        if what == "the drive":
            axis.silent = 1.0
        elif what == "a fault":
            axis.changes["holding"] = 0.0
        elif what == "an experiment":
            axis.changes["experiment"] = 1.0
        elif what == "parameters":
            axis.told = Told(2, axis.told.values)
        return what != "the page"

    begun = axis.time
    says = {"the page": "did not answer", "the drive": "no joint states", "a fault": "holds no position"}
    assert says.get(what, what) in play(axis, each=each)
    assert axis.aimed < begun + 0.3 + (HELD if what == "the page" else 0.05)
    assert not math.isnan(axis.held)


def test_one_press_moves_a_turn_at_most_whatever_lies_on_the_key(play: Play) -> None:
    axis = Follower(at=1.0)
    assert play(axis, share=1.0).startswith("one press moves the load to 7.28319 rad")
    assert axis.sent[-1][1][0] == pytest.approx(1.0 + TURN)
    assert max(position for _, (position, _, _) in axis.sent) < 1.0 + TURN + 1e-9


def test_it_comes_to_rest_at_the_end_of_the_travel(play: Play) -> None:
    axis = Follower(told=Told(1, {**VALUES, "limits.position_lower": -0.2, "limits.position_upper": 0.3}))
    assert "the end of the travel" in play(axis, -1)
    assert axis.sent[-1][1][:2] == pytest.approx([-0.2, 0.0])
    assert min(position for _, (position, _, _) in axis.sent) >= -0.2 - 1e-9


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"setpoint_timeout": 10.0}, "setpoint_timeout must be <= 0.5 s, got 10 s"),
        ({"gear.reduction": None}, "another version"),
    ],
)
def test_nothing_is_sent_with_parameters_that_would_not_let_it_stop(play: Play, change: Any, why: str) -> None:
    axis = Follower(told=Told(1, {**VALUES, **change}))
    assert why in play(axis)
    assert not axis.sent


def test_a_controller_that_follows_something_else_is_not_asked_again(play: Play) -> None:
    axis = Follower(follows=False)
    assert play(axis).startswith("the controller does not follow")
    assert axis.sent[-1][0] - axis.sent[0][0] < 1.0


def test_a_process_that_was_held_up_begins_again_within_the_same_press(play: Play) -> None:
    """Not with a leap: the load has come to rest meanwhile; and no farther than one press goes."""
    axis = Follower()
    assert play(axis, share=SHARES[3], stalls={20: 0.4}).startswith("one press moves the load to 6.28319 rad")
    assert axis.sent[-1][1][0] == pytest.approx(TURN)
    rests = [when for when, (_, velocity, _) in axis.sent if velocity == 0.0]
    assert axis.sent[0][0] < rests[1] < axis.sent[-1][0] - 0.5
    ways = [after[1][0] - before[1][0] for before, after in itertools.pairwise(axis.sent)]
    assert max(ways) < 0.3 * abilities(VALUES).velocity * 0.05
    assert min(ways) > -1e-9


def test_a_sign_that_comes_too_late_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 5.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    hand = Hand()
    now += 0.9 * HELD
    hand.sign()
    now += 0.9 * HELD
    assert hand.holds
    assert hand.lost == ""
    now += 0.2 * HELD
    hand.sign()
    assert not hand.holds
    assert "did not answer" in hand.lost
    hand.let_go()
    assert hand.lost == ""
