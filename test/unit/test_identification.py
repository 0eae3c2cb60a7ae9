"""The fit against the plant: drives drawn at random, found again from what their encoders showed."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from backlash_ros.analysis.evaluation.population import Member, draw_member, told_model
from backlash_ros.analysis.evaluation.task import settings_for
from backlash_ros.control import Servo
from backlash_ros.control.experiment import Deferred
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.signals import THETA_L
from backlash_ros.identification import fit as fit_module
from backlash_ros.identification.drive import identified_drive
from backlash_ros.identification.filter import (
    COULOMB_L,
    COULOMB_M,
    DELAY,
    LN_HALF_GAP,
    LN_INERTIA,
    LN_VISCOUS,
    OFFSET,
    PARAMETERS,
    STATES,
    TORQUE,
    Noise,
    filter_with,
)
from backlash_ros.identification.fit import FITS, PASSES, Problem, Stage, count_of, motor_side
from backlash_ros.identification.gap import Gap, measure_gap
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.identify import identify
from backlash_ros.identification.regression import guess_of
from backlash_ros.simulation import SimulatedDrive

SEED = 20261122
STALL = 6.0


@cache
def probed(number: int) -> tuple[Member, Recording, float]:
    """Return a drive, what the probe recorded of it, and the gap where the load was then, rad."""
    member = draw_member(SEED, number, "core")
    model = told_model(member, "nominal")
    settings = settings_for(model, member)
    servo = Servo(model, settings)
    plant = SimulatedDrive(member.drive, settings.period, sensors=member.sensors, delay=member.delay)
    servo.start_experiment("gap_probe")
    while (outcome := servo.take_outcome()) is None:
        plant.advance(servo.update(plant.sample(), plant.elapsed), member.load_torque)
    assert isinstance(outcome, Deferred), outcome
    recording: Recording = outcome.work.args[1]  # type: ignore[attr-defined]
    return member, recording, member.drive.gear.backlash_at(float(plant.state[THETA_L]))


@cache
def measured(number: int) -> Gap:
    member, recording, _ = probed(number)
    return measure_gap(told_model(member, "nominal"), recording, STALL)


DRIVES = [k for k in range(6) if draw_member(SEED, k, "core").can_outrun]


@pytest.mark.corners(3)
@pytest.mark.parametrize("number", DRIVES)
def test_gap_load_and_delay_are_found_again(number: int) -> None:
    member, _, gap = probed(number)
    found = measured(number)
    assert found.valid, found.reason
    assert abs(found.angle - gap) < max(0.02 * gap, member.load_count)
    assert 0.0 < found.uncertainty < 0.05 * gap + member.load_count
    assert found.fit is not None
    drive, truth = identified_drive(told_model(member, "nominal"), found.fit), member.drive
    assert drive.gear.backlash_angle == pytest.approx(found.angle)
    assert drive.load.inertia == pytest.approx(truth.load.inertia, rel=0.1)
    friction = drive.load.viscous_friction * 10.0 + drive.load.coulomb_friction
    assert friction == pytest.approx(
        truth.load.viscous_friction * 10.0 + truth.load.coulomb_friction, rel=0.15, abs=2e-3
    )
    assert found.fit.delay == pytest.approx(member.delay.command, abs=0.25 / member.rate)
    assert drive.gear.contact.section == truth.gear.contact.section


def test_an_estimate_says_how_sure_it_is() -> None:
    """Next to the test of the same fits, so that one process mostly has both."""
    found = [measured(number) for number in DRIVES]
    errors = [abs(gap.angle - probed(number)[2]) for number, gap in zip(DRIVES, found, strict=True)]
    within = [error <= 2.0 * gap.uncertainty for error, gap in zip(errors, found, strict=True)]
    assert np.mean(within) >= 0.8


def true_parameters(member: Member, gap: float) -> np.ndarray:
    drive, x = member.drive, np.zeros(PARAMETERS)
    x[LN_HALF_GAP] = math.log(0.5 * gap)
    x[OFFSET] = member.sensors.motor_offset * drive.gear.ratio - member.sensors.load_offset
    x[LN_INERTIA], x[LN_VISCOUS] = math.log(drive.load.inertia), math.log(drive.load.viscous_friction)
    x[COULOMB_L], x[TORQUE], x[DELAY] = drive.load.coulomb_friction, member.standing_torque, member.delay.command
    x[COULOMB_M] = drive.motor.coulomb_friction / drive.gear.ratio
    return x


def predicted(member: Member, recording: Recording, x: np.ndarray, teeth: float) -> tuple[np.ndarray, np.ndarray]:
    """Return innovations and their derivatives."""
    contact, count = member.drive.gear.contact, recording.time.size
    readings = (count_of(angle) ** 2 / 12.0 for angle in (recording.motor, recording.load))
    innovations, derivatives = np.zeros((count, 2)), np.zeros((count, 2, PARAMETERS))
    noise = Noise(*readings, 0.03, 0.12, teeth**2)
    side = motor_side(told_model(member, "nominal"), contact)
    filter_with(type(contact))(side, noise, x, *recording, innovations, derivatives, np.zeros((count, STATES)))
    return innovations[1:], derivatives[1:]


@pytest.mark.corners(2)
@pytest.mark.parametrize("number", DRIVES[:4])
def test_the_truth_explains_what_was_seen(number: int) -> None:
    """The innovations are no larger than counts and noise allow: the filter's plant is the plant."""
    member, recording, gap = probed(number)
    innovations, _ = predicted(member, recording, true_parameters(member, gap), 0.013)
    assert np.all(np.sqrt(np.mean(np.minimum(innovations**2, 25.0), axis=0)) < 1.3)


@pytest.mark.parametrize("column", range(PARAMETERS))
def test_derivatives_are_those_of_the_innovations(column: int) -> None:
    """By finite differences, before the teeth have met often; the filter takes its gains as fixed, so not quite."""
    member, whole, gap = probed(DRIVES[0])
    recording = whole.part(slice(round(0.45 * member.rate)))
    x = true_parameters(member, gap)
    x[COULOMB_L] += 0.01
    x[COULOMB_M] += 0.01
    step = np.zeros(PARAMETERS)
    step[column] = 1e-6
    _, derivatives = predicted(member, recording, x, 0.05)
    (after, _), (before, _) = (predicted(member, recording, x + side * step, 0.05) for side in (1, -1))
    wanted = (after - before) / 2e-6
    found = derivatives[:, :, column]
    cosine = np.sum(found * wanted) / (np.linalg.norm(found) * np.linalg.norm(wanted))
    assert cosine > 0.9
    assert 0.5 < np.linalg.norm(found) / np.linalg.norm(wanted) < 2.0


def reversed_motor(recording: Recording) -> Recording:
    return recording._replace(motor=2.0 * recording.motor[0] - recording.motor)


def frozen_load(recording: Recording) -> Recording:
    load = recording.load.copy()
    load[load.size // 2 :] = load[load.size // 2]
    return recording._replace(load=load)


def slipping(recording: Recording) -> Recording:
    load = recording.load.copy()
    load[load.size // 2 :] += 0.3 * float(np.ptp(recording.motor - recording.load))
    return recording._replace(load=load)


def stuck_bit(recording: Recording) -> Recording:
    count = count_of(recording.load)
    whole = np.round(recording.load / count).astype(int)
    return recording._replace(load=count * (whole | 16))


def stretched(recording: Recording) -> Recording:
    return recording._replace(motor=1.05 * recording.motor)


@pytest.mark.corners(3)
@pytest.mark.population
@pytest.mark.parametrize("number", DRIVES[:1])
@pytest.mark.parametrize("broken", [reversed_motor, frozen_load, slipping, stuck_bit, stretched])
def test_a_broken_encoder_gives_no_gap(number: int, broken: object) -> None:
    member, recording, _ = probed(number)
    found = measure_gap(told_model(member, "nominal"), broken(recording), STALL)  # type: ignore[operator]
    assert not found.valid
    assert (found.angle, found.uncertainty) == (0.0, 0.0)
    assert "check" in found.reason or "flank" in found.reason or "too large to be used" in found.reason


@pytest.mark.parametrize("most", [5, 150, pytest.param(1_000_000, marks=pytest.mark.grid)])
def test_a_search_ends_after_so_many_passes_and_says_so(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """Of a recording that nothing explains, all laws, delays and widths are tried; without a bound that ends, too."""
    member, whole, _ = probed(DRIVES[0])
    recording = slipping(whole.part(slice(whole.time.size // 2)))
    passed = []
    look = Problem.look

    def counting(problem: Problem, x: np.ndarray, stage: Stage) -> tuple[float, np.ndarray, np.ndarray]:
        passed.append(problem.recording.time.size / recording.time.size)
        return look(problem, x, stage)

    monkeypatch.setattr(Problem, "look", counting)
    monkeypatch.setattr(fit_module, "PASSES", most)
    found = measure_gap(told_model(member, "nominal"), recording, STALL)
    assert not found.valid
    assert sum(passed) < most + 200
    assert found.fit is not None
    assert found.fit.exhausted == (most < PASSES)
    assert ("passes of the filter" in found.reason) == (most < PASSES)


@pytest.mark.parametrize("late", [0, 3])
def test_a_refusal_says_that_commands_were_late(monkeypatch: pytest.MonkeyPatch, late: int) -> None:
    member, whole, _ = probed(DRIVES[0])
    recording = slipping(whole.part(slice(whole.time.size // 2)))
    doubt = np.zeros(recording.time.size)
    doubt[10 : 10 + late] = 1e-3
    monkeypatch.setattr(fit_module, "PASSES", 5)
    found = measure_gap(told_model(member, "nominal"), recording._replace(doubt=doubt), STALL)
    assert not found.valid
    assert "no model of teeth, friction and load explains" in found.reason
    assert (f"{late} of {recording.time.size} commands were late" in found.reason) == (late > 0)


@pytest.mark.population
def test_what_was_found_before_the_search_had_ended_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if it explains all that was seen, on the way to the bottom."""
    member, recording, _ = probed(DRIVES[0])
    ends = []
    for most in range(100, 500, 50):
        monkeypatch.setattr(fit_module, "PASSES", most)
        found = measure_gap(told_model(member, "nominal"), recording, STALL)
        assert found.fit is not None
        assert found.valid != found.fit.exhausted, found.reason
        ends.append((found.fit.exhausted, max(found.fit.rms) <= FITS))
        if ends[-1] == (True, True):
            everything = identify(told_model(member, "nominal"), recording, hold_out=False)
            assert not everything.valid
            assert f"found none in {PASSES} passes" in everything.reason
    assert (True, True) in ends


def test_a_regression_finds_inertia_and_torque_without_a_derivative() -> None:
    member, recording, _ = probed(DRIVES[0])
    guess = guess_of(motor_side(told_model(member, "nominal")), recording, member.delay.command)
    assert guess.load_torque == pytest.approx(member.standing_torque, abs=0.05)
    assert guess.inertia == pytest.approx(member.drive.load.inertia, rel=0.5)


@pytest.mark.parametrize("counts", [(4096.0, 4096.0), (4096.0, 65536.0), (2.0**17, 2.0**18)])
def test_friction_that_cannot_be_told_apart_is_guessed_right_in_sum(counts: tuple[float, float]) -> None:
    """A load torque keeps the teeth in contact: it is not much of one side's less nearly as much of the other's."""
    drive = replace(NOMINAL_DRIVE, command_interface="current")
    side, inertia, viscous, dry, torque = motor_side(drive), 3e-4, 5e-3, 0.05, -0.3
    time = 1e-3 * np.arange(1300)
    angle = 0.03 * np.sin(6.0 * np.pi * time) * np.sin(0.8 * np.pi * time)
    speed = np.gradient(angle, 1e-3)
    effort = (side.inertia + inertia) * np.gradient(speed, 1e-3) + (side.viscous + viscous) * speed - torque
    effort += dry * np.sign(speed)
    motor_count, load_count = 2.0 * np.pi * drive.gear.ratio / counts[0], 2.0 * np.pi / counts[1]
    motor, load = motor_count * np.floor(angle / motor_count), load_count * np.floor((angle + 0.01) / load_count)
    guess = guess_of(side, Recording.of(time, motor, load, np.append(effort[1:], 0.0) / side.gain), -0.5e-3)
    assert min(guess.coulomb_l, guess.coulomb_m) >= 0.0
    assert guess.coulomb_l + guess.coulomb_m == pytest.approx(dry, rel=0.2)
    assert guess.load_torque == pytest.approx(torque, abs=0.01)


def test_teeth_that_give_more_are_found_so() -> None:
    """Stiffness is fitted for a spring, in place of that of the contact's defaults."""
    number = next(k for k in DRIVES if draw_member(SEED, k, "core").drive.gear.contact.section == "contact.elastic")
    member, recording, gap = probed(number)
    contact = CONTACTS["elastic"]()
    soft = replace(contact, wind_up=2.0 * contact.wind_up, damping=0.5 * contact.damping)
    found = measure_gap(told_model(member, "nominal"), recording, STALL, [soft])
    assert found.valid, found.reason
    assert found.angle == pytest.approx(gap, rel=0.03)
    assert found.fit is not None
    drive: Drive = identified_drive(told_model(member, "nominal"), found.fit)
    assert drive.gear.contact.wind_up == pytest.approx(contact.wind_up, rel=0.2)  # type: ignore[attr-defined]
