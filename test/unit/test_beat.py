"""How periods are counted, which answers count as late, and what learning makes of them."""

import math
from functools import cache

import numpy as np
import pytest

from backlash_ros.control import BacklashEstimate, Servo
from backlash_ros.control.experiment import Deferred
from backlash_ros.control.monitoring.beat import LATE, Beat
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.identification.drive import identified_drive
from backlash_ros.identification.recording import with_late_answers
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.evaluation.task import DELAY_NEAR, EFFORT_NEAR, GAP_NEAR, INERTIA_NEAR, SPEEDS, settings_for

PERIOD = 0.004
SEED = 20261122


def judged(waits: list[float], *, faster: float = 1.0, periods: int = 1) -> list[float]:
    """Return how late answers are, s, each so long after its sample (s), by a clock that goes ``faster``."""
    beat, time = Beat(PERIOD), 0.0
    result: list[float] = []
    for wait in waits:
        result.append(beat.sample(periods * PERIOD)[1])
        beat.answered(5.0 + faster * (time + wait))
        time += periods * PERIOD
    return [*result[1:], beat.sample(PERIOD)[1]]


def test_an_answer_is_late_that_waits_longer_than_usual() -> None:
    usual = 0.0013
    waits = [usual + 0.1 * PERIOD * (k % 2) for k in range(300)]
    assert not any(judged(waits))
    waits[150] += (LATE + 0.11) * PERIOD
    waits[200] += 3.0 * PERIOD
    for periods in (1, 4):
        late = judged(waits, periods=periods)
        assert np.flatnonzero(late).tolist() == [150, 200]
        assert late[200] == pytest.approx(3.0 * PERIOD, abs=0.2 * PERIOD)


@pytest.mark.parametrize("faster", [0.999, 1.001])
def test_clocks_that_do_not_go_alike_make_none_late(faster: float) -> None:
    assert not any(judged([1e-3] * 5000, faster=faster))


def test_a_beat_that_slips_is_the_usual_one_after_a_while() -> None:
    late = judged([1e-3] * 200 + [1e-3 + PERIOD] * 200)
    assert any(late)
    assert not any(late[300:])


def test_what_nobody_tells_is_on_time() -> None:
    beat = Beat(PERIOD)
    assert not any(beat.sample(PERIOD)[1] for _ in range(10))
    beat.answered(10.0)
    assert beat.sample(PERIOD) == beat.sample(math.nan) == beat.sample(math.inf) == (1, 0.0)


def test_a_late_stamp_makes_the_answer_before_it_doubtful() -> None:
    """The drive was late itself: nobody knows whether it took the answer before."""
    beat = Beat(PERIOD)
    assert [beat.sample(PERIOD)[1] for _ in range(10)] == [0.0] * 10
    assert beat.sample(1.2 * PERIOD) == (1, 0.0)
    assert beat.sample(1.2 * PERIOD) == (1, pytest.approx(0.4 * PERIOD))
    assert beat.sample(0.6 * PERIOD) == (1, 0.0)


def counted(stamps: list[float]) -> list[int]:
    """Return in which period each sample was taken, of stamps (periods)."""
    beat = Beat(PERIOD)
    passed = [beat.sample(PERIOD * step)[0] for step in np.diff(stamps, prepend=-1.0)]
    return (np.cumsum(passed) - 1).tolist()


def test_periods_are_counted_by_the_beat_not_from_one_late_stamp_to_the_next() -> None:
    on_time = [0.05 * (k % 2) + k for k in range(20)]
    assert counted(on_time) == list(range(20))
    # One is late by 0.4, the next but one by 0.6: from stamp to stamp 1.4, 1.2, 0.4 and so on would be counted.
    assert counted([*on_time, 20.4, 21.0, 22.4, 24.6, 25.0]) == [*range(20), 20, 21, 22, 25, 26]
    assert counted([*on_time, 20.4, 22.6, 23.0, 24.0]) == [*range(20), 20, 23, 24, 25]
    # Samples are lost.
    assert counted([*on_time, 24.0, 25.1, 31.0]) == [*range(20), 24, 25, 31]


@pytest.mark.parametrize("length", [0.998, 1.002])
def test_a_period_that_is_not_quite_the_nominal_one_is_one_period(length: float) -> None:
    assert counted([length * k for k in range(3000)]) == list(range(3000))


def learned(member: Member, *, told: bool, seed: int = 0, slip: float = 0.0) -> tuple[BacklashEstimate, float]:
    """Learn where one of 20 answers is 1 to 3 periods late, and what is measured meanwhile is not seen.

    ``told``: whether the controller is told when it answered. ``slip`` of the load's encoder on the way, in gaps.
    Returns what came of it, and the true gap.
    """
    model = told_model(member, "nominal")
    settings = settings_for(model, member)
    servo = Servo(model, settings)
    plant = SimulatedDrive(member.drive, settings.period, sensors=member.sensors, delay=member.delay)
    servo.start_experiment("gap_probe")
    random, sent, elapsed = np.random.default_rng(seed), 0.0, settings.period
    while True:
        shown = plant.sample()
        shown[THETA_L] += slip * member.drive.gear.backlash_angle * (plant.time > 1.5)
        command = servo.update(shown, elapsed)
        if (outcome := servo.take_outcome()) is not None:
            break
        late = int(random.integers(1, 4)) if random.random() < 0.05 else 0
        if told:
            servo.answered(7.0 + plant.time + late * settings.period)
        for _ in range(late):
            plant.advance(sent, member.load_torque)
            plant.sample()
        plant.advance(command, member.load_torque)
        sent, elapsed = command, (1 + late) * settings.period
    assert isinstance(outcome, Deferred), outcome
    result = outcome.work()
    assert isinstance(result, BacklashEstimate)
    return result, member.drive.gear.backlash_at(float(plant.state[THETA_L]))


@cache
def drive(number: int, population: str) -> Member:
    return draw_member(SEED, number, population)


def recorded(slots: list[int], late: list[float]) -> list[tuple[float, float, float, float]]:
    """Return slot, reading, command and doubt of each row, of samples k = 0, 1, ... with commands 10 k and readings k.

    ``slots`` are the periods of the samples, ``late`` the periods by which their answers are.
    """
    numbers = np.arange(float(len(slots)))
    time = 5.0 + PERIOD * np.array(slots)
    found = with_late_answers(time, numbers, -numbers, 10.0 * numbers, PERIOD * np.array(late), PERIOD)
    assert np.array_equal(found.motor, -found.load, equal_nan=True)
    rows = zip(found.time, found.motor, found.command, found.doubt, strict=True)
    return [(round((at - 5.0) / PERIOD, 9), reading, command, doubt) for at, reading, command, doubt in rows]


NONE = pytest.approx(np.nan, nan_ok=True)


def test_a_recording_without_late_answers_stays_as_it_is() -> None:
    slots = [0, 1, 2, 5, 6]
    assert recorded(slots, [0.0] * 5) == [(slot, k, 10.0 * k, 0.0) for k, slot in enumerate(slots)]


def test_between_two_periods_a_late_answer_may_act_or_not() -> None:
    # By part of a period: the one before may still act.
    assert recorded([0, 1, 2, 3], [0, 0.0, 0.4, 0.0])[1:] == [(1, 1, 10.0, 0.0), (2, 2, 15.0, 5.0), (3, 3, 30.0, 0.0)]
    # By 1.5 periods, and nothing is seen meanwhile: first surely the one before, then perhaps, then surely not.
    assert recorded([0, 1, 4], [0, 1.5, 0.0]) == [
        (0, 0, 0.0, 0.0),
        (1, 1, 0.0, 0.0),
        (2, NONE, 5.0, 5.0),
        (3, NONE, 10.0, 0.0),
        (4, 2, 20.0, 0.0),
    ]
    # By two whole ones: there is no doubt.
    assert recorded([0, 1, 4], [0, 2.0, 0.0])[1:] == [(1, 1, 0.0, 0.0), (3, NONE, 10.0, 0.0), (4, 2, 20.0, 0.0)]


def test_answers_that_are_late_together_act_one_after_the_other() -> None:
    """A stall of two and a half periods: samples have waited, and are answered at once."""
    rows = recorded([0, 1, 2, 3, 4], [0, 2.5, 1.5, 0.5, 0.0])
    assert rows[1:] == [(1, 1, 0.0, 0.0), (2, 2, 0.0, 0.0), (3, 3, 15.0, 15.0), (4, 4, 40.0, 0.0)]


def test_an_answer_that_a_newer_one_overtakes_never_acts() -> None:
    assert recorded([0, 1, 2], [0.0, 3.0, 0.0])[1:] == [(1, 1, 0.0, 0.0), (2, 2, 20.0, 0.0)]
    assert recorded([0, 1], [0.0, 3.0])[1:] == [(1, 1, 0.0, 0.0)]


LATE_DRIVES = [(0, "core"), (4, "core"), (2, "full"), (4, "full")]


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.parametrize(("number", "population"), LATE_DRIVES)
def test_a_drive_is_found_though_answers_are_late(number: int, population: str) -> None:
    """It was refused where nobody told that they are."""
    member = drive(number, population)
    found, gap = learned(member, told=True, seed=number)
    assert found.valid, found.reason
    assert found.angle == pytest.approx(gap, abs=max(GAP_NEAR * gap, member.load_count))
    assert found.fit is not None
    model, truth = identified_drive(told_model(member, "nominal"), found.fit).load, member.drive.load
    assert model.inertia == pytest.approx(truth.inertia, rel=INERTIA_NEAR)
    assert found.fit.delay == pytest.approx(member.delay.mean, abs=DELAY_NEAR / member.rate)
    for speed in SPEEDS:
        effort = truth.viscous_friction * speed + truth.coulomb_friction
        assert model.viscous_friction * speed + model.coulomb_friction == pytest.approx(effort, rel=EFFORT_NEAR)


@pytest.mark.grid
@pytest.mark.population
@pytest.mark.parametrize("told", [True, False])
def test_late_answers_do_not_hide_that_a_coupling_slips(told: bool) -> None:
    found, _ = learned(drive(0, "core"), told=told, slip=0.3)
    assert not found.valid


@pytest.mark.grid
@pytest.mark.population
def test_late_answers_of_which_nobody_tells_make_a_gap_less_certain() -> None:
    member = drive(0, "core")
    (found, gap), (told, _) = (learned(member, told=told) for told in (False, True))
    assert abs(found.angle - gap) <= 2.0 * found.uncertainty
    assert found.uncertainty > told.uncertainty
