"""The gate of samples: positions that begin again, joints in messages of their own, two publishers, no stamps."""

import math
from collections.abc import Iterator, Sequence

import pytest

from backlash_ros.gates import Action, Fault, Judged, Publishers, SampleGate
from backlash_ros.gates.positions import Position

MS = 10**6
PERIOD, TIMEOUT = 4 * MS, 100 * MS
TURN = 2 * math.pi
MOTOR, LOAD, BOTH = (True, False), (False, True), (True, True)
FASTEST = 1470.0, 147.0  # rad/s, of the nominal drive


class Loop:
    """A gate with its clock; stamps are of a clock that is 50 s ahead."""

    def __init__(self, wraps: tuple[float, float] = (0.0, 0.0)) -> None:
        self.gate = SampleGate(TIMEOUT, PERIOD * 3 // 2, wraps=wraps)
        self.gate.fastest = FASTEST
        self.now = 1_000 * MS
        self.values = [0.0, 0.0]

    @property
    def stamp(self) -> int:
        return self.now + 50_000 * MS

    def wait(self, periods: int = 1) -> "Loop":
        self.now += periods * PERIOD
        return self

    def put(self, motor: float = math.nan, load: float = math.nan, *, stamp: int | None = 0, **what: object) -> Judged:
        self.values = [motor, load]
        joints = not math.isnan(motor), not math.isnan(load)
        return self.gate.sample(
            self.stamp if stamp == 0 else stamp, self.now, joints=joints, values=self.values, **what
        )

    def holds(self, motor: float = 0.0, load: float = 0.0) -> "Loop":
        assert self.put(motor, load).action is Action.TAKE
        return self


def wrapped(angle: float, size: float = TURN) -> float:
    return (angle + size / 2) % size - size / 2


def test_position_that_begins_again_goes_on_if_the_gate_is_told() -> None:
    loop = Loop((TURN, TURN))
    for k in range(3000):
        load = 2e-3 * k * math.sin(1e-3 * k)
        motor = 10.0 * load
        loop.wait()
        assert loop.put(wrapped(motor), wrapped(load)).action is Action.TAKE
        assert loop.values == pytest.approx([motor, load], abs=1e-9)


@pytest.mark.parametrize("lost", range(1, 20))
def test_lost_samples_lose_no_turn_of_a_motor_at_speed(lost: int) -> None:
    """At 300 rad/s it turns by a fifth of a turn each sample."""
    loop = Loop((TURN, 0.0))
    for k in (0, 1, 2, 2 + lost, 3 + lost):
        loop.now = 1_000 * MS + k * PERIOD
        motor = 300.0 * 0.004 * k
        assert loop.put(wrapped(motor), 0.1 * motor).action is Action.TAKE
        assert loop.values[0] == pytest.approx(motor)


def test_turns_are_counted_on_while_a_fault_is_latched() -> None:
    """Somebody turns the load by hand."""
    loop = Loop((0.0, TURN)).holds()
    loop.wait(1000).put(0.0, 0.0)
    assert loop.gate.fault is Fault.NO_SAMPLES
    for k in range(100):
        assert loop.wait().put(0.0, wrapped(0.1 * k)).action is Action.REFUSE
    loop.gate.open()
    assert loop.wait().holds(0.0, wrapped(10.0)).values[1] == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("before", "after", "what"),
    [
        (3.14, -3.13, "by about one turn: the position begins again"),
        (-3.1, 3.16, "by about one turn: the position begins again"),
        (6.28, 0.01, "by about one turn: the position begins again"),
        (1.0, 1.0 - TURN, "by about one turn: the position begins again"),
        (180.0, -179.9, "by about 360: the position is in degrees, not in rad, and begins again"),
        (359.9, 0.1, "by about 360: the position is in degrees"),
        (50.26, -50.26, "by about the range of a counter: the position begins again"),
        (16 * TURN, 0.002, "by about the range of a counter: the position begins again"),
        (51.4, -51.4, "by about the range of a counter: the position begins again"),  # 16 bits of 4000 counts a turn
    ],
)
@pytest.mark.parametrize("side", ["motor", "load"])
def test_jump_by_a_range_is_named_as_what_it_is(side: str, before: float, after: float, what: str) -> None:
    loop = Loop()
    positions = [(before, 0.0), (before, 0.0), (after, 0.0)]
    judged = [loop.wait().put(*(pair if side == "motor" else pair[::-1])) for pair in positions]
    assert [each.action for each in judged] == [Action.TAKE, Action.TAKE, Action.REFUSE]
    assert loop.gate.fault is (Fault.MOTOR_JUMP if side == "motor" else Fault.LOAD_JUMP)
    assert loop.gate.why.startswith(f"{side} went from {before:.4g} to {after:.4g} rad within 0.004 s, {what}")
    assert loop.gate.why.endswith(f"publish it continuously, or set {side}_wrap")


def test_turn_at_speed_is_named_too() -> None:
    loop = Loop()
    for k in range(3):
        loop.wait().holds(1.2 * k)
    assert loop.wait().put(1.2 * 3 - TURN, 0.0).action is Action.REFUSE
    assert "one turn" in loop.gate.why


@pytest.mark.parametrize("jump", [0.5, -1.0, 3.0, 20.0, -150.0])
def test_other_jumps_are_left_to_the_monitor(jump: float) -> None:
    loop = Loop().holds(1.0, 1.0)
    assert loop.wait().put(1.0, 1.0 + jump).action is Action.TAKE


def test_motion_is_never_taken_for_a_turn() -> None:
    """At the highest speed that the monitor lets pass, and where samples are lost."""
    loop = Loop()
    for periods in (1, 1, 2, 1, 10, 20, 1):
        loop.wait(periods).holds(1469.0 * 1e-9 * loop.now, 146.9 * 1e-9 * loop.now)


def test_motion_in_degrees_through_zero_is_not_named_a_position_that_begins_again() -> None:
    """It goes from one side of zero to the other, as a counter that overflows does, but the way it moves."""
    position = Position()
    for angle in (-17.0, -15.5, -5.638, 6.095):
        position.take(angle, 10 * MS, 80.0)
        assert not position.jump
    position.take(-6.3, 10 * MS, 80.0)
    assert "the range of a counter" in position.jump


def test_first_sample_after_a_reset_may_be_anywhere() -> None:
    loop = Loop().holds(0.0, 3.14)
    loop.wait().put(0.0, -3.14)
    assert loop.gate.fault is Fault.LOAD_JUMP
    loop.gate.open()
    assert loop.wait().put(0.0, -3.14 + TURN).action is Action.TAKE


# Joints in messages of their own.


def halves(loop: Loop, order: str = "ml", lag: int = 0) -> list[Judged]:
    """Put motor and load of one stamp, the position of each its time in seconds."""
    stamp, judged = loop.stamp, []
    for joint in order:
        judged.append(loop.put(**{"motor" if joint == "m" else "load": 1e-9 * loop.now}, stamp=stamp))
        loop.now += lag
    return judged


def started(order: str = "ml") -> Loop:
    loop = Loop()
    for _ in range(3):
        halves(loop.wait(), order)
    assert loop.gate.begun
    return loop


@pytest.mark.parametrize("order", ["ml", "lm"])
def test_motor_and_load_of_one_stamp_are_one_sample(order: str) -> None:
    loop = started(order)
    for turn in range(50):
        first, second = halves(loop.wait(), order if turn % 3 else order[::-1])
        assert (first.action, second.action, second.elapsed) == (Action.IGNORE, Action.TAKE, PERIOD)
        assert not any(map(math.isnan, loop.values))
    assert loop.gate.dropped == loop.gate.late == 0


def test_a_value_is_never_held_over_to_another_stamp() -> None:
    """The load's message is lost now and then: the sample is lost with it, and nothing is answered."""
    loop = started()
    for turn in range(100):
        loop.wait()
        if turn % 3:
            assert halves(loop)[-1].action is Action.TAKE
            assert loop.values[0] == loop.values[1]
        else:
            assert loop.put(motor=1e-9 * loop.now).action is Action.IGNORE
    assert not loop.gate.fault
    assert loop.gate.dropped >= 33
    assert loop.gate.last_dropped == "one of the joints without the other one of the same stamp"


def test_messages_of_two_samples_may_cross() -> None:
    loop = started()
    for _ in range(20):
        first, second = loop.wait().stamp, loop.wait().stamp
        ways = [{"motor": 1.0}, {"motor": 2.0}, {"load": 0.1}, {"load": 0.2}]
        judged = [
            loop.put(**way, stamp=stamp).action for way, stamp in zip(ways, (first, second, first, second), strict=True)
        ]
        assert judged == [Action.IGNORE, Action.IGNORE, Action.TAKE, Action.TAKE]
        assert loop.values == [2.0, 0.2]
    assert not loop.gate.fault


@pytest.mark.parametrize("left", ["motor", "load"])
def test_one_driver_that_dies_is_silence(left: str) -> None:
    loop = started()
    end = loop.now + TIMEOUT
    while loop.now + PERIOD < end:
        assert loop.wait().put(**{left: 0.0}).action is Action.IGNORE
    assert loop.wait().put(**{left: 0.0}).action is Action.REFUSE
    assert loop.gate.fault is Fault.NO_SAMPLES
    assert "only one of the joints without the other one of the same stamp" in loop.gate.why


def test_a_clock_that_is_set_back_does_not_stop_the_joints() -> None:
    loop = started()
    for jump in (-3600 * 10**9, 3600 * 10**9):
        taken = 0
        for k in range(10):
            stamp = loop.wait().stamp + (jump if jump < 0 else 0)
            loop.put(motor=0.0, stamp=stamp)
            taken += loop.put(load=0.0, stamp=stamp).action is Action.TAKE
            assert taken > k - 2
        assert not loop.gate.fault


def test_a_message_that_comes_again_is_answered_again() -> None:
    """As in lockstep, where the drive waits for the answer."""
    loop = started()
    stamp = loop.stamp
    assert loop.put(load=5.0, stamp=stamp).action is Action.REPEAT
    assert loop.gate.dropped == 0


@pytest.mark.parametrize(("apart", "why"), [(MS, "have different stamps"), (None, "are not stamped")])
def test_joints_that_do_not_fit_together_are_a_fault_before_a_position_is_held(apart: int | None, why: str) -> None:
    loop = Loop()
    for _ in range(40):
        stamp = loop.wait().stamp
        for joint, late in (("motor", 0), ("load", apart)):
            judged = loop.put(**{joint: 0.0}, stamp=None if apart is None else stamp + (late or 0))
            assert judged.action in (Action.IGNORE, Action.REFUSE)
    assert loop.gate.fault is Fault.JOINTS_APART
    assert f"joints 'motor' and 'load' come in separate messages, which {why}" in loop.gate.why
    assert not loop.gate.begun


@pytest.mark.parametrize(("joint", "joints"), [("motor", MOTOR), ("load", LOAD)])
def test_drive_with_one_encoder_begins_after_a_moment(joint: str, joints: Sequence[bool]) -> None:
    loop = Loop()
    began = loop.now
    while loop.wait().put(**{joint: 0.0}).action is Action.IGNORE:
        assert loop.now - began < TIMEOUT
    assert loop.gate.begun
    assert loop.wait().put(**{joint: 0.1}).action is Action.TAKE


def test_joint_that_comes_after_the_loop_began_with_the_other_alone_is_a_fault_and_a_reset_begins_with_both() -> None:
    loop = Loop()
    for _ in range(30):
        loop.wait().put(load=0.0)
    assert loop.gate.begun
    assert halves(loop.wait())[0].action is Action.REFUSE
    assert loop.gate.fault is Fault.JOINTS_APART
    assert "joint 'motor' comes in messages of its own, but the loop has begun with 'load' alone" in loop.gate.why
    loop.gate.open()
    assert [each.action for each in halves(loop.wait())] == [Action.IGNORE, Action.TAKE]


@pytest.mark.parametrize("joint", ["motor", "load"])
def test_reset_begins_with_the_driver_that_is_left(joint: str) -> None:
    loop = started()
    loop.wait(1000).put(**{joint: 0.0})
    assert loop.gate.fault is Fault.NO_SAMPLES
    loop.gate.open()
    began = loop.now
    while loop.wait().put(**{joint: 0.0}).action is Action.IGNORE:
        assert loop.now - began < TIMEOUT
    assert loop.gate.begun


def test_a_joint_that_is_missing_from_whole_messages_is_unusable_as_before() -> None:
    loop = Loop().holds()
    assert loop.wait().put(motor=0.0).action is Action.REFUSE
    assert not loop.gate.fault
    loop.wait().holds()


# Two publishers.


def numbered(start: int, names: Sequence[str] = ("motor", "load")) -> Iterator[tuple[Sequence[str], int]]:
    number = start
    while True:
        yield names, (number := number + 1)


@pytest.mark.parametrize("other", [0, 1, 500, 100_000])
@pytest.mark.parametrize("every", [1, 25, 250])
def test_two_publishers_of_a_joint_are_found_by_the_numbers_of_their_messages(other: int, every: int) -> None:
    publishers, first, second = Publishers(["motor", "load"]), numbered(500), numbered(other, ["load"])
    found, now = "", 0
    for k in range(3 * every):
        now += PERIOD
        found = found or publishers.heard(*next(first), now)
        if k % every == 0:
            found = found or publishers.heard(*next(second), now)
    assert found == "load"


@pytest.mark.parametrize(
    "names", [(["motor"], ["load"]), (["motor", "load"], ["wheel"])], ids=["one each", "another axis"]
)
def test_publishers_of_different_joints_are_fine(names: tuple[list[str], list[str]]) -> None:
    publishers, first, second = Publishers(["motor", "load"]), numbered(500, names[0]), numbered(7, names[1])
    for k in range(1000):
        for each in (first, second):
            assert publishers.heard(*next(each), k * PERIOD) == ""


def test_driver_that_starts_again_is_one_publisher() -> None:
    publishers, now = Publishers(["motor", "load"]), 0
    for _ in range(5):
        driver, now = numbered(0), now + 11 * 10**9
        for _ in range(300):
            assert publishers.heard(*next(driver), now) == ""


@pytest.mark.parametrize(("apart", "fault"), [(2, Fault.SECOND_DRIVE), (300, Fault.NONE)])
def test_stray_samples_are_a_second_drive_only_if_they_come_within_a_second(apart: int, fault: Fault) -> None:
    loop = Loop().holds()
    for _ in range(5):
        for _ in range(apart):
            loop.wait().put(0.0, 0.0)
        loop.put(0.0, 0.0, stamp=loop.stamp - MS)
    assert loop.gate.fault is fault


def test_middleware_that_does_not_number_messages_finds_nobody() -> None:
    publishers = Publishers(["motor"])
    assert [publishers.heard(["motor"], None, k) for k in range(10)] == [""] * 10


def test_no_position_is_held_before_several_publishers_were_listened_to() -> None:
    loop = Loop()
    began = loop.now
    while loop.wait().put(0.0, 0.0, publishers=2).action is Action.IGNORE:
        assert loop.now - began < 10**9
    assert loop.now - began >= 0.4 * 10**9
    loop.gate.open()
    loop.wait().put(0.0, 0.0, publishers=2)
    loop.gate.fail(Fault.SECOND_DRIVE, "two publishers")
    assert loop.wait().put(0.0, 0.0, publishers=2).action is Action.REFUSE


# No stamps.


def test_samples_without_stamps_are_taken_by_their_arrival() -> None:
    loop = Loop()
    for _ in range(10):
        judged = loop.wait().put(0.0, 0.0, stamp=None)
        assert judged.action is Action.TAKE
    assert judged.elapsed == PERIOD
    loop.wait(1000)
    assert loop.put(0.0, 0.0, stamp=None).action is Action.REFUSE
    assert loop.gate.fault is Fault.NO_SAMPLES
