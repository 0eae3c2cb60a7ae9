"""Friction that sticks, loss in the teeth, gravity and a gap that varies: against scipy, algebra and the energy."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import varied
from dry_friction import Reference
from hypothesis import given, settings
from hypothesis import strategies as st
from searched import searched

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Plant
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.motion.friction import first_zero

FEATURES: dict[str, dict[str, Any]] = {
    "nothing": {},
    "motor": {"motor_coulomb_friction": 0.02},
    "load": {"load_coulomb_friction": 0.1},
    "teeth": {"gear_efficiency_forward": 0.7, "gear_efficiency_backward": 0.4},
    "self-locking": {"gear_efficiency_forward": 0.4, "gear_efficiency_backward": 0.0},
    "gravity": {"load_gravity_torque": 0.3, "load_gravity_offset": 1.0},
    "varying gap": {"gear_backlash_variation": 0.6, "gear_backlash_cycles": 12, "gear_backlash_phase": 0.7},
}
FEATURES["all"] = {k: v for name, feature in FEATURES.items() if name != "self-locking" for k, v in feature.items()}


def pieces() -> list[tuple[float, float]]:
    """Voltages and load torques under which a drive moves, stops, sticks and comes back."""
    return [(3.0 * math.sin(k / 6), 0.2 * math.cos(k / 9)) for k in range(60)]


@pytest.mark.parametrize("name", FEATURES)
def test_motion_agrees_with_scipy_and_its_events(name: str) -> None:
    drive = varied(**FEATURES[name])
    start = [0.0, 8.0, 0.0, -0.3, 0.0]
    plant, reference = Plant(drive, start, tolerance=1e-11), Reference(drive, start)
    for voltage, torque in pieces():
        plant.advance(voltage, torque, 0.005)
        reference.advance(voltage, torque, 0.005)
        np.testing.assert_allclose(plant.state, reference.x, rtol=2e-6, atol=2e-7)
    seen = set(reference.events)
    if name in ("motor", "teeth", "self-locking", "all"):
        assert {("motor", 1), ("motor", -1)} <= seen
    if name in ("motor", "self-locking", "all"):
        assert ("motor", 0) in seen
    if name in ("load", "all"):
        assert {("load", 0), ("load", 1), ("load", -1)} <= seen


@pytest.mark.parametrize("law", ["power", "power_no_pull", "elastic", "restitution"])
@pytest.mark.parametrize("name", FEATURES)
def test_energy_supplied_is_stored_or_lost(name: str, law: str) -> None:
    """To 1e-9 of what is turned over, while either shaft stops and breaks away."""
    drive = varied(**FEATURES[name], gear_contact=CONTACTS[law]())
    plant = Plant(drive, [0.0, 50.0, 0.0, -2.0, 0.3], tolerance=2e-12, account=True)
    before, turnover = plant.energy_stored, 0.0
    for voltage, torque in pieces():
        supplied, lost = plant.energy_supplied, plant.energy_lost
        plant.advance(voltage, torque, 0.005)
        turnover += abs(plant.energy_supplied - supplied)
        assert law.startswith("power") or plant.energy_lost >= lost
    balance = plant.energy_supplied - plant.energy_lost - (plant.energy_stored - before)
    assert turnover > 0.05
    assert abs(balance) <= 1e-9 * turnover


def test_energies_without_an_account_are_refused_not_zero() -> None:
    plant = Plant(NOMINAL_DRIVE)
    plant.advance(1.0, 0.0, 0.01)
    assert plant.energy_stored > 0.0
    for energy in ("energy_supplied", "energy_lost"):
        with pytest.raises(RuntimeError, match=r"Plant\(\.\.\., account=True\)"):
            getattr(plant, energy)


def test_load_that_friction_holds_does_not_move_at_all() -> None:
    plant = Plant(varied(load_coulomb_friction=0.05), [0.0, 0.0, 0.003, 0.0, 0.0], account=True)
    for torque in (0.04, -0.0499999, 0.0499999, 0.0):
        plant.advance(0.0, torque, 0.5)
        assert plant.load_speed == 0.0
        assert plant.load_angle == 0.003
    assert plant.energy_supplied == 0.0


def test_motor_that_friction_holds_does_not_move_at_all() -> None:
    """0.8 V drive 0.02 N m through the winding; the teeth lie apart."""
    plant = Plant(varied(motor_coulomb_friction=0.021, gear_contact=ElasticContact()))
    plant.advance(0.8, 0.0, 0.5)
    assert (plant.motor_speed, plant.motor_angle) == (0.0, 0.0)
    plant.advance(0.85, 0.0, 0.5)
    assert plant.motor_speed > 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("beyond", [1e-6, 0.01, 1.0])
def test_load_breaks_away_beyond_its_friction_and_is_braked_by_it(sign: float, beyond: float) -> None:
    """In the gap J domega/dt = what is beyond the friction."""
    drive = varied(
        load_coulomb_friction=0.05, load_viscous_friction=0.0, gear_contact=ElasticContact(), gear_backlash_angle=3.0
    )
    plant = Plant(drive)
    time = min(1.0, math.sqrt(5e-4 / beyond))
    plant.advance(0.0, sign * (0.05 + beyond), time)
    assert plant.load_speed == pytest.approx(sign * beyond * time / 5e-4, rel=1e-4)


@pytest.mark.parametrize("tolerance", [1e-9, 1e-4])
@pytest.mark.parametrize("speed", [3.0, -0.01])
def test_load_that_is_thrown_stops_where_its_friction_has_used_up_its_energy(speed: float, tolerance: float) -> None:
    drive = varied(
        load_coulomb_friction=0.05, load_viscous_friction=0.0, gear_contact=ElasticContact(), gear_backlash_angle=3.0
    )
    plant = Plant(drive, [0.0, 0.0, 0.0, speed, 0.0], tolerance, account=True)
    plant.advance(0.0, 0.0, 1.0)
    way = 0.5 * 5e-4 * speed * abs(speed) / 0.05
    assert plant.load_angle == pytest.approx(way, rel=1e-9)
    assert plant.load_speed == 0.0
    assert plant.energy_lost == pytest.approx(0.5 * 5e-4 * speed**2, rel=1e-9)


@pytest.mark.parametrize("tolerance", [1e-9, 1e-4])
def test_reversal_is_found_within_a_long_step(tolerance: float) -> None:
    """Thrown against a torque beyond the friction: the acceleration changes where the speed is 0."""
    drive = varied(
        load_coulomb_friction=0.05, load_viscous_friction=0.0, gear_contact=ElasticContact(), gear_backlash_angle=3.0
    )
    plant = Plant(drive, [0.0, 0.0, 0.0, 20.0, 0.0], tolerance)
    stop = 20.0 * 5e-4 / 0.15
    plant.advance(0.0, -0.1, stop + 0.1)
    assert plant.load_speed == pytest.approx(-0.05 / 5e-4 * 0.1, rel=1e-9)
    assert plant.load_angle == pytest.approx(0.5 * 20.0 * stop - 0.5 * 0.05 / 5e-4 * 0.01, rel=1e-9)


def test_swing_that_friction_ends_is_the_same_in_one_call_and_in_many() -> None:
    """A pendulum in a wide gap loses 2 tau_c/(m g l) each half swing, and sticks off its lowest point."""
    drive = varied(
        load_gravity_torque=0.1,
        load_coulomb_friction=0.004,
        load_viscous_friction=0.0,
        gear_contact=ElasticContact(),
        gear_backlash_angle=3.2,
    )
    once, often = (
        Plant(drive, [0.0, 0.0, 0.3, 0.0, 0.0], 1e-8, account=True),
        Plant(drive, [0.0, 0.0, 0.3, 0.0, 0.0], account=True),
    )
    once.advance(0.0, 0.0, 3.0)
    for _ in range(1500):
        often.advance(0.0, 0.0, 0.002)
    assert once.load_speed == often.load_speed == 0.0
    assert once.load_angle == pytest.approx(often.load_angle, abs=1e-6)
    assert 0.0 < abs(math.sin(once.load_angle)) < 0.04
    assert once.energy_lost == pytest.approx(0.1 * (math.cos(once.load_angle) - math.cos(0.3)), rel=1e-6)


@pytest.mark.parametrize("forward", [0.9, 0.5])
@pytest.mark.parametrize("backward", [0.8, 0.3])
def test_efficiency_is_the_share_of_the_power_that_gets_through(forward: float, backward: float) -> None:
    drive = varied(gear_efficiency_forward=forward, gear_efficiency_backward=backward)
    plant = Plant(drive)
    for voltage, torque, share in ((6.0, -0.3, forward), (0.0, 1.0, 1 / backward)):
        plant.advance(voltage, torque, 3.0)
        at_shaft = plant.motor_torque - drive.motor.viscous_friction * plant.motor_speed
        assert plant.gear_torque * plant.load_speed == pytest.approx(share * at_shaft * plant.motor_speed, rel=1e-6)


def test_self_locking_gear_holds_any_load() -> None:
    plant = Plant(varied(gear_efficiency_forward=0.4, gear_efficiency_backward=0.0))
    plant.advance(3.0, 0.0, 0.5)
    for torque in (5.0, -5.0):
        plant.advance(0.0, torque, 1.0)
        angle = plant.motor_angle
        plant.advance(0.0, torque, 1.0)
        assert (plant.motor_speed, plant.motor_angle) == (0.0, angle)


@pytest.mark.parametrize("law", CONTACTS)
@pytest.mark.parametrize("torque", [0.3, -0.003])
@pytest.mark.parametrize("lost", [{"gear_efficiency_forward": 0.8}, {"gear_efficiency_backward": 0.8}], ids=str)
def test_load_that_falls_on_a_motor_at_rest_takes_it_along(law: str, torque: float, lost: dict[str, float]) -> None:
    """By teeth that push from the edge of the gap on and not before, all at once or not."""
    drive = varied(gear_contact=CONTACTS[law](), **lost)
    plant, fine = Plant(drive), Plant(drive, tolerance=1e-11)
    for each in (plant, fine):
        for _ in range(50):
            each.advance(0.0, torque, 0.004)
    assert math.copysign(1.0, torque) * plant.motor_angle > 0.0
    np.testing.assert_allclose(plant.state, fine.state, rtol=1e-4, atol=1e-6)


def test_weight_hangs_straight_down_and_takes_its_torque_to_lift() -> None:
    drive = varied(load_gravity_torque=0.4, load_gravity_offset=0.5)
    plant = Plant(drive)
    plant.advance(0.0, 0.0, 20.0)
    assert plant.load_angle == pytest.approx(-0.5, abs=0.011)
    held = Plant(drive)
    held.advance(0.0, 0.4 * math.sin(0.5), 1.0)
    assert held.state == pytest.approx(np.zeros(5), abs=1e-9)


def test_gap_that_varies_is_as_wide_as_said_where_the_load_stands() -> None:
    """Pushed through it by a slow motor, the load held fast by friction."""
    drive = varied(
        gear_backlash_variation=0.5,
        gear_backlash_cycles=3,
        gear_backlash_phase=0.2,
        gear_contact=ElasticContact(),
        load_coulomb_friction=1e3,
    )
    for angle in (0.0, 0.4, 1.7, -2.0):
        half = 0.01 * (1 + 0.5 * math.cos(3 * angle + 0.2))
        plant = Plant(drive, [10 * angle, 0.0, angle, 0.0, 0.0])
        for voltage in (0.01, -0.01):
            plant.advance(voltage, 0.0, 60.0)
            torque = 0.05 * voltage / 2.0 / 0.1
            assert plant.motor_angle / 10 - angle == pytest.approx(
                math.copysign(half, voltage) + 1e-3 * torque, rel=1e-4
            )
            assert plant.load_angle == angle


@settings(max_examples=300, deadline=None)
@given(st.floats(0, 1), *[st.floats(-3, 3)] * 3)
def test_first_zero_of_a_cubic(before: float, after: float, slope_before: float, slope_after: float) -> None:
    """The cubic is above 0 up to there, and goes below; one that stays above has none."""
    x = np.linspace(0, 1, 2001)
    cubic = before * (1 + 2 * x) * (1 - x) ** 2 + slope_before * x * (1 - x) ** 2
    cubic += after * x**2 * (3 - 2 * x) - slope_after * x**2 * (1 - x)
    share = first_zero(before, after, slope_before, slope_after)
    if share == 2.0:
        assert after >= 0
        if slope_before < 0 < slope_after:
            assert np.min(cubic) > -1e-5
    else:
        assert 0 <= share <= 1
        assert abs(np.interp(share, x, cubic)) < 1e-4
        assert after < 0 or np.min(cubic) <= 1e-12


@pytest.mark.parametrize("law", ["power", "elastic"])
def test_mirrored_commands_give_the_mirrored_motion(law: str) -> None:
    """Bit for bit, events and all."""
    drive = varied(
        motor_coulomb_friction=0.02,
        load_coulomb_friction=0.1,
        gear_efficiency_forward=0.7,
        gear_efficiency_backward=0.4,
        load_gravity_torque=0.3,
        gear_contact=CONTACTS[law](),
    )
    one, other = Plant(drive), Plant(drive)
    for voltage, torque in pieces():
        one.advance(voltage, torque, 0.005)
        other.advance(-voltage, -torque, 0.005)
        np.testing.assert_array_equal(one.state, -other.state)


SHARES = st.sampled_from([0.0, 0.01, 0.1, 0.5])


@searched(
    60,
    150,
    given(
        law=st.sampled_from(["power", "power_no_pull", "elastic", "restitution"]),
        motor=SHARES,
        load=SHARES,
        forward=st.sampled_from([1.0, 0.9, 0.3]),
        backward=st.sampled_from([1.0, 0.8, 0.0]),
        gravity=SHARES,
        variation=st.sampled_from([0.0, 0.3, 0.9]),
        cycles=st.integers(1, 40),
        inertia=st.floats(0.05, 20),
        interface=st.sampled_from(["voltage", "current"]),
        seed=st.integers(0, 2**32 - 1),
    ),
)
def test_any_practical_drive_integrates_and_keeps_its_energy_account(
    law: str,
    motor: float,
    load: float,
    forward: float,
    backward: float,
    gravity: float,
    variation: float,
    cycles: int,
    inertia: float,
    interface: str,
    seed: int,
) -> None:
    """Frictions and weight as shares of the torque at standstill; voltages and load torques at random, and none."""
    drive = varied(
        motor_coulomb_friction=0.6 * motor,
        load_coulomb_friction=6.0 * load,
        load_inertia=5e-4 * inertia,
        load_gravity_torque=6.0 * gravity,
        gear_efficiency_forward=forward,
        gear_efficiency_backward=backward,
        gear_backlash_variation=variation,
        gear_backlash_cycles=cycles,
        gear_contact=CONTACTS[law](),
    )
    drive = replace(drive, command_interface=interface)
    random = np.random.default_rng(seed)
    plant = Plant(
        drive, [random.uniform(-0.1, 0.1), random.uniform(-50, 50), 0.0, random.uniform(-5, 5), 0.0], account=True
    )
    balance, turnover = plant.energy_stored, plant.energy_stored
    for _ in range(30):
        supplied = plant.energy_supplied
        command = random.choice([0.0, 1.0]) * random.uniform(-drive.command_limit, drive.command_limit)
        plant.advance(command, random.choice([0.0, 1.0]) * random.uniform(-3, 3), 0.01)
        turnover += abs(plant.energy_supplied - supplied)
    balance += plant.energy_supplied - plant.energy_lost - plant.energy_stored
    assert abs(balance) <= 1e-6 * turnover
