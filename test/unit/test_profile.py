"""Profiles: the setpoint's way to a reference stays within its limits, whatever comes in flight."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.control import Gains, GainSet, Limits, Polynomials, Servo, ServoSettings
from backlash_ros.control.motion.motion_limits import motion_limits
from backlash_ros.control.motion.profile import MotionLimits, Profile
from backlash_ros.control.motion.profile_parameters import ProfileParameters
from backlash_ros.control.motion.setpoint import DURATION, evaluate, extent
from backlash_ros.control.motion.trajectory import Trajectory
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY, Measurement, Setpoint
from backlash_ros.simulation import Scenario, run
from backlash_ros.studies.evaluation.population import draw_member
from backlash_ros.studies.evaluation.task import first_reading, settings_for, true_reading

PERIOD = 0.004
SLOW = ProfileParameters("limited", 2.0, 20.0, 400.0)
ROUNDING = 1e-9


def sampled(rows: Array, times: Array) -> Array:
    """Return the setpoints of a plan at times, shape (times, 3)."""
    out, seen = Setpoint(np.zeros(3)), np.empty((times.size, 3))
    for k, time in enumerate(times):
        evaluate(rows, time, out)
        seen[k] = out
    return seen


def assert_within(seen: Array, period: float, limits: MotionLimits) -> None:
    assert np.max(np.abs(seen[:, VELOCITY])) <= limits.velocity * (1.0 + ROUNDING)
    assert np.max(np.abs(seen[:, ACCELERATION])) <= limits.acceleration * (1.0 + ROUNDING)
    jerks = np.abs(np.diff(seen[:, ACCELERATION])) / period
    assert np.max(jerks, initial=0.0) <= limits.jerk * (1.0 + 1e-6)


@pytest.mark.parametrize("motions", [20, pytest.param(50, marks=pytest.mark.grid)])
def test_retargets_in_flight_keep_every_limit_and_end_at_the_reference(motions: int) -> None:
    """Of limits over decades, at any time of the flight: from one sample after the last one to its end."""
    random = np.random.default_rng(5)
    for _ in range(motions):
        limits = MotionLimits(*(10.0 ** random.uniform(least, most) for least, most in ((-1, 2), (-1, 3.5), (0, 6))))
        period, seen, time = random.choice([0.001, 0.004]), np.array([[random.uniform(-1.0, 1.0), 0.0, 0.0]]), 0.0
        profile, hull = Profile(Setpoint(seen[-1]), seen[0, 0], limits), [seen[0, 0]]
        for _ in range(20):
            begin, reference = Setpoint(seen[-1].copy()), random.uniform(-1.0, 1.0)
            profile, hull = profile.onward(begin, reference, time), [*hull, reference]
            rows = profile.segments(begin)
            ends = rows[:, :DURATION] * rows[:, -1:] ** np.arange(DURATION)
            np.testing.assert_allclose(ends.sum(axis=1)[:-1], rows[1:, 0], atol=ROUNDING)
            _, end, least, largest = extent(rows)
            np.testing.assert_allclose(profile.reach, (least, largest), atol=ROUNDING)
            assert end == reference
            assert min(hull) - ROUNDING <= least <= largest <= max(hull) + ROUNDING
            whole = rows[:, -1].sum()
            count = random.choice([1, 2, 10, math.ceil(random.uniform(0.0, 1.2) * whole / period)])
            times = period * np.arange(min(count, 3000) + 1)
            seen, time = sampled(rows, times), float(times[-1])
            np.testing.assert_allclose(seen[0] - begin, 0.0, atol=ROUNDING * limits.acceleration + ROUNDING)
            assert_within(seen, period, limits)
        np.testing.assert_array_equal(sampled(rows, np.array([whole]))[0], [reference, 0.0, 0.0])


def test_a_profile_is_as_fast_as_its_limits_allow() -> None:
    """The mean of a trapezoid of speed over a window: way over speed, time to the speed, window."""
    rows = Profile(Setpoint(np.zeros(3)), 10.0, MotionLimits(2.0, 20.0, 400.0)).segments(Setpoint(np.zeros(3)))
    assert rows[:-1, -1].sum() == pytest.approx(10.0 / 2.0 + 2.0 / 20.0 + 2.0 * 20.0 / 400.0)
    seen = sampled(rows, np.arange(0.0, 6.0, 1e-3))
    np.testing.assert_allclose(np.max(np.abs(seen), axis=0), [10.0, 2.0, 20.0])
    for given in ((1e6, 1e9, 1e12), (1e-6, 1e9, 1e-6), (1e6, 1e-6, 1e12), (1e-6, 1e-6, 1e12)):  # the extreme ones
        for reference in (6.0, -1e-12, 0.0, 1e6):
            rows = Profile(Setpoint(np.zeros(3)), reference, MotionLimits(*given)).segments(Setpoint(np.zeros(3)))
            assert extent(Polynomials(rows).rows)[:2] == (0.0, reference)


class Moved:
    """A servo of the nominal drive whose setpoint alone moves: its monitor is off, and its load stands at 0."""

    def __init__(self, profile: ProfileParameters = SLOW, **limits: float) -> None:
        gains = Gains(1.0, 0.1, 0.0)
        self.settings = ServoSettings(GainSet(gains, gains), law="fast", period=PERIOD, profile=profile)
        self.servo = Servo(NOMINAL_DRIVE, self.settings, Limits(24.0, **limits), watched=False)
        self.seen = np.empty((0, 3))
        self.run(1)

    def run(self, count: int) -> Array:
        """Take so many samples and return their setpoints, after the last one before."""
        found = [self.servo.memory.setpoint.copy()]
        for _ in range(count):
            self.servo.update(Measurement(np.zeros(5)))
            found.append(self.servo.memory.setpoint.copy())
        return np.array(found)

    def use(self, **changes: float) -> None:
        """Use other limits of the profile."""
        self.servo.use(replace(self.settings, profile=replace(self.settings.profile, **changes)))


def test_references_at_any_rate_are_one_motion() -> None:
    """A sine from 1 Hz to one reference a sample, too fast for the limits: no second smoothing, and no leap."""
    for every in (1, 3, 25, 250):
        moved, seen = Moved(), []
        for k in range(1500 // every):
            assert moved.servo.set_reference(0.8 * math.sin(2.0 * k * every * PERIOD)) == ""
            seen.append(moved.run(every)[1:])
            assert moved.servo.memory.motion.on_path == 0.0
            plan = moved.servo.segments
            assert moved.servo.set_reference(moved.servo.reference) == ""
            assert moved.servo.segments is plan
        whole = np.concatenate([*seen, moved.run(250)[1:]])
        assert_within(whole, PERIOD, MotionLimits(2.0, 20.0, 400.0))
        assert np.max(np.abs(whole[:, POSITION])) <= 0.8
        np.testing.assert_array_equal(whole[-1], [moved.servo.reference, 0.0, 0.0])
        assert moved.servo.arrived


def test_a_profile_goes_on_from_whatever_moved_the_setpoint() -> None:
    """A trajectory, a stop, other limits in flight: speed and acceleration go on, the jerk is bounded."""
    moved, able = Moved(), MotionLimits(2.0, 20.0, 400.0)
    path = Trajectory(np.array([0.5, 1.0]), np.array([[0.4, 1.5, 0.0], [1.0, 0.0, 0.0]]))
    assert moved.servo.follow(path, at_once=True) == ""
    moved.run(60)
    assert moved.servo.set_reference(-0.3) == ""
    assert_within(moved.run(20), PERIOD, able)
    assert moved.servo.stop() == ""
    moved.run(5)
    assert moved.servo.set_reference(3.0) == ""
    assert_within(moved.run(250), PERIOD, able)
    moved.use(velocity=0.5)
    slower = moved.run(400)
    assert_within(slower, PERIOD, able)
    assert np.max(slower[50:, VELOCITY]) <= 0.5 * (1.0 + ROUNDING)
    moved.use(velocity=5.0, acceleration=50.0, jerk=2000.0)
    assert_within(moved.run(400), PERIOD, MotionLimits(5.0, 50.0, 2000.0))
    np.testing.assert_array_equal(moved.servo.memory.setpoint, [3.0, 0.0, 0.0])


def test_what_is_refused_changes_nothing_and_says_why() -> None:
    for changes, text in (
        ({"mode": "fast"}, "profile.mode must be one of ['step', 'limited', 'auto'], got 'fast'"),
        ({"jerk": 0.0}, "profile.jerk must be >= 1e-06 rad/s^3 with profile.mode = 'limited', got 0.0"),
        ({"mode": "auto", "velocity": 1e-9}, "profile.velocity must be >= 1e-06 rad/s or 0, got 1e-09"),
        ({"acceleration": -1.0}, "profile.acceleration must be >= 0 rad/s^2 and <= 1e+09 rad/s^2, got -1.0"),
        ({"velocity": math.nan}, "profile.velocity must be a finite number, >= 0 rad/s and <= 1e+06 rad/s, got nan"),
    ):
        with pytest.raises(ValueError) as refused:  # noqa: PT011  compared below
            replace(SLOW, **changes)
        assert str(refused.value) == text
    moved = Moved(position_upper=4.0)
    assert moved.servo.set_reference(1.0) == ""
    moved.run(50)
    plan = moved.servo.segments
    for reference, text in (
        (math.nan, "reference must be finite, in rad, got nan"),
        (4.1, "limits.position_upper = 4 rad, got 4.1"),
        (-90.0, "reference must be within limits.step = 6.28319 rad of 1 rad, got -90"),
    ):
        assert moved.servo.set_reference(reference).endswith(text)
    assert moved.servo.segments is plan
    assert moved.servo.set_reference(4.0) == ""  # the very end
    moved.run(500)
    thresholds = replace(moved.settings.thresholds_of(NOMINAL_DRIVE), velocity=1.0)
    moved.servo.use(replace(moved.settings, thresholds=thresholds))
    why = "the profile to 0 rad is refused: path must be slower than faults.velocity = 1 rad/s, got 2"
    assert moved.servo.set_reference(0.0) == why
    # What moves too fast to stop before an end goes on as it was.
    moved.servo.use(moved.settings)
    moved.servo.follow(Polynomials(np.array([[4.0, 0.0, -200.0, 0.0, 0.0, 0.0, 0.02], [3.92, -8.0, 0, 0, 0, 0, 0.5]])))
    moved.run(100)
    lower = replace(moved.servo.limits, position_lower=0.0)
    moved.servo.use(moved.settings, lower)
    assert "the profile to 1 rad is refused: reference must be within" in moved.servo.set_reference(1.0)


def test_a_load_that_is_held_outside_of_the_travel_comes_back() -> None:
    moved = Moved(position_lower=1.0, position_upper=2.0)  # it stands at 0
    assert moved.servo.set_reference(0.5) != ""
    assert moved.servo.set_reference(1.5) == ""
    np.testing.assert_array_equal(moved.run(1000)[-1], [1.5, 0.0, 0.0])


def judged(number: int) -> tuple[Sequence[float], Sequence[float]]:
    """Return, of a step of 1 rad and of the drive's profile, overshoot, b, tooth force, N, settling, s, and more."""
    member = draw_member(20, number, "core")
    drive, b = member.drive, member.drive.gear.backlash_angle
    settings = replace(
        settings_for(drive, member),
        backlash_angle=b,
        identified=True,
        expected_load_torque=member.load_torque,
        profile=ProfileParameters("auto"),
    )
    origin, held, count = first_reading(member), round(member.rate), round(2.2 * member.rate)
    limits = motion_limits(drive, settings, Limits.of(drive))
    assert limits is not None
    begin, time = Setpoint(np.array([origin, 0.0, 0.0])), np.arange(count)
    waits = np.array([[origin, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    profile = Polynomials(np.vstack([waits, Profile(begin, origin + 1.0, limits).segments(begin)]))
    scenario = Scenario(
        origin + 1.0 * (time >= held), np.array(member.load_torque), sensors=member.sensors, delay=member.delay
    )
    figures = []
    for source in (None, profile):
        done = run(drive, settings, replace(scenario, source=source), model=drive)
        load = true_reading(member, done.load_angle)[:-1]
        away = np.abs(load - done.setpoint)[held:] / b
        outside = np.abs(load - origin - 1.0) > max(0.25 * b, member.load_count)
        settled = (1 + np.max(np.flatnonzero(outside)) - held) / member.rate
        saturated = np.count_nonzero(np.abs(done.command[held:]) >= 0.999 * drive.command_limit)
        overshoot = max(np.max(load) - origin - 1.0, 0.0) / b
        force = np.max(done.peak_force[held:])
        figures.append((overshoot, force, settled, np.max(away), saturated, float(bool(done.fault))))
    return figures[0], figures[1]


@pytest.mark.parametrize("drives", [6, pytest.param(20, marks=pytest.mark.grid)])
def test_a_drive_bears_the_motion_that_it_chooses(drives: int) -> None:
    """None saturates, each keeps its load near the setpoint, settles, and is easy on its teeth."""
    steps, profiles = np.array([judged(number) for number in range(drives)]).transpose(1, 0, 2)
    print("overshoot, b, tooth force, N, and settling, s: median, 90 %, worst")
    for name, each in (("step", steps), ("auto", profiles)):
        spread = np.percentile(each[:, :3], (50, 90, 100), axis=0, method="higher").T
        print(name, *(" ".join(f"{value:.2f}" for value in row) for row in spread), sep="  ")
    _, force, settled, away, saturated, faulted = profiles.T
    assert not np.any(faulted)
    assert np.all(saturated == 0)
    assert np.max(away) < 1.0
    assert np.max(settled) < 0.5
    assert np.max(force) < np.max(steps[:, 1])
    assert np.median(force) < np.median(steps[:, 1])


def test_limits_of_a_drive_are_its_own_and_given_ones_lower_them() -> None:
    """What takes torque or voltage makes them smaller; so does a delay the jerk."""
    settings, limits = Moved(ProfileParameters("auto")).settings, Limits.of(NOMINAL_DRIVE)

    def found(**changes: object) -> MotionLimits:
        able = motion_limits(NOMINAL_DRIVE, replace(settings, **changes), limits)
        assert able is not None
        return able

    able = found()
    assert 10.0 < able.velocity < 0.5 * 48.0
    weak = found(expected_load_torque_slope=3.0)
    assert weak.velocity < able.velocity
    assert weak.acceleration < able.acceleration
    assert 0.0 < found(expected_load_torque=100.0).acceleration < 0.1 * able.acceleration
    assert found(loop_delay=0.01).jerk < able.jerk
    fault = replace(settings.thresholds_of(NOMINAL_DRIVE), velocity=5.0)
    assert found(thresholds=fault).velocity < 5.0
    lowered = found(profile=ProfileParameters("auto", velocity=1.0, jerk=30.0))
    assert lowered == MotionLimits(1.0, able.acceleration, 30.0)
    assert found(profile=ProfileParameters("auto", velocity=1e5)) == able
    assert motion_limits(NOMINAL_DRIVE, replace(settings, profile=ProfileParameters()), limits) is None
