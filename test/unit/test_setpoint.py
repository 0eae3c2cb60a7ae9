"""The setpoint: plans of polynomials, what the tick makes of them, and how the servo takes them up."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from samples import sample_of

from backlash_ros.control import AtRest, GainSet, Limits, Polynomials, Servo, ServoSettings
from backlash_ros.control.motion.setpoint import DURATION, ORDER, evaluate, extent
from backlash_ros.drivetrain import NOMINAL_DRIVE, Plant
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY, PlantState, Setpoint, at_rest
from backlash_ros.simulation import Scenario, run

HELD = np.zeros(5)

ROW = st.tuples(*[st.floats(-10, 10)] * (ORDER + 1), st.floats(0.01, 2.0)).map(list)
ROWS = st.lists(ROW, min_size=1, max_size=4).map(np.array)


def at(rows: np.ndarray, time: float) -> np.ndarray:
    out = np.full(3, math.nan)
    evaluate(np.ascontiguousarray(rows, dtype=float), time, Setpoint(out))
    return out


def quintic(start: float, end: float, duration: float) -> Polynomials:
    """The polynomial of least order that is at rest, without acceleration, at both ends."""
    way = end - start
    row = [start, 0.0, 0.0, *(way * c / duration**k for k, c in ((3, 10.0), (4, -15.0), (5, 6.0))), duration]
    return Polynomials(np.array([row]))


# What the tick makes of a plan


@settings(deadline=None)  # compiles
@given(ROWS, st.floats(0, 0.999))
def test_plan_is_its_polynomials_and_their_derivatives(rows: np.ndarray, share: float) -> None:
    time = share * float(np.sum(rows[:, DURATION]))
    seen, row = at(rows, time), 0
    while row < len(rows) - 1 and time >= rows[row, DURATION]:
        time -= rows[row, DURATION]
        row += 1
    position = Polynomial(rows[row, :DURATION])
    for index, expected in ((POSITION, position), (VELOCITY, position.deriv()), (ACCELERATION, position.deriv(2))):
        scale = float(Polynomial(np.abs(expected.coef))(time)) + 1e-300
        assert abs(seen[index] - float(expected(time))) <= 1e-13 * scale


@settings(deadline=None)  # compiles
@given(ROWS, st.floats(0, 1e6))
def test_after_its_end_a_plan_rests_there(rows: np.ndarray, later: float) -> None:
    duration = float(rows[-1, DURATION])
    end = float(Polynomial(rows[-1, :DURATION])(duration))
    seen = at(rows, float(np.sum(rows[:, DURATION])) * (1 + 1e-12) + later)
    scale = float(Polynomial(np.abs(rows[-1, :DURATION]))(duration))
    assert seen[POSITION] == pytest.approx(end, abs=1e-12 * scale)
    assert seen[VELOCITY] == seen[ACCELERATION] == 0.0


def test_segment_begins_where_the_one_before_ends() -> None:
    rows = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5], [7.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]])
    assert at(rows, 0.5 - 1e-12)[POSITION] == pytest.approx(0.5)
    np.testing.assert_array_equal(at(rows, 0.5), [7.0, 0.0, 2.0])
    np.testing.assert_array_equal(at(rows, 1.5), [8.0, 0.0, 0.0])


@settings(deadline=None)  # compiles
@given(st.floats(-1e6, 1e6), st.floats(0, 1e9))
def test_rest_is_one_position_for_ever(position: float, time: float) -> None:
    segments = AtRest(position).segments(Setpoint(np.array([5.0, 1.0, 1.0])))
    np.testing.assert_array_equal(at(segments, time), [position, 0.0, 0.0])
    assert extent(segments) == (position,) * 4


@settings(deadline=None)  # compiles
@given(ROWS)
def test_extent_is_where_a_plan_goes(rows: np.ndarray) -> None:
    start, end, least, largest = extent(rows)
    assert start == rows[0, 0]
    positions = [Polynomial(row[:DURATION])(np.linspace(0, row[DURATION], 401)) for row in rows]
    seen = np.concatenate(positions)
    assert end == pytest.approx(positions[-1][-1], abs=1e-9)
    curvatures = [Polynomial(np.abs(row[:DURATION])).deriv(2)(row[DURATION]) * row[DURATION] ** 2 for row in rows]
    between = max(curvatures) / 400**2 / 8 + 1e-9  # samples
    assert np.min(seen) - between <= least <= np.min(seen) + 1e-9
    assert np.max(seen) - 1e-9 <= largest <= np.max(seen) + between


def test_extent_of_a_plan_with_powers_that_do_not_count() -> None:
    rows = np.array([[0.0, 1.0, -1.0, 0.0, 1e-310, 5e-324, 1.0]])
    assert extent(rows) == (0.0, pytest.approx(0.0, abs=1e-12), 0.0, pytest.approx(0.25))
    assert extent(np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1e200]]))[2:] == (-math.inf, math.inf)
    assert extent(np.array([[0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 1e200]])) == (0.3,) * 4


def test_last_segment_without_an_end_that_moves_has_no_bound() -> None:
    drifting = np.array([[0.3, 1.0, 0.0, 0.0, 0.0, 0.0, math.inf]])
    assert extent(drifting) == (0.3, math.inf, 0.3, math.inf)
    assert extent(-drifting * [1, 1, 1, 1, 1, 1, -1]) == (-0.3, -math.inf, -math.inf, -0.3)
    assert at(drifting, 100.0)[POSITION] == pytest.approx(100.3)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (np.zeros((0, 7)), r"segments must have the shape \(segments, 7\), got \(0, 7\)"),
        (np.ones((2, 6)), r"segments must have the shape \(segments, 7\), got \(2, 6\)"),
        (np.full((1, 7), math.nan), "segments must be finite"),
        (np.array([[1.0] * 6 + [math.inf], [1.0] * 7]), "segments must be finite"),
        (np.array([[1.0] * 6 + [0.0]]), r"segments must last > 0 s each, got \[0\.0\]"),
        (np.array([[1.0] * 6 + [math.nan]]), r"segments must last > 0 s each, got \[nan\]"),
    ],
)
def test_segments_that_make_no_sense_are_refused(rows: np.ndarray, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Polynomials(rows)


# How the servo takes them up


def holding(gains: GainSet, **limits: float) -> Servo:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), **limits))
    servo.update(HELD)
    return servo


def test_plan_that_leaves_the_travel_is_refused_though_it_ends_inside(gains: GainSet) -> None:
    servo = holding(gains, position_upper=0.5)
    hump = Polynomials(np.array([[0.0, 2.8, -2.6, 0.0, 0.0, 0.0, 1.0]]))  # up to 0.754 rad, ends at 0.2
    assert extent(hump.rows)[1:] == (pytest.approx(0.2), pytest.approx(0.0), pytest.approx(0.7538, abs=1e-4))
    reason = servo.follow(hump)
    assert reason.startswith("reference must be within limits.position_lower = -1e+09 rad and limits.position_upper")
    assert reason.endswith("= 0.5 rad, got 0.753846")
    assert servo.reference == 0.0
    assert servo.update(HELD) == 0.0
    dip = Polynomials(hump.rows * [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    assert servo.follow(dip) == ""
    assert "limits.position_lower = -0.5 rad" in holding(gains, position_lower=-0.5).follow(dip)


def test_plan_without_end_that_moves_is_refused_within_a_travel(gains: GainSet) -> None:
    drifting = Polynomials(np.array([[0.0, 0.1, 0.0, 0.0, 0.0, 0.0, math.inf]]))
    assert "limits.position_upper = 0.5 rad, got inf" in holding(gains, position_upper=0.5).follow(drifting)


def test_plan_that_begins_a_step_away_is_refused(gains: GainSet) -> None:
    servo = holding(gains, step=0.1)
    assert servo.follow(quintic(0.0, 1.0, 0.5)) == ""  # a long way, but none at once
    assert "limits.step = 0.1 rad of 0 rad, got 0.2" in holding(gains, step=0.1).follow(quintic(0.2, 0.3, 0.5))


def test_plan_is_refused_where_nobody_would_follow_it(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    assert servo.follow(quintic(0.0, 1.0, 0.5)) == "reference 1 rad came while no position is held"
    servo.update(HELD)
    servo.start_experiment("limit_cycle")
    assert servo.follow(quintic(0.0, 1.0, 0.5)) == "reference 1 rad came while learning"


@dataclass(frozen=True)
class Onwards:
    """Goes on from where the setpoint stands, and keeps what it was told."""

    starts: list[np.ndarray]

    def segments(self, start: Setpoint) -> np.ndarray:
        self.starts.append(start.copy())
        return quintic(float(start[POSITION]), float(start[POSITION]) + 0.2, 0.1).rows


def test_each_plan_starts_anew_in_time_from_the_present_setpoint(gains: GainSet) -> None:
    servo, source = holding(gains), Onwards([])
    seen = []
    for _ in range(2):
        assert servo.follow(source) == ""
        assert servo.reference == pytest.approx(source.starts[-1][POSITION] + 0.2)
        for _ in range(13):  # half a period before the middle, and half of it over
            servo.update(HELD)
            seen.append(servo.memory.setpoint.copy())
    first, second = np.array(seen[:13]), np.array(seen[13:])
    for k in range(13):
        np.testing.assert_allclose(first[k], at(quintic(0.0, 0.2, 0.1).rows, 0.004 * k), atol=1e-12)
    np.testing.assert_array_equal(source.starts[1], first[-1])
    assert first[-1][VELOCITY] > 0
    np.testing.assert_allclose(second[:, POSITION] - first[-1][POSITION], first[:, POSITION], atol=1e-12)
    np.testing.assert_allclose(second[:, VELOCITY:], first[:, VELOCITY:], atol=1e-9)


def test_plan_goes_on_over_missing_samples(gains: GainSet) -> None:
    servo, plan = holding(gains), quintic(0.0, 1.0, 0.5)
    assert servo.follow(plan) == ""
    servo.update(HELD)
    servo.update(HELD, 0.02)
    servo.update(HELD)
    assert servo.memory.setpoint[POSITION] == pytest.approx(at(plan.rows, 0.024)[POSITION])


def followed(gains: GainSet, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Return tracking error and load angle, sample by sample, on the way to 1 rad and a second there; 0 s: a step."""
    servo, plant = Servo(NOMINAL_DRIVE, ServoSettings(gains, law="fast")), Plant(NOMINAL_DRIVE)
    servo.update(sample_of(plant.state))
    assert (servo.follow(quintic(0.0, 1.0, duration)) if duration else servo.set_reference(1.0)) == ""
    errors, angles = [], []
    for _ in range(round((1.0 + duration) / 0.004)):
        command = servo.update(sample_of(plant.state))
        errors.append(servo.tracking_error)
        angles.append(plant.load_angle)
        plant.advance(command, 0.0, 0.004)
    assert servo.fault == ""
    assert servo.reference == 1.0
    return np.array(errors), np.array(angles)


def test_fast_law_follows_a_quintic_move_closer_than_a_step(gains: GainSet) -> None:
    """To a tenth of a step's error at most, and a seventh in the mean square; then the limit cycle stays."""
    step, angles = followed(gains, 0.0)
    move, moved = followed(gains, 0.5)
    assert np.max(np.abs(step)) == 1.0
    assert np.max(np.abs(move)) < 0.1
    assert np.sqrt(np.mean(move**2)) < np.sqrt(np.mean(step**2)) / 7
    assert np.max(moved) < 1.0 + NOMINAL_DRIVE.gear.backlash_angle
    assert np.max(angles) < 1.0 + NOMINAL_DRIVE.gear.backlash_angle


def test_offline_run_of_a_source_is_what_the_servo_follows(gains: GainSet) -> None:
    plan, count = quintic(0.0, 1.0, 0.4), 150
    choice = ServoSettings(gains, backlash_angle=0.02)
    offline = run(NOMINAL_DRIVE, choice, Scenario(np.zeros(count), source=plan))
    servo, plant = Servo(NOMINAL_DRIVE, choice), Plant(NOMINAL_DRIVE)
    for k in range(count):
        np.testing.assert_allclose(plant.state, offline.state[k], rtol=1e-12, atol=1e-12)
        if k == 0:
            servo.segments = plan.segments(Setpoint(np.zeros(3)))  # before any position is held, as the run has it
        plant.advance(servo.update(sample_of(plant.state)), 0.0, 0.004)


def ramp(rate: float, seconds: float) -> Polynomials:
    """Return a way at an even speed, rad/s, for so many seconds."""
    return Polynomials(np.array([[0.0, rate, 0.0, 0.0, 0.0, 0.0, seconds]]))


def test_plan_goes_on_in_time_where_samples_are_missing(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    servo.update(HELD)
    assert servo.follow(ramp(0.01, 10.0)) == ""
    time = -0.004  # the plan begins with the next sample, whenever that comes
    for elapsed in (0.004, 0.004, 0.02, 0.004, 0.012):
        servo.update(HELD, elapsed)
        time += elapsed
        assert servo.memory.setpoint[POSITION] == pytest.approx(0.01 * time, abs=1e-15)


def test_limits_are_judged_by_all_of_a_plan_that_is_under_way(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    servo.update(HELD)
    there_and_back = Polynomials(np.array([[0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 1.0]]))  # to 0.25 rad at half time
    assert servo.follow(there_and_back) == ""
    narrow = replace(Limits.of(NOMINAL_DRIVE), position_upper=0.2)
    assert "limits.position_upper = 0.2 rad, got 0.25" in servo.rejection_reason(narrow)
    assert servo.rejection_reason(replace(narrow, position_upper=0.3)) == ""
    servo.use(servo.settings, replace(narrow, position_upper=0.3))
    # 0.25 rad and the swing of 0.3
    assert "position_upper = 0.3 rad, got 0.55" in servo.experiment_refusal("limit_cycle")


def test_offline_source_is_planned_from_where_the_load_is_and_within_the_limits(gains: GainSet) -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_upper=0.9)
    with pytest.raises(ValueError, match=r"limits\.position_upper = 0\.9 rad, got 1"):
        run(NOMINAL_DRIVE, ServoSettings(gains), Scenario(np.zeros(5), source=quintic(0.0, 1.0, 0.1)), limits=limits)
    starts: list[float] = []

    class Away:
        def segments(self, start: Setpoint) -> np.ndarray:
            starts.append(float(start[POSITION]))
            return AtRest(start[POSITION] + 0.1).segments(start)

    state = at_rest(0.5, 5.0)
    result = run(NOMINAL_DRIVE, ServoSettings(gains), Scenario(np.zeros(500), source=Away(), initial_state=state))
    assert starts == [0.5]
    assert result.load_angle[-1] == pytest.approx(0.6, abs=0.02)
    with pytest.raises(ValueError, match="initial_state must be finite"):
        run(NOMINAL_DRIVE, ServoSettings(gains), Scenario(np.zeros(5), initial_state=PlantState(np.full(5, math.nan))))


def test_no_way_around_the_largest_step(gains: GainSet) -> None:
    """By a plan that has hardly begun, by references between two samples, or from row to row of a plan."""
    slow = Polynomials(np.array([[0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 10.0]]))
    servo = holding(gains, step=0.2)
    assert servo.follow(slow) == ""
    servo.update(HELD)
    assert "limits.step = 0.2 rad of 0 rad, got 1" in servo.set_reference(1.0)
    assert servo.set_reference(0.0) == ""
    assert servo.set_reference(0.2) == ""
    assert "limits.step = 0.2 rad of 0 rad, got 0.4" in servo.set_reference(0.4)
    leaping = np.array([[0.0] * 6 + [0.004], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf]])
    assert "limits.step = 0.2 rad of 0 rad, got 1" in holding(gains, step=0.2).follow(Polynomials(leaping))


def test_plan_that_is_over_does_not_stand_in_the_way_of_limits(gains: GainSet) -> None:
    servo = holding(gains)
    assert servo.follow(Polynomials(np.array([[0.0, 8.0, -8.0, 0.0, 0.0, 0.0, 1.0]]))) == ""  # to 2 rad and back
    narrow = replace(Limits.of(NOMINAL_DRIVE), position_upper=1.0)
    assert "position_upper = 1 rad, got 2" in servo.rejection_reason(narrow)
    servo.memory.plan_time = 1.0
    assert servo.rejection_reason(narrow) == ""
