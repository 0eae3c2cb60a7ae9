"""Trajectories mean what they mean to joint_trajectory_controller, and never make the setpoint leap."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from backlash_ros.control import FaultThresholds, GainSet, Limits, Servo, ServoSettings
from backlash_ros.control.motion.setpoint import DURATION, evaluate
from backlash_ros.control.motion.trajectory import START, Trajectory, TrajectoryError, trajectory_of
from backlash_ros.control.tick import tick_constants_at, tick_memory_at
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import Measurement, Setpoint
from backlash_ros.gates.faults import Fault


def setpoint(position: float = 0.0, velocity: float = 0.0, acceleration: float = 0.0) -> Setpoint:
    return Setpoint(np.array([position, velocity, acceleration]))


def at(trajectory: Trajectory, time: float, start: Setpoint | None = None) -> Array:
    return at_time(trajectory.segments(setpoint() if start is None else start), time)


def at_time(plan: Array, time: float) -> Array:
    evaluate(plan, time, out := setpoint())
    return np.array(out)


def points(times: list[float], *columns: list[float], age: float = 0.0) -> Trajectory:
    return Trajectory(np.array(times), np.array(columns).T, age)


def message(
    times: tuple[float, ...] = (1.0, 2.0), names: tuple[str, ...] = ("load",), stamp: float = 0.0, **fields: Any
) -> Any:
    """Return what has the fields of a JointTrajectory; ``fields``: a list for each point."""
    named = {"positions": [[1.0] * len(names)] * len(times)} | fields

    def stamped(time: float) -> Any:
        return SimpleNamespace(sec=math.floor(time), nanosec=round(1e9 * (time - math.floor(time))))

    rows = [
        SimpleNamespace(
            time_from_start=stamped(time),
            **{kind: named.get(kind, [[]] * len(times))[k] for kind in (*KINDS, "effort")},
        )
        for k, time in enumerate(times)
    ]
    return SimpleNamespace(header=SimpleNamespace(stamp=stamped(stamp)), joint_names=list(names), points=rows)


KINDS = "positions", "velocities", "accelerations"


def test_positions_alone_are_joined_by_straight_lines_from_the_setpoint() -> None:
    path = points([1.0, 3.0], [1.0, 0.0])
    np.testing.assert_allclose(at(path, 0.5, setpoint(0.5)), [0.75, 0.5, 0.0])
    np.testing.assert_allclose(at(path, 2.0), [0.5, -0.5, 0.0])
    np.testing.assert_array_equal(at(path, 9.0), [0.0, 0.0, 0.0])


def test_velocities_make_cubics() -> None:
    path = points([1.0, 2.0], [1.0, 2.0], [1.0, 0.0])
    np.testing.assert_allclose(at(path, 1.0 - 1e-9)[:2], [1.0, 1.0], atol=1e-6)
    assert at(path, 0.5)[0] == pytest.approx(0.375)  # a cubic from rest at 0 to 1 rad and 1 rad/s: 2 t^2 - t^3


def test_accelerations_make_quintics_that_begin_with_the_setpoint() -> None:
    path, start = points([1.0, 2.0], [1.0, 2.0], [1.0, 0.0], [0.5, 0.0]), setpoint(0.2, -0.3, 4.0)
    np.testing.assert_allclose(at(path, 0.0, start), start, atol=1e-12)
    np.testing.assert_allclose(at(path, 1.0 - 1e-9, start), [1.0, 1.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(at(path, 1.0 + 1e-9, start), [1.0, 1.0, 0.5], atol=1e-6)


def test_points_that_are_past_are_left_out_and_not_hurried_through() -> None:
    path = points([1.0, 2.0, 4.0], [5.0, 7.0, 1.0], age=2.5)
    rows = path.segments(setpoint())
    np.testing.assert_allclose(rows[:, DURATION], [1.5])
    np.testing.assert_allclose(at(path, 0.75), [0.5, 1.0 / 1.5, 0.0])


def test_a_trajectory_that_starts_later_is_reached_when_its_first_point_is_due() -> None:
    path = points([0.0, 1.0], [1.0, 2.0], age=-2.0)
    np.testing.assert_allclose(path.segments(setpoint())[:, DURATION], [2.0, 1.0])
    assert at(path, 2.0)[0] == pytest.approx(1.0)


def test_a_first_point_due_at_once_is_where_the_setpoint_is() -> None:
    path = points([0.0, 1.0], [0.01, 1.0])
    np.testing.assert_allclose(at(path, 0.0), [0.0, 1.0, 0.0])  # from the setpoint, not with a leap to the point
    with pytest.raises(
        TrajectoryError, match=r"positions of point 0, .* within 0.05 rad of the setpoint, 1 rad, got 0"
    ):
        points([0.0, 1.0], [0.0, 1.0]).segments(setpoint(1.0))
    np.testing.assert_array_equal(at(points([0.0], [START]), 7.0), [START, 0.0, 0.0])


@pytest.mark.parametrize(
    ("times", "columns", "age", "text"),
    [
        ([], [[]], 0.0, "at least one point"),
        ([1.0, 1.0], [[0.0, 1.0]], 0.0, r"time_from_start of point 1 must be > 1 s, .* got 1 s"),
        ([-1.0, 1.0], [[0.0, 1.0]], 0.0, r"time_from_start of point 0 must be >= 0 s, got -1"),
        ([1.0, math.nan], [[0.0, 1.0]], 0.0, "time_from_start of point 1 must be finite"),
        ([1.0, 2.0], [[0.0, math.inf]], 0.0, "positions of point 1 must be finite, got inf"),
        ([1.0, 2.0], [[0.0, 1.0], [math.nan, 0.0]], 0.0, "velocities of point 0 must be finite"),
        ([1.0, 2.0], [[0.0, 1.0], [0.0, 0.1]], 0.0, "velocities of the last point must be 0 rad/s, got 0.1"),
        ([1.0, 2.0], [[0.0, 1.0]], 2.5, "must not end in the past, got an end 0.5 s ago"),
        ([1.0, 2.0], [[0.0, 1.0]], math.inf, "the start of a trajectory must be finite"),
    ],
)
def test_what_cannot_be_followed_is_refused(
    times: list[float], columns: list[list[float]], age: float, text: str
) -> None:
    with pytest.raises(TrajectoryError, match=text):
        points(times, *columns, age=age)


def test_a_message_gives_each_axis_its_own_joint() -> None:
    sent = message(names=("other", "load"), positions=[[9.0, 1.0], [9.0, 2.0]], velocities=[[9.0, 0.5], [9.0, 0.0]])
    path = trajectory_of(sent, "load", now=100 * 10**9)
    np.testing.assert_array_equal(path.times, [1.0, 2.0])
    np.testing.assert_array_equal(path.states, [[1.0, 0.5], [2.0, 0.0]])
    assert path.age == 0.0
    assert trajectory_of(message(stamp=98.5), "load", now=100 * 10**9).age == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"names": ("motor",)}, r"joint_names must contain 'load', got \['motor'\]"),
        ({"names": ("load", "load")}, "name each joint once, got load"),
        ({"times": ()}, "at least one point"),
        ({"positions": [[1.0], []]}, "positions of point 1 must have 1 values, got 0"),
        ({"positions": [[1.0], [1.0, 2.0]]}, "positions of point 1 must have 1 values, got 2"),
        ({"positions": [[], []], "velocities": [[1.0], [0.0]]}, r"points must have positions, .* got \['velocities'\]"),
        ({"accelerations": [[1.0], [0.0]]}, "velocities to have accelerations"),
        ({"velocities": [[], [0.0]]}, "velocities of point 1 must have 0 values, got 1"),
        ({"effort": [[1.0], []]}, "effort of point 0 must be empty"),
        ({"stamp": 90.0}, "must not end in the past, got an end 8 s ago"),
    ],
)
def test_a_message_that_does_not_fit_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(TrajectoryError, match=text):
        trajectory_of(message(**changes), "load", now=100 * 10**9)


_number = st.floats(-10.0, 10.0)


@settings(max_examples=200, deadline=None)
@given(
    steps=st.lists(st.floats(1e-3, 5.0), min_size=1, max_size=6),
    kinds=st.integers(1, 3),
    age=st.floats(-3.0, 10.0),
    start=st.tuples(_number, _number, _number),
    data=st.data(),
)
def test_the_setpoint_is_continuous_whatever_comes(
    steps: list[float], kinds: int, age: float, start: tuple[float, float, float], data: st.DataObject
) -> None:
    """As many derivatives are continuous as are given; the end is the last point, at rest."""
    times = np.cumsum(steps)
    states = np.array([[data.draw(_number) for _ in range(kinds)] for _ in times])
    states[-1, 1:] = 0.0
    assume(age not in times)
    if times[-1] < age:
        with pytest.raises(TrajectoryError, match="in the past"):
            Trajectory(times, states, age)
        return
    rows = Trajectory(times, states, age).segments(setpoint(*start))
    before, off = np.array(start)[:kinds], np.zeros(kinds)
    for row in rows:
        begins, ends = np.polynomial.Polynomial(row[:DURATION]), row[DURATION]
        if math.isinf(ends):
            return
        # Rounding, of each derivative, at either end of a segment.
        rounding = 1e-9 * (1.0 + np.abs(row[:DURATION] * ends ** np.arange(DURATION)).sum()) / ends ** np.arange(kinds)
        for k in range(kinds):
            assert (begins.deriv(k) if k else begins)(0.0) == pytest.approx(before[k], abs=off[k] + rounding[k])
        before, off = np.array([(begins.deriv(k) if k else begins)(ends) for k in range(kinds)]), rounding
    assert before[0] == pytest.approx(states[-1, 0], abs=off[0])


# How the servo takes them up


HELD = Measurement(np.array([0.0, 0.0, 0.0, 0.0, 0.0]))
PERIOD = 0.004


def holding(gains: GainSet, **limits: float) -> Servo:
    """Return a servo that holds 0 rad; the load of these tests stays there, so nothing watches it."""
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), **limits), watched=False)
    servo.update(HELD)
    return servo


def test_a_trajectory_goes_on_from_the_setpoint_of_the_newest_sample(gains: GainSet) -> None:
    servo = holding(gains)
    assert servo.follow(points([1.0, 2.0], [1.0, 2.0], [1.0, 0.0]), at_once=True) == ""
    servo.update(HELD)
    assert servo.memory.setpoint[0] == pytest.approx(2.0 * PERIOD**2 - PERIOD**3)  # a period after it came
    assert servo.reference == 2.0


@pytest.mark.parametrize("replacements", [300, pytest.param(1000, marks=pytest.mark.grid)])
def test_replacements_in_flight_never_leap(gains: GainSet, replacements: int) -> None:
    """Position and speed go on from sample to sample, whatever replaces what."""
    servo, random = holding(gains), np.random.default_rng(11)
    seen = []
    for _ in range(replacements):
        times = np.cumsum(random.uniform(0.2, 1.0, size=3))
        states = random.uniform(-1.0, 1.0, size=(3, 3))
        states[-1, 1:] = 0.0
        assert servo.follow(Trajectory(times, states), at_once=True) == ""
        for _ in range(random.integers(1, 40)):
            servo.update(HELD)
            seen.append(servo.memory.setpoint.copy())
    position, speed, acceleration = np.array(seen).T
    largest = 1.01 * np.max(np.abs(acceleration))
    assert np.max(np.abs(np.diff(speed))) <= PERIOD * largest
    assert np.max(np.abs(np.diff(position))) <= PERIOD * (np.max(np.abs(speed)) + PERIOD * largest)


@pytest.mark.parametrize("upper", [10.0, 0.301])
@pytest.mark.parametrize("after", [1, 40, 125])
def test_hold_comes_to_rest_within_the_travel(gains: GainSet, after: int, upper: float) -> None:
    """Amid the motion, at its begin, and where no smooth stop fits before the end of the travel."""
    servo = holding(gains, position_upper=upper)
    assert servo.follow(points([0.5, 0.52], [0.29, 0.3], [1.0, 0.0]), at_once=True) == ""
    for _ in range(after):
        servo.update(HELD)
    before = servo.memory.setpoint.copy()
    assert servo.stop() == ""
    assert before[0] <= servo.reference <= min(upper, before[0] + 0.1)
    for _ in range(100):
        servo.update(HELD)
        assert servo.memory.setpoint[0] <= servo.reference + 1e-9
    np.testing.assert_allclose(servo.memory.setpoint, [servo.reference, 0.0, 0.0])


def test_hold_ends_a_trajectory_that_waits(gains: GainSet) -> None:
    servo = holding(gains)
    assert servo.follow(points([1.0, 2.0], [0.0, 1.0]), at_once=True) == ""
    servo.update(HELD)
    assert servo.stop() == ""
    for _ in range(1000):
        servo.update(HELD)
        assert servo.memory.setpoint[0] == 0.0


def test_hold_stops_a_load_on_its_way_to_a_step(gains: GainSet) -> None:
    servo = holding(gains)
    assert servo.set_reference(1.0) == ""
    moving = Measurement(np.array([2.0, 40.0, 0.2, 4.0, 0.0]))
    servo.update(moving)
    assert servo.stop() == ""
    assert 0.2 < servo.reference < 0.6


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_hold_takes_a_load_that_has_passed_an_end_back_to_it(gains: GainSet, way: float) -> None:
    servo = holding(gains, position_lower=-0.3, position_upper=0.3)
    assert servo.set_reference(0.29 * way) == ""
    servo.update(Measurement(way * np.array([3.1, 40.0, 0.31, 4.0, 0.0])))
    assert servo.stop() == ""
    assert servo.reference == 0.3 * way


@pytest.mark.parametrize("end", [True, False])
def test_hold_says_why_nothing_is_held(gains: GainSet, end: bool) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    if end:
        servo.update(HELD)
        servo.fail(Fault.TRACKING, "away")
    text = "while TRACKING is latched: call reset_fault" if end else "while no position is held"
    assert servo.stop() == f"nothing is held {text}"


@pytest.mark.parametrize(("speed", "by"), [(20.0, "faults.velocity"), (None, "the drive's no-load speed")])
def test_a_path_that_is_too_fast_is_refused(gains: GainSet, speed: float | None, by: str) -> None:
    """It is faster than the drive without load, or than the speed at which the monitor stops the axis."""
    servo = holding(gains)
    if speed is not None:
        thresholds = replace(FaultThresholds.of(NOMINAL_DRIVE), velocity=speed)
        servo.use(replace(servo.settings, thresholds=thresholds))
    fastest = speed or NOMINAL_DRIVE.no_load_speed
    reason = servo.follow(points([0.01], [0.02 * fastest]), at_once=True)
    assert reason == f"path must be slower than {by} = {fastest:.4g} rad/s, got {2.0 * fastest:.4g}"
    assert servo.reference == 0.0
    assert servo.follow(points([0.01], [0.00999 * fastest]), at_once=True) == ""


def test_a_pace_that_changes_at_random_stays_on_the_path_and_within_the_drive(gains: GainSet) -> None:
    """Position, speed and acceleration are those of one motion along the path, and never back."""
    servo, random = holding(gains), np.random.default_rng(7)
    assert servo.follow(points([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [3.0, -1.0, 0.0]), at_once=True, paced=True) == ""
    plan, seen, before = servo.segments, [], 0.0
    planned = np.array([at_time(plan, time) for time in np.linspace(0.0, 3.0, 3001)])
    for k in range(2500):
        if k % 25 == 0:
            assert servo.set_pace(random.choice([0.0, 1.0, random.uniform()])) == ""
        servo.update(HELD)
        assert servo.memory.setpoint[0] == at_time(plan, servo.memory.plan_time)[0]
        assert before <= servo.memory.plan_time <= before + 1.001 * PERIOD
        before = servo.memory.plan_time
        seen.append(servo.memory.setpoint.copy())
    position, speed, acceleration = np.array(seen).T
    able = float(tick_constants_at(servo.constants).motion.acceleration)
    assert np.max(np.abs(acceleration)) <= np.max(np.abs(planned[:, 2])) + able
    assert np.max(np.abs(np.diff(speed))) <= PERIOD * (np.max(np.abs(planned[:, 2])) + able)
    np.testing.assert_allclose(np.diff(position), PERIOD * 0.5 * (speed[1:] + speed[:-1]), atol=2e-4)


@pytest.mark.parametrize("pace", [0.5, 0.02])
def test_a_law_sees_a_slow_path_as_it_will_come(gains: GainSet, pace: float) -> None:
    servo = holding(gains)
    assert servo.follow(points([2.0], [0.5], [0.0]), at_once=True, paced=True) == ""
    assert servo.set_pace(pace) == ""
    for _ in range(100):
        servo.update(HELD)
    seen = tick_memory_at(servo.memory.row).path[:].copy()
    for row in seen[1:]:
        servo.update(HELD)
        np.testing.assert_allclose(servo.memory.setpoint, row, rtol=1e-9, atol=1e-12)


def test_a_path_that_stands_still_goes_on_or_is_held(gains: GainSet) -> None:
    servo = holding(gains)

    def after(samples: int) -> Array:
        for _ in range(samples):
            servo.update(HELD)
        return servo.memory.setpoint.copy()

    assert servo.set_pace(0.0) == ""
    assert servo.follow(points([1.0], [1.0], [0.0]), at_once=True, paced=True) == ""
    stands = after(100)
    assert stands[0] > 0.0
    assert not stands[1:].any()
    np.testing.assert_array_equal(after(500), stands)
    assert not servo.arrived
    assert servo.set_pace(1.0) == ""
    assert after(270)[0] == 1.0
    assert servo.set_pace(0.1) == ""
    assert servo.follow(points([1.0], [2.0], [0.0]), at_once=True, paced=True) == ""
    after(500)
    assert servo.stop() == ""
    assert not after(30)[1:].any()  # a stop is not slowed down
    assert servo.follow(points([1.0], [1.0], [0.0]), at_once=True) == ""
    assert after(251)[0] == 1.0


@pytest.mark.parametrize("pace", [math.nan, -0.01, 1.01, math.inf, 30.0])
def test_a_pace_that_is_no_share_is_refused(gains: GainSet, pace: float) -> None:
    servo = holding(gains)
    assert servo.set_pace(0.5) == ""
    assert servo.set_pace(pace) == f"speed_scaling must be a share from 0 to 1, got {pace:g}"
    assert servo.pace == 0.5


_anything = st.floats() | st.sampled_from([0.0, 1.0, -1.0, 1e-300, 1e300])


@pytest.mark.parametrize("kinds", [pytest.param(kinds, id=str(kinds)) for kinds in (1, 2, 3)])
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=st.lists(st.integers(-1, 2**31) | st.integers(0, 3), min_size=0, max_size=4),
    nanoseconds=st.integers(0, 2**32 - 1),
    stamp=st.integers(0, 2**31),
    data=st.data(),
)
def test_whatever_a_message_says_the_setpoint_stays_sound(
    gains: GainSet, kinds: int, steps: list[int], nanoseconds: int, stamp: int, data: st.DataObject
) -> None:
    """It is followed, or refused with a reason and nothing changes; the setpoint is finite and within the travel."""
    servo = holding(gains, position_lower=-2.0, position_upper=2.0)
    columns = {kind: [[data.draw(_anything)] for _ in steps] for kind in KINDS[:kinds]}
    sent = message(times=tuple(float(time) for time in steps), stamp=0.0, **columns)
    sent.header.stamp = SimpleNamespace(sec=stamp, nanosec=nanoseconds)
    for point in sent.points:
        point.time_from_start.nanosec = nanoseconds
    before = servo.segments.copy()
    try:
        refusal = servo.follow(trajectory_of(sent, "load", now=2**30 * 10**9), at_once=True)
    except TrajectoryError as error:
        refusal = str(error)
    if refusal:
        np.testing.assert_array_equal(servo.segments, before)
    for _ in range(5):
        assert math.isfinite(servo.update(HELD))
        assert np.all(np.isfinite(servo.memory.setpoint))
        assert abs(servo.memory.setpoint[0]) <= 2.0 + 1e-9
