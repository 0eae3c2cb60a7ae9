"""Every contact law: against scipy, energy balance, momentum, restitution, and what each is named for."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from searched import searched

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive, Plant
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.contact import ToothForce, law_name
from backlash_ros.drivetrain.contacts.hunt_crossley import dissipation_for
from backlash_ros.drivetrain.contacts.restitution import damping_ratio_of, restitution_of

LAWS = ["power", "power_no_pull", "elastic", "restitution", "hunt_crossley"]
HALF = 0.5e-3


def drive_with(law: str, **others: float) -> Drive:
    return replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, contact=CONTACTS[law](**others)))


def contact(drive: Drive, gap: float, rate: float, half_gap: float = HALF) -> ToothForce:
    return drive.gear.contact.force(plant_constants(drive).contact, half_gap, gap, rate)


def elastic_energy(drive: Drive, gap: float, half_gap: float = HALF) -> float:
    return drive.gear.contact.energy(plant_constants(drive).contact, half_gap, gap)


damping_ratio = cache(damping_ratio_of)


def force_of(drive: Drive, gap: float, rate: float) -> float:
    """The force, written down a second time."""
    teeth: Any = drive.gear.contact
    half, law = drive.gear.backlash / 2, law_name(teeth)
    if law.startswith("power"):
        s, n = gap / half, teeth.exponent
        force = teeth.stiffness * s**n + teeth.damping * rate * s ** (n + 1)
        return 0.0 if law == "power_no_pull" and force * s < 0 else force
    depth, side = max(abs(gap) - half, 0.0), math.copysign(1.0, gap)
    if law == "hunt_crossley":
        radius = drive.gear.load_radius
        spring = teeth.torque / radius * (depth / radius / teeth.wind_up) ** teeth.exponent
        return side * spring * max(0.0, 1 + teeth.dissipation * rate / radius * side)
    stiffness = 1 / (teeth.wind_up * drive.gear.load_radius**2)
    spring = stiffness * depth
    if law == "elastic":
        return side * (spring + min(max(teeth.damping * rate * side, -spring), spring))
    damping = 2 * damping_ratio(teeth.restitution) * math.sqrt(stiffness * drive.contact_mass)
    return side * max(0.0, spring + damping * rate * side) if depth > 0 else 0.0


@searched(40, 100, given(s=st.floats(-1.3, 1.3), rate=st.floats(-2, 2)))
@pytest.mark.parametrize("law", LAWS)
def test_force_and_its_derivatives(law: str, s: float, rate: float) -> None:
    drive = drive_with(law)
    gap = s * HALF
    force, stiffness, damping, elastic, elastic_stiffness = contact(drive, gap, rate)
    assert force == pytest.approx(force_of(drive, gap, rate), rel=1e-9, abs=1e-12)
    assert contact(drive, -gap, -rate)[0] == -force
    assert elastic == contact(drive, gap, 0.0)[3]
    # Derivatives by difference, where the force is smooth.
    h, v = 1e-9, 1e-6
    around = [contact(drive, gap + dg, rate + dv)[0] for dg in (-h, 0, h) for dv in (-v, 0, v)]
    one_piece = all((f == 0.0) == (force == 0.0) for f in around)
    slopes = (around[7] - around[4]) / h, (around[4] - around[1]) / h
    if one_piece and slopes[0] == pytest.approx(slopes[1], rel=1e-3, abs=1e-3):
        assert stiffness == pytest.approx((around[7] - around[1]) / (2 * h), rel=1e-3, abs=1e-2)
        assert damping == pytest.approx((around[5] - around[3]) / (2 * v), rel=1e-3, abs=1e-4)
    step = 1e-8
    slope = (elastic_energy(drive, gap + step) - elastic_energy(drive, gap - step)) / (2 * step)
    # A quarter of k times the step is the difference's own error across the corner at d/2.
    assert elastic == pytest.approx(slope, rel=1e-4, abs=0.26 * 4e5 * step)
    assert elastic_stiffness >= 0


@pytest.mark.parametrize("law", ["power_no_pull", "elastic", "restitution", "hunt_crossley"])
def test_laws_that_do_not_pull_never_pull(law: str) -> None:
    drive = drive_with(law)
    for gap in np.linspace(-6e-4, 6e-4, 25):
        for rate in np.linspace(-3, 3, 25):
            assert contact(drive, gap, rate)[0] * gap >= 0


@pytest.mark.parametrize("law", ["elastic", "restitution", "hunt_crossley"])
def test_dead_zone_has_no_force(law: str) -> None:
    assert contact(drive_with(law), 0.999 * HALF, 5.0)[0] == 0.0


@pytest.mark.parametrize("law", LAWS)
def test_impacts_agree_with_scipy(law: str) -> None:
    """Several impacts at either flank; scipy in short pieces, so that it misses no edge of a law with a corner."""
    drive = drive_with(law)
    motor, gear, load = drive.motor, drive.gear, drive.load

    def equations(_t: float, x: np.ndarray) -> list[float]:
        force = force_of(
            drive,
            gear.motor_radius * x[0] - gear.load_radius * x[2],
            gear.motor_radius * x[1] - gear.load_radius * x[3],
        )
        return [
            x[1],
            (motor.torque_constant * x[4] - motor.viscous_friction * x[1] - gear.motor_radius * force) / motor.inertia,
            x[3],
            (gear.load_radius * force - load.viscous_friction * x[3] + 0.02) / load.inertia,
            (0.5 - motor.resistance * x[4] - motor.torque_constant * x[1]) / motor.inductance,
        ]

    start = np.array([0.0, 20.0, 0.0, -1.0, 0.0])
    plant = Plant(drive, start, tolerance=1e-11)
    x = start
    for _ in range(25):
        plant.advance(0.5, 0.02, 0.001)
        x = solve_ivp(equations, (0, 0.001), x, "DOP853", rtol=1e-11, atol=1e-14, max_step=1e-5).y[:, -1]
    np.testing.assert_allclose(plant.state, x, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("coulomb", [0.0, 0.01])
def test_energy_supplied_is_stored_or_lost(law: str, coulomb: float) -> None:
    """To 1e-8, relative, over limit-cycle-like motion under changing voltage and load torque."""
    drive = drive_with(law)
    drive = replace(drive, load=replace(drive.load, coulomb_friction=coulomb))
    plant = Plant(drive, [0.0, 50.0, 0.0, -2.0, 0.3], tolerance=5e-12, account=True)
    before = plant.energy_stored
    turnover = 0.0
    for k in range(120):
        supplied = plant.energy_supplied
        plant.advance(6.0 * math.sin(k / 7.0), 0.1 * math.cos(k / 11.0), 0.001)
        turnover += abs(plant.energy_supplied - supplied)
    balance = plant.energy_supplied - plant.energy_lost - (plant.energy_stored - before)
    assert turnover > 0.05
    assert abs(balance) <= 1e-8 * turnover
    assert plant.energy_lost > 0


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("ratio", [0.25, 1.0, 4.0, 25.0])
def test_load_moves_by_its_momentum_share_of_the_gap(law: str, ratio: float) -> None:
    """Two gears that nothing else touches keep their momentum: the load covers J_r/(J_r + J_l) of every gap travel."""
    drive = drive_with(law)
    load = replace(drive.load, inertia=drive.reflected_inertia / ratio, viscous_friction=0.0)
    drive = replace(drive, load=load, motor=replace(drive.motor, viscous_friction=0.0, torque_constant=1e-12))
    omega_l = 0.5
    plant = Plant(drive, [0.0, -omega_l * load.inertia / (drive.motor.inertia / 0.1), 0.0, omega_l, 0.0])
    rows = []
    for _ in range(2000):
        plant.advance(0.0, 0.0, 1e-4)
        rows.append(plant.state)
    states = np.array(rows)
    gap = 0.1 * states[:, 0] - states[:, 2]
    assert np.ptp(gap) > 0.5 * 0.02  # it has moved
    np.testing.assert_allclose(states[:, 2], -drive.motor_share * gap, atol=1e-7)


@pytest.mark.parametrize("restitution", [0.3, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("speed", [0.05, 2.0])
def test_restitution_is_what_remains_of_the_speed(restitution: float, speed: float) -> None:
    """At any speed of impact, which the power law does not give."""
    assert_left_of_an_impact(drive_with("restitution", restitution=restitution), restitution, speed)


@pytest.mark.parametrize("restitution", [0.3, 0.75, 0.95])
@pytest.mark.parametrize("speed", [0.05, 2.0])
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.2])
def test_dissipation_leaves_the_share_of_the_speed_that_it_is_made_for(
    restitution: float, speed: float, exponent: float
) -> None:
    """Whatever the exponent and the wind-up."""
    dissipation = dissipation_for(restitution, speed)
    assert_left_of_an_impact(
        drive_with("hunt_crossley", exponent=exponent, dissipation=dissipation), restitution, speed
    )


def assert_left_of_an_impact(drive: Drive, restitution: float, speed: float) -> None:
    """Let a load at a ``speed`` (rad/s) hit a motor at rest without friction, and look at what is left."""
    drive = replace(
        drive,
        motor=replace(drive.motor, viscous_friction=0.0, torque_constant=1e-12),
        load=replace(drive.load, viscous_friction=0.0),
    )
    plant = Plant(drive, [0.0, 0.0, 0.0, -speed, 0.0], tolerance=1e-11)
    meeting = 0.05 * speed
    for _ in range(100000):
        plant.advance(0.0, 0.0, 1e-4 / speed / 10)
        rate = 0.005 * plant.motor_speed - 0.05 * plant.load_speed
        if rate < 0 and plant.gear_torque == 0.0:
            break
    assert -rate == pytest.approx(restitution * meeting, rel=1e-4)


def test_damping_ratio_and_restitution_are_inverse() -> None:
    for e in (0.2, 0.5, 0.9, 1.0):
        assert restitution_of(damping_ratio_of(e)) == pytest.approx(e, abs=1e-9)
    assert restitution_of(0.0) == 1.0
