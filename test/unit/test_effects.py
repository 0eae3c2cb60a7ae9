"""The effects of real axes: what each equation says, no energy from nowhere, and nothing at all at size zero."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import varied
from real_axis import by_scipy

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive, Effects, Plant
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.effects.amplifier import amplified
from backlash_ros.drivetrain.effects.implicit import factorize, solve
from backlash_ros.drivetrain.motion.dynamics import is_plain
from backlash_ros.drivetrain.motion.integrator import integrator_for
from backlash_ros.drivetrain.parameters import drive_in, drive_of, values_of
from backlash_ros.foundation.quantity import quantities

RUBS: dict[str, Any] = {"motor_coulomb_friction": 0.004, "load_coulomb_friction": 0.04}
LIVELY: dict[str, Any] = {"wind_up": 1e-3, "torque": 1.5, "dissipation": 0.1}
EFFECTS: dict[str, dict[str, Any]] = {
    "cogging": {"cogging": 6e-3, "cogging_cycles": 12, "cogging_phase": 0.4},
    "ripple": {"torque_ripple": 0.05, "torque_ripple_phase": 1.0},
    "sag": {"supply_sag": 0.09},
    "flexible": {"outer_share": 0.4, "outer_frequency": 40.0},
    "stages": {"first_gap": 0.6, "wheel_inertia": 0.1},
    "drift": {"gap_growth": 0.5, "friction_fall": 0.3, "drift_time": 0.2},
}
EFFECTS["all"] = {name: value for effect in EFFECTS.values() for name, value in effect.items()}


def drive_with(effects: dict[str, Any], exponent: float = 1.0, **changes: Any) -> Drive:
    """The nominal drive with teeth of Hunt and Crossley, effects, and other parameters named ``part_parameter``."""
    teeth = CONTACTS["hunt_crossley"](**LIVELY, exponent=exponent)
    return replace(varied(gear_contact=teeth, **changes), effects=Effects(**effects))


def pieces(count: int = 60) -> list[tuple[float, float]]:
    """Voltages and load torques under which the teeth meet on both flanks."""
    return [(4.0 * math.sin(k / 6), 0.1 * math.cos(k / 9)) for k in range(count)]


# Nothing at size zero.


def test_effects_of_size_zero_are_no_effects() -> None:
    """Whatever else is said of them: the very same integrator plays the drive, from the same constants."""
    shapes = {"cogging_cycles": 7, "torque_ripple_phase": 1.0, "stribeck_speed": 0.2, "outer_frequency": 15.0}
    drive = replace(NOMINAL_DRIVE, effects=Effects(**shapes, wheel_inertia=0.5, drift_time=1.0))  # type: ignore[arg-type]
    assert not drive.effects.acts
    assert is_plain(drive)
    assert integrator_for(drive) is integrator_for(NOMINAL_DRIVE)
    ideal, other = plant_constants(NOMINAL_DRIVE), plant_constants(drive)
    assert ideal._replace(effects=other.effects) == other


@pytest.mark.parametrize("name", [each for each in quantities(Effects) if not each.endswith("_error")])
def test_every_size_counts(name: str) -> None:
    shapes = ("cycles", "phase", "speed", "frequency", "damping", "inertia", "time", "stiffness")
    described = quantities(Effects)[name]
    value: float = 8 if described.whole else 0.5 * (described.lower + min(described.upper, described.lower + 1))
    assert Effects(**{name: value}).acts is not name.endswith(shapes)  # type: ignore[arg-type]


def test_next_to_nothing_of_an_effect_changes_next_to_nothing() -> None:
    """The equations with effects are those without, and more: here with every friction and a gap that varies."""
    changes = {"gear_efficiency_forward": 0.8, "gear_efficiency_backward": 0.6, "gear_backlash_variation": 0.3}
    drive = drive_with({}, **RUBS, **changes, load_gravity_torque=0.1)
    plain = Plant(drive, tolerance=1e-11)
    real = Plant(replace(drive, effects=Effects(cogging=1e-12)), tolerance=1e-11)
    for voltage, torque in pieces():
        plain.advance(voltage, torque, 0.005)
        real.advance(voltage, torque, 0.005)
        np.testing.assert_allclose(real.state, plain.state, rtol=1e-6, atol=1e-7)
    assert real.gear_torque == pytest.approx(plain.gear_torque, rel=1e-5, abs=1e-6)


# What the equations say.


@pytest.mark.corners(7)
@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize("name", EFFECTS)
def test_motion_agrees_with_scipy(name: str, exponent: float) -> None:
    drive = drive_with(EFFECTS[name], exponent, load_gravity_torque=0.05)
    plant = Plant(drive, [0.0, 5.0, 0.0, -0.3, 0.0], tolerance=1e-11)
    states = []
    for voltage, torque in pieces(20):
        plant.advance(voltage, torque, 0.005)
        states.append(plant.state)
    expected = by_scipy(drive, pieces(20), 0.005, [0.0, 5.0, 0.0, -0.3, 0.0])
    scale = np.max(np.abs(expected), axis=0)
    np.testing.assert_allclose(np.array(states) / scale, expected / scale, rtol=0, atol=2e-5)


@pytest.mark.parametrize("k", [0.02, 0.1])
def test_stiff_teeth_of_hertz_agree_with_scipy(k: float) -> None:
    """Teeth at the hard end of what a population draws, on a gap of a fifth of the nominal one."""
    teeth = CONTACTS["hunt_crossley"](wind_up=k * 0.004, torque=1.5, exponent=1.5, dissipation=0.05)
    gear = replace(NOMINAL_DRIVE.gear, backlash_angle=0.004, contact=teeth)
    drive = replace(NOMINAL_DRIVE, gear=gear, effects=Effects(cogging=3e-3))
    plant = Plant(drive)
    for voltage, torque in pieces(12):
        plant.advance(voltage, torque, 0.005)
    np.testing.assert_allclose(plant.state, by_scipy(drive, pieces(12), 0.005)[-1], rtol=1e-4, atol=1e-6)


def test_dry_friction_falls_with_the_speed_and_differs_between_both_directions() -> None:
    """A motor that slides in the gap, without teeth in contact or winding."""
    effects = {"static_friction": 1.8, "stribeck_speed": 0.2, "friction_asymmetry": 0.25}
    drive = replace(drive_with(effects, **RUBS, gear_backlash_angle=3.0), command_interface="current")
    coulomb, inertia = drive.motor.coulomb_friction, drive.motor.inertia
    for way, speed in ((1.0, 20.0), (-1.0, 20.0), (1.0, 1.0), (-1.0, 1.0)):
        plant, span = Plant(drive, [0.0, way * speed, 0.0, 0.0, 0.0]), 1e-5
        plant.advance(0.0, 0.0, span)
        ratio = speed * drive.gear.ratio / 0.2
        torque = coulomb * (1 + 0.8 * math.exp(-(ratio**2))) * (1 + way * 0.25)
        torque += drive.motor.viscous_friction * speed
        assert way * (way * speed - plant.motor_speed) == pytest.approx(torque / inertia * span, rel=2e-2)


@pytest.mark.parametrize(("way", "share"), [(1.0, 1.3), (-1.0, 0.7)])
def test_load_at_rest_holds_its_static_friction_and_no_more(way: float, share: float) -> None:
    effects = {"static_friction": 1.5, "friction_asymmetry": 0.3}
    drive = drive_with(effects, **RUBS)
    largest = drive.load.coulomb_friction * 1.5 * share
    held, gone = Plant(drive), Plant(drive)
    held.advance(0.0, way * 0.999 * largest, 0.1)
    gone.advance(0.0, way * 1.001 * largest, 0.1)
    assert held.load_angle == 0.0
    assert way * gone.load_angle > 1e-4


def test_friction_that_falls_lets_go_of_the_load() -> None:
    drive = drive_with({"friction_fall": 0.5, "drift_time": 0.2}, **RUBS)
    plant = Plant(drive)
    torque = 0.75 * drive.load.coulomb_friction  # held until half of the drift time
    plant.advance(0.0, torque, 0.098)
    assert plant.load_angle == 0.0
    plant.advance(0.0, torque, 0.1)
    assert plant.load_angle > 0.0


def test_amplifier_has_a_dead_band_and_a_resolution() -> None:
    plant = plant_constants(drive_with({"dead_band": 0.01, "command_bits": 8}))
    count = 48.0 / 256
    for command in np.linspace(-24, 24, 97):
        got = amplified(plant, float(command))
        size = max(abs(command) - 0.24, 0.0)
        assert abs(abs(got) - size) <= 0.5 * count * (1 + 1e-9)
        assert got * command >= 0
        assert got / count == pytest.approx(round(got / count), abs=1e-9)
    exact = plant_constants(drive_with({"dead_band": 0.01}))
    assert amplified(exact, 3.0) == pytest.approx(2.76)
    assert amplified(exact, -0.2) == 0.0


def test_command_within_the_dead_band_moves_nothing() -> None:
    plant = Plant(drive_with({"dead_band": 0.01}))
    plant.advance(0.239, 0.0, 0.1)
    assert not np.any(plant.state)


def test_load_rests_and_gap_is_shared_at_the_start() -> None:
    """Neither the spring of the load nor the wheel moves anything by itself."""
    plant = Plant(drive_with(EFFECTS["all"] | {"cogging_phase": 0.0}), account=True)
    plant.advance(0.0, 0.0, 0.1)
    np.testing.assert_allclose(plant.state, 0.0, atol=1e-12)
    assert plant.energy_stored == pytest.approx(0.0, abs=1e-15)


# What holds of every one of them.


@pytest.mark.parametrize("law", ["power", "power_no_pull", "elastic", "restitution", "hunt_crossley"])
@pytest.mark.parametrize("interface", ["voltage", "current"])
def test_energy_supplied_is_stored_or_lost(law: str, interface: str) -> None:
    effects = EFFECTS["all"] | {"static_friction": 1.6, "friction_asymmetry": 0.2, "dead_band": 0.01}
    drive = drive_with(
        effects, **RUBS, gear_efficiency_forward=0.8, gear_efficiency_backward=0.6, gear_backlash_variation=0.3
    )
    drive = replace(drive, command_interface=interface, gear=replace(drive.gear, contact=CONTACTS[law]()))
    # Damped teeth on both sides of a light wheel: finer than this, the steps get too many, and the run says so.
    tolerance = 1e-9 if law == "restitution" else 1e-11
    plant = Plant(drive, [0.0, 50.0, 0.0, -2.0, 0.3], tolerance=tolerance, account=True)
    before, turnover = plant.energy_stored, 0.0
    for voltage, torque in pieces(40):
        supplied, lost = plant.energy_supplied, plant.energy_lost
        plant.advance(voltage if interface == "voltage" else 0.1 * voltage, torque, 0.005)
        turnover += abs(plant.energy_supplied - supplied)
        assert law.startswith("power") or plant.energy_lost >= lost
    balance = plant.energy_supplied - plant.energy_lost - (plant.energy_stored - before)
    assert turnover > 0.02
    assert abs(balance) <= 1e-7 * turnover


def test_mirrored_commands_give_the_mirrored_motion() -> None:
    """Bit for bit, where no phase and no direction is preferred."""
    effects = EFFECTS["all"] | {"cogging_phase": 0.0, "torque_ripple_phase": 0.0, "static_friction": 1.6}
    drive = drive_with(effects | {"dead_band": 0.01, "command_bits": 10}, 1.5, **RUBS, load_gravity_torque=0.1)
    one, other = Plant(drive), Plant(drive)
    for voltage, torque in pieces(40):
        one.advance(voltage, torque, 0.005)
        other.advance(-voltage, -torque, 0.005)
        np.testing.assert_array_equal(one.state, -other.state)


def test_stiff_teeth_press_as_they_do_without_effects() -> None:
    """Heavily damped teeth hold the explicit method down, so that the implicit one takes over."""
    teeth = CONTACTS["elastic"](wind_up=1e-6, damping=1e5)
    drive = replace(
        NOMINAL_DRIVE,
        gear=replace(NOMINAL_DRIVE.gear, contact=teeth),
        effects=Effects(cogging=3e-3, outer_share=0.4),
    )
    plain, real = Plant(replace(drive, effects=Effects())), Plant(drive)
    for plant in (plain, real):
        for _ in range(50):
            plant.advance(6.0, 0.0, 0.004)
    assert real.load_speed == pytest.approx(plain.load_speed, rel=0.05)
    assert abs(real.motor_angle * 0.1 - real.load_angle) == pytest.approx(0.01, rel=1e-3)


def test_factors_solve_their_matrix() -> None:
    random = np.random.default_rng(2)
    matrix, right, out, order = random.normal(size=(12, 12)), random.normal(size=12), np.empty(12), np.empty(12)
    factors = matrix.copy()
    factorize(factors, order)
    solve(factors, order, right, out)
    np.testing.assert_allclose(matrix @ out, right, rtol=1e-9, atol=1e-9)


# As parameters.


def test_data_sheet_errors_change_the_motor_alone() -> None:
    errors = {"resistance_error": 0.2, "inductance_error": -0.1, "torque_constant_error": 0.05, "inertia_error": 0.15}
    drive = replace(NOMINAL_DRIVE, effects=Effects(**errors))  # type: ignore[arg-type]
    motor = replace(NOMINAL_DRIVE.motor, resistance=2.4, inductance=1.8e-3, torque_constant=0.0525, inertia=2.3e-5)
    built = drive.as_built
    for name in quantities(type(motor)):
        assert getattr(built.motor, name) == pytest.approx(getattr(motor, name))
    assert built.effects == Effects()
    assert (drive.motor, built.gear, built.load) == (NOMINAL_DRIVE.motor, drive.gear, drive.load)
    ours, theirs = plant_constants(drive), plant_constants(built)
    np.testing.assert_array_equal(ours.effects, theirs.effects)
    assert ours._replace(effects=theirs.effects) == theirs
    assert NOMINAL_DRIVE.as_built is NOMINAL_DRIVE


def test_effects_are_named_as_parameters_and_no_controller_is_told() -> None:
    values = values_of(NOMINAL_DRIVE)
    assert not [name for name in values if name.startswith("effects")]
    for kind in CONTACTS.values():
        values |= {f"{kind.section}.{name}": getattr(kind(), name) for name in quantities(kind)}
    assert drive_of(values | {"effects.cogging": 0.01}).effects == Effects(cogging=0.01)
    assert drive_of(values).effects == Effects()
    assert drive_in({"effects": {"supply_sag": 0.05}}).effects == Effects(supply_sag=0.05)
    with pytest.raises(ValueError, match=r"effects\.coging is no parameter"):
        drive_in({"effects": {"coging": 0.05}})


def test_error_names_effect_value_bound_and_unit() -> None:
    with pytest.raises(ValueError, match=r"effects\.cogging must be >= 0 N m and <= 1000 N m, got -1"):
        Effects(cogging=-1)
    with pytest.raises(ValueError, match=r"effects\.first_gap must be >= 0\.01 and <= 1, got 0"):
        Effects(first_gap=0)
    with pytest.raises(ValueError, match=r"motor\.inductance must be >= 1e-07 H"):
        _ = replace(
            NOMINAL_DRIVE,
            motor=replace(NOMINAL_DRIVE.motor, inductance=1e-7),
            effects=Effects(inductance_error=-0.2),
        ).as_built
