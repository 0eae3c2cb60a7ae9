"""The relay with one encoder: the gap that it finds, how far it goes, what it refuses, and that it ends at rest."""

import math
from dataclasses import replace

import numpy as np
import pytest
from broken_measurements import kinds_for, play
from drives import varied
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from backlash_ros.control import EXPERIMENTS, GainSet, Limits, Method, Servo, ServoSettings
from backlash_ros.control.experiment import BacklashEstimate, Deferred, DriveEstimate
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.signals import OMEGA_L, THETA_L, THETA_M, Measurement
from backlash_ros.identification.fitting.problem import Problem
from backlash_ros.simulation import SimulatedDrive, run_experiment
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.evaluation.task import settings_for

ENCODERS = {"load": ("theta_l",), "motor": ("theta_m",)}
SWING = 0.3


def sensors_of(encoder: str) -> Sensors:
    return Sensors(measured=ENCODERS[encoder], motor_counts=4096.0, load_counts=16384.0)


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.parametrize("encoder", ["load", "motor"])
@pytest.mark.parametrize(
    ("drive", "torque"),
    [
        (NOMINAL_DRIVE, 0.0),
        (varied(load_coulomb_friction=0.1, load_inertia=1e-3), 0.0),
        (varied(load_inertia=1.5e-3, gear_backlash_angle=0.012), 0.1),
        (varied(gear_backlash_angle=0.05), 0.0),
    ],
    ids=["free", "friction", "torque", "wide gap"],
)
def test_one_encoder_tells_the_gap(gains: GainSet, drive: Drive, torque: float, encoder: str) -> None:
    estimate = run_experiment(
        drive,
        ServoSettings(gains),
        "relay",
        model=NOMINAL_DRIVE,
        load_torque=torque,
        sensors=sensors_of(encoder),
    )
    assert estimate.valid, estimate.reason
    assert estimate.method is Method.RELAY
    assert estimate.angle == pytest.approx(drive.gear.backlash_angle, rel=0.05)
    assert abs(estimate.angle - drive.gear.backlash_angle) < 2.5 * estimate.uncertainty


def learned(member: Member, told: str, experiment: str = "relay") -> BacklashEstimate:
    """Learn the gap of a drive of a population by the relay; ``told``: what the controller knows of the drive."""
    model = told_model(member, told)
    return run_experiment(
        member.drive,
        settings_for(model, member, 0.0),
        experiment,
        model=model,
        load_torque=member.load_torque,
        sensors=member.sensors,
        delay=member.delay,
    )


def assert_learned(member: Member, told: str, within: float) -> None:
    """Assert that the gap is learned, off by a share of it at most."""
    estimate = learned(member, told)
    assert estimate.valid, estimate.reason
    assert estimate.angle == pytest.approx(member.drive.gear.backlash_angle, rel=within)


@pytest.mark.grid
@pytest.mark.population
@pytest.mark.parametrize("number", [83, 88])
def test_each_contact_law_is_tried_from_what_the_other_has_found(number: int) -> None:
    """By itself the right one misses its minimum: the other one then was 12 % off, or the drive was refused."""
    assert_learned(draw_member(818181, number, "core", "load"), "nominal", within=0.02)


@pytest.mark.grid
@pytest.mark.population
@pytest.mark.parametrize("number", [36, 45])
def test_the_motion_starts_on_the_flank_on_which_a_torque_holds_the_load(number: int) -> None:
    """Started in the middle of the gap, even the true parameters explained nothing: the filter left all bounds."""
    assert_learned(draw_member(352711, number, "core", "load"), "identified", within=0.01)


@pytest.mark.grid
@pytest.mark.population
@pytest.mark.parametrize("number", [42, 44])
def test_free_teeth_do_not_pass_for_elastic_ones(number: int) -> None:
    """By what more parameters explain by chance, gaps were 4 and 9 % too narrow, and a load 43 % too light."""
    assert_learned(draw_member(291126, number, "core", "load"), "identified", within=0.04)


@pytest.mark.population
def test_a_motion_that_leaves_all_bounds_with_every_model_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Problem, "_run", lambda *_, **__: math.inf)
    estimate = learned(draw_member(291126, 44, "core", "load"), "identified")
    assert not estimate.valid
    assert estimate.reason.startswith("no gap measured: ")


@pytest.mark.population
def test_an_inertia_that_the_recording_leaves_open_is_not_told_as_sure() -> None:
    """A narrower gap with a lighter load explains nearly as much; the inertia is off by a quarter, with 3 % said."""
    member = draw_member(291126, 44, "core", "load")
    estimate = learned(member, "identified", "identify_by_relay")
    assert isinstance(estimate, DriveEstimate)
    found = next(each for each in estimate.findings if each.symbol == "J_l")
    assert not found.told
    assert abs(found.value - member.drive.load.inertia) < 2.0 * found.uncertainty


@pytest.mark.population
@pytest.mark.parametrize("effect", ["dead_band", "datasheet", "lively"])
def test_an_axis_that_the_equations_describe_nearly_is_learned(effect: str) -> None:
    """With motor and amplifier as told, the first two were 5 and 9 % off."""
    assert_learned(draw_member(731903, 1, "core", "load", effects=(effect,)), "identified", within=0.05)


@pytest.mark.population
@pytest.mark.parametrize(("encoder", "number"), [("load", 2), pytest.param("motor", 3, marks=pytest.mark.grid)])
def test_samples_up_to_a_tenth_of_a_period_early_or_late_are_no_reason_to_refuse(encoder: str, number: int) -> None:
    """Taken when their stamps say, they made the gap 0.63 of what it is, and moved motor and load as no model can."""
    assert_learned(draw_member(501177, number, "core", encoder, effects=("jitter",)), "identified", within=0.02)


@pytest.mark.grid
@pytest.mark.population
def test_where_the_gentle_part_leads_astray_the_brisk_one_tells_the_gap() -> None:
    """With the gentle part, the gap was 19 % too wide."""
    assert_learned(draw_member(640217, 14, "core", "motor"), "identified", within=0.02)


@pytest.mark.population
def test_with_the_motors_encoder_the_search_begins_where_the_motor_carries_the_load_in_play() -> None:
    """Started anywhere with much noise, it ended at 0.005 of the gap."""
    assert_learned(draw_member(908441, 39, "core", "motor"), "identified", within=0.02)


@pytest.mark.grid
@pytest.mark.population
def test_in_play_a_load_that_a_torque_holds_on_a_flank_does_not_pass_for_a_wide_gap() -> None:
    """A gap 38 times as wide, whose other flank never bore a torque, leaves nothing to be explained either."""
    assert_learned(draw_member(908441, 32, "core", "motor"), "identified", within=0.02)


@pytest.mark.population
def test_a_load_that_the_motor_hardly_feels_is_told_where_all_is_plain() -> None:
    """A load of 0.08 of the motor's inertia, seen at the output."""
    assert_learned(draw_member(5150, 42, "core", "motor"), "identified", within=0.04)


@pytest.mark.grid
@pytest.mark.population
def test_a_load_that_the_motor_hardly_feels_is_refused_where_another_gap_is_nearly_as_likely() -> None:
    estimate = learned(draw_member(5150, 30, "core", "motor"), "identified")
    assert not estimate.valid
    assert "gaps of different widths explain what was seen equally well" in estimate.reason


@pytest.mark.grid
@pytest.mark.population
def test_a_gap_of_a_few_counts_is_refused() -> None:
    """It has 2.9 counts, and was found 43 % too wide, with an uncertainty of 3 %."""
    estimate = learned(draw_member(352711, 61, "core", "load"), "identified")
    assert not estimate.valid
    assert "counts of the encoder: fewer than 5 do not tell it" in estimate.reason


def run(
    servo: Servo, plant: SimulatedDrive, samples: int, torque: float = 0.0, jumps: dict[int, float] | None = None
) -> float:
    """Go on until an outcome or a fault is there; return how far the load went, rad."""
    swing = 0.0
    for k in range(samples):
        measured = plant.sample().copy()
        measured[[THETA_M, THETA_L]] += (jumps or {}).get(k, 0.0)
        plant.advance(servo.update(Measurement(measured), plant.elapsed), torque)
        swing = max(swing, abs(float(plant.state[THETA_L])))
        experiment = servo._experiment.run
        if servo.latched or (experiment is not None and experiment.outcome is not None):
            break
    return swing


def started(gains: GainSet, drive: Drive, encoder: str, **changes: float) -> tuple[Servo, SimulatedDrive]:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    plant = SimulatedDrive(drive, servo.settings.period, sensors=sensors_of(encoder))
    servo.update(plant.sample())
    servo.start_experiment("relay", replace(EXPERIMENTS["relay"].parameters, **changes))
    return servo, plant


@pytest.mark.corners(3)
@pytest.mark.parametrize("encoder", ["load", "motor"])
@pytest.mark.parametrize("torque", [0.0, 0.3, -0.45])
@pytest.mark.parametrize("inertia", [1.3e-4, 2e-3])
@pytest.mark.parametrize("backlash", [0.004, 0.09])
def test_the_load_stays_within_the_swing(
    gains: GainSet, encoder: str, torque: float, inertia: float, backlash: float
) -> None:
    drive = varied(load_inertia=inertia, gear_backlash_angle=backlash)
    servo, plant = started(gains, drive, encoder)
    assert run(servo, plant, 5000, torque) <= SWING + backlash
    outcome = servo.take_outcome()
    assert isinstance(outcome, Deferred) or (outcome is not None and "swing" in outcome.reason)


@pytest.mark.parametrize("encoder", ["load", "motor"])
def test_a_travel_beyond_the_swing_is_cut_to_it(gains: GainSet, encoder: str) -> None:
    servo, plant = started(gains, NOMINAL_DRIVE, encoder, travel=SWING)
    assert run(servo, plant, 5000) < 0.5 * SWING
    assert isinstance(servo.take_outcome(), Deferred)


@pytest.mark.parametrize("encoder", ["load", "motor"])
def test_a_load_that_is_held_is_refused_with_the_torque(gains: GainSet, encoder: str) -> None:
    servo, plant = started(gains, varied(load_coulomb_friction=50.0), encoder)
    held = replace(plant.drive, motor=replace(plant.drive.motor, coulomb_friction=5.0)) if encoder == "motor" else None
    if held is not None:
        plant = SimulatedDrive(held, servo.settings.period, sensors=sensors_of(encoder))
    run(servo, plant, 5000)
    outcome = servo.take_outcome()
    assert not isinstance(outcome, Deferred)
    assert outcome is not None
    assert "nothing moved under a torque of" in outcome.reason


@pytest.mark.corners(2)
@pytest.mark.parametrize("encoder", ["load", "motor"])
@pytest.mark.parametrize("since", [2, 300, 700, 1000])
def test_an_encoder_that_freezes_ends_it_soon(gains: GainSet, encoder: str, since: int) -> None:
    """The motor goes unseen until it may have gone through the swing, from where it is and at its speed."""
    servo, plant = started(gains, varied(load_coulomb_friction=0.02), encoder)
    shown, swing = plant.sample().copy(), 0.0
    for k in range(1500):
        measured = plant.sample().copy()
        shown = measured if k < since else shown
        plant.advance(servo.update(Measurement(shown.copy()), plant.elapsed))
        swing = max(swing, abs(float(plant.state[THETA_L])))
        if servo.latched or servo.take_outcome() is not None:
            break
    else:
        pytest.fail("it did not end")
    assert swing < 3.0 * SWING


def test_an_encoder_that_goes_missing_ends_it(gains: GainSet) -> None:
    experiment = EXPERIMENTS["relay"].make(
        NOMINAL_DRIVE, EXPERIMENTS["relay"].parameters, 0.004, Limits.of(NOMINAL_DRIVE)
    )
    servo, plant = started(gains, NOMINAL_DRIVE, "load")
    measured = plant.sample().copy()
    experiment.step(Measurement(measured), servo.estimate, 0.0, 0.004, 0.0)
    assert experiment.outcome is None
    measured[THETA_L] = math.nan
    assert experiment.step(Measurement(measured), servo.estimate, 0.0, 0.004, 0.0).torque == 0.0
    assert experiment.outcome is not None
    assert not experiment.outcome.valid
    assert "the encoder that the run started with is missing" in experiment.outcome.reason


@examples(max_examples=8, deadline=None)
@given(
    after=st.integers(1, 1000),
    torque=st.sampled_from([0.0, -0.02]),
    encoder=st.sampled_from(["load", "motor"]),
)
def test_it_is_cancelled_at_any_sample_and_ends_at_rest(
    gains: GainSet, after: int, torque: float, encoder: str
) -> None:
    servo, plant = started(gains, varied(load_coulomb_friction=0.05), encoder)
    run(servo, plant, after, torque)
    servo.cancel("test")
    assert servo.take_outcome() is not None
    run(servo, plant, 1500, torque)
    assert servo.fault == ""
    assert abs(float(plant.state[OMEGA_L])) < 0.02


@examples(max_examples=8, deadline=None)
@given(
    at=st.integers(1, 1000),
    samples=st.sampled_from([1, 3, 10]),
    size=st.floats(0.005, 1e4),
    way=st.sampled_from([1.0, -1.0]),
    encoder=st.sampled_from(["load", "motor"]),
)
def test_wrong_samples_do_not_take_the_load_beyond_the_swing(
    gains: GainSet, at: int, samples: int, size: float, way: float, encoder: str
) -> None:
    """The encoder jumps for a few samples: a fault, the end, or a load that stays where it may be."""
    servo, plant = started(gains, NOMINAL_DRIVE, encoder)
    jumps = dict.fromkeys(range(at, at + samples), way * size)
    assert run(servo, plant, 1200, 0.0, jumps) <= SWING + NOMINAL_DRIVE.gear.backlash_angle


@pytest.mark.corners(2)
@pytest.mark.population
@pytest.mark.parametrize(
    ("encoder", "number", "kind"),
    [(encoder, number % 3, kind) for encoder in ("load", "motor") for number, kind in enumerate(kinds_for(encoder))],
)
def test_a_broken_measurement_is_never_valid_and_wrong(encoder: str, number: int, kind: str) -> None:
    assert not play(kind, number, 20261124, "core", encoder).wrong


def test_limits_that_are_nearer_than_the_swing_refuse_it(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), position_upper=0.25))
    servo.update(Measurement(np.array([math.nan, math.nan, 0.0, math.nan, math.nan])))
    assert "it swings by learning.relay.swing = 0.3 rad to either side, but" in servo.experiment_refusal()
