"""The stability check and the margins: delays are exact, and margins are where the loop turns unstable."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from searched import searched

from backlash_ros.control import Gains, GainSet, ServoSettings, check_stable, design_gains, stability_margins
from backlash_ros.drivetrain import (
    COMMAND_INTERFACES,
    NOMINAL_DRIVE,
    Drive,
    command_from_voltage,
    discretize,
    discretize_from_command,
    rigid_model,
)

PERIOD = 0.004


def test_gains_that_the_rate_is_too_slow_for_are_refused(gains: GainSet) -> None:
    check_stable("gains.fast.k", NOMINAL_DRIVE, gains.fast, PERIOD)
    with pytest.raises(ValueError, match=r"gains\.fast\.k = .* is unstable at 10 Hz even .* must be < 1, got"):
        check_stable("gains.fast.k", NOMINAL_DRIVE, gains.fast, 0.1)
    with pytest.raises(ValueError, match=r"is unstable at 250 Hz"):
        check_stable("k", NOMINAL_DRIVE, replace(gains.fast, velocity=-5.0), PERIOD)


def test_error_names_the_delay(gains: GainSet) -> None:
    with pytest.raises(ValueError, match=r"fast = .* is unstable at 250 Hz with a delay of 0\.022 s even without"):
        check_stable("fast", NOMINAL_DRIVE, gains.fast, PERIOD, delay=0.022)
    current = replace(NOMINAL_DRIVE, command_interface="current")
    light = replace(current, motor=replace(current.motor, inertia=2e-6))
    with pytest.raises(ValueError, match=r"unstable at 250 Hz with a delay of 0\.006 s inside the gap"):
        check_stable("k", light, replace(gains.overdamped, current=0.0), PERIOD, delay=0.006)


@pytest.mark.parametrize("delay", [-1e-6, math.nan, math.inf, 0.0401])
def test_delay_out_of_bounds_is_refused(delay: float, gains: GainSet) -> None:
    says = r"delay must be >= 0 s and at most 10 periods, 0\.04 s, got"
    with pytest.raises(ValueError, match=f"k: {says}"):
        check_stable("k", NOMINAL_DRIVE, gains.fast, PERIOD, delay)
    with pytest.raises(ValueError, match=says):
        stability_margins(NOMINAL_DRIVE, gains.fast, PERIOD, delay)


def test_delay_of_ten_periods_is_checked(gains: GainSet) -> None:
    check_stable("k", NOMINAL_DRIVE, gains.overdamped, PERIOD, 10 * PERIOD)
    check_stable("k", NOMINAL_DRIVE, gains.overdamped, 0.0013, 10 * 0.0013)


# The delay in the model


def simulated(drive: Drive, gains: Gains, delay: float, samples: int, fine: int = 1000) -> np.ndarray:
    """Return the rigid loop's states at each sample, on a grid that delay and period are multiples of."""
    a, b = rigid_model(drive)
    from_states, from_voltage = command_from_voltage(drive, a, b)
    short, effect = discretize_from_command(drive, a, b[:, :1], PERIOD / fine)
    late = round(delay / PERIOD * fine)
    x, commands, seen = np.array([1.0, 0.0, 0.0]), np.zeros(samples * fine + late + fine), []
    for tick in range(samples * fine):
        if tick % fine == 0:
            seen.append(x.copy())
            command = from_states @ x - from_voltage[:, 0] * (gains.as_array() @ x)
            commands[tick + late : tick + late + fine] = command[0]
        x = short @ x + effect[:, 0] * commands[tick]
    return np.array(seen)


@pytest.mark.parametrize("interface", COMMAND_INTERFACES)
@pytest.mark.parametrize("periods", [0.0, 0.25, 0.999, 1.0, 1.5, 2.0, 3.75])
def test_delayed_model_is_the_continuous_one_with_a_late_command(
    interface: str, periods: float, gains: GainSet
) -> None:
    drive = replace(NOMINAL_DRIVE, command_interface=interface)
    delay, k = periods * PERIOD, replace(gains.overdamped, current=0.3)
    seen = simulated(drive, k, delay, samples=12)
    a, b = rigid_model(drive)
    following, effect = discretize(drive, a, b[:, :1], PERIOD, delay)
    x = np.zeros(len(following))
    x[0] = 1.0
    for expected in seen:
        np.testing.assert_allclose(x[:3], expected, rtol=1e-9, atol=1e-9)
        x = following @ x - effect[:, 0] * (k.as_array() @ x[:3])


@pytest.mark.parametrize("interface", COMMAND_INTERFACES)
def test_whole_delay_adds_poles_at_zero_to_the_drive(interface: str) -> None:
    drive = replace(NOMINAL_DRIVE, command_interface=interface)
    a, b = rigid_model(drive)
    ideal, _ = discretize_from_command(drive, a, b[:, :1], PERIOD)
    late, _ = discretize_from_command(drive, a, b[:, :1], PERIOD, 3 * PERIOD)
    assert len(late) == len(ideal) + 3
    expected = np.sort(np.abs([*np.linalg.eigvals(ideal), 0, 0, 0]))
    np.testing.assert_allclose(np.sort(np.abs(np.linalg.eigvals(late))), expected, atol=1e-4)


# Margins


@st.composite
def loops(draw: st.DrawFn) -> tuple[Drive, Gains, float, float]:
    """Random drives over decades, designed gains with a random scale, sampled 2 to 60 times a time constant."""

    def factor(decades: float) -> float:
        return float(10 ** draw(st.floats(-decades, decades)))

    motor, load = NOMINAL_DRIVE.motor, NOMINAL_DRIVE.load
    drive = replace(
        NOMINAL_DRIVE,
        motor=replace(
            motor,
            inertia=motor.inertia * factor(1),
            resistance=motor.resistance * factor(0.7),
            inductance=motor.inductance * factor(1),
            viscous_friction=motor.viscous_friction * factor(1),
        ),
        load=replace(load, inertia=load.inertia * factor(1.5), viscous_friction=load.viscous_friction * factor(1)),
        command_interface=draw(st.sampled_from(COMMAND_INTERFACES)),
    )
    designed = design_gains("q", drive, [1000.0 * factor(2), draw(st.sampled_from([0.0, 1.0])) * factor(2)]).as_array()
    scale = [draw(st.floats(0.3, 3)) for _ in range(3)]
    gains = Gains(*(float(k * s) for k, s in zip(designed, scale, strict=True)))
    a, b = rigid_model(drive)
    slow = float(np.min(np.abs(np.linalg.eigvals(a - b[:, :1] @ gains.as_array()[None, :]))))
    period = 1.0 / (slow * draw(st.floats(2, 60)))
    return drive, gains, period, draw(st.sampled_from([0.0, 0.3, 0.5, 1.0, 1.7])) * period


def stable(drive: Drive, gains: Gains, period: float, delay: float) -> bool:
    """Whether the loop in contact is stable, by `check_stable`; by the poles themselves beyond its longest delay."""
    if delay > 10 * period:
        a, b = rigid_model(drive)
        following, effect = discretize(drive, a, b[:, :1], period, delay)
        feedback = np.zeros((1, len(following)))
        feedback[:, :3] = gains.as_array()
        return bool(np.max(np.abs(np.linalg.eigvals(following - effect @ feedback))) < 1)
    try:
        check_stable("k", drive, gains, period, delay)
    except ValueError as error:
        assert "is unstable" in str(error)
        return "inside the gap" in str(error)
    return True


@searched(25, 60, given(loops()))
def test_delay_margin_is_where_the_loop_turns_unstable(loop: tuple[Drive, Gains, float, float]) -> None:
    drive, gains, period, delay = loop
    assume(stable(drive, gains, period, delay))
    margins = stability_margins(drive, gains, period, delay)
    assert margins.phase > 0
    assert margins.gain > 1
    assert margins.delay > 0
    # Nearly unstable, or with a current loop faster than the samples, it is unstable in narrow ranges of delay too.
    assume(margins.gain > 1.1)
    assume(gains.current < drive.motor.resistance)
    assume(margins.delay < 15 * period)  # the poles of longer delays take long to compute
    for factor in (0.3, 0.6, 0.9, 0.999, 1.001):
        assert stable(drive, gains, period, delay + factor * margins.delay) == (factor < 1)


@pytest.mark.population
@pytest.mark.parametrize("loops", [24, pytest.param(60, marks=pytest.mark.grid)])
@pytest.mark.parametrize("interface", COMMAND_INTERFACES)
def test_a_tenth_beyond_the_delay_margin_designed_gains_are_unstable(interface: str, loops: int) -> None:
    """Sampled a few times in the delay margin: some loops sampled as slowly as they can bear are stable again later."""
    rng, checked = np.random.default_rng(1), 0
    for _ in range(loops):
        inertia, resistance, weight = 10.0 ** rng.uniform(-1, 1, size=3)
        motor, load = NOMINAL_DRIVE.motor, NOMINAL_DRIVE.load
        drive = replace(
            NOMINAL_DRIVE,
            motor=replace(motor, resistance=motor.resistance * float(resistance)),
            load=replace(load, inertia=load.inertia * float(inertia)),
            command_interface=interface,
        )
        gains = design_gains("q", drive, [1000.0 * float(weight), 1.0])
        period = float(stability_margins(drive, gains, 1e-5).delay * rng.uniform(0.15, 0.4))
        delay = float(rng.uniform(0, 1)) * period
        if stable(drive, gains, period, delay):
            checked += 1
            margin = stability_margins(drive, gains, period, delay).delay
            assert stable(drive, gains, period, delay + 0.9 * margin)
            assert not stable(drive, gains, period, delay + 1.1 * margin)
    assert checked > loops // 2


@searched(15, 30, given(loops(), st.floats(-0.5, 0.5)))
def test_margin_with_a_current_gain_on_an_imposed_current(loop: tuple[Drive, Gains, float, float], k3: float) -> None:
    """At whole periods a sample sees the current of an earlier command, and some such loops are stable again there."""
    drive, gains, period, delay = loop
    drive = replace(drive, command_interface="current")
    gains = replace(gains, current=k3 * drive.motor.resistance)
    assume(stable(drive, gains, period, delay))
    margins = stability_margins(drive, gains, period, delay)
    margin = margins.delay
    assume(margins.gain > 1.1)
    assume(margin < 15 * period)
    for factor in (0.3, 0.6, 0.9):
        assert stable(drive, gains, period, delay + factor * margin)
    assert stable(drive, gains, period, delay + 0.9999 * margin)
    assert not stable(drive, gains, period, delay + 1.0001 * margin)


def test_a_narrow_range_of_unstable_delays_from_a_whole_period_on_is_found() -> None:
    """It is 0.05 periods wide here, and the next one begins 0.7 periods later."""
    nominal = NOMINAL_DRIVE
    drive = replace(
        nominal,
        motor=replace(nominal.motor, resistance=5.236),
        load=replace(nominal.load, inertia=2.034e-3),
        command_interface="current",
    )
    gains, period = Gains(41.01, 1.68, 2.618), 0.015824
    assert stability_margins(drive, gains, period).delay == pytest.approx(period, rel=1e-5)
    assert [stable(drive, gains, period, periods * period) for periods in (0.99, 1.0, 1.1, 1.8)] == [True, False] * 2


@searched(15, 30, given(loops()))
def test_gain_margin_is_where_the_loop_turns_unstable(loop: tuple[Drive, Gains, float, float]) -> None:
    """Where the drive takes a voltage all of the command is the gains', and a factor on it is one on them."""
    drive, gains, period, delay = loop
    drive = replace(drive, command_interface="voltage")
    assume(stable(drive, gains, period, delay))
    gain = stability_margins(drive, gains, period, delay).gain
    for factor in (0.3, 0.9, 1.1):
        if math.isfinite(gain) and (raised := 1.0 + factor * (gain - 1.0)) * gains.position < 1e9:
            scaled = Gains(*(float(raised * k) for k in gains.as_array()))
            assert stable(drive, scaled, period, delay) == (factor < 1)


def test_margins_of_the_nominal_gains(gains: GainSet) -> None:
    """Fast gains at 250 Hz: full state feedback has a phase margin near 90 degrees, which delay takes away."""
    ideal = stability_margins(NOMINAL_DRIVE, gains.fast, PERIOD)
    assert math.degrees(ideal.phase) == pytest.approx(90.0, abs=0.5)
    assert ideal.crossover == pytest.approx(81.15, rel=1e-3)
    assert ideal.delay == pytest.approx(0.01951, rel=1e-3)
    assert ideal.gain == pytest.approx(5.798, rel=1e-3)
    late = stability_margins(NOMINAL_DRIVE, gains.fast, PERIOD, PERIOD)
    assert late.delay == pytest.approx(ideal.delay - PERIOD, rel=1e-6)
    assert late.phase == pytest.approx(ideal.phase - ideal.crossover * PERIOD, rel=1e-6)
    assert late.gain < 0.6 * ideal.gain


@pytest.mark.parametrize("interface", COMMAND_INTERFACES)
def test_delay_and_its_margin_add_up(interface: str, gains: GainSet) -> None:
    drive = replace(NOMINAL_DRIVE, command_interface=interface)
    fast = replace(gains.fast, current=0.0)
    total = stability_margins(drive, fast, PERIOD).delay
    for delay in (0.0003, 0.004, 0.0065):
        assert delay + stability_margins(drive, fast, PERIOD, delay).delay == pytest.approx(total, rel=1e-6)


def test_an_unstable_loop_has_no_margins(gains: GainSet) -> None:
    with pytest.raises(ValueError, match=r"no margins: .* is unstable at 250 Hz with a delay of 0\.024 s"):
        stability_margins(NOMINAL_DRIVE, gains.fast, PERIOD, 0.024)


def test_margins_are_computed_once(gains: GainSet) -> None:
    assert stability_margins(NOMINAL_DRIVE, gains.fast, PERIOD) is stability_margins(NOMINAL_DRIVE, gains.fast, PERIOD)


def test_settings_have_the_margins_of_their_gains(gains: GainSet) -> None:
    prompt, late = (ServoSettings(gains, loop_delay=delay).margins(NOMINAL_DRIVE) for delay in (0.0, 0.008))
    assert prompt["fast"] == stability_margins(NOMINAL_DRIVE, gains.fast, 0.004)
    assert late["fast"].delay == pytest.approx(prompt["fast"].delay - 0.008, abs=1e-6)
    assert late["overdamped"].phase > 1.5
