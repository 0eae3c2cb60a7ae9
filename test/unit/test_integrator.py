"""The integrator against scipy, and what physics demands of any drive: energy, symmetry, limits, no overflow."""

import math
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from backlash_ros.control import GainSet, ServoSettings
from backlash_ros.drivetrain import (
    COMMAND_INTERFACES,
    CONTACTS,
    NOMINAL_DRIVE,
    Drive,
    Gear,
    IntegrationError,
    Load,
    Motor,
    Plant,
    rigid_model,
)
from backlash_ros.drivetrain.contacts.power import PowerContact
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.quantity import Quantity, quantities
from backlash_ros.simulation import Scenario, largest_load_torque, run


def equations(_t: float, x: np.ndarray, drive: Drive, voltage: float, load_torque: float) -> list[float]:
    """The equations of motion, written down a second time, from the paper."""
    motor, gear, load = drive.motor, drive.gear, drive.load
    theta_m, omega_m, theta_l, omega_l, i = x
    s = (gear.motor_radius * theta_m - gear.load_radius * theta_l) / (gear.backlash / 2)
    dv = gear.motor_radius * omega_m - gear.load_radius * omega_l
    teeth: Any = gear.contact
    n = teeth.exponent
    force = teeth.stiffness * s**n + teeth.damping * dv * s ** (n + 1)
    return [
        omega_m,
        (motor.torque_constant * i - motor.viscous_friction * omega_m - gear.motor_radius * force) / motor.inertia,
        omega_l,
        (gear.load_radius * force - load.viscous_friction * omega_l + load_torque) / load.inertia,
        (voltage - motor.resistance * i - motor.torque_constant * omega_m) / motor.inductance,
    ]


def scipy_state(drive: Drive, x: np.ndarray, voltage: float, load_torque: float, duration: float) -> np.ndarray:
    solution = solve_ivp(
        equations, (0, duration), x, "LSODA", args=(drive, voltage, load_torque), rtol=1e-10, atol=1e-13
    )
    assert solution.success
    return solution.y[:, -1]


def test_free_flight_agrees_with_scipy() -> None:
    start = [0.0, 0.5, 0.0, 0.04, 0.0]  # inside the gap for all of the time
    plant = Plant(NOMINAL_DRIVE, start)
    plant.advance(0.02, 0.0, 0.01)
    expected = scipy_state(NOMINAL_DRIVE, np.array(start), 0.02, 0.0, 0.01)
    gap = 0.005 * expected[0] - 0.05 * expected[2]
    assert abs(gap) < 4e-4
    np.testing.assert_allclose(plant.state, expected, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("load_torque", [0.0, 0.3, -0.3])
def test_impacts_agree_with_scipy(load_torque: float) -> None:
    start = [0.0, 30.0, 0.0, -1.0, 0.0]
    plant = Plant(NOMINAL_DRIVE, start)
    plant.advance(2.0, load_torque, 0.2)
    expected = scipy_state(NOMINAL_DRIVE, np.array(start), 2.0, load_torque, 0.2)
    np.testing.assert_allclose(plant.state, expected, rtol=1e-6, atol=1e-8)


def test_limit_cycle_agrees_with_scipy_over_one_second(gains: GainSet) -> None:
    """The whole loop a second time, law and plant, through at least ten impacts: load angle within 1e-6 rad."""
    period, count = 0.001, 1000
    choice = ServoSettings(gains, law="fast", period=period)
    ours = run(NOMINAL_DRIVE, choice, Scenario(np.ones(count), known_load_torque=True))
    touching = np.abs(ours.gap) >= 0.5 * NOMINAL_DRIVE.gear.backlash
    assert np.count_nonzero(touching[1:] & ~touching[:-1]) >= 10

    x, error = np.zeros(5), 0.0
    for k in range(count):
        voltage = -gains.fast.position * (x[2] - 1.0) - gains.fast.velocity * x[3] - gains.fast.current * x[4]
        x = scipy_state(NOMINAL_DRIVE, x, min(max(voltage, -24.0), 24.0), 0.0, period)
        error = max(error, abs(x[2] - ours.load_angle[k + 1]))
    assert error <= 1e-6


def test_error_follows_the_tolerance(gains: GainSet) -> None:
    """A tighter tolerance gives a smaller error, by about as much, down to rounding."""
    choice = ServoSettings(gains, law="fast", period=0.004)
    best, *others = [run(NOMINAL_DRIVE, choice, Scenario(np.ones(100)), 10.0**k) for k in (-12, *range(-10, -3))]
    errors = [np.max(np.abs(other.load_angle - best.load_angle)) for other in others]
    assert errors == sorted(errors)
    decades, _ = np.polyfit(range(-10, -3), np.log10(errors), 1)
    assert 0.8 < decades < 1.2


def energy(drive: Drive, x: np.ndarray) -> float:
    """Kinetic, magnetic and elastic energy, J."""
    gear = drive.gear
    s = (gear.motor_radius * x[0] - gear.load_radius * x[2]) / (gear.backlash / 2)
    teeth: Any = gear.contact
    n = teeth.exponent
    elastic = teeth.stiffness * gear.backlash / 2 / (n + 1) * s ** (n + 1)
    kinetic = 0.5 * drive.motor.inertia * x[1] ** 2 + 0.5 * drive.load.inertia * x[3] ** 2
    return float(kinetic + elastic + 0.5 * drive.motor.inductance * x[4] ** 2)


@settings(max_examples=100, deadline=None)
@given(
    s=st.floats(-1.3, 1.3),
    omega_m=st.floats(-300, 300),
    omega_l=st.floats(-30, 30),
    current=st.floats(-10, 10),
    damping=st.sampled_from([0.0, 20.0, 200.0, 20000.0]),
)
def test_contact_never_creates_energy(s: float, omega_m: float, omega_l: float, current: float, damping: float) -> None:
    drive = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, contact=PowerContact(damping=damping)))
    plant = Plant(drive, [s * 0.5e-3 / 0.005, omega_m, 0.0, omega_l, current])
    before = energy(drive, plant.state)
    for _ in range(50):
        plant.advance(0.0, 0.0, 0.001)
        after = energy(drive, plant.state)
        assert after <= before * (1 + 1e-6) + 1e-12
        before = after


@pytest.mark.parametrize("law", ["fast", "overdamped", "two_region"])
def test_mirrored_reference_gives_the_mirrored_trajectory(gains: GainSet, law: str) -> None:
    choice = ServoSettings(gains, law=law, backlash_angle=0.02)
    torque = 0.05 * np.sin(np.arange(500) / 20)
    forward = run(NOMINAL_DRIVE, choice, Scenario(np.ones(500), torque))
    backward = run(NOMINAL_DRIVE, choice, Scenario(-np.ones(500), -torque))
    np.testing.assert_array_equal(forward.state, -backward.state)
    np.testing.assert_array_equal(forward.command, -backward.command)
    np.testing.assert_array_equal(forward.region, backward.region)


def test_vanishing_backlash_approaches_the_rigid_model() -> None:
    a, b = rigid_model(NOMINAL_DRIVE)
    held = expm(np.block([[a, b], [np.zeros((2, 5))]]) * 0.3)
    rigid = (held[:3, 3:] @ np.array([3.0, 0.1]))[0]
    errors = []
    for backlash in (2e-2, 2e-3, 2e-4, 2e-5, 2e-6):
        plant = Plant(replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, backlash_angle=backlash)))
        plant.advance(3.0, 0.1, 0.3)
        errors.append(abs(plant.load_angle - rigid))
        assert errors[-1] < 2.0 * plant.drive.gear.backlash_angle
    assert errors == sorted(errors, reverse=True)


def quantity_values(described: Quantity) -> st.SearchStrategy[float]:
    """Values over the whole of a quantity's range, evenly in their logarithm, its ends among them."""
    if described.lower < 0:
        return st.floats(described.lower, described.upper)
    low = described.lower if described.lower > 0 else described.upper * 1e-9
    spread = st.floats(math.log(low), math.log(described.upper)).map(
        lambda value: min(max(math.exp(value), described.lower), described.upper)
    )
    ends = [described.upper] if described.open_lower else [described.lower, described.upper]
    return spread | st.sampled_from(ends)


def part(kind: type) -> st.SearchStrategy:
    fields = {name: quantity_values(described) for name, described in quantities(kind).items()}
    for name, described in quantities(kind).items():
        if described.whole:
            fields[name] = st.integers(int(described.lower), int(described.upper))
    if "exponent" in fields and quantities(kind)["exponent"].upper > 3.0:
        fields["exponent"] = st.integers(0, 50).map(lambda k: 2 * k + 1)
    if kind is Gear:
        fields["contact"] = st.one_of(part(each) for each in CONTACTS.values())
    return st.builds(kind, **fields)


ANYTHING = given(
    drive=st.builds(Drive, part(Motor), part(Gear), part(Load), st.sampled_from(COMMAND_INTERFACES)),
    command=st.floats(-1, 1),
    load_torque=st.floats(-1, 1),
)


def integrates_or_says_why_not(drive: Drive, command: float, load_torque: float) -> None:
    plant = Plant(drive)
    try:
        for _ in range(5):
            plant.advance(command * drive.command_limit, load_torque, 0.004)
            assert np.all(np.isfinite(plant.state))
    except IntegrationError as error:
        assert np.all(np.isfinite(error.state))
        assert 0 <= error.time <= 0.02
        assert f"t = {error.time:.9g} s" in str(error)
        assert "theta_l = " in str(error)


@pytest.mark.population
@pytest.mark.parametrize("drives", [10, pytest.param(500, marks=pytest.mark.grid)])
def test_any_validated_drive_integrates_or_says_why_not(drives: int) -> None:
    judged = settings(max_examples=drives, deadline=None, suppress_health_check=list(HealthCheck))
    judged(ANYTHING(integrates_or_says_why_not))()


@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
@pytest.mark.parametrize("command_interface", COMMAND_INTERFACES)
@pytest.mark.parametrize("reversed_every", [0.1, 1.0])
def test_largest_load_torque_is_simulated_in_real_time(
    contact: type, command_interface: str, reversed_every: float
) -> None:
    """Processor time over 0.1 s of 250 Hz, of a drive whose gap varies and whose load hangs, rubbed by everything."""
    gear = replace(NOMINAL_DRIVE.gear, contact=contact(), backlash_variation=0.3, efficiency_backward=0.8)
    motor = replace(NOMINAL_DRIVE.motor, coulomb_friction=1e-3)
    load = replace(NOMINAL_DRIVE.load, coulomb_friction=0.1, gravity_torque=1.0)
    plant = Plant(Drive(motor, gear, load, command_interface))
    plant.advance(0.0, 0.0, 0.004)
    torque, periods = largest_load_torque(plant.drive), []
    assert torque == 60.0
    for k in range(250):
        began = process_time()
        plant.advance(0.0, torque if k * 0.004 % (2 * reversed_every) < reversed_every else -torque, 0.004)
        periods.append(process_time() - began)
    longest = np.max(np.convolve(periods, np.ones(25), "valid"))
    assert longest < 0.1


def test_run_that_cannot_go_on_says_when_and_where(gains: GainSet) -> None:
    """With substeps, too: time and state are those of the last good step."""
    torque = np.zeros(100)
    torque[50:] = 1e300
    with pytest.raises(IntegrationError) as stopped:
        run(NOMINAL_DRIVE, ServoSettings(gains), Scenario(np.ones(100), torque, substeps=10))
    good = run(NOMINAL_DRIVE, ServoSettings(gains), Scenario(np.ones(50), substeps=10))
    assert stopped.value.time == pytest.approx(0.2, abs=1e-3)
    assert stopped.value.state[2] == pytest.approx(good.load_angle[-1], abs=1e-3)
    assert "too many steps" in str(stopped.value) or "below rounding" in str(stopped.value)


@pytest.mark.parametrize("name", ["reference", "load_torque"])
def test_scenario_that_is_not_finite_is_refused_by_name(gains: GainSet, name: str) -> None:
    inputs = {"reference": np.ones(10), name: np.full(10, math.nan)}
    with pytest.raises(ValueError, match=f"{name} must be finite throughout"):
        run(NOMINAL_DRIVE, ServoSettings(gains), Scenario(**inputs))


def test_noise_that_is_not_finite_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"sensors\.load_noise must be a finite number, >= 0 rad and <= .*, got nan"):
        Sensors(load_noise=math.nan)


def test_impossible_state_stops_with_time_and_state() -> None:
    plant = Plant(NOMINAL_DRIVE, [1e30, 0.0, -1e30, 0.0, 0.0])
    with pytest.raises(IntegrationError, match=r"stopped at t = 0 s: .*theta_m = 1e\+30"):
        plant.advance(0.0, 0.0, 0.001)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_plant_refuses_inputs_that_are_not_finite_and_stays_as_it_was(bad: float) -> None:
    plant = Plant(NOMINAL_DRIVE, [0.0, 1.0, 0.0, 0.0, 0.0])
    before = plant.state
    with pytest.raises(ValueError, match="command must be finite, in V"):
        plant.advance(bad, 0.0, 0.01)
    with pytest.raises(ValueError, match="load_torque must be finite, in N m"):
        plant.advance(0.0, bad, 0.01)
    with pytest.raises(ValueError, match="duration must be >= 0 s and finite"):
        plant.advance(0.0, 0.0, bad)
    np.testing.assert_array_equal(plant.state, before)
    assert plant.time == 0.0


def test_supply_limits_the_voltage() -> None:
    limited, full = Plant(NOMINAL_DRIVE), Plant(NOMINAL_DRIVE)
    limited.advance(1000.0, 0.0, 0.01)
    full.advance(24.0, 0.0, 0.01)
    np.testing.assert_array_equal(limited.state, full.state)
