"""The delay between drive and controller: what acts when, what is seen when, and what jitter may not do."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from samples import sample_of

from backlash_ros.control import GainSet, Servo, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE, Plant
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.delay import (
    LINE,
    Delay,
    acts_at,
    delay_constants,
    line_of,
    player_for,
    stamped_at,
    taken_at,
)
from backlash_ros.drivetrain.motion.integrator import DEFAULT_TOLERANCE, DONE, integration_memory
from backlash_ros.foundation.signals import CURRENT, at_rest
from backlash_ros.simulation import Scenario, SimulatedDrive, run

PERIOD = 0.004
COUNT = 150
COMMANDS = 8.0 + 2.0 * np.sin(0.9 * np.arange(COUNT))
TORQUE = -0.1
"""Presses the load onto the motor: impacts would amplify rounding. For the same reason the times between two events are
worked out here from those since the start, as k T + d is rounded."""
LATE = pytest.mark.parametrize("late", [0.0, 0.3, 1.0, 1.5, 2.7, LINE - 2.0])
"""Delays in periods."""


def simulated(delay: Delay) -> tuple[np.ndarray, np.ndarray]:
    """Return what a drive with the delay shows at each sample, and its state there, under `COMMANDS`."""
    drive = SimulatedDrive(NOMINAL_DRIVE, PERIOD, delay=delay)
    shown, states = [], []
    for command in COMMANDS:
        shown.append(drive.sample().copy())
        states.append(drive.state[:5].copy())
        drive.advance(command, TORQUE)
    return np.array(shown), np.array(states)


def assert_same(actual: np.ndarray, expected: Sequence[np.ndarray]) -> None:
    """Of each signal, to 1e-12 of its largest value."""
    scale = np.max(np.abs(expected), axis=0)
    np.testing.assert_allclose(actual / scale, expected / scale, rtol=0, atol=1e-12)


def command_of(number: int) -> float:
    return float(COMMANDS[number]) if number >= 0 else 0.0


@LATE
def test_command_acts_after_its_delay_exactly(late: float) -> None:
    _, states = simulated(Delay(command=late * PERIOD))
    plant, whole = Plant(NOMINAL_DRIVE), math.floor(late)
    part, expected = late - whole, []
    for k in range(COUNT):
        expected.append(plant.state)
        before = ((k - whole) * PERIOD + late * PERIOD) - k * PERIOD if part and k >= whole else 0.0
        plant.advance(command_of(k - whole - 1), TORQUE, before)
        plant.advance(command_of(k - whole), TORQUE, PERIOD - before)
    assert_same(states, expected)


@LATE
def test_sample_shows_the_state_at_the_time_at_which_it_was_taken(late: float) -> None:
    """Before the start the drive stood as it does there."""
    shown, _ = simulated(Delay(sample=late * PERIOD))
    plant, whole = Plant(NOMINAL_DRIVE), math.floor(late)
    part = late - whole
    taken = [plant.state] * (whole + 1 + COUNT)
    for k in range(COUNT):
        before = ((k + 1 + whole) * PERIOD - late * PERIOD) - k * PERIOD if part else PERIOD
        plant.advance(command_of(k), TORQUE, before)
        taken[k + 1 + whole] = plant.state
        plant.advance(command_of(k), TORQUE, PERIOD - before)
    assert_same(shown, taken[:COUNT])


def test_both_ways_may_be_late() -> None:
    """A sample of 0.4 periods ago, an answer that acts 0.25 periods from now: two times in each period."""
    shown, states = simulated(Delay(sample=0.4 * PERIOD, command=0.25 * PERIOD))
    plant, seen, expected = Plant(NOMINAL_DRIVE), [Plant(NOMINAL_DRIVE).state], []
    for k in range(COUNT):
        expected.append(plant.state)
        switched, taken = (k * PERIOD + 0.25 * PERIOD) - k * PERIOD, ((k + 1) * PERIOD - 0.4 * PERIOD) - k * PERIOD
        plant.advance(command_of(k - 1), TORQUE, switched)
        plant.advance(command_of(k), TORQUE, taken - switched)
        seen.append(plant.state)
        plant.advance(command_of(k), TORQUE, PERIOD - taken)
    assert_same(states, expected)
    assert_same(shown, seen[:COUNT])


@pytest.mark.parametrize("jitter", [0.3, 2.5])
@pytest.mark.parametrize("seed", [0, 7])
def test_jitter_stays_within_its_bound_and_is_even(jitter: float, seed: int) -> None:
    delay = Delay(0.5 * PERIOD, 1.5 * PERIOD, jitter * PERIOD, jitter * PERIOD)
    constants = delay_constants(delay, PERIOD, seed)
    k = np.arange(5000)
    for late, least in (
        (k * PERIOD - [taken_at(constants, each) for each in k], 0.5),
        (np.array([acts_at(constants, each) for each in k]) - k * PERIOD, 1.5),
    ):
        share = (late / PERIOD - least) / jitter
        assert np.min(share) >= -1e-9
        assert np.max(share) <= 1 + 1e-9
        assert np.mean(share) == pytest.approx(0.5, abs=5 * math.sqrt(1 / 12 / k.size))
        assert np.var(share) == pytest.approx(1 / 12, abs=5 * math.sqrt(1 / 180 / k.size))


@pytest.mark.parametrize("seed", [0, 7])
def test_stamps_with_jitter_are_as_often_too_early_as_too_late(seed: int) -> None:
    """And no sample is taken after it has arrived."""
    delay, jitter = Delay(0.5 * PERIOD, stamp_jitter=0.1 * PERIOD), 0.1 * PERIOD
    constants, k = delay_constants(delay, PERIOD, seed), np.arange(5000)
    taken = np.array([taken_at(constants, each) for each in k])
    stamped = np.array([stamped_at(constants, each) for each in k])
    np.testing.assert_allclose(k * PERIOD - stamped, 0.6 * PERIOD, rtol=1e-9)
    assert np.all(taken <= k * PERIOD - 0.5 * PERIOD + 1e-12)
    share = (taken - stamped) / jitter
    assert np.max(np.abs(share)) <= 1 + 1e-9
    assert np.mean(share) == pytest.approx(0.0, abs=5 * math.sqrt(1 / 3 / k.size))
    assert np.var(share) == pytest.approx(1 / 3, rel=0.05)


def test_sample_whose_stamp_errs_shows_the_state_at_the_time_at_which_it_was_taken() -> None:
    drive = SimulatedDrive(NOMINAL_DRIVE, PERIOD, delay=Delay(stamp_jitter=0.4 * PERIOD), seed=3)
    constants, plant = delay_constants(Delay(stamp_jitter=0.4 * PERIOD), PERIOD, 3), Plant(NOMINAL_DRIVE)
    for k, command in enumerate(COMMANDS[:40]):
        drive.advance(float(command), TORQUE)
        shown = drive.sample()
        assert drive.elapsed == pytest.approx(PERIOD)
        assert drive.age == pytest.approx(0.4 * PERIOD)
        at, begin = taken_at(constants, k + 1), plant.time
        if at > k * PERIOD:  # else it is from the period before
            plant.advance(float(command), TORQUE, at - begin)
            np.testing.assert_allclose(shown, plant.state, rtol=1e-9, atol=1e-9)
        plant.advance(float(command), TORQUE, (k + 1) * PERIOD - plant.time)


def test_mean_delay_counts_both_ways_and_half_the_jitter() -> None:
    assert Delay(0.001, 0.002, 0.0004, 0.0006).mean == pytest.approx(0.0035)
    assert Delay(0.001, 0.002, stamp_jitter=0.0004).mean == pytest.approx(0.0034)


@pytest.mark.parametrize("jitter", [0.4, 3.3])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_older_command_acts_after_a_newer_one(jitter: float, seed: int) -> None:
    """Commands that grow, on a drive whose current is the command: at any time the newest that has come acts."""
    drive, substeps, count = replace(NOMINAL_DRIVE, command_interface="current"), 40, 60
    constants = delay_constants(Delay(command=0.2 * PERIOD, command_jitter=jitter * PERIOD), PERIOD, seed)
    state, step, play = at_rest(), integration_memory(), player_for(drive)
    line, rows, currents = line_of(constants, state), np.empty((substeps, 5)), []
    for k in range(count):
        arguments = state, step, line, 0.01 * (k + 1), 0.0, DEFAULT_TOLERANCE, rows
        assert play(plant_constants(drive), *arguments)[0] == DONE
        currents.append(rows[:, CURRENT].copy())
    acting = np.round(100 * np.concatenate(currents)).astype(int) - 1
    assert np.all(np.diff(acting) >= 0)
    due = np.array([acts_at(constants, k) for k in range(count)])
    for now, number in zip(PERIOD / substeps * np.arange(1, acting.size + 1), acting, strict=True):
        # What comes at this very time acts from it on, not before.
        sent_until = math.ceil(now / PERIOD - 1e-9)
        assert number == max((j for j in range(sent_until) if due[j] < now - 1e-9), default=-1)


@pytest.mark.parametrize(
    ("delay", "text"),
    [
        (Delay(sample=0.2481), r"delay\.sample \+ delay\.sample_jitter must be <= 62 periods, 0\.248 s, got 0\.2481"),
        (Delay(command=0.2, command_jitter=0.05), r"delay\.command \+ delay\.command_jitter must be <= 62 periods"),
    ],
)
def test_more_than_a_simulation_keeps_is_refused_by_name(gains: GainSet, delay: Delay, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        SimulatedDrive(NOMINAL_DRIVE, PERIOD, delay=delay)
    with pytest.raises(ValueError, match=text):
        run(NOMINAL_DRIVE, ServoSettings(gains), Scenario(np.ones(3), delay=delay))


def test_negative_delay_is_refused() -> None:
    with pytest.raises(ValueError, match=r"delay\.command must be >= 0 s and <= 1 s, got -0\.001"):
        Delay(command=-0.001)


@pytest.mark.parametrize("law", ["overdamped", "cascade"])
@pytest.mark.parametrize("late", [1, 3])
def test_run_with_a_delay_of_whole_periods_is_one_with_shifted_commands(gains: GainSet, law: str, late: int) -> None:
    choice = ServoSettings(gains, law=law, backlash_angle=0.02)
    count = 250
    scenario = Scenario(np.full(count, 0.3), np.array(TORQUE), delay=Delay(command=late * PERIOD))
    offline = run(NOMINAL_DRIVE, choice, scenario)
    assert offline.fault == ""
    servo, plant = Servo(NOMINAL_DRIVE, choice), Plant(NOMINAL_DRIVE)
    servo.segments[0, 0] = 0.3  # before any position is held, as the run has it
    sent = [0.0] * late
    for k in range(count):
        np.testing.assert_allclose(plant.state, offline.state[k], rtol=1e-12, atol=1e-12)
        sent.append(servo.update(sample_of(plant.state)))
        assert sent[-1] == pytest.approx(offline.command[k], rel=1e-12, abs=1e-12)
        plant.advance(sent[k], TORQUE, PERIOD)
