"""Exact steps where the contact force is linear: against the other methods, and never across a bound unseen."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from searched import searched

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive, Plant
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.contact import nowhere_linear
from backlash_ros.drivetrain.motion.integrator import integration_at, integration_memory, integrator_for
from backlash_ros.drivetrain.motion.series import ROOM, series_with
from backlash_ros.foundation.signals import at_rest

LINEAR = [name for name, law in CONTACTS.items() if law.linear is not nowhere_linear]
factors = st.floats(-1.0, 1.0).map(lambda power: 4.0**power)


def drive_of(law: str, inertia: float, gap: float, inductance: float) -> Drive:
    """The nominal drive with another contact, load inertia, gap and inductance, each times its factor."""
    nominal = NOMINAL_DRIVE
    return replace(
        nominal,
        motor=replace(nominal.motor, inductance=inductance * nominal.motor.inductance),
        gear=replace(nominal.gear, contact=CONTACTS[law](), backlash_angle=gap * nominal.gear.backlash_angle),
        load=replace(nominal.load, inertia=inertia * nominal.load.inertia),
    )


def state_of(drive: Drive, share: float, motor: float, load: float) -> np.ndarray:
    """A state with the gap at a share of its half, and both speeds in rad/s."""
    state = at_rest()
    state[0], state[1], state[3] = share * 0.5 * drive.gear.backlash / drive.gear.motor_radius, motor, load
    return np.array(state)


def test_the_laws_that_have_linear_pieces() -> None:
    assert {"power", "elastic", "restitution"} <= set(LINEAR)


@pytest.mark.parametrize("law", LINEAR)
@given(
    inertia=factors,
    gap=factors,
    inductance=factors,
    share=st.floats(-1.2, 1.2),
    motor=st.floats(-40.0, 40.0),
    load=st.floats(-4.0, 4.0),
    command=st.floats(-24.0, 24.0),
)
@example(  # teeth that hardly touch, amid a step
    inertia=0.30645020527675243,
    gap=2.0,
    inductance=4.0**0.6171875,
    share=-0.99999,
    motor=0.0,
    load=-0.07,
    command=11.65625,
)
@settings(max_examples=25, deadline=None)
def test_motion_is_that_of_the_other_methods(
    law: str, inertia: float, gap: float, inductance: float, share: float, motor: float, load: float, command: float
) -> None:
    """Through impacts; with the energies to account for there are no exact steps."""
    drive = drive_of(law, inertia, gap, inductance)
    start = state_of(drive, share, motor, load)[:5]
    exact, stepped = Plant(drive, start, 1e-10), Plant(drive, start, 1e-11, account=True)
    for _ in range(5):
        for plant in (exact, stepped):
            plant.advance(command, 0.05, 0.004)
    allowed = 1e-7 * np.array([10 * drive.gear.backlash_angle, 480.0, drive.gear.backlash_angle, 48.0, 12.0])
    assert np.all(np.abs(exact.state - stepped.state) <= allowed)


@pytest.mark.parametrize("law", LINEAR)
@searched(
    80,
    200,
    given(share=st.floats(-1.5, 1.5), rate=st.floats(-1.0, 1.0), other=st.floats(-1.5, 1.5), fast=st.floats(-1.0, 1.0)),
)
def test_piece_is_the_force_wherever_its_bounds_are_kept(
    law: str, share: float, rate: float, other: float, fast: float
) -> None:
    drive = drive_of(law, 1.0, 1.0, 1.0)
    contact: Any = drive.gear.contact
    constants, half = plant_constants(drive).contact, 0.5 * drive.gear.backlash
    offset, stiffness, damping, a0, a1, a2, b0, b1, b2 = contact.linear(constants, half, share * half, rate)
    for gap, speed in ((share * half, rate), (other * half, fast), (share * half, fast)):
        if a0 + a1 * gap + a2 * speed >= 0.0 and b0 + b1 * gap + b2 * speed >= 0.0:
            force = contact.force(constants, half, gap, speed)[0]
            assert offset + stiffness * gap + damping * speed == pytest.approx(force, rel=1e-9, abs=1e-8)


@pytest.mark.parametrize("law", LINEAR)
@searched(
    40,
    100,
    given(
        share=st.floats(-1.3, 1.3), motor=st.floats(-60.0, 60.0), load=st.floats(-6.0, 6.0), command=st.floats(-24, 24)
    ),
)
def test_no_step_goes_across_a_bound_unseen(law: str, share: float, motor: float, load: float, command: float) -> None:
    """Nor is any too long to be as good as two of half its length."""
    drive = drive_of(law, 1.0, 1.0, 1.0)
    contact: Any = drive.gear.contact
    plant, step, half = plant_constants(drive), series_with(type(contact)), 0.5 * drive.gear.backlash
    start, work = state_of(drive, share, motor, load), np.zeros(ROOM)
    state = start.copy()
    used, force = step(plant, state, 0.004, command, 0.05, work)
    assert 0.0 <= used <= 0.004
    if used == 0.0:
        np.testing.assert_array_equal(state, start)
        return

    def gap_of(s: np.ndarray) -> tuple[float, float]:
        return plant.R1 * s[0] - plant.R2 * s[2], plant.R1 * s[1] - plant.R2 * s[3]

    _, _, _, a0, a1, a2, b0, b1, b2 = contact.linear(plant.contact, half, *gap_of(start))
    way = start.copy()
    for _ in range(40):
        part, least = way.copy(), used / 40
        moved, pushed = step(plant, part, least, command, 0.05, work)
        if moved < least:  # it is behind a bound that it was let across, at the end
            break
        way = part
        gap, rate = gap_of(way)
        assert min(a0 + a1 * gap + a2 * rate, b0 + b1 * gap + b2 * rate) >= -2e-10 * half
        assert pushed <= 1.003 * force + 1e-9
    else:
        np.testing.assert_allclose(way, state, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("law", LINEAR)
def test_mirrored_drive_moves_mirrored_to_the_last_bit(law: str) -> None:
    drive = drive_of(law, 1.0, 1.0, 1.0)
    advance, plant = integrator_for(drive), plant_constants(drive)
    one, other = state_of(drive, 0.3, 30.0, -2.0), -state_of(drive, 0.3, 30.0, -2.0)
    memories = integration_memory(), integration_memory()
    for command in (5.0, -3.0, 0.0, 12.0, -12.0) * 4:
        advance(plant, one, memories[0], command, 0.02, 0.004, 1e-9)
        advance(plant, other, memories[1], -command, -0.02, 0.004, 1e-9)
        np.testing.assert_array_equal(one, -other)
    assert integration_at(memories[0]).peak_force == integration_at(memories[1]).peak_force > 0.0


@pytest.mark.parametrize("law", LINEAR)
def test_rest_at_the_edge_of_the_gap_is_no_trap(law: str) -> None:
    """Neither pressed against the teeth nor pulled off them."""
    drive = drive_of(law, 1.0, 1.0, 1.0)
    for share in (-1.0, 1.0):
        for command in (-1.0, 0.0, 1e-9, 1.0):
            plant = Plant(drive, state_of(drive, share, 0.0, 0.0)[:5])
            for _ in range(50):
                plant.advance(command, 0.0, 0.004)
            assert plant.time == pytest.approx(0.2)


@pytest.mark.parametrize(("inductance", "wind_up"), [(1e-4, 1e-3), (1.0, 1e-8)])
def test_stiff_motion_is_left_to_the_other_methods(inductance: float, wind_up: float) -> None:
    """A quick winding, or hard teeth that are pressed: exact steps would be of a microsecond."""
    drive = drive_of("elastic", 1.0, 1.0, inductance)
    drive = replace(drive, gear=replace(drive.gear, contact=CONTACTS["elastic"](wind_up=wind_up)))
    state, work = state_of(drive, 1.0 + 1e-6, 0.0, 0.0), np.zeros(ROOM)
    step = series_with(type(drive.gear.contact))  # type: ignore[arg-type]
    assert step(plant_constants(drive), state, 0.004, 3.0, 0.0, work) == (0.0, 0.0)
    plant = Plant(drive, state[:5])
    plant.advance(3.0, 0.0, 1.0)
    assert plant.load_speed > 1.0


def test_other_drives_have_another_integrator() -> None:
    """What is not linear, or has friction that switches, has an integrator of its own."""
    nominal = drive_of("elastic", 1.0, 1.0, 1.0)
    for drive in (
        replace(nominal, load=replace(nominal.load, gravity_torque=0.2)),
        replace(nominal, load=replace(nominal.load, coulomb_friction=0.02)),
        replace(nominal, motor=replace(nominal.motor, coulomb_friction=0.002)),
        replace(nominal, gear=replace(nominal.gear, backlash_variation=0.3)),
        replace(nominal, gear=replace(nominal.gear, efficiency_forward=0.8)),
    ):
        assert integrator_for(drive) is not integrator_for(nominal)
