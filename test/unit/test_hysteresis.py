"""Lost motion on an output that stands: what is found, what ends it, and that it ends at rest."""

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from experiments import Broken, frozen, play, reversed_, stuck_bit, swapped
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from recorded import probed, stepped

from backlash_ros.control import BacklashEstimate, GainSet, HysteresisSettings, Limits, Method, Servo, ServoSettings
from backlash_ros.control.experiment import Deferred
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.contacts.power import PowerContact
from backlash_ros.drivetrain.contacts.restitution import RestitutionContact
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement
from backlash_ros.identification.locked_output.hysteresis import static_place
from backlash_ros.identification.locked_output.lost_motion import LostMotion
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.slow_torque import hysteresis_findings, hysteresis_of, torque_of
from backlash_ros.simulation import SimulatedDrive, run_experiment
from backlash_ros.studies.evaluation.population import told_model

pytestmark = pytest.mark.population

HEAVY, BRAKED = {"inertia": 1e5}, {"coulomb_friction": 10.0}
STANDSTILL = 6.0
"""Torque of the nominal drive, N m at the output."""


def standing(
    held: dict[str, float], backlash: float = 0.02, contact: Contact | None = None, motor_friction: float = 0.0
) -> Drive:
    """Return a drive with an output that stands, with a motor's friction as a share of the torque at standstill."""
    gear = replace(NOMINAL_DRIVE.gear, backlash_angle=backlash, contact=contact or NOMINAL_DRIVE.gear.contact)
    friction = motor_friction * STANDSTILL * gear.ratio
    motor = replace(NOMINAL_DRIVE.motor, coulomb_friction=friction)
    return replace(NOMINAL_DRIVE, motor=motor, gear=gear, load=replace(NOMINAL_DRIVE.load, **held))


def told(drive: Drive) -> Drive:
    """Return what the controller takes ``drive`` for: its command and its law of teeth are known."""
    contact = CONTACTS[drive.gear.contact.section.removeprefix("contact.")]()
    gear = replace(NOMINAL_DRIVE.gear, contact=contact)
    return replace(NOMINAL_DRIVE, gear=gear, command_interface=drive.command_interface)


def place(drive: Drive, torque: float) -> float:
    """Return the angle between both flanks under a torque to either side, rad."""
    if isinstance(drive.gear.contact, PowerContact):  # its teeth give within the gap, too
        return 2.0 * static_place(drive, drive.gear.contact, 0.5 * drive.gear.backlash_angle, torque)
    return drive.gear.backlash_angle + 2.0 * drive.gear.wind_up(torque)


def measured(gains: GainSet, drive: Drive, bits: tuple[int, int] = (12, 16), period: float = 0.004) -> BacklashEstimate:
    sensors = Sensors(measured=POSITIONS, motor_counts=2.0 ** bits[0], load_counts=2.0 ** bits[1])
    settings = replace(ServoSettings(gains), period=period)
    estimate = run_experiment(drive, settings, "hysteresis", model=told(drive), sensors=sensors)
    assert isinstance(estimate, BacklashEstimate)
    return estimate


def found_in(estimate: BacklashEstimate) -> LostMotion:
    assert estimate.valid, estimate.reason
    assert estimate.method is Method.HYSTERESIS
    assert estimate.lost_motion is not None
    return estimate.lost_motion


def power(stiffness: float) -> Contact:
    return PowerContact(stiffness=10.0 * stiffness)


def elastic(give: float) -> Contact:
    return ElasticContact(wind_up=1e-3 * give)


def restitution(give: float) -> Contact:
    return RestitutionContact(wind_up=1e-3 * give)


@pytest.mark.corners(2)
@pytest.mark.parametrize(
    ("held", "backlash", "contact", "friction", "bits", "period", "interface"),
    [
        (HEAVY, 0.02, elastic(1.0), 0.0, (12, 16), 0.004, "voltage"),
        (BRAKED, 0.02, restitution(1.0), 0.05, (18, 18), 0.004, "current"),
        (BRAKED, 0.09, power(3.0), 0.05, (12, 14), 0.001, "voltage"),
        (BRAKED, 0.02, elastic(3.0), 0.05, (12, 16), 0.001, "voltage"),
        (BRAKED, 0.004, elastic(0.3), 0.02, (14, 18), 0.004, "voltage"),
        (HEAVY, 0.09, elastic(3.0), 0.02, (12, 12), 0.001, "current"),
        (HEAVY, 0.004, restitution(3.0), 0.0, (13, 17), 0.001, "voltage"),
        (HEAVY, 0.02, power(1.0), 0.0, (12, 16), 0.004, "voltage"),
        (BRAKED, 0.02, power(0.3), 0.02, (12, 16), 0.004, "current"),
    ],
)
def test_gap_lost_motion_stiffness_and_friction(
    gains: GainSet,
    held: dict[str, float],
    backlash: float,
    contact: Contact,
    friction: float,
    bits: tuple[int, int],
    period: float,
    interface: str,
) -> None:
    drive = replace(standing(held, backlash, contact, friction), command_interface=interface)
    estimate = measured(gains, drive, bits, period)
    found = found_in(estimate)
    true_gap = place(drive, found.gap_torque) if found.gap_torque else backlash
    assert found.gap == estimate.angle == pytest.approx(true_gap, rel=0.01)
    assert found.gap_uncertainty == estimate.uncertainty < 0.03 * backlash
    assert found.at == pytest.approx(0.03 * 0.5 * STANDSTILL)
    assert found.lost_motion == pytest.approx(place(drive, found.at), rel=0.01)
    torques = np.linspace(0.5, 1.0, 20) * found.torque
    true_stiffness = 1.0 / np.polyfit(torques, [0.5 * place(drive, float(each)) for each in torques], 1)[0]
    for stiffness, uncertainty in zip(found.stiffness, found.stiffness_uncertainty, strict=True):
        assert abs(stiffness - true_stiffness) < max(0.1 * true_stiffness, 2.0 * uncertainty)
    assert found.friction + found.loss * 0.5 * found.torque == pytest.approx(friction * STANDSTILL, abs=0.04)


def test_it_tells_which_law_the_teeth_have(gains: GainSet) -> None:
    drive = standing(BRAKED, contact=elastic(1.0))
    sensors = Sensors(measured=POSITIONS, motor_counts=2.0**16, load_counts=2.0**16)
    estimate = run_experiment(drive, ServoSettings(gains), "hysteresis", model=NOMINAL_DRIVE, sensors=sensors)
    assert isinstance(estimate, BacklashEstimate)
    assert found_in(estimate).contact == "elastic"
    assert estimate.angle == pytest.approx(0.02, rel=0.01)


def test_teeth_that_lose_power_are_told_from_the_motor_s_friction(gains: GainSet) -> None:
    drive = standing(BRAKED, contact=elastic(3.0), motor_friction=0.02)
    drive = replace(drive, gear=replace(drive.gear, efficiency_forward=0.9, efficiency_backward=0.9))
    found = found_in(measured(gains, drive, (16, 18)))
    assert found.loss == pytest.approx(0.1, abs=0.03)
    assert found.friction == pytest.approx(0.02 * STANDSTILL, abs=0.05)
    assert found.gap == pytest.approx(0.02, rel=0.01)


def test_a_gear_that_locks_itself_is_refused(gains: GainSet) -> None:
    drive = standing(BRAKED, contact=elastic(1.0))
    drive = replace(drive, gear=replace(drive.gear, efficiency_forward=0.5, efficiency_backward=0.0))
    estimate = measured(gains, drive)
    assert not estimate.valid
    assert "friction takes about half of the torque" in estimate.reason


def test_a_load_that_is_heavy_but_free_goes_to_and_fro_and_ends_at_rest(gains: GainSet) -> None:
    servo, plant = started(gains, standing({"inertia": 1000.0}, contact=elastic(1.0), motor_friction=0.02))
    assert play(servo, plant, 8000) < 0.005
    assert isinstance(servo.take_outcome(), Deferred)
    assert abs(float(plant.state[OMEGA_L])) < 5e-4


def test_a_wrong_reduction_is_not_seen_and_the_gap_is_wrong_by_its_factor(gains: GainSet) -> None:
    """The output does not move: nothing tells the gear's ratio."""
    drive = standing(BRAKED, contact=elastic(1.0))
    model = replace(told(drive), gear=replace(told(drive).gear, reduction=13.0))
    sensors = Sensors(measured=POSITIONS, motor_counts=2.0**14, load_counts=2.0**16)
    estimate = run_experiment(drive, ServoSettings(gains), "hysteresis", model=model, sensors=sensors)
    assert isinstance(estimate, BacklashEstimate)
    assert estimate.angle == pytest.approx(0.02 * 10.0 / 13.0, rel=0.01)


def test_the_words_are_those_of_gearbox_makers(gains: GainSet) -> None:
    estimate = measured(gains, standing(BRAKED, contact=elastic(1.0)))
    for words in ("arcmin", "lost motion", "N m/arcmin", "between +-0.09 N m", "elastic law"):
        assert words in estimate.reason


# What ends it.


def started(gains: GainSet, drive: Drive, **changes: Any) -> tuple[Servo, SimulatedDrive]:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains).with_law("overdamped"))
    sensors = Sensors(measured=POSITIONS, motor_counts=4096.0, load_counts=65536.0)
    plant = SimulatedDrive(drive, servo.settings.period, sensors=sensors)
    servo.update(plant.sample())
    assert servo.experiment_refusal("hysteresis", HysteresisSettings(**changes)) == ""
    servo.start_experiment("hysteresis", HysteresisSettings(**changes))
    return servo, plant


@pytest.mark.parametrize("load", [{}, {"inertia": 5e-3}, {"inertia": 0.5}, {"coulomb_friction": 0.3}], ids=str)
def test_a_load_that_is_free_is_refused_within_the_swing(gains: GainSet, load: dict[str, float]) -> None:
    servo, plant = started(gains, standing(load))
    assert play(servo, plant, 8000) < 0.052  # the last sample is seen when it is too late
    outcome = servo.take_outcome()
    assert outcome is not None
    assert not isinstance(outcome, Deferred)
    assert "the output must be locked, braked or heavy; gap_probe measures a load that is free" in outcome.reason
    if "inertia" not in load:  # the law is that of the nominal load
        assert play(servo, plant, 1000) < 0.05
        assert servo.fault == ""
        assert abs(float(plant.state[OMEGA_L])) < 0.01


def test_a_load_that_slips_from_its_brake_on_the_way_ends_it(gains: GainSet) -> None:
    servo, plant = started(gains, standing({"coulomb_friction": 2.0}))
    assert play(servo, plant, 8000) < 0.05
    outcome = servo.take_outcome()
    assert outcome is not None
    assert not isinstance(outcome, Deferred)
    assert "the load moved by" in outcome.reason
    assert servo.fault == ""


@examples(max_examples=8, deadline=None)
@given(after=st.integers(1, 4000), held=st.sampled_from([BRAKED, HEAVY, {}]))
def test_it_is_cancelled_at_any_sample_and_ends_at_rest(gains: GainSet, after: int, held: dict[str, float]) -> None:
    servo, plant = started(gains, standing(held, motor_friction=0.01))
    play(servo, plant, after)
    servo.cancel("test")
    assert servo.take_outcome() is not None
    play(servo, plant, 1000)
    assert servo.fault == ""
    assert abs(float(plant.state[OMEGA_L])) < 0.01
    assert abs(float(plant.state[OMEGA_M])) < 0.5


def test_progress_grows_from_0_to_1(gains: GainSet) -> None:
    servo, plant = started(gains, standing(BRAKED))
    progress = []
    while servo.take_outcome() is None:
        progress.append(servo.progress)
        play(servo, plant, 1)
    assert progress[0] < 0.01
    assert np.all(np.diff(progress) >= 0.0)
    assert progress[-1] > 0.99


@pytest.mark.corners(2)
@pytest.mark.population
@pytest.mark.parametrize("held", [BRAKED, {}], ids=["braked", "free"])
@pytest.mark.parametrize("start", [1, 1500], ids=["from the start", "on the way"])
@pytest.mark.parametrize("signal", [THETA_M, THETA_L], ids=["motor", "load"])
@pytest.mark.parametrize("broken", [frozen, reversed_, swapped, stuck_bit])
def test_a_broken_encoder_gives_no_wrong_gap(
    gains: GainSet,
    broken: Broken,
    signal: int,
    start: int,
    held: dict[str, float],
) -> None:
    servo, plant = started(gains, standing(held, contact=elastic(1.0)))
    outcome, before = None, plant.sample().copy()
    for k in range(8000):
        sample = plant.sample()
        if k >= start:
            broken(sample, before, signal)
        before = sample.copy()
        command = servo.update(sample, plant.elapsed)
        outcome = servo.take_outcome()
        if outcome is not None or servo.latched:
            break
        plant.advance(command)
    if isinstance(outcome, Deferred):
        outcome = outcome.work()
    if isinstance(outcome, BacklashEstimate) and outcome.valid:
        assert outcome.angle == pytest.approx(0.02, rel=0.05)


def test_one_encoder_is_refused(gains: GainSet) -> None:
    for seen in (("theta_m",), ("theta_l",)):
        estimate = run_experiment(NOMINAL_DRIVE, ServoSettings(gains), "hysteresis", sensors=Sensors(measured=seen))
        assert not estimate.valid
        assert estimate.reason == ("no lost motion measured: the measurement needs two encoders, and one is missing")


# What is refused before anything moves.


def test_a_torque_that_the_monitor_takes_for_a_fault_is_refused(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    servo.update(Measurement(np.zeros(5)))
    assert servo.experiment_refusal("hysteresis") == ""
    why = servo.experiment_refusal("hysteresis", HysteresisSettings(torque=0.7))
    assert why == (
        "it presses with 4.2 N m against an output that stands, and from faults.load_torque = 3.6 N m on that is a "
        "fault: lower learning.hysteresis.torque = 0.7 to 0.54, or raise faults.load_torque"
    )


def test_a_lost_motion_beyond_the_torque_is_refused(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    why = servo.experiment_refusal("hysteresis", HysteresisSettings(rated_torque=1000.0))
    assert why.startswith("the lost motion is wanted at +-30 N m, but the torque reaches only 2.7 N m: raise")


def test_limits_that_are_nearer_than_the_swing_refuse_it(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), position_upper=0.02))
    servo.update(Measurement(np.zeros(5)))
    assert "it swings by learning.hysteresis.swing = 0.05 rad" in servo.experiment_refusal("hysteresis")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"swing": 0.0}, r"learning\.hysteresis\.swing must be > 0 rad and <= 3\.2 rad, got 0"),
        ({"movement": 0.1}, r"learning\.hysteresis\.movement must be <= swing = 0\.05 rad, got 0\.1 rad"),
        ({"torque": 0.9}, r"learning\.hysteresis\.torque must be > 0 and <= 0\.8, got 0\.9"),
        ({"cycles": 1}, r"learning\.hysteresis\.cycles must be a whole number >= 2 and <= 20, got 1"),
        ({"cycle": math.nan}, r"learning\.hysteresis\.cycle must be a finite number"),
        ({"rated_torque": -1.0}, r"learning\.hysteresis\.rated_torque must be >= 0 N m and <= 1e\+06 N m, got -1"),
    ],
)
def test_settings_out_of_bounds_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HysteresisSettings(**change)


# The same from a recording alone.


def slowly(
    drive: Drive, *, turns: int = 9, length: float = 1.5, largest: float = 0.45, still: float = 1.0
) -> Recording:
    """Return a recording of a torque that goes up and down in equal steps of time, on an output that stands."""
    ratio, period = NOMINAL_DRIVE.gear.ratio, 0.004
    plant = SimulatedDrive(
        drive, period, sensors=Sensors(measured=POSITIONS, motor_counts=2.0**16, load_counts=2.0**16)
    )
    ends = [0.0, *(largest * (-1.0) ** k * NOMINAL_DRIVE.motor.voltage_limit for k in range(turns)), 0.0]
    knots = np.concatenate(([0.0], still + length * np.arange(len(ends))))
    rows = []
    while plant.time < knots[-1] + 0.5:
        shown = plant.sample()
        command = float(np.interp(plant.time, knots, [0.0, *ends]))
        rows.append((plant.time, ratio * float(shown[THETA_M]), float(shown[THETA_L]), command))
        plant.advance(command, 0.0)
    return Recording.of(*(column.copy() for column in np.array(rows).T))


STIFF = standing(BRAKED, contact=elastic(3.0), motor_friction=0.02)


def test_a_recording_of_the_experiment_tells_the_same(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    sensors = Sensors(measured=POSITIONS, motor_counts=4096.0, load_counts=65536.0)
    plant = SimulatedDrive(STIFF, 0.004, sensors=sensors)
    rows: list[tuple[float, float, float, float]] = []
    outcome = None
    while outcome is None:
        shown = plant.sample()
        command = servo.update(shown, plant.elapsed)
        if not rows:
            servo.start_experiment("hysteresis")
        rows.append((plant.time, NOMINAL_DRIVE.gear.ratio * float(shown[THETA_M]), float(shown[THETA_L]), command))
        plant.advance(command, 0.0)
        outcome = servo.take_outcome()
    assert isinstance(outcome, Deferred)
    estimate = outcome.work()
    assert isinstance(estimate, BacklashEstimate)
    there = found_in(estimate)
    here = hysteresis_of(NOMINAL_DRIVE, Recording.of(*(column.copy() for column in np.array(rows).T)), there.at)
    assert here.valid, here.reason
    assert here.gap == pytest.approx(there.gap, abs=0.3 * there.gap_uncertainty)
    assert here.lost_motion == pytest.approx(there.lost_motion, abs=0.3 * there.lost_motion_uncertainty)
    for stiffness, other, uncertainty in zip(here.stiffness, there.stiffness, there.stiffness_uncertainty, strict=True):
        assert stiffness == pytest.approx(other, abs=0.5 * uncertainty)
    rows_told = {row.symbol: row for row in hysteresis_findings(here)}
    friction = rows_told["friction"]
    assert abs(friction.value - 0.02 * STANDSTILL) < 2.0 * friction.uncertainty
    assert rows_told["b at rest"].value == here.gap
    seen = np.isfinite(here.modelled)
    assert np.mean(seen) > 0.5
    assert np.median(np.abs(here.modelled - here.angles)[seen]) < 0.03 * here.gap


@pytest.mark.parametrize("volts", [12.0, -5.0])
def test_a_motor_makes_its_torque_at_rest_and_none_at_the_speed_of_its_voltage(volts: float) -> None:
    motor, ratio = NOMINAL_DRIVE.motor, NOMINAL_DRIVE.gear.ratio
    time, command = 0.004 * np.arange(100), np.full(100, volts)
    fast = ratio * volts / motor.torque_constant
    for speed, share in ((0.0, 1.0), (fast, 0.0), (-fast, 2.0)):
        torque, seen = torque_of(NOMINAL_DRIVE, time, speed * time, command)
        assert seen[50] == pytest.approx(speed)
        assert torque[50] == pytest.approx(share * volts / motor.voltage_limit * STANDSTILL, abs=1e-9)


def test_a_torque_by_hand_tells_gap_lost_motion_and_stiffness() -> None:
    found = hysteresis_of(NOMINAL_DRIVE, slowly(STIFF), 0.18)
    assert found.valid, found.reason
    assert found.gap == pytest.approx(0.02, abs=3.0 * found.gap_uncertainty)
    assert found.lost_motion == pytest.approx(place(STIFF, 0.18), abs=3.0 * found.lost_motion_uncertainty)
    for stiffness, uncertainty in zip(found.stiffness, found.stiffness_uncertainty, strict=True):
        assert abs(stiffness - 1.0 / 3e-3) < 3.0 * uncertainty


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"load": lambda r: 0.3 * r.motor + 0.05 * np.sin(r.time)}, r"the load moved by 0\.\d+ rad; an output"),
        ({"command": lambda r: -r.command}, "the motor goes against its torque: check the sign of the command"),
        ({"command": lambda r: 0.0 * r.command}, r"the command never changes: it is always 0 V"),
        ({"command": lambda r: 3.0 * r.command}, r"the command reaches .* V, but the drive obeys at most 24 V"),
        ({"time": lambda r: 0.2 * r.time}, r"the torque turned every 0\.3 s, and must not .* than every 0\.5 s"),
        ({"time": lambda r: r.time + 5.0 * (r.time > 6.0)}, "the recording has a hole of more than 10 periods"),
        ({"motor": lambda r: 0.0 * r.motor}, "the motor"),
    ],
    ids=["output moved", "sign", "no torque", "unit", "fast", "hole", "frozen"],
)
def test_a_recording_that_does_not_show_it_is_refused(change: dict[str, Any], message: str) -> None:
    recording = slowly(STIFF)
    found = hysteresis_of(NOMINAL_DRIVE, recording._replace(**{k: of(recording) for k, of in change.items()}), 0.18)
    assert not found.valid
    assert re.search(message, found.reason), found.reason


@pytest.mark.parametrize("turns", [1, 6])
def test_too_few_branches_are_refused(turns: int) -> None:
    found = hysteresis_of(NOMINAL_DRIVE, slowly(STIFF, turns=turns), 0.18)
    assert not found.valid
    assert found.reason.startswith(f"the torque turned {turns} times, and must turn at least 7 times")


def test_a_torque_that_never_turns_is_refused() -> None:
    time = 0.004 * np.arange(1000)
    found = hysteresis_of(NOMINAL_DRIVE, Recording.of(time, 0.001 * time, 0.0 * time, time), 0.18)
    assert not found.valid
    assert found.reason.startswith("the torque turned 0 times")


def test_a_torque_that_is_too_small_for_the_lost_motion_is_refused() -> None:
    found = hysteresis_of(NOMINAL_DRIVE, slowly(STIFF), 3.0)
    assert not found.valid
    assert found.reason.startswith("the lost motion is wanted at +-3 N m, but the torque reaches only 2.")


@pytest.mark.corners(1)
@pytest.mark.parametrize("motion", [probed, stepped], ids=["probe", "steps"])
def test_free_motion_has_no_curve(motion: Any) -> None:
    for number in range(4):
        member, recording = motion(number, "core")
        found = hysteresis_of(told_model(member, "nominal"), recording, 0.01)
        assert not found.valid
        assert found.reason.startswith("the load moved by ")
