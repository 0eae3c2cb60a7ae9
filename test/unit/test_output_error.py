"""A position servo with one encoder, found again from what its encoder showed; and what is refused."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from output_error import ServoFit, fit_servo, mean_errors
from position_servo import PARAMETERS, PositionServo, ServoRun, simulate
from servo_gap import judge_gap

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.simulation import SimulatedDrive

SERVO = PositionServo(
    torque_per_volt=0.5,
    back_emf=2.0,
    inertia=0.02,
    viscous_friction=0.03,
    coulomb_friction=0.1,
    weight_share=0.1,
    gravity_offset=0.02,
    delay=0.03,
    speed_limit=5.0,
)
FREE = (
    "torque_per_volt",
    "back_emf",
    "inertia",
    "viscous_friction",
    "coulomb_friction",
    "weight_share",
    "gravity_offset",
    "delay",
    "speed_limit",
)
COUNT = 2.0 * math.pi / 4096
LOADS = ((0.007, 0.55), (0.015, 1.2))
TIME = np.arange(0.0, 4.0, 0.01)
ON = np.ones_like(TIME)


def swept(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.6, 1.2) * np.sin(rng.uniform(1.2, 2.2) * TIME**2)


def stepped(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.8, 1.5) * np.sign(np.sin(rng.uniform(1.5, 2.5) * TIME + 0.5))


def slow(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.8, 1.4) * np.sin(rng.uniform(0.5, 1.0) * TIME)


def record(
    servo: PositionServo,
    seed: int,
    goals: tuple[Callable[[np.random.Generator], np.ndarray], ...] = (swept, stepped, slow),
    count: int = 9,
    dropped: bool = True,
) -> list[ServoRun]:
    """Return runs as its encoder shows them, noisy counts; every third lets go of the load on the way."""
    rng = np.random.default_rng(seed)
    runs = []
    for k in range(count):
        inertia, weight = LOADS[k % 2]
        enabled = np.where(TIME < 2.5, 1.0, 0.0) if dropped and k % 3 == 2 else ON
        goal = goals[k % len(goals)](rng)
        start = np.full_like(TIME, COUNT * round(0.1 * rng.standard_normal() / COUNT))
        empty = ServoRun(TIME, start, goal, enabled, 12.0 * ON, (0.66, 2.0, 5.3)[k // 3 % 3], 0.97, inertia, weight)
        angle = simulate(servo, [empty])[0]
        angle[1:] = COUNT * np.round((angle[1:] + 0.5 * COUNT * rng.standard_normal(TIME.size - 1)) / COUNT)
        runs.append(replace(empty, angle=angle))
    return runs


def scattered(servo: PositionServo, seed: int, by: float) -> PositionServo:
    """Return another servo, each parameter times or by a factor of about 1 + ``by``."""
    rng = np.random.default_rng(seed)
    values = {name: getattr(servo, name) * math.exp(by * rng.uniform(-1, 1)) for name in FREE}
    return replace(servo, **{**values, "gravity_offset": 0.05 * rng.standard_normal()})


@cache
def refound(seed: int) -> tuple[PositionServo, ServoFit]:
    servo = scattered(SERVO, seed, 0.4)
    return servo, fit_servo(record(servo, seed), scattered(servo, seed + 1000, 0.3), FREE)


population = pytest.mark.parametrize("population", [range(2), pytest.param(range(6), marks=pytest.mark.grid)])


@population
def test_finds_random_servos_again(population: range) -> None:
    for seed in population:
        servo, fit = refound(seed)
        assert fit.untold == {}
        assert np.mean(fit.errors) < COUNT
        for name in FREE:
            off = abs(getattr(fit.servo, name) - getattr(servo, name))
            assert off <= (5e-3 if name == "gravity_offset" else 0.1 * getattr(servo, name)), (seed, name)


@population
def test_uncertainties_hold_over_random_servos(population: range) -> None:
    errors = []
    for seed in population:
        servo, fit = refound(seed)
        errors += [(getattr(fit.servo, name) - getattr(servo, name)) / fit.uncertainty[name] for name in FREE]
    sizes = np.abs(errors)
    assert np.mean(sizes <= 2.0) >= 0.85
    assert np.max(sizes) <= 5.0


def test_states_a_gap_that_is_there() -> None:
    servo = replace(SERVO, backlash_angle=0.05)
    runs = record(servo, 3, count=8)
    gap = judge_gap(runs, fit_servo(runs, SERVO, ("torque_per_volt", "inertia", "coulomb_friction")))
    assert gap.valid, gap.reason
    assert gap.angle == pytest.approx(0.05, abs=max(3.0 * gap.uncertainty, 1e-3))
    assert gap.beside < gap.without


def test_refuses_to_state_a_gap_where_there_is_none() -> None:
    runs = record(SERVO, 4, count=8)
    gap = judge_gap(runs, fit_servo(runs, SERVO, ("torque_per_volt", "inertia", "coulomb_friction")))
    assert not gap.valid
    assert (gap.angle, gap.uncertainty) == (0.0, 0.0)
    assert "must fall by at least 10 %" in gap.reason


def test_names_what_is_only_told_together() -> None:
    """While the servo drives, back-EMF and viscous friction brake alike."""
    servo = replace(SERVO, weight_share=0.0)
    fit = fit_servo(record(servo, 5, dropped=False), servo, ("torque_per_volt", "back_emf", "viscous_friction"))
    assert "viscous_friction" in fit.untold
    assert "back_emf" in fit.untold["viscous_friction"]
    assert "torque_per_volt" not in fit.untold


def test_names_a_speed_limit_that_was_never_met() -> None:
    fit = fit_servo(
        record(SERVO, 6, goals=(slow,)), replace(SERVO, speed_limit=20.0), ("coulomb_friction", "speed_limit")
    )
    assert list(fit.untold) == ["speed_limit"]


def test_names_friction_that_is_not_there() -> None:
    servo = replace(SERVO, weight_share=0.0)
    fit = fit_servo(record(servo, 7), replace(servo, weight_share=0.1), ("coulomb_friction", "weight_share"))
    assert fit.untold.keys() == {"weight_share"} or fit.servo.weight_share < 3.0 * fit.uncertainty["weight_share"]


@pytest.mark.population
def test_finds_the_plant_of_the_package() -> None:
    """The other simulation, with two shafts, winding and teeth, stepped by its controller's period."""
    drive = replace(
        NOMINAL_DRIVE,
        motor=replace(NOMINAL_DRIVE.motor, inductance=2e-4),
        gear=replace(NOMINAL_DRIVE.gear, backlash_angle=2e-3),
        load=replace(NOMINAL_DRIVE.load, coulomb_friction=0.2, gravity_torque=0.4),
    )
    period, runs = 1e-3, []
    for k, goal_of in enumerate((lambda t: np.sin(3.0 * t**2), lambda t: np.sign(np.sin(4.0 * t)))):
        time = period * np.arange(1500)
        goal, plant, angle = goal_of(time), SimulatedDrive(drive, period), np.zeros(time.size)
        for sample in range(time.size - 1):
            duty = float(np.clip((1.0, 2.0)[k] * (goal[sample] - angle[sample]), -1.0, 1.0))
            plant.advance(duty * 12.0)
            angle[sample + 1] = plant.state[2]
        load = (drive.load.inertia, drive.load.gravity_torque)
        runs.append(
            ServoRun(time, angle, goal, np.ones_like(time), np.full_like(time, 12.0), (1.0, 2.0)[k], 1.0, *load)
        )
    motor, ratio = drive.motor, drive.gear.ratio
    truth = PositionServo(
        torque_per_volt=motor.torque_constant / motor.resistance / ratio,
        back_emf=motor.torque_constant / ratio,
        inertia=drive.reflected_inertia,
        viscous_friction=drive.effective_friction,
        coulomb_friction=0.2,
    )
    first = replace(truth, torque_per_volt=0.3, inertia=0.003, coulomb_friction=0.1, delay=2e-3)
    free = ("torque_per_volt", "inertia", "coulomb_friction", "delay")
    found = fit_servo(runs, first, free).servo
    assert np.mean(mean_errors(found, runs)) < 5e-3
    assert found.torque_per_volt == pytest.approx(truth.torque_per_volt, rel=0.03)
    assert found.inertia == pytest.approx(truth.inertia, rel=0.05)
    assert found.coulomb_friction == pytest.approx(truth.coulomb_friction, rel=0.15)


def test_one_run_is_enough_where_it_moves() -> None:
    fit = fit_servo(record(SERVO, 8, count=1), SERVO, ("torque_per_volt", "coulomb_friction"))
    assert fit.servo.torque_per_volt == pytest.approx(SERVO.torque_per_volt, rel=0.02)
    assert fit.errors.shape == (1,)


def test_one_bad_reading_does_not_matter() -> None:
    runs = record(SERVO, 9)
    spoilt = runs[4].angle.copy()
    spoilt[200] = -3.0
    free = ("torque_per_volt", "inertia", "coulomb_friction")
    clean = fit_servo(runs, SERVO, free)
    dirty = fit_servo([*runs[:4], replace(runs[4], angle=spoilt), *runs[5:]], SERVO, free)
    for name in free:
        assert getattr(dirty.servo, name) == pytest.approx(getattr(clean.servo, name), rel=0.01)


def test_errors_of_the_model_widen_the_uncertainty() -> None:
    """Without its delay the model is wrong for many samples on end: that is told from noise."""
    runs = record(SERVO, 10)
    free = ("torque_per_volt", "back_emf", "inertia", "coulomb_friction")
    right, wrong = fit_servo(runs, SERVO, free), fit_servo(runs, replace(SERVO, delay=0.01), free)
    for name in free:
        assert wrong.uncertainty[name] > 3.0 * right.uncertainty[name]


def run_of(**changes: Any) -> ServoRun:
    values: dict[str, Any] = {
        "time": TIME,
        "angle": 0.3 * np.sin(TIME),
        "goal": np.sin(2.0 * TIME),
        "enabled": ON,
        "supply": 12.0 * ON,
        "gain": 2.0,
        "largest_duty": 0.97,
        "load_inertia": 0.01,
        "weight_torque": 0.8,
    }
    return ServoRun(**{**values, **changes})


FRICTIONS = st.builds(
    replace,
    st.just(SERVO),
    coulomb_friction=st.floats(0.0, 0.5),
    stribeck_friction=st.floats(0.0, 0.3),
    motor_share=st.floats(0.0, 0.5),
    start_duty=st.floats(0.0, 0.05),
    backlash_angle=st.sampled_from([0.0, 0.01, 0.1]),
)


@settings(max_examples=25, deadline=None)
@given(FRICTIONS, st.integers(0, 100))
def test_a_mirrored_goal_mirrors_the_motion(servo: PositionServo, seed: int) -> None:
    run = run_of(goal=stepped(np.random.default_rng(seed)))
    mirrored = replace(run, goal=-run.goal, angle=-run.angle)
    (one,) = simulate(servo, [run])
    (other,) = simulate(replace(servo, gravity_offset=-servo.gravity_offset), [mirrored])
    assert np.allclose(one, -other, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(FRICTIONS, st.floats(-1.5, 1.5))
def test_a_load_let_go_never_swings_higher(servo: PositionServo, start: float) -> None:
    (angle,) = simulate(servo, [run_of(angle=np.full_like(TIME, start), enabled=0.0 * ON)])
    height = np.cos(angle + servo.gravity_offset)
    assert np.min(height) >= height[0] - 2e-3


@pytest.mark.parametrize("goal_of", [swept, stepped, slow])
def test_a_gap_of_next_to_nothing_is_rigid(goal_of: Callable[[np.random.Generator], np.ndarray]) -> None:
    run = run_of(goal=goal_of(np.random.default_rng(1)))
    (rigid,) = simulate(SERVO, [run])
    (tight,) = simulate(replace(SERVO, backlash_angle=1e-7), [run])
    assert np.allclose(rigid, tight, atol=1e-4)


def test_steps_between_samples_are_short_enough() -> None:
    run = run_of()
    fine = np.arange(0.0, TIME[-1] + 1e-9, 0.001)
    columns = {name: np.interp(fine, TIME, getattr(run, name)) for name in ("goal", "angle", "enabled", "supply")}
    (coarse,) = simulate(SERVO, [run])
    (exact,) = simulate(SERVO, [replace(run, time=fine, **columns)])
    assert np.allclose(coarse, exact[::10], atol=3e-3)


def test_friction_holds_what_stands_still() -> None:
    (angle,) = simulate(SERVO, [run_of(angle=np.full_like(TIME, 0.05), goal=np.full_like(TIME, 0.05))])
    assert np.ptp(angle) == 0.0


def test_only_the_first_angle_is_used() -> None:
    run = run_of()
    (one,), (other,) = (
        simulate(SERVO, [run]),
        simulate(SERVO, [replace(run, angle=np.r_[run.angle[0], 0.0 * TIME[1:]])]),
    )
    assert np.array_equal(one, other)


SPOILT = np.where(np.arange(TIME.size) == 7, np.nan, 0.1)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"angle": SPOILT}, r"run\.angle must be finite, rad, got nan at sample 7"),
        ({"supply": SPOILT}, r"run\.supply must be finite, V"),
        ({"angle": np.array([0.1])}, r"run\.angle must have >= 3 samples in one row, got shape \(1,\)"),
        ({"goal": np.zeros((4, 100))}, r"run\.goal must have >= 3 samples in one row"),
        ({"goal": np.zeros(5)}, r"run\.goal must have 400 samples as run\.time, got 5"),
        ({"time": TIME[::-1]}, r"run\.time must rise in equal steps, s"),
        ({"time": TIME**2}, r"run\.time must rise in equal steps, s"),
        ({"angle": np.degrees(np.sin(TIME))}, r"run\.angle must be within \+-25\.1 rad, got .*degrees"),
        ({"supply": 12000.0 * ON}, r"run\.supply must be 0 to 1000 V"),
        ({"gain": 0.0}, r"run\.gain must be > 0 1/rad, got 0\.0"),
        ({"gain": math.nan}, r"run\.gain must be > 0 1/rad, got nan"),
        ({"largest_duty": 97.0}, r"run\.largest_duty must be <= 1, got 97\.0"),
        ({"load_inertia": -1.0}, r"run\.load_inertia must be >= 0 kg m\^2, got -1\.0"),
    ],
)
def test_a_bad_recording_is_named(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        run_of(**changes)


@pytest.mark.parametrize(
    ("runs", "free", "said"),
    [
        ([], ("inertia",), "runs must have at least one recording"),
        ([run_of()], (), "free must name some of"),
        ([run_of()], ("inertia", "inertia"), "each once"),
        ([run_of()], ("mass",), "free must name some of"),
        ([run_of(angle=0.0 * TIME)], ("inertia",), r"must move by >= 0\.005 rad, the largest motion is 0 rad"),
        ([run_of(load_inertia=0.0)], ("backlash_angle",), r"run\.load_inertia must be > 0 kg m\^2 beyond a gap"),
    ],
)
def test_what_cannot_be_fitted_is_named(runs: list[ServoRun], free: tuple[str, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        fit_servo(runs, SERVO, free)


@pytest.mark.parametrize(
    ("runs", "free", "said"),
    [
        ([run_of()], "inertia", "runs must be >= 4 recordings to judge a gap, got 1"),
        ([run_of(load_inertia=0.0)] * 4, "inertia", r"run\.load_inertia must be > 0 kg m\^2 beyond a gap, got 0\.0"),
        ([run_of()] * 4, "backlash_angle", r"fit\.free must have a parameter other than the gap"),
    ],
)
def test_what_cannot_tell_a_gap_is_named(runs: list[ServoRun], free: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        judge_gap(runs, ServoFit(SERVO, (free,), {}, {}, np.zeros(1), 0.0))


@pytest.mark.parametrize("name", [name for name in PARAMETERS if name != "gravity_offset"])
def test_no_parameter_may_be_negative(name: str) -> None:
    with pytest.raises(ValueError, match=rf"servo\.{name} must be "):
        replace(SERVO, **{name: -1.0})
