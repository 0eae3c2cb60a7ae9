"""Setpoints that come one by one are one plan: in time, within the drive's reach, and at rest where none comes."""

import math

import numpy as np
import pytest

from backlash_ros.control import GainSet, Limits, Servo, ServoSettings
from backlash_ros.control.motion.stream import Stream
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import Measurement

PERIOD, INTERVAL, TIMEOUT = 4_000_000, 10_000_000, 0.1  # ns, ns, s
W = math.pi


def sine(time: float, order: int = 3) -> Array:
    """Return a sine from 0 to 1 rad, 0.5 Hz, that begins at rest."""
    state = [0.5 - 0.5 * math.cos(W * time), 0.5 * W * math.sin(W * time), 0.5 * W * W * math.cos(W * time)]
    return np.array(state[:order])


class Planner:
    """Who sends setpoints to a servo, and sees its setpoint; times in ns."""

    def __init__(self, gains: GainSet, upper: float = 10.0) -> None:
        limits = Limits(command=24.0, position_lower=-10.0, position_upper=upper)
        self.servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, period=1e-9 * PERIOD), limits, watched=False)
        self.stream, self.now = Stream(self.servo, TIMEOUT), 10**9
        self.sample()

    def sample(self) -> Array:
        """Let the servo take one sample, and return its setpoint."""
        self.now += PERIOD
        self.servo.update(Measurement(np.zeros(5)))
        return self.servo.memory.setpoint.copy()

    def send(self, *state: float, early: float = 0.0) -> str:
        return self.stream.take(self.now + round(1e9 * early), np.array(state), self.now)

    def follow(self, seconds: float, order: int = 3) -> Array:
        """Send the sine for so long, and nothing for as long as a stop takes; return times, s, and setpoints."""
        begins, sent, seen = self.now, 0, []
        for _ in range(round(1e9 * (seconds + 0.5)) // PERIOD):
            while sent <= min(self.now - begins, round(1e9 * seconds)):
                assert not self.stream.take(begins + sent, sine(1e-9 * sent, order), self.now)
                sent += INTERVAL
            seen.append([1e-9 * (self.now + PERIOD - begins), *self.sample()])
        return np.array(seen)


@pytest.mark.parametrize("order", [2, 3])
def test_a_path_to_the_end_of_the_travel_is_followed_and_ends_within_it(gains: GainSet, order: int) -> None:
    """It touches the end after 1 s. Wherever the stream ends, the load comes to rest within the travel, smoothly."""
    for seconds in (0.3, 0.7, 0.94, 0.97, 0.99, 1.0, 1.2):
        planner = Planner(gains, upper=1.0)
        times, positions, velocities, accelerations = planner.follow(seconds, order).T
        late = times - planner.stream.delay
        sent = (late > 0.0) & (late < seconds - 0.011)
        path = np.array([sine(time) for time in late[sent]])
        np.testing.assert_allclose(positions[sent], path[:, 0], atol=1e-6)
        if order == 3:
            np.testing.assert_allclose(accelerations[sent], path[:, 2], atol=1e-4)
        assert np.max(positions) <= 1.0
        assert np.max(np.abs(np.diff(positions))) < 1.01 * 0.5 * W * 1e-9 * PERIOD
        assert seconds > 1.0 or np.min(np.diff(positions[late > 0.0])) > -1e-9  # it does not turn back
        assert velocities[-1] == 0.0
        assert planner.stream.stops == (seconds != 1.0)
        assert not planner.stream.runs


def test_setpoints_that_cannot_be_followed_change_nothing(gains: GainSet) -> None:
    planner = Planner(gains)
    plan = planner.servo.segments
    for state, early, text in (
        ((0.06, 0.0), 0.0, "the first one must be within 0.05 rad of the setpoint in use, 0 rad, got 0.06"),
        ((0.0, math.nan), 0.0, "must be finite, got"),
        ((0.0, 0.0, math.inf), 0.0, "must be finite, got"),
        ((0.0, 0.0), -0.021, "it must be less than 0.02 s late and 1 s early, got 0.021 s behind the clock"),
        ((0.0, 0.0), 1.001, "got 1 s ahead of the clock"),
        ((0.0, 10.0), -0.019, "it must be within reach: the drive accelerates with 2400 rad/s^2, it needs"),
        ((0.0, 1000.0), 0.0, "must be within"),
    ):
        assert text in planner.send(*state, early=early)
        assert planner.servo.segments is plan
    assert not planner.send(0.01, 0.0)
    planner.sample()
    plan = planner.servo.segments
    for state, early, text in (
        ((0.01, 0.0), -0.004, "its time must be later than that of the one before, got 0 s less"),
        ((0.5, 0.0), 0.0, "it must be within reach"),
        ((10.001, 0.0), 0.9, "must be within limits.position_lower = -10 rad and limits.position_upper = 10 rad"),
        ((10.0, 0.1), 0.9, "it must be possible to stop before the end of the travel, got 0.1 rad/s there"),
    ):
        assert text in planner.send(*state, early=early)
        assert planner.servo.segments is plan
    assert not planner.send(0.01, 0.0)


def test_a_stream_that_something_else_has_ended_begins_again_after_a_pause(gains: GainSet) -> None:
    planner = Planner(gains)
    for end in (lambda: planner.servo.set_reference(0.0), planner.servo.stop, lambda: planner.servo.release("a test")):
        assert not planner.send(0.01, 0.5)
        planner.sample()
        end()
        for _ in range(30):
            planner.sample()
            assert planner.send(0.0, 0.0) == "the stream has ended; another one begins after a pause of 0.1 s"
        for _ in range(26):
            planner.sample()
        assert not planner.stream.runs
    planner.servo.release("another test")
    assert planner.send(0.0, 0.0) == "it came while no position is held"
