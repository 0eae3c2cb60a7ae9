"""A request to learn is answered once, however it ends; the servo is the real one, the clock the test's."""

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from backlash_ros.control import (
    EXPERIMENTS,
    BacklashEstimate,
    GainSet,
    LimitCycleSettings,
    Method,
    Servo,
    ServoSettings,
)
from backlash_ros.control.estimates.requests import PATIENCE, LearnRequests, Reply, describe_outcome
from backlash_ros.control.experiment import Deferred, DriveEstimate, Excitation, NamedExperiment, Refusal
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import Measurement
from backlash_ros.gates import Fault
from backlash_ros.identification.recordings.findings import Finding

AT_REST = Measurement(np.zeros(5))


@pytest.fixture
def servo(gains: GainSet) -> Servo:
    return Servo(NOMINAL_DRIVE, ServoSettings(gains).with_experiment("limit_cycle"))


def test_a_request_waits_for_the_first_sample_and_no_longer_than_its_patience(servo: Servo) -> None:
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
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
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
    refusal = (False, "cannot learn: a run is already in progress", None)
    assert requests.ask(0) is None
    assert requests.ask(0) == refusal
    servo.update(AT_REST)
    requests.begin()
    assert requests.ask(0) == refusal


def test_a_fault_refuses_when_asked_and_when_begun(servo: Servo) -> None:
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
    refusal = (False, "cannot learn while this fault is latched: silence", None)
    assert requests.ask(0) is None
    servo.fail(Fault.NO_SAMPLES, "silence")
    assert requests.begin() == refusal
    assert requests.ask(0) == refusal


def test_cancel_ends_what_runs_and_refuses_what_waits(servo: Servo) -> None:
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
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
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
    requests.ask(0)
    servo.update(AT_REST)
    requests.begin()
    servo.update(Measurement(np.array([0.0, 0.0, math.nan, math.nan, 0.0])))
    reply = requests.end()
    assert reply is not None
    assert (reply.success, reply.estimate) == (False, None)
    assert "load encoder is missing" in reply.text


def test_identify_is_answered_as_that_and_runs_an_experiment_of_its_own(servo: Servo) -> None:
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
    assert requests.ask(0, "identify") is None
    assert requests.ask(0) == (False, "cannot learn: a run is already in progress", None)
    assert requests.ask(0, "identify") == (False, "cannot identify: a run is already in progress", None)
    assert requests.waited(PATIENCE, "no joint_states") == (False, "cannot identify: no joint_states for 5 s", None)
    servo.update(AT_REST)
    assert requests.ask(0, "identify") is None
    assert requests.begin() is None
    servo.update(AT_REST)
    requests.cancel()
    assert requests.end() == (False, "nothing was identified: cancelled on request", None)
    assert requests.service == "identify"


def test_with_one_encoder_the_relay_identifies(servo: Servo) -> None:
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
    load_alone = Measurement(np.array([math.nan, math.nan, 0.0, 0.0, 0.0]))
    servo.update(load_alone)
    requests.ask(0, "identify")
    requests.begin()
    assert servo.experiment == "identify_by_relay"
    servo.update(Measurement(np.full(5, math.nan)))
    reply = requests.end()
    assert reply is not None
    assert (reply.success, reply.estimate) == (False, None)
    assert "nothing was identified" in reply.text


def test_outcomes_in_words() -> None:
    found = BacklashEstimate(0.02, Method.GAP_TRAVEL, valid=True, reason="10 cycles")
    assert describe_outcome(found) == "backlash 0.02 rad at the output, by gap_travel, from 10 cycles"
    told = (
        Finding("load.inertia", "J_l", "", "kg m^2", 5e-4, 2e-6),
        Finding("motor.coulomb_friction", "c_m", "", "N m", 3e-10, 1e-4),
        Finding("load.coulomb_friction", "c_l", "", "N m", why="too little motion"),
    )
    inertia = {"load.inertia": 5e-4}
    drive = DriveEstimate(0.0, Method.IDENTIFY, valid=True, reason="4 s of motion", drive=inertia, findings=told)
    assert describe_outcome(drive) == (
        "J_l = 0.0005 +- 2e-06 kg m^2, c_m = 0 +- 0.0001 N m, from 4 s of motion; not told: c_l: too little motion; "
        "the drive does not count as identified: load.coulomb_friction not found; identify again at another place, "
        "with the load at rest, or set load.* by hand, and identified to true"
    )
    rough = (replace(told[0], uncertainty=1e-4, why="too little motion", rough=True),)
    assert describe_outcome(replace(drive, findings=rough)) == (
        ", from 4 s of motion; not told: J_l: too little motion; good enough to plan moves: "
        "J_l = 0.0005 +- 0.0001 kg m^2; the drive does not count as identified: load.coulomb_friction not found; "
        "identify again at another place, with the load at rest, or set load.* by hand, and identified to true"
    )
    assert describe_outcome(drive, identified=True).endswith("not told: c_l: too little motion")
    assert describe_outcome(Refusal("it failed: OSError()")) == "it failed: OSError()"


class _Probe:
    """An experiment that is over with its first sample, and has something to compute."""

    progress = 1.0

    def __init__(self, work: object) -> None:
        self.outcome = Deferred(work)  # type: ignore[arg-type]

    def step(self, *_: object) -> Excitation:
        return Excitation()

    def cancel(self, reason: str) -> None:
        """Too late."""


def deferring(servo: Servo, work: object) -> LearnRequests:
    """Return requests of which the first one is under way, its experiment over."""
    EXPERIMENTS._entries["computes"] = NamedExperiment(
        "computes", lambda *_: _Probe(work), LimitCycleSettings(), law=""
    )
    servo.use(servo.settings.with_experiment("computes"))
    requests = LearnRequests(servo, ThreadPoolExecutor(1))
    servo.update(AT_REST)
    assert requests.ask(0) is None
    assert requests.begin() is None
    servo.update(AT_REST)
    return requests


def answer_of(requests: LearnRequests) -> Reply:
    end = time.monotonic() + 60.0
    while (reply := requests.end()) is None:
        assert time.monotonic() < end
    return reply


def test_what_takes_computing_is_answered_when_it_is_done(servo: Servo) -> None:
    gate = Event()
    found = BacklashEstimate(0.02, Method.GAP_PROBE, valid=True, reason="4 s of motion", uncertainty=1e-4)

    def work() -> BacklashEstimate:
        assert gate.wait(60.0)
        return found

    requests = deferring(servo, work)
    assert requests.end() is None
    assert requests.computing
    assert not servo.experimenting
    assert requests.ask(0) == (False, "cannot learn: a run is already in progress", None)
    gate.set()
    assert answer_of(requests) == (
        True,
        "backlash 0.02 +- 0.0001 rad at the output, by gap_probe, from 4 s of motion",
        found,
    )
    assert not requests.computing


def test_computing_that_fails_is_a_refusal(servo: Servo) -> None:
    def work() -> BacklashEstimate:
        raise OSError("no disk")

    assert answer_of(deferring(servo, work)) == (False, "it failed: OSError('no disk')", None)


def test_computing_is_cancelled(servo: Servo) -> None:
    gate = Event()
    requests = deferring(servo, gate.wait)
    assert requests.end() is None
    assert requests.cancel() == (True, "cancelled", None)
    assert requests.stop("cancelled on request") == (False, "cannot learn: cancelled on request", None)
    assert not requests.computing
    gate.set()
    assert requests.end() is None
