"""A request to learn is answered once, however it ends; the servo is the real one, the clock the test's."""

import math

import numpy as np
import pytest

from backlash_ros.control import BacklashEstimate, GainSet, Method, Servo, ServoSettings
from backlash_ros.control.experiment import Refusal
from backlash_ros.control.learning import PATIENCE, LearnRequests, describe_outcome
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.signals import Measurement
from backlash_ros.gates import Fault

AT_REST = Measurement(np.zeros(5))


@pytest.fixture
def servo(gains: GainSet) -> Servo:
    return Servo(NOMINAL_DRIVE, ServoSettings(gains))


def test_a_request_waits_for_the_first_sample_and_no_longer_than_its_patience(servo: Servo) -> None:
    requests = LearnRequests(servo)
    assert requests.ask(0) is None
    assert requests.begin() is None
    assert requests.waited(PATIENCE - 1, "no joint_states") is None
    assert requests.waited(PATIENCE, "no joint_states") == (False, "cannot learn: no joint_states for 5 s", None)
    assert requests.waited(2 * PATIENCE, "no joint_states") is None
    assert requests.ask(0) is None
    servo.update(AT_REST)
    assert requests.begin() is None
    assert servo.experimenting


def test_a_second_request_is_refused_while_the_first_waits_or_runs(servo: Servo) -> None:
    requests = LearnRequests(servo)
    refusal = (False, "cannot learn: already learning", None)
    assert requests.ask(0) is None
    assert requests.ask(0) == refusal
    servo.update(AT_REST)
    requests.begin()
    assert requests.ask(0) == refusal


def test_a_fault_refuses_when_asked_and_when_begun(servo: Servo) -> None:
    requests = LearnRequests(servo)
    refusal = (False, "cannot learn while a fault is latched: silence", None)
    assert requests.ask(0) is None
    servo.fail(Fault.NO_SAMPLES, "silence")
    assert requests.begin() == refusal
    assert requests.ask(0) == refusal


def test_cancel_ends_what_runs_and_refuses_what_waits(servo: Servo) -> None:
    requests = LearnRequests(servo)
    assert requests.cancel() == (False, "there is no experiment to cancel", None)
    requests.ask(0)
    assert requests.cancel() == (True, "cancelled", None)
    assert requests.stop("cancelled on request") == (False, "cannot learn: cancelled on request", None)
    requests.ask(0)
    servo.update(AT_REST)
    requests.begin()
    servo.update(AT_REST)
    assert requests.cancel() == (True, "cancelled", None)
    assert requests.end() == (False, "no valid cycle: cancelled on request", None)
    assert requests.end() is None
    assert not servo.experimenting


def test_an_experiment_that_ends_by_itself_is_answered_with_its_reason(servo: Servo) -> None:
    requests = LearnRequests(servo)
    requests.ask(0)
    servo.update(AT_REST)
    requests.begin()
    servo.update(Measurement(np.array([0.0, 0.0, math.nan, math.nan, 0.0])))
    reply = requests.end()
    assert reply is not None
    assert (reply.success, reply.backlash_angle) == (False, None)
    assert "load encoder is missing" in reply.text


def test_outcomes_in_words() -> None:
    found = BacklashEstimate(0.02, Method.GAP_TRAVEL, 0.016, 0.03, 10, True, "10 cycles")
    assert describe_outcome(found) == "backlash 0.02 rad at the output, by gap_travel, from 10 cycles"
    assert describe_outcome(Refusal("it failed: OSError()")) == "it failed: OSError()"
