"""The dual loop: it jumps by the gap, follows without lag, comes to rest, and takes over where the load is."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from backlash_ros.control import GainSet, Servo, ServoSettings, design_law
from backlash_ros.control.laws.dual_loop import DualLoopParameters, dual_loop_state_at
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.simulation import Run, Scenario, SimulatedDrive, run

B = NOMINAL_DRIVE.gear.backlash_angle
PERIOD = 0.004
COUNTED = Sensors(measured=POSITIONS, motor_counts=16384, load_counts=65536)


def settings_of(gains: GainSet, **changes: Any) -> ServoSettings:
    own = replace(ServoSettings(gains, period=PERIOD, backlash_angle=B, identified=True), **changes)
    return own.with_law("dual_loop")


def step_of(gains: GainSet, size: float, load_torque: float = 0.0) -> Run:
    """Return a step at 0.5 s, watched until 6 s."""
    reference = np.r_[np.zeros(125), np.full(1375, size)]
    return run(NOMINAL_DRIVE, settings_of(gains), Scenario(reference, np.array(load_torque), sensors=COUNTED))


def told(gains: GainSet, load_torques: list[float]) -> Array:
    """Return the shift of the motor's target, sample by sample: both shafts at rest at 0 under these load torques."""
    law = design_law(NOMINAL_DRIVE, settings_of(gains))
    state, shifts = law.state.copy(), []
    for torque in load_torques:
        law.step(law.constants, state, np.array([0.0, 0.0, 0.0, 0.0, 0.0, torque]), np.zeros((1, 3)), -24.0, 24.0)
        shifts.append(float(dual_loop_state_at(state).shift))
    return np.array(shifts)


def test_target_of_the_motor_jumps_by_the_gap_when_the_load_torque_changes_its_sign(gains: GainSet) -> None:
    """By half of it the first time, when the flank is unknown; not for a torque that is too small to count."""
    shifts = told(gains, [0.01, 0.3, 0.3, 0.01, -0.01, -0.3, -0.2, 0.2])
    np.testing.assert_allclose(shifts / B, [0.0, -0.5, -0.5, -0.5, -0.5, 0.5, 0.5, -0.5], atol=1e-12)


def test_a_move_drives_the_load_by_one_flank_and_brakes_it_by_the_other(gains: GainSet) -> None:
    servo, plant = Servo(NOMINAL_DRIVE, settings_of(gains)), SimulatedDrive(NOMINAL_DRIVE, PERIOD, sensors=COUNTED)
    memory, seen = dual_loop_state_at(servo.law_arrays[1]), []
    for k in range(250):
        command = servo.update(plant.sample(), plant.elapsed)
        if k == 0:
            assert servo.set_reference(1.0) == ""
        seen.append((memory.flank, memory.shift))
        plant.advance(command)
    flanks, shifts = np.array(seen).T
    assert [flanks[0], *flanks[1:][np.diff(flanks) != 0.0]] == [0.0, 1.0, -1.0]
    jumps = np.diff(shifts)[np.diff(flanks) != 0.0]
    np.testing.assert_allclose(jumps / B, [0.5, -1.0], atol=0.2)  # the load loop goes on meanwhile


def test_mirrored_reference_and_load_torque_give_the_mirrored_run(gains: GainSet) -> None:
    torque = 0.2 * np.sin(np.arange(500) / 20)
    ways = [run(NOMINAL_DRIVE, settings_of(gains), Scenario(np.full(500, s), s * torque)) for s in (1.0, -1.0)]
    np.testing.assert_array_equal(ways[0].state, -ways[1].state)
    np.testing.assert_array_equal(ways[0].command, -ways[1].command)
    assert np.ptp(ways[0].load_angle) > 0.5


@pytest.mark.parametrize("load_torque", [0.0, 0.1, -0.3])
@pytest.mark.parametrize("size", [1.0, -0.1])
def test_comes_to_rest_at_the_target(gains: GainSet, size: float, load_torque: float) -> None:
    """A free load stops somewhat short of it first, until the load loop has crossed the gap."""
    done = step_of(gains, size, load_torque)
    off = (done.load_angle - size) / B
    assert done.fault == ""
    assert np.max(np.abs(off[done.time >= 1.5])) <= (0.05 if load_torque else 0.25)
    assert np.max(np.abs(off[done.time >= 5.0])) <= 0.1
    assert np.ptp(off[done.time >= 5.0]) <= 0.05
    assert np.max(math.copysign(1.0, size) * off) <= 0.25


@pytest.mark.parametrize("load_torque", [0.3, -0.3])
def test_takes_over_with_the_voltage_that_holds_the_load(gains: GainSet, load_torque: float) -> None:
    servo = Servo(NOMINAL_DRIVE, settings_of(gains).with_law("two_region"))
    plant, angles, commands = SimulatedDrive(NOMINAL_DRIVE, PERIOD, sensors=COUNTED), [], []
    for k in range(750):
        if k == 375:
            servo.use(settings_of(gains))
        commands.append(servo.update(plant.sample(), plant.elapsed))
        plant.advance(commands[-1], load_torque)
        angles.append(plant.state[THETA_L])
    assert servo.fault == ""
    assert commands[375] == pytest.approx(-4.0 * load_torque, rel=0.05)
    assert np.ptp(angles[374:]) <= 0.05 * B


def test_follows_a_setpoint_in_motion_without_lag(gains: GainSet) -> None:
    law = design_law(NOMINAL_DRIVE, settings_of(gains))
    state, estimate = law.state.copy(), np.zeros(6)
    for k in range(500):
        setpoint = np.array([2.0 * PERIOD * k, 2.0, 0.0])
        law.step(law.constants, state, estimate, setpoint[None], -1e9, 1e9)
    assert dual_loop_state_at(state).reference == pytest.approx(2.0 * PERIOD * 500, abs=1e-6)


def test_reference_waits_for_a_drive_at_its_limit(gains: GainSet) -> None:
    """10 rad with 24 V, at most 48 rad/s: without the wait the reference would go at 74 rad/s, and the load overrun."""
    done = step_of(gains, 10.0)
    assert np.max(done.load_angle) <= 10.0 + 0.25 * B
    assert done.load_angle[-1] == pytest.approx(10.0, abs=0.25 * B)
    assert np.max(np.abs(done.command)) == 24.0


@pytest.mark.parametrize("lacking", [{"identified": False}, {"backlash_angle": 0.0}])
def test_overdamped_gains_stand_in_while_the_gap_or_the_drive_is_unknown(
    gains: GainSet, lacking: dict[str, Any]
) -> None:
    chosen = settings_of(gains)
    stand_in = design_law(NOMINAL_DRIVE, replace(chosen, **lacking))
    overdamped = design_law(NOMINAL_DRIVE, replace(chosen, **lacking).with_law("overdamped"))
    assert stand_in.step is overdamped.step is not design_law(NOMINAL_DRIVE, chosen).step


def test_both_encoders_are_needed(gains: GainSet) -> None:
    with pytest.raises(ValueError, match=r"law = 'dual_loop' needs both encoders, got measured = \('theta_l',\)"):
        run(NOMINAL_DRIVE, settings_of(gains), Scenario(np.ones(9), sensors=Sensors(measured=("theta_l",))))


def test_reference_faster_than_half_the_rate_is_refused(gains: GainSet) -> None:
    quick = settings_of(gains).with_law("dual_loop", DualLoopParameters(reference_bandwidth=126.0))
    with pytest.raises(ValueError, match=r"laws\.dual_loop\.reference_bandwidth must be at most 125 rad/s .* got 126"):
        design_law(NOMINAL_DRIVE, quick)
