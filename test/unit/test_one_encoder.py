"""The law of planned moves with one encoder: drives drawn at random, how it rests, and what a lost model does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from backlash_ros.control import GainSet, Servo, ServoSettings
from backlash_ros.control.laws import law_of
from backlash_ros.control.laws.planned.constants import FINEST_ERROR
from backlash_ros.control.laws.planned.memory import Count, Memory, memory_at
from backlash_ros.control.laws.planned.motor_count import find_count
from backlash_ros.control.motion.setpoint import Polynomials
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.record import row_of
from backlash_ros.foundation.signals import THETA_L, THETA_M
from backlash_ros.simulation import Run, Scenario, SimulatedDrive, run
from backlash_ros.studies.evaluation.population import draw_member
from backlash_ros.studies.evaluation.task import judge_run, scenario_of, settings_for

B = NOMINAL_DRIVE.gear.backlash_angle
SENSORS = {
    "load": Sensors(measured=("theta_l",), load_counts=65536),
    "motor": Sensors(measured=("theta_m",), motor_counts=16384),
}
KEPT = {"load": THETA_L, "motor": THETA_M}
each_encoder = pytest.mark.parametrize("encoder", SENSORS)


def settings_of(gains: GainSet, law: str = "planned", delay: float = 0.0) -> ServoSettings:
    return ServoSettings(gains, law=law, backlash_angle=B, identified=True, loop_delay=delay)


def played(
    gains: GainSet,
    encoder: str,
    load_torque: float = 0.0,
    sign: float = 1.0,
    delay: float = 0.0,
    drive: Drive = NOMINAL_DRIVE,
) -> Run:
    """Return 4 s of a drive that is known, with a step of 1 rad after half a second."""
    reference = sign * np.r_[np.zeros(125), np.ones(875)]
    scenario = Scenario(
        reference, np.array(sign * load_torque), sensors=SENSORS[encoder], delay=Delay(command=delay), substeps=4
    )
    return run(drive, settings_of(gains, delay=delay), scenario)


@each_encoder
@pytest.mark.parametrize("delay", [0.0, 0.002, 0.008])
def test_a_step_lands_and_rests(gains: GainSet, encoder: str, delay: float) -> None:
    done = played(gains, encoder, delay=delay)
    assert done.fault == ""
    assert np.max(done.load_angle) <= 1.0 + 0.25 * B
    after = done.load_angle[done.time >= 3.0]
    assert np.ptp(after) <= 0.05 * B
    assert np.max(np.abs(after - 1.0)) <= 0.1 * B


@each_encoder
@pytest.mark.parametrize("load_torque", [0.3, -0.3, 0.02])
def test_a_load_torque_that_nobody_told_leaves_no_error(gains: GainSet, encoder: str, load_torque: float) -> None:
    done = played(gains, encoder, load_torque)
    assert done.fault == ""
    after = done.load_angle[done.time >= 3.0]
    assert np.ptp(after) <= 0.05 * B
    assert abs(np.mean(after) - 1.0) <= 0.1 * B


@each_encoder
@pytest.mark.parametrize("load_torque", [0.3, 0.0])
def test_a_motor_that_rubs_leaves_no_error(gains: GainSet, encoder: str, load_torque: float) -> None:
    """A model that creeps where the motor stands is wrong about the gap: the load ends half a gap off, or swings."""
    friction = 0.02 * NOMINAL_DRIVE.standstill_torque() * NOMINAL_DRIVE.gear.ratio
    drive = replace(NOMINAL_DRIVE, motor=replace(NOMINAL_DRIVE.motor, coulomb_friction=friction))
    done = played(gains, encoder, load_torque, drive=drive)
    assert done.fault == ""
    after = done.load_angle[done.time >= 3.0]
    assert np.ptp(after) <= 0.05 * B
    assert abs(np.mean(after) - 1.0) <= 0.1 * B


def test_a_mirrored_run_is_the_mirror_image(gains: GainSet) -> None:
    """With the motor's encoder a free load is wiped to one side first, as no move has shown one."""
    there, back = (played(gains, "load", 0.1, sign) for sign in (1.0, -1.0))
    assert np.max(np.abs(there.load_angle + back.load_angle)) <= 0.02 * B


@pytest.mark.population
@pytest.mark.parametrize(
    ("encoder", "least", "drives"),
    [
        ("load", 6, 6),
        ("motor", 6, 6),
        pytest.param("load", 22, 24, marks=pytest.mark.grid),
        pytest.param("motor", 20, 24, marks=pytest.mark.grid),
    ],
)
def test_random_drives_come_to_rest_where_the_drive_is_known(encoder: str, least: int, drives: int) -> None:
    """Drives of `core`: quiet, precise and hardly beyond, where nobody told the load torque or the flank."""
    good, faults = 0, []
    for number in range(drives):
        member = draw_member(9002, number, "core", encoder)
        known = replace(
            settings_for(member.drive, member), backlash_angle=member.drive.gear.backlash_angle, identified=True
        )
        scenario = scenario_of(member)
        found = judge_run(member, scenario, run(member.drive, known, scenario, model=member.drive))
        good += found.quiet and found.precise and found.overshoot_ok
        faults.append(found.fault)
    assert set(faults) == {""}
    assert good >= least


@pytest.mark.parametrize("counts_in_gap", [20, 30])
def test_a_coarse_encoder_on_the_motor_is_no_rattle(counts_in_gap: int) -> None:
    """With the observer's gain for fine counts 10 of 24 such drives are quiet at 20, and 14 at 30."""
    for number in range(8):
        member = draw_member(771, number, "core", "motor")
        gear = member.drive.gear
        counts = round(counts_in_gap * 2.0 * np.pi / (gear.backlash_angle * gear.reduction))
        member = replace(member, sensors=replace(member.sensors, motor_counts=counts))
        known = replace(settings_for(member.drive, member), backlash_angle=gear.backlash_angle, identified=True)
        scenario = scenario_of(member)
        assert judge_run(member, scenario, run(member.drive, known, scenario, model=member.drive)).quiet, number


def counted(readings: np.ndarray) -> Count:
    """Return the count that readings of the motor's angle show, rad."""
    count = memory_at(row_of(Memory)).motor.count
    count.reading = readings[0]
    for reading in readings:
        find_count(count, reading)
    return count


@example(1e-3, [0, 5, 3, *[2] * 57], 0.0)
@given(st.floats(1e-4, 0.1), st.lists(st.integers(-200, 200), min_size=60, max_size=60), st.floats(-100.0, 100.0))
def test_a_count_is_what_all_changes_are_multiples_of(size: float, changes: list[int], zero: float) -> None:
    assume(math.gcd(*changes[1:]) == 1)  # the first reading is no change
    count = counted(zero + size * np.cumsum(changes))
    assert count.width == pytest.approx(size, rel=1e-6) or count.agreeing < 8


def test_readings_without_a_count_show_none() -> None:
    rng = np.random.default_rng(1)
    assert counted(np.cumsum(rng.normal(0.0, 0.01, 500))).width < FINEST_ERROR
    assert counted(np.zeros(500)).width == 0.0


def test_the_first_sample_shows_which_encoders_there_are(gains: GainSet) -> None:
    auto = settings_of(gains, "auto")
    for seen, encoders in ((("theta_l",), "load"), (("theta_m",), "motor"), (("theta_m", "theta_l"), "both")):
        servo = Servo(NOMINAL_DRIVE, auto)
        plant = SimulatedDrive(NOMINAL_DRIVE, 0.004, sensors=Sensors(measured=seen))
        for _ in range(3):
            plant.advance(servo.update(plant.sample(), plant.elapsed))
        assert servo.law == law_of(NOMINAL_DRIVE, auto) == "planned"
        assert not servo.calmed
        assert servo.settings.encoders == encoders
        servo.use(auto)
        assert servo.settings.encoders == encoders


def test_other_encoders_than_there_are_are_refused(gains: GainSet) -> None:
    with pytest.raises(ValueError, match=r"encoders must be one of \['both', 'load', 'motor'\], got 'none'"):
        replace(settings_of(gains), encoders="none")


@each_encoder
def test_the_encoder_that_is_left_is_lost_and_the_drive_released(gains: GainSet, encoder: str) -> None:
    servo = Servo(NOMINAL_DRIVE, settings_of(gains))
    plant = SimulatedDrive(NOMINAL_DRIVE, 0.004, sensors=SENSORS[encoder])
    for _ in range(50):
        plant.advance(servo.update(plant.sample(), plant.elapsed))
    measured = plant.sample()
    measured[:] = np.nan
    assert servo.update(measured, plant.elapsed) == 0.0
    assert servo.latched.name == "NOT_FINITE"


@each_encoder
def test_after_any_readings_memory_and_command_are_finite_and_within_the_range(gains: GainSet, encoder: str) -> None:
    """Readings that leap by up to a turn, with the watch off: a model that is lost begins anew."""
    random, kept = np.random.default_rng(5), KEPT[encoder]
    servo = Servo(NOMINAL_DRIVE, settings_of(gains, delay=0.006), watched=False)
    plant = SimulatedDrive(NOMINAL_DRIVE, 0.004, sensors=SENSORS[encoder])
    for k in range(2000):
        measured = plant.sample()
        if random.uniform() < 0.2:
            measured[kept] += random.uniform(-6.0, 6.0)
        if k % 100 == 0 and k:
            servo.set_reference(random.uniform(-1.0, 1.0))
        command = servo.update(measured, plant.elapsed)
        assert abs(command) <= NOMINAL_DRIVE.motor.voltage_limit
        assert np.all(np.isfinite(servo.law_arrays[1]))
        plant.advance(command)


@each_encoder
@pytest.mark.parametrize("wrong", [0.5 * B, 5.0 * B, 0.5, 1.0, 100.0])
def test_one_wrong_reading_moves_the_load_by_little_or_is_a_fault(gains: GainSet, encoder: str, wrong: float) -> None:
    servo = Servo(NOMINAL_DRIVE, settings_of(gains))
    plant = SimulatedDrive(NOMINAL_DRIVE, 0.004, sensors=SENSORS[encoder])
    way = []
    for k in range(600):
        measured = plant.sample()
        if k == 300:
            measured[KEPT[encoder]] += wrong / (1.0 if encoder == "load" else NOMINAL_DRIVE.gear.ratio)
        command = servo.update(measured, plant.elapsed)
        if servo.latched:
            assert (k, command, wrong >= 1.0) == (300, 0.0, True)  # a speed beyond faults.velocity
            break
        plant.advance(command, 0.1)
        way.append(plant.state[THETA_L])
    assert np.ptp(way[290:]) <= B


@each_encoder
def test_a_path_is_followed_and_ends_at_rest(gains: GainSet, encoder: str) -> None:
    """1 rad in one second, and 2 s at rest."""
    source = Polynomials(np.array([[0.0, 0.0, 0.0, 10.0, -15.0, 6.0, 1.0]]))
    scenario = Scenario(np.zeros(750), sensors=SENSORS[encoder], source=source)
    done = run(NOMINAL_DRIVE, settings_of(gains), scenario)
    assert done.fault == ""
    step = (done.load_angle.size - 1) // 750
    error = done.setpoint - done.load_angle[:-1:step]
    assert np.max(np.abs(error)) <= B
    assert np.max(np.abs(error[-200:])) <= 0.1 * B
    assert np.ptp(done.load_angle[done.time >= 2.2]) <= 0.05 * B
