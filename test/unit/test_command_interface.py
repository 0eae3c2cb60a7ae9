"""Both command interfaces, voltage and current: the same laws, the same behaviour, one plant whose energy balances."""

import math
from dataclasses import replace

import numpy as np
import pytest
from drives import varied
from hypothesis import given, settings
from hypothesis import strategies as st
from samples import EVERYTHING, sample_of

from backlash_ros.control import (
    LAWS,
    Gains,
    GainSet,
    Limits,
    Method,
    Servo,
    ServoSettings,
    check_stable,
    find_limit_cycle,
)
from backlash_ros.control.command_range import RangeConstants, command_of, range_constants, voltage_range
from backlash_ros.control.design.describing_function import predict_limit_cycle
from backlash_ros.control.observer import ObserverMemory, observer_memory_at, observer_step
from backlash_ros.drivetrain import (
    COMMAND_INTERFACES,
    NOMINAL_DRIVE,
    Drive,
    Plant,
    discretize,
    rigid_model,
    without_inductance,
)
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.record import row_of
from backlash_ros.foundation.signals import CURRENT, LOAD_TORQUE, OMEGA_L, THETA_L
from backlash_ros.simulation import Run, Scenario, learn_backlash, run

CURRENT_DRIVE = replace(NOMINAL_DRIVE, command_interface="current")
B = NOMINAL_DRIVE.gear.backlash_angle


def step_of(drive: Drive, law: str, period: float = 0.004, seconds: float = 6.0, **scenario: object) -> Run:
    choice = ServoSettings(GainSet.of(drive), law=law, backlash_angle=B, period=period)
    return run(drive, choice, Scenario(np.ones(round(seconds / period)), **scenario))


def range_of(drive: Drive) -> RangeConstants:
    return range_constants(drive, Limits.of(drive))


def residual(result: Run) -> float:
    """Peak to peak of the load angle over the last second, in b."""
    return float(np.ptp(result.load_angle[result.time >= result.time[-1] - 1.0])) / B


def rise(result: Run) -> float:
    angle = result.load_angle
    return float(result.time[np.argmax(angle >= 0.9)] - result.time[np.argmax(angle >= 0.1)])


# What is refused


def test_command_interface_is_one_of_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"^command_interface must be one of \['voltage', 'current'\], got 'torque'$"):
        replace(NOMINAL_DRIVE, command_interface="torque")


def test_command_that_is_not_finite_is_refused_in_its_unit() -> None:
    with pytest.raises(ValueError, match="command must be finite, in A, got nan"):
        Plant(CURRENT_DRIVE).advance(math.nan, 0.0, 0.001)


def test_model_that_takes_another_command_than_the_drive_is_refused(gains: GainSet) -> None:
    with pytest.raises(
        ValueError, match="command_interface of the model must be the drive's, 'current', got 'voltage'"
    ):
        run(CURRENT_DRIVE, ServoSettings(gains), Scenario(np.ones(3)), model=NOMINAL_DRIVE)


@pytest.mark.parametrize("k3", [2.0, 3.0, -2.1])
def test_feedback_of_the_last_current_beyond_the_resistance_is_refused(k3: float) -> None:
    """A held current answers the one before with -k3/R of it."""
    check_stable("k", CURRENT_DRIVE, Gains(2.0, 0.04, 0.5 * k3), 0.004)
    with pytest.raises(ValueError, match=r"^k = \[2, 0\.04, .*\] is unstable at 250 Hz .* must be < 1, got [12]\."):
        check_stable("k", CURRENT_DRIVE, Gains(2.0, 0.04, k3), 0.004)


def test_rate_too_slow_for_the_motor_inside_the_gap_is_refused() -> None:
    """The back-EMF that is played comes once a period: too late for a motor of a time constant of 0.8 ms.

    With the winding in the drive, and with the load in contact, the same gains are stable.
    """
    light, period = varied(CURRENT_DRIVE, motor_inertia=1e-6), 0.004
    gains = GainSet.of(light).overdamped
    a, b = rigid_model(light)
    held, driven = discretize(light, a, b[:, :1], period)
    assert np.max(np.abs(np.linalg.eigvals(held - driven @ gains.as_array()[None, :]))) < 1
    check_stable("k", replace(light, command_interface="voltage"), gains, period)
    check_stable("k", light, gains, 0.001)
    with pytest.raises(
        ValueError, match=r"unstable at 250 Hz inside the gap, where the motor turns alone: pole .* < 1"
    ):
        check_stable("k", light, gains, period)


# The plant


def test_current_is_what_was_commanded_and_no_more_than_the_drive_gives() -> None:
    plant = Plant(CURRENT_DRIVE)
    for command, current in ((3.0, 3.0), (-0.5, -0.5), (1000.0, 12.0), (-1000.0, -12.0)):
        plant.advance(command, 0.0, 0.002)
        assert plant.motor_torque == pytest.approx(0.05 * current)


@settings(max_examples=50, deadline=None)
@given(
    command=st.floats(-12, 12),
    load_torque=st.floats(-0.3, 0.3),
    omega_m=st.floats(-300, 300),
    interface=st.sampled_from(COMMAND_INTERFACES),
)
def test_energy_balances(command: float, load_torque: float, omega_m: float, interface: str) -> None:
    """What is supplied at the terminals and by the load torque is stored or lost; nothing is lost twice or gained."""
    plant = Plant(replace(NOMINAL_DRIVE, command_interface=interface), [0.0, omega_m, 0.0, 0.0, 0.0], account=True)
    start, lost = plant.energy_stored, 0.0
    for sign in (1, 1, -1, 1, -1, -1) * 3:
        plant.advance(sign * command, load_torque, 0.004)
        assert plant.energy_lost >= lost
        lost = plant.energy_lost
        throughput = start + abs(plant.energy_supplied) + lost
        assert plant.energy_stored + lost == pytest.approx(start + plant.energy_supplied, abs=1e-6 * throughput + 1e-12)


def test_imposed_current_supplies_torque_and_heat() -> None:
    """At constant speed and current: V i = R i^2 + K_m i omega_m."""
    plant = Plant(CURRENT_DRIVE, account=True)
    plant.advance(1.0, 0.0, 6.0)
    before, speed = plant.energy_supplied, plant.motor_speed
    plant.advance(1.0, 0.0, 0.5)
    assert plant.motor_speed == pytest.approx(speed, rel=1e-3)
    assert plant.energy_supplied - before == pytest.approx((2.0 + 0.05 * speed) * 0.5, rel=1e-3)


# The law


def test_design_model_drops_the_electrical_pole() -> None:
    """It is the limit L -> 0 of the drive with its winding: the same two poles, and k3 = 0."""
    designed = GainSet.of(CURRENT_DRIVE)
    for region in ("fast", "overdamped"):
        k = getattr(designed, region).as_array()
        assert k[2] == 0.0
        windings = [GainSet.of(varied(motor_inductance=each)) for each in (1e-5, 1e-6, 1e-7)]
        far, nearer, near = (float(np.max(np.abs(getattr(each, region).as_array() - k))) for each in windings)
        assert nearer == pytest.approx(far / 10, rel=0.02)
        assert near == pytest.approx(nearer / 10, rel=0.02)
    a, b = rigid_model(NOMINAL_DRIVE)
    two, _ = without_inductance(a, b[:, :1])
    assert two[1, 1] == pytest.approx(-(7e-3 + 0.05**2 / (0.1**2 * 2.0)) / 2.5e-3)  # friction, and the back-EMF's


def test_command_is_the_current_that_the_winding_would_take() -> None:
    constants = range_of(CURRENT_DRIVE)
    estimate = np.array([0.0, 100.0, 0.0, 0.0, 0.0, 0.0])  # back-EMF of 5 V
    assert command_of(constants, estimate, 9.0) == pytest.approx(2.0)
    assert command_of(constants, estimate, 5.0) == 0.0
    assert command_of(constants, estimate, -24.0) == -12.0
    assert voltage_range(constants, estimate) == (pytest.approx(-19.0), 24.0)


@given(st.floats(-1e4, 1e4), st.floats(-30, 30), st.sampled_from(COMMAND_INTERFACES), st.floats(0.1, 50))
def test_command_keeps_to_its_limit_at_any_speed(omega_m: float, voltage: float, interface: str, limit: float) -> None:
    drive = varied(replace(NOMINAL_DRIVE, command_interface=interface), motor_current_limit=limit)
    constants, estimate = range_of(drive), np.array([0.0, omega_m, 0.0, 0.0, 0.0, 0.0])
    low, high = voltage_range(constants, estimate)
    assert low <= high
    if abs(constants.back_emf * omega_m) - constants.resistance * constants.limit <= 24.0:
        assert -24.0 <= low <= high <= 24.0
    else:  # the supply makes no current that is allowed: the nearest is left, which brakes
        assert low == high
        assert command_of(constants, estimate, low) == pytest.approx(-math.copysign(drive.command_limit, omega_m))
    for within in (low, 0.5 * (low + high), high):
        applied = constants.resistance * command_of(constants, estimate, within) + constants.back_emf * omega_m
        assert applied == pytest.approx(within, rel=1e-9, abs=1e-9)
    assert voltage_range(constants, -estimate) == (-high, -low)
    assert abs(command_of(constants, estimate, voltage)) <= drive.command_limit


@pytest.mark.parametrize("interface", COMMAND_INTERFACES)
@pytest.mark.parametrize("law", sorted(LAWS))
def test_servo_and_plant_step_by_step_are_the_offline_run(law: str, interface: str) -> None:
    drive, seconds = replace(NOMINAL_DRIVE, command_interface=interface), 0.8
    choice = ServoSettings(GainSet.of(drive), law=law, backlash_angle=B)
    torque = 0.05 * np.sin(np.arange(round(seconds / choice.period)) / 20)
    offline = run(drive, choice, Scenario(np.ones(torque.size), torque, sensors=Sensors(measured=POSITIONS)))
    servo, plant = Servo(drive, choice), Plant(drive)
    for k in range(torque.size):
        np.testing.assert_allclose(plant.state, offline.state[k], rtol=1e-12, atol=1e-12)
        if k == 0:
            servo.segments[0, 0] = 1.0  # before any position is held, as the run has it
        command = servo.update(sample_of(plant.state, POSITIONS))
        assert command == pytest.approx(offline.command[k], rel=1e-12, abs=1e-12)
        assert servo.command == command
        plant.advance(command, torque[k], choice.period)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_mirrored_reference_gives_the_mirrored_current(law: str) -> None:
    torque = 0.05 * np.sin(np.arange(500) / 20)
    choice = ServoSettings(GainSet.of(CURRENT_DRIVE), law=law, backlash_angle=B)
    forward = run(CURRENT_DRIVE, choice, Scenario(np.ones(500), torque))
    backward = run(CURRENT_DRIVE, choice, Scenario(-np.ones(500), -torque))
    np.testing.assert_array_equal(forward.state, -backward.state)
    np.testing.assert_array_equal(forward.command, -backward.command)


@pytest.mark.parametrize("law", ["overdamped", "two_region"])
def test_interfaces_agree_in_the_limit_of_a_fast_winding_and_fast_samples(law: str) -> None:
    """L -> 0 in the drive or left out of what the controller plays: the difference goes with the period."""
    quick = varied(motor_inductance=1e-6)
    choice = ServoSettings(GainSet.of(CURRENT_DRIVE), law=law, backlash_angle=B)
    differences = []
    for period in (8e-4, 4e-4, 2e-4):
        sampling, scenario = replace(choice, period=period), Scenario(np.ones(round(1.0 / period)))
        voltage, current = (run(drive, sampling, scenario) for drive in (quick, CURRENT_DRIVE))
        differences.append(float(np.max(np.abs(voltage.load_angle - current.load_angle))))
    assert differences[1] == pytest.approx(differences[0] / 2, rel=0.05)
    assert differences[2] == pytest.approx(differences[1] / 2, rel=0.05)


def test_poles_agree_in_the_limit_of_a_fast_winding_and_fast_samples() -> None:
    """Linear and exact: the two mechanical poles of the sampled loops, in 1/s."""
    k = GainSet.of(CURRENT_DRIVE).fast.as_array()[None, :]
    a, b = rigid_model(varied(motor_inductance=1e-6))
    differences = []
    for period in (4e-4, 2e-4, 1e-4):
        poles = []
        for drive in (NOMINAL_DRIVE, CURRENT_DRIVE):
            held, driven = discretize(drive, a, b[:, :1], period)
            z = np.sort(np.abs(np.linalg.eigvals(held - driven @ k)))[-2:]
            poles.append(np.log(z) / period)
        differences.append(float(np.max(np.abs(poles[0] - poles[1]) / np.abs(poles[0]))))
    assert differences[1] == pytest.approx(differences[0] / 2, rel=0.2)
    assert differences[2] == pytest.approx(differences[1] / 2, rel=0.2)


# The closed loop on the nominal drive


@pytest.mark.parametrize("period", [0.004, 0.001])
@pytest.mark.parametrize("measured", [EVERYTHING, POSITIONS], ids=["everything", "positions"])
def test_the_paper_holds_with_a_current(period: float, measured: tuple[str, ...]) -> None:
    """Fast gains rattle, over-damped ones are slow and quiet, two regions rise fast and come to rest."""
    fast, slow, both = (
        step_of(CURRENT_DRIVE, law, period, sensors=Sensors(measured=measured))
        for law in ("fast", "overdamped", "two_region")
    )
    assert residual(fast) > 0.7
    assert residual(slow) < 0.01
    assert residual(both) < 0.01
    assert rise(both) == pytest.approx(rise(fast))
    assert rise(both) < 0.2 * rise(slow)
    assert np.max(both.load_angle) < 1.0 + 0.05 * B
    assert abs(both.load_angle[-1] - 1.0) < 0.05 * B


@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_law_does_with_a_current_what_it_does_with_a_voltage(law: str) -> None:
    """The same rise, and rest or limit cycle as there."""
    voltage, current = (step_of(drive, law, 0.001) for drive in (NOMINAL_DRIVE, CURRENT_DRIVE))
    assert rise(current) == pytest.approx(rise(voltage), rel=0.1)
    assert (residual(current) > 0.5) == (residual(voltage) > 0.5)


@pytest.mark.parametrize("period", [0.004, 0.001])
def test_learning_works_with_a_current(period: float) -> None:
    settings = ServoSettings(GainSet.of(CURRENT_DRIVE), period=period)
    estimate = learn_backlash(CURRENT_DRIVE, settings.with_experiment("limit_cycle"))
    assert estimate.valid, estimate.reason
    assert estimate.method is Method.GAP_TRAVEL
    assert estimate.angle == pytest.approx(B, rel=0.05)


@pytest.mark.parametrize("measured", [EVERYTHING, POSITIONS], ids=["everything", "positions"])
def test_load_torque_is_held_without_error(measured: tuple[str, ...]) -> None:
    result = step_of(CURRENT_DRIVE, "two_region", load_torque=np.array(0.1), sensors=Sensors(measured=measured))
    assert result.load_angle[-1] == pytest.approx(1.0, abs=0.01 * B)
    assert result.load_torque_estimate[-1] == pytest.approx(0.1, rel=1e-3)
    assert result.command[-1] == pytest.approx(-0.1 * 0.1 / 0.05, rel=1e-3)


def test_damping_needs_the_motors_own_speed() -> None:
    """From the load's speed through the rigid gear the motor is not damped inside the gap: the limit cycle stays."""
    load_only = Sensors(measured=("theta_l", "omega_l"))
    assert residual(step_of(CURRENT_DRIVE, "two_region", sensors=load_only)) > 0.5
    assert residual(step_of(NOMINAL_DRIVE, "two_region", sensors=load_only)) < 0.01


@pytest.mark.parametrize("law", ["cascade", "elastic_lqg"])
def test_laws_with_a_memory_know_a_small_current_limit(law: str) -> None:
    """A tenth of the stall current: the integrator stops, the model of the drive follows what it gets."""
    weak, full = varied(CURRENT_DRIVE, motor_current_limit=1.2), step_of(CURRENT_DRIVE, law, 0.001)
    result = step_of(weak, law, 0.001)
    assert np.max(np.abs(result.command)) == 1.2
    assert np.max(result.load_angle) < np.max(full.load_angle) + B
    assert result.load_angle[-1] == pytest.approx(1.0, abs=B)


def test_observer_takes_the_command_for_the_current() -> None:
    constants, memory = (
        ServoSettings(GainSet.of(CURRENT_DRIVE)).observer(CURRENT_DRIVE),
        observer_memory_at(row_of(ObserverMemory)),
    )
    plant = Plant(CURRENT_DRIVE)
    for k in range(300):
        command = math.sin(0.1 * k)
        plant.advance(command, 0.1, 0.004)
        sample = sample_of(plant.state)
        sample[CURRENT] = math.nan
        observer_step(constants, memory, sample, command, 0.004, constants.torque_bandwidth)
        if k:  # the first sample only starts it
            assert memory.estimate[CURRENT] == command
    assert memory.estimate[LOAD_TORQUE] == pytest.approx(0.1, rel=0.05)


def test_harmonic_balance_predicts_the_amplitude_with_a_current() -> None:
    gains = GainSet.of(CURRENT_DRIVE)
    result = step_of(CURRENT_DRIVE, "fast", 0.001, 4.0, known_load_torque=True, substeps=4)
    tail = slice(result.time.size // 2, None)
    seen = find_limit_cycle(result.state[tail, THETA_L], result.state[tail, OMEGA_L], 0.00025)
    predicted = predict_limit_cycle(CURRENT_DRIVE, gains.fast, 0.001)
    assert seen is not None
    assert predicted is not None
    assert predicted.amplitude == pytest.approx(seen.amplitude, rel=0.15)
