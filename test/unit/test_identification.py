"""The fit against the plant: drives drawn at random, found again from what their encoders showed."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from backlash_ros.control import Servo
from backlash_ros.control.experiment import Deferred
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.contacts.restitution import RestitutionContact
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.drive import identified_drive
from backlash_ros.identification.fitting import fit as fit_module
from backlash_ros.identification.fitting.fit import LOUD, Search
from backlash_ros.identification.fitting.parameters import place_of
from backlash_ros.identification.fitting.problem import motor_side
from backlash_ros.identification.gap import Gap, _doubt, measure_gap
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.regression import guess_of
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.evaluation.task import settings_for

SEED = 20261122
STALL = 6.0


def recorded(member: Member) -> tuple[Recording, float]:
    """Return what the probe recorded of a drive whose motor and gear alone are told, and the gap there, rad."""
    told = told_model(draw_member(SEED, member.number, "core"), "nominal")
    settings = settings_for(told, member)
    servo = Servo(told, settings, watched=False)
    plant = SimulatedDrive(member.drive, settings.period, sensors=member.sensors, delay=member.delay)
    servo.start_experiment("gap_probe")
    while (outcome := servo.take_outcome()) is None:
        plant.advance(servo.update(plant.sample(), plant.elapsed), member.load_torque)
    assert isinstance(outcome, Deferred), outcome
    recording: Recording = outcome.work.args[1]  # type: ignore[attr-defined]
    return recording, member.drive.gear.backlash_at(float(plant.state[THETA_L]))


@cache
def probed(number: int) -> tuple[Member, Recording, float]:
    """Return a drive, what the probe recorded of it, and the gap where the load was then, rad."""
    member = draw_member(SEED, number, "core")
    return member, *recorded(member)


@cache
def measured(number: int) -> Gap:
    member, recording, _ = probed(number)
    return measure_gap(told_model(member, "nominal"), recording, STALL)


DRIVES = [k for k in range(6) if draw_member(SEED, k, "core").can_outrun]


@pytest.mark.corners(1)
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


@pytest.mark.grid
def test_an_estimate_says_how_sure_it_is() -> None:
    """Next to the test of the same fits, so that one process mostly has both."""
    found = [measured(number) for number in DRIVES]
    errors = [abs(gap.angle - probed(number)[2]) for number, gap in zip(DRIVES, found, strict=True)]
    within = [error <= 2.0 * gap.uncertainty for error, gap in zip(errors, found, strict=True)]
    assert np.mean(within) >= 0.8


def test_a_gap_of_no_more_than_a_count_is_none() -> None:
    fit = measured(DRIVES[0]).fit
    assert fit is not None
    for counts in ((fit.gap, 0.0), (0.0, fit.gap)):
        doubt = _doubt(replace(fit, counts=counts), 0.0, STALL)
        assert doubt is not None
        assert "no more than one encoder count" in doubt.reason
        assert _doubt(replace(fit, counts=(0.9 * counts[0], 0.9 * counts[1])), 0.0, STALL) is None


def test_a_gap_that_is_not_sure_is_none() -> None:
    fit = measured(DRIVES[0]).fit
    assert fit is not None
    fine = replace(fit, counts=(0.0, 0.0))
    assert _doubt(fine, 0.079 * fit.gap, STALL) is None
    doubt = _doubt(fine, 0.081 * fit.gap, STALL)
    assert doubt is not None
    assert "too large to be used" in doubt.reason


SEEN = (
    "ln_half_gap",
    "gap_slope",
    "ln_stiffness",
    "ln_exponent",
    "load_coulomb",
    "load_torque",
    "load_torque_slope",
    "load_scale_error",
    "delay",
    "ln_motor_gain",
)
"""Parameters that change what is predicted more than they change the filter's gains."""


@pytest.mark.parametrize("name", SEEN)
def test_derivatives_are_those_of_the_innovations(name: str) -> None:
    """By finite differences, before the teeth have met often; the filter takes its gains as fixed, so not quite."""
    member, whole, _ = probed(DRIVES[0])
    recording = whole.part(slice(round(0.45 * member.rate)))
    search = Search(told_model(member, "nominal"), recording, STALL, [member.delay.command])
    start = list(search.starts())[4]  # by the best guess, with a gap of 0.75 of the travel in its middle
    problem = search.problem(search.free, start)

    column = place_of(name)

    def innovations(step: float) -> np.ndarray:
        other = start.copy()
        other[column] += step
        problem.look(other, LOUD)
        return problem.results.innovations[1:].copy()

    wanted = (innovations(1e-6) - innovations(-1e-6)) / 2e-6
    innovations(0.0)
    found = problem.results.derivatives[1:, :, column]
    cosine = np.sum(found * wanted) / (np.linalg.norm(found) * np.linalg.norm(wanted))
    assert cosine > 0.9
    assert 0.5 < np.linalg.norm(found) / np.linalg.norm(wanted) < 2.0


def with_contact(drive: Drive, contact: object) -> Drive:
    return replace(drive, gear=replace(drive.gear, contact=contact))  # type: ignore[arg-type]


def lively(drive: Drive) -> Drive:
    """Teeth of steel, that part with most of the speed with which they met."""
    return with_contact(drive, RestitutionContact(wind_up=2e-4, restitution=0.8))


def soft(drive: Drive) -> Drive:
    return with_contact(drive, ElasticContact(wind_up=0.2 * drive.gear.backlash_angle, damping=20.0))


def warm(drive: Drive) -> Drive:
    """A motor that is warmer and weaker than its data sheet says."""
    motor = drive.motor
    return replace(
        drive, motor=replace(motor, resistance=1.15 * motor.resistance, torque_constant=0.95 * motor.torque_constant)
    )


def lossy(drive: Drive) -> Drive:
    return replace(drive, gear=replace(drive.gear, efficiency_forward=0.85, efficiency_backward=0.82))


def rubbing(drive: Drive) -> Drive:
    motor, load = drive.motor, drive.load
    return replace(
        drive,
        motor=replace(motor, coulomb_friction=0.01 * STALL * drive.gear.ratio),
        load=replace(load, coulomb_friction=0.01 * STALL),
    )


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.parametrize("number", [DRIVES[0], DRIVES[2]])
@pytest.mark.parametrize("other", [lively, soft, warm, lossy, rubbing])
def test_a_drive_that_is_not_as_told_is_measured(number: int, other: Callable[[Drive], Drive]) -> None:
    """Misfit makes a gap less certain, and is no reason to refuse it."""
    member = draw_member(SEED, number, "core")
    true = other(member.drive)
    recording, gap = recorded(replace(member, drive=true))
    found = measure_gap(told_model(member, "nominal"), recording, STALL)
    assert found.valid, found.reason
    assert found.angle == pytest.approx(gap, abs=max(0.05 * gap, member.load_count))
    assert abs(found.angle - gap) <= 3.0 * found.uncertainty
    assert found.fit is not None
    inertia = math.exp(found.fit.values.ln_load_inertia)
    assert inertia == pytest.approx(true.load.inertia, abs=0.03 * true.effective_inertia)
    if other is warm:
        assert math.exp(found.fit.values.ln_motor_gain) == pytest.approx(0.95 / 1.15, rel=0.03)


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


def reversed_command(recording: Recording) -> Recording:
    return recording._replace(command=-recording.command)


def stretched(recording: Recording) -> Recording:
    return recording._replace(motor=1.05 * recording.motor)


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.parametrize("number", DRIVES[:1])
@pytest.mark.parametrize("broken", [reversed_command, reversed_motor, frozen_load, slipping, stuck_bit, stretched])
def test_a_broken_encoder_gives_no_gap(number: int, broken: Callable[[Recording], Recording]) -> None:
    member, recording, _ = probed(number)
    found = measure_gap(told_model(member, "nominal"), broken(recording), STALL)
    assert not found.valid
    assert (found.angle, found.uncertainty) == (0.0, 0.0)
    assert broken is not reversed_command or "backwards" in found.reason
    assert "check" in found.reason or "flank" in found.reason or "too large to be used" in found.reason


@pytest.mark.parametrize("most", [5.0, 60.0])
def test_a_search_ends_after_so_many_passes_and_says_so(monkeypatch: pytest.MonkeyPatch, most: float) -> None:
    """What was found before the search had ended is not believed, even if it explains all that was seen."""
    member, recording, _ = probed(DRIVES[0])
    monkeypatch.setattr(fit_module, "PASSES", most)
    found = measure_gap(told_model(member, "nominal"), recording, STALL)
    assert not found.valid
    assert not found.sound
    assert found.fit is not None
    assert found.fit.exhausted
    assert "passes of the filter" in found.reason


@pytest.mark.parametrize("late", [0, 3])
def test_a_refusal_says_that_commands_were_late(monkeypatch: pytest.MonkeyPatch, late: int) -> None:
    member, recording, _ = probed(DRIVES[0])
    doubt = np.zeros(recording.time.size)
    doubt[10 : 10 + late] = 1e-3
    monkeypatch.setattr(fit_module, "PASSES", 5.0)
    found = measure_gap(told_model(member, "nominal"), recording._replace(doubt=doubt), STALL)
    assert not found.valid
    assert (f"{late} of {recording.time.size} commands were late" in found.reason) == (late > 0)


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
    """Stiffness is fitted, in place of that of the contact's defaults."""
    number = next(k for k in DRIVES if draw_member(SEED, k, "core").drive.gear.contact.section == "contact.elastic")
    member = draw_member(SEED, number, "core")
    soft_teeth = ElasticContact(wind_up=2e-3, damping=25.0)
    recording, gap = recorded(replace(member, drive=with_contact(member.drive, soft_teeth)))
    found = measure_gap(told_model(member, "nominal"), recording, STALL)
    assert found.valid, found.reason
    assert found.angle == pytest.approx(gap, rel=0.03)
    assert found.fit is not None
    teeth = identified_drive(told_model(member, "nominal"), found.fit).gear.contact
    assert teeth.wind_up == pytest.approx(2e-3, rel=0.2)  # type: ignore[attr-defined]
