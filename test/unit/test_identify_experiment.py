"""The experiment behind ~/identify: what is told is set, what is not told is not, and nothing from what is broken."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest

from backlash_ros.control import Servo
from backlash_ros.control.estimates.requests import describe_outcome
from backlash_ros.control.experiment import Deferred, DriveEstimate, Outcome
from backlash_ros.drivetrain.sensors import POSITIONS
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement
from backlash_ros.identification.fitting.parameters import parameters_at, place_of
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.evaluation.task import DELAY_NEAR, INERTIA_NEAR, first_reading, settings_for

pytestmark = pytest.mark.population

SEED = 20261122
EXPECTED = tuple(f"expected_load_torque{part}" for part in ("", "_angle", "_slope"))
UNEXPLAINED = "unexplained_motor_torque", "unexplained_load_torque"


def identified(member: Member, spoil: Callable[[Measurement], None] = lambda _: None) -> Outcome:
    model = told_model(member, "identified")
    servo = Servo(model, settings_for(model, member, 0.0), watched=False)
    plant = SimulatedDrive(member.drive, 1.0 / member.rate, sensors=member.sensors, delay=member.delay)
    outcome: Outcome | Deferred | None = None
    servo.start_experiment("identify" if set(POSITIONS) <= set(member.sensors.measured) else "identify_by_relay")
    while outcome is None:
        shown = plant.sample()
        spoil(shown)
        plant.advance(servo.update(shown, plant.elapsed), member.load_torque)
        outcome = servo.take_outcome()
    return outcome.work() if isinstance(outcome, Deferred) else outcome


@cache
def sound(population: str, number: int) -> Outcome:
    return identified(draw_member(SEED, number, population))


@pytest.mark.grid
def test_what_cannot_be_told_is_not_set_and_the_answer_says_why() -> None:
    """The motor never leaves this load: gap and teeth are unknown, and the inertia apart from the motor's gain."""
    member = draw_member(SEED, 18, "full")
    found = sound("full", 18)
    assert isinstance(found, DriveEstimate)
    assert found.valid
    assert {"motor.coulomb_friction", "loop_delay"} <= set(found.uncertainties) <= set(found.parameters)
    assert not [name for name in found.parameters if name.startswith(("backlash", "contact", "gear", "load."))]
    assert found.parameters["loop_delay"] == pytest.approx(member.delay.command, abs=0.25 / member.rate)
    text = describe_outcome(found)
    assert "; not told: b: the teeth never bore a positive torque" in text
    assert "J_l: its standard uncertainty is" in text


@pytest.mark.parametrize(("population", "number"), [("core", 4), pytest.param("full", 4, marks=pytest.mark.grid)])
def test_a_weight_shows_as_the_slope_of_the_load_torque_where_the_load_was(population: str, number: int) -> None:
    member = draw_member(SEED, number, population)
    found, load = sound(population, number), member.drive.load
    assert isinstance(found, DriveEstimate)
    torque, angle, slope = (found.parameters[name] for name in EXPECTED)
    assert torque == pytest.approx(member.standing_torque, abs=5e-3)
    assert angle == pytest.approx(first_reading(member), abs=member.drive.gear.backlash_angle)
    assert slope == pytest.approx(-load.gravity_torque * math.cos(load.gravity_offset), abs=0.02)
    assert (slope == 0.0) == (load.gravity_torque == 0.0)


def test_a_slope_too_steep_for_a_weight_is_none_and_what_nothing_explains_is_told_in_newton_metres() -> None:
    found = sound("core", 4)
    assert isinstance(found, DriveEstimate)
    assert found.fit is not None
    stall = found.fit.standstill_torque
    assert stall == pytest.approx(6.0)
    parameters, covariance = found.fit.parameters.copy(), found.fit.covariance.copy()
    place = place_of("load_torque_slope")
    covariance[place, place] = 1e-6
    for slope, told in [(0.19 * stall, 0.19 * stall), (0.21 * stall, 0.0), (-0.21 * stall, 0.0), (1e-3, 0.0)]:
        parameters_at(parameters).load_torque_slope = slope
        fit = replace(found.fit, parameters=parameters, covariance=covariance)
        assert fit.load_torque["expected_load_torque_slope"] == pytest.approx(told)
    unexplained = replace(found.fit, noise=(2.3e-3, 1e-2, 0.0, 0.0)).unexplained
    assert list(unexplained) == list(UNEXPLAINED)
    assert [value / stall for value in unexplained.values()] == pytest.approx([2e-3, 1e-2])
    assert replace(found.fit, noise=(3e-4, 0.0, 0.0, 0.0)).unexplained[UNEXPLAINED[0]] == pytest.approx(0.0, abs=1e-9)


def test_all_that_is_told_has_its_uncertainty_and_teeth_come_as_a_whole() -> None:
    found = sound("core", 1)
    assert isinstance(found, DriveEstimate)
    assert found.fit is not None
    assert max(found.fit.rms) <= 1.15
    teeth = {"contact.law", "contact.elastic.wind_up", "contact.elastic.damping", "gear.backlash_angle"}
    load = {"load.inertia", "load.viscous_friction", "load.coulomb_friction"}
    motor = {"motor.coulomb_friction", "motor.torque_constant", "motor.resistance"}
    assert set(found.parameters) == {*teeth, *load, *motor, "backlash_angle", "loop_delay", *EXPECTED, *UNEXPLAINED}
    assert found.parameters["backlash_angle"] == found.parameters["gear.backlash_angle"] == found.angle
    untold = {"contact.law", "contact.elastic.damping", EXPECTED[1], *UNEXPLAINED}
    assert set(found.uncertainties) == {*found.parameters} - untold
    assert all(0.0 < value < math.inf for value in found.uncertainties.values())


@pytest.mark.parametrize(("encoder", "number"), [("load", 4), pytest.param("motor", 5, marks=pytest.mark.grid)])
def test_one_encoder_tells_gap_load_and_delay_by_the_relay(encoder: str, number: int) -> None:
    """The load of drive 4 is too light for its motor to feel it."""
    member = draw_member(SEED, number, "core", encoder)
    found = identified(member)
    assert isinstance(found, DriveEstimate)
    assert found.valid
    gap = member.drive.gear.backlash_angle
    assert found.parameters["backlash_angle"] == pytest.approx(gap, abs=3.0 * found.uncertainties["backlash_angle"])
    assert found.parameters["load.inertia"] == pytest.approx(member.drive.load.inertia, rel=INERTIA_NEAR)
    assert found.parameters["loop_delay"] == pytest.approx(member.delay.command, abs=DELAY_NEAR / member.rate)
    motor = member.drive.motor
    assert found.parameters["motor.torque_constant"] == pytest.approx(motor.torque_constant, rel=0.02)
    assert found.parameters["motor.resistance"] == pytest.approx(motor.resistance, rel=0.03)


def freeze(shown: Measurement) -> None:
    shown[THETA_L] = 0.3


def reverse(shown: Measurement) -> None:
    shown[THETA_L] = -shown[THETA_L]


def swap(shown: Measurement) -> None:
    shown[THETA_M], shown[THETA_L] = shown[THETA_L], shown[THETA_M]


@pytest.mark.parametrize("spoil", [freeze, reverse, swap])
def test_nothing_is_identified_from_broken_encoders(spoil: Callable[[Measurement], None]) -> None:
    outcome = identified(draw_member(SEED, 4, "core"), spoil)
    assert not outcome.valid
    assert outcome.reason.startswith("nothing was identified: ")
