"""The unit of time of the law of planned moves: usual drives have a second, slow and fast ones are moved alike."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scaled import Scale

from backlash_ros.control import GainSet, ServoSettings, design_law
from backlash_ros.control.laws.planned.unit import natural_time, time_unit
from backlash_ros.control.motion.setpoint import DURATION, Polynomials
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOAD_TORQUE, OMEGA_L, OMEGA_M, THETA_L, THETA_M, Estimate, Setpoint
from backlash_ros.simulation import Scenario, run
from backlash_ros.studies.evaluation.motion import LEAD, sine
from backlash_ros.studies.evaluation.population import draw_member, told_model
from backlash_ros.studies.evaluation.task import settings_for

B = NOMINAL_DRIVE.gear.backlash_angle
ENCODERS = {"both": POSITIONS, "load": ("theta_l",), "motor": ("theta_m",)}
SLOW, FAST = (4.0, 8.0), (0.0625, 0.125)
"""Times of two drives, as multiples of those of the nominal one: all beyond the usual range."""
each_encoder = pytest.mark.parametrize("encoders", ENCODERS)
each_pair = pytest.mark.parametrize("pair", [SLOW, FAST], ids=["slow", "fast"])


def rough_drive(time: float, interface: str = "voltage") -> Drive:
    """Return the nominal drive with dry friction and with times that are so many times as long."""
    rough = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, coulomb_friction=0.05))
    drive = Scale(time=time).drive(rough)
    motor = replace(drive.motor, current_limit=drive.motor.current_limit / time)
    return replace(drive, motor=motor, command_interface=interface)


def settings_of(gains: GainSet, time: float, delay: float = 0.002, encoders: str = "both") -> ServoSettings:
    bandwidths = {"velocity_bandwidth": 800.0 / time, "torque_bandwidth": 40.0 / time}
    known = ServoSettings(gains, "planned", period=0.004 * time, loop_delay=delay * time, encoders=encoders)
    return replace(known, backlash_angle=B, identified=True, **bandwidths)


def commands(gains: GainSet, time: float, encoders: str, moves: bool) -> Array:
    """Return the commands for a step of 1 rad, or for a sine, in the drive's own times."""
    drive, reference, source = rough_drive(time), np.r_[np.zeros(125), np.ones(375)], None
    if moves:
        rows = sine(0.5, 0.5).rows(0.0)
        rows[:, DURATION] *= time
        # The coefficients of the powers of time.
        rows[:, :DURATION] /= time ** np.arange(DURATION)
        reference, source = np.zeros(round((LEAD + 6.0) / 0.004)), Polynomials(rows)
    sensors = Sensors(measured=ENCODERS[encoders], motor_counts=16384, load_counts=65536)
    scenario = Scenario(reference, sensors=sensors, delay=Delay(command=0.002 * time), source=source)
    done = run(drive, settings_of(gains, time), scenario)
    assert done.fault == ""
    return done.command


@each_pair
@each_encoder
@pytest.mark.parametrize("moves", [False, True], ids=["step", "sine"])
def test_a_drive_of_other_times_gets_the_same_commands(
    gains: GainSet, pair: tuple[float, float], encoders: str, moves: bool
) -> None:
    one, other = (commands(gains, time, encoders, moves) for time in pair)
    assert np.ptp(one) > 0.1
    np.testing.assert_allclose(one, other, atol=1e-6)


@each_pair
@each_encoder
@pytest.mark.parametrize("interface", ["voltage", "current"])
def test_a_take_over_takes_speeds_and_currents_in_the_laws_unit(
    gains: GainSet, pair: tuple[float, float], encoders: str, interface: str
) -> None:
    states = []
    for time in pair:
        law = design_law(rough_drive(time, interface), settings_of(gains, time, encoders=encoders))
        estimate, state = Estimate(np.zeros(6)), law.state.copy()
        estimate[[THETA_M, OMEGA_M, THETA_L, OMEGA_L]] = 3.1, 20.0 / time, 0.3, 1.5 / time
        estimate[[CURRENT, LOAD_TORQUE]] = 0.7 / time, 0.2
        law.take_over(law.constants, state, estimate, Setpoint(np.array([0.3, 0.0, 0.0])), 2.0)
        states.append(state)
    one, other = states
    # The remembered commands are V, or A, of which a slow motor needs fewer.
    scaled = np.zeros(one.size, bool) if interface == "voltage" else ~np.isclose(one, other, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one[~scaled], other[~scaled], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one[scaled] * pair[0], other[scaled] * pair[1], rtol=1e-9)


def test_usual_drives_have_the_second() -> None:
    """Every drive of `core`, and most of `full`, whose motors differ: what the populations showed holds for them."""
    units = {"core": [], "full": []}
    for population, found in units.items():
        for number in range(60):
            member = draw_member(9001, number, population)
            known = told_model(member, "true")
            found.append(time_unit(known, settings_for(known, member)))
    assert set(units["core"]) == {1.0}
    assert sum(unit == 1.0 for unit in units["full"]) >= 50
    assert all(0.7 < unit < 1.5 for unit in units["full"])


def test_the_unit_grows_without_a_leap_and_soon_in_proportion(gains: GainSet) -> None:
    times = np.geomspace(0.02, 50.0, 2000)
    drives = [(rough_drive(float(time)), settings_of(gains, float(time), delay=0.0)) for time in times]
    units = np.array([time_unit(*each) for each in drives])
    growth = np.diff(np.log(units)) / np.diff(np.log(times))
    assert np.all(growth >= -1e-9)
    assert np.max(growth) <= 2.0 + 1e-6
    far = (times < 0.1) | (times > 3.0)
    np.testing.assert_allclose(units[far], times[far], rtol=0.01)


def test_the_natural_time_is_as_long_as_motor_and_loop(gains: GainSet) -> None:
    """A motor of which alone all times are four times as long, or a loop, counts twice."""
    usual, slow = rough_drive(1.0), rough_drive(4.0)
    known, late = settings_of(gains, 1.0), settings_of(gains, 4.0)
    once = natural_time(usual, known)
    assert natural_time(slow, known) == pytest.approx(2.0 * once)
    assert natural_time(usual, late) == pytest.approx(2.0 * once)
    assert natural_time(slow, late) == pytest.approx(4.0 * once)
    torque, inertia = usual.standstill_torque(), usual.reflected_inertia
    assert 0.5 * torque / inertia * (once**2 / 0.008) ** 2 == pytest.approx(0.5)
    assert math.isclose(1.5 * known.period + known.loop_delay, 0.008)
