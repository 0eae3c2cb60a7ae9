"""What the paper claims, computed: every run and every number behind the figures and the page."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from backlash_ros.control import LAWS, GainSet, ServoSettings, find_limit_cycle
from backlash_ros.control.design.describing_function import predict_limit_cycle
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import OMEGA_L, THETA_L
from backlash_ros.simulation import Run, Scenario, learn_backlash, run
from backlash_ros.simulation.open_loop import OpenLoop, drive_with_torque
from backlash_ros.studies.metrics import settling_time, step_response

Number = float | int | bool | str | None

PERIOD = 0.001
"""Sample period of every loop here, s: the paper's loops are continuous."""
SECONDS = 6.0
NOISY = Sensors(load_noise=0.01)
"""Noise on the measured load angle, uniform within ±0.01 rad: 1 % of the step."""
ENCODERS = Sensors(measured=(*POSITIONS, "current"), motor_counts=2.0**12, load_counts=2.0**12)
"""12-bit encoders on both shafts; speeds are their differences."""
SEED = 2009
"""Of the noise."""


@cache
def gains() -> GainSet:
    """Return the gains of the paper's weights for the nominal drive."""
    return GainSet.of(NOMINAL_DRIVE)


@dataclass(frozen=True)
class Case:
    """One condition: the drive that moves, the load torque (N m), the sensors.

    The controller knows the nominal drive and the backlash of the simulated one.
    """

    drive: Drive = NOMINAL_DRIVE
    load_torque: float = 0.0
    sensors: Sensors = field(default_factory=Sensors)


def inertia(factor: float) -> Drive:
    """Return the nominal drive with another load inertia."""
    return replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, inertia=NOMINAL_DRIVE.load.inertia * factor))


def friction(factor: float) -> Drive:
    """Return the nominal drive with another viscous friction of the load."""
    viscous = NOMINAL_DRIVE.load.viscous_friction * factor
    return replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, viscous_friction=viscous))


def backlash(factor: float, **gear: Any) -> Drive:
    """Return the nominal drive with another backlash, and other changes to its gear."""
    angle = NOMINAL_DRIVE.gear.backlash_angle * factor
    return replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, backlash_angle=angle, **gear))


CASES: dict[str, Case] = {
    "nominal": Case(),
    "load inertia x4": Case(inertia(4)),
    "viscous friction x0.5": Case(friction(0.5)),
    "backlash x5": Case(backlash(5)),
    "load torque 0.1 N m": Case(load_torque=0.1),
    "load torque 0.5 N m": Case(load_torque=0.5),
    "1 % noise": Case(sensors=NOISY),
    "12-bit encoders": Case(sensors=ENCODERS),
}
VARIATIONS: dict[str, dict[str, Case]] = {
    "moment of inertia": {f"load inertia x{k:g}": Case(inertia(k)) for k in (0.5, 1, 2)},
    "viscous friction": {f"load friction x{k:g}": Case(friction(k)) for k in (0.5, 1, 2)},
    "backlash": {f"backlash x{k:g}": Case(backlash(k)) for k in (1, 2, 5)},
    "load torque": {f"{k:g} N m": Case(load_torque=k) for k in (0.1, 0.3, 0.5)},
    "where it fails": {"load inertia x4": Case(inertia(4))},
}
SWEEP = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Backlash, relative to the nominal one."""
FRICTION_TRIED = 0.2
"""Largest Coulomb friction that is tried, N m."""
INERTIA_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0, 10.0, 25.0)
"""Reflected motor inertia over load inertia."""


def respond(law: str, case: Case, seconds: float = SECONDS) -> Run:
    """Run a step of 1 rad with a law."""
    count = round(seconds / PERIOD)
    scenario = Scenario(np.ones(count), np.array(case.load_torque), sensors=case.sensors, seed=SEED)
    gap = case.drive.gear.backlash_angle
    told = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, backlash_angle=gap))
    settings = ServoSettings(gains(), law=law, backlash_angle=gap, period=PERIOD, identified=case.drive == told)
    return run(case.drive, settings, scenario, model=NOMINAL_DRIVE)


def judge(result: Run, case: Case) -> dict[str, float]:
    """Return the table's row for one run."""
    gear = case.drive.gear
    judged = step_response(
        result.time,
        result.load_angle,
        result.gap,
        target=1.0,
        backlash=gear.backlash,
        backlash_angle=gear.backlash_angle,
    )
    return {
        "rise_time_s": judged.rise_time,
        "settling_time_s": settling_time(result.time, result.load_angle, 1.0, 0.5 * gear.backlash_angle),
        "overshoot_b": judged.overshoot,
        "residual_b": judged.residual,
        "impacts_after_switch": judged.impacts,
        "peak_force_N": float(np.max(result.peak_force)),
        "control_energy_V2s": float(np.sum(result.command**2) * PERIOD),
    }


def cycle_of(drive: Drive, seconds: float = 4.0) -> dict[str, Number]:
    """Return the limit cycle of the fast gains, without observer: amplitude over b, gap travel over d, period, s."""
    settings = ServoSettings(gains(), law="fast", period=PERIOD)
    scenario = Scenario(np.ones(round(seconds / PERIOD)), known_load_torque=True, substeps=4)
    result = run(drive, settings, scenario, model=NOMINAL_DRIVE)
    tail = slice(result.time.size // 2, None)
    travel = float(np.ptp(result.gap[tail])) / drive.gear.backlash
    cycle = find_limit_cycle(result.state[tail, THETA_L], result.state[tail, OMEGA_L], PERIOD / 4)
    alive = cycle is not None and cycle.amplitude > 0.05 * drive.gear.backlash_angle
    if cycle is None or not alive:
        return {"amplitude_b": 0.0, "gap_travel_d": travel, "period_s": None}
    return {
        "amplitude_b": cycle.amplitude / drive.gear.backlash_angle,
        "gap_travel_d": travel,
        "period_s": cycle.period,
    }


def sweep_backlash() -> list[dict[str, Number]]:
    """Return the limit cycle, its prediction by harmonic balance and what the learner finds, over the backlash."""
    rows = []
    for factor in SWEEP:
        drive = backlash(factor)
        b = drive.gear.backlash_angle
        settings = ServoSettings(gains(), period=PERIOD).with_experiment("limit_cycle")
        both = learn_backlash(drive, settings)
        load = learn_backlash(drive, settings, sensors=Sensors(measured=("theta_l", "omega_l")))
        row: dict[str, Number] = {"backlash_m": drive.gear.backlash, "backlash_angle_rad": b, **cycle_of(drive)}
        row |= {
            "learned_both_encoders_b": both.angle / b,
            "learned_load_encoder_b": load.angle / b,
            "load_amplitude_when_learning_b": load.amplitude / b,
        }
        rows.append(row | prediction(drive))
    return rows


def prediction(drive: Drive) -> dict[str, Number]:
    """Return what harmonic balance predicts for the fast gains."""
    predicted = predict_limit_cycle(drive, gains().fast, PERIOD)
    if predicted is None:
        return {"predicted_amplitude_b": None, "predicted_period_s": None}
    return {
        "predicted_amplitude_b": predicted.amplitude / drive.gear.backlash_angle,
        "predicted_period_s": predicted.period,
    }


def sweep_damping() -> list[dict[str, Number]]:
    """Return limit cycle and prediction for elastic teeth, from little to much damping: the gap's shape decides."""
    rows: list[dict[str, Number]] = []
    for damping in (0.2, 2.0, 10.0, 50.0):
        drive = backlash(1.0, contact=ElasticContact(damping=damping))
        rows.append({"tooth_damping": damping, **cycle_of(drive), **prediction(drive)})
    return rows


def sweep_contact_laws() -> dict[str, dict[str, Number]]:
    """Return the limit cycle with each contact law."""
    return {law: cycle_of(backlash(1.0, contact=kind())) for law, kind in CONTACTS.items()}


def sweep_inertia() -> list[dict[str, Number]]:
    """Return the load's amplitude against its share of the gap by momentum exchange."""
    rows: list[dict[str, Number]] = []
    for ratio in INERTIA_RATIOS:
        load = replace(NOMINAL_DRIVE.load, inertia=NOMINAL_DRIVE.reflected_inertia / ratio)
        drive = replace(NOMINAL_DRIVE, load=load)
        rows.append({"inertia_ratio": ratio, "share": drive.motor_share, **cycle_of(drive, 8.0)})
    return rows


def friction_boundary() -> list[dict[str, float]]:
    """Return the least Coulomb friction on the load that ends the cycle, N m, over the backlash (bisection)."""
    rows = []
    for factor in SWEEP:
        low, high = 0.0, FRICTION_TRIED
        for _ in range(7):
            middle = 0.5 * (low + high)
            drive = backlash(factor)
            drive = replace(drive, load=replace(drive.load, coulomb_friction=middle))
            amplitude = cycle_of(drive, 3.0)["amplitude_b"]
            low, high = (middle, high) if amplitude else (low, middle)
        rows.append({"backlash_m": backlash(factor).gear.backlash, "coulomb_friction_Nm": high})
    return rows


def open_loop() -> OpenLoop:
    """Return fig 7: sinusoidal motor torque of 20 mN m at 2 Hz, constant load torque of -50 mN m."""
    time = np.arange(0.0, 1.5, 2e-5)
    return drive_with_torque(NOMINAL_DRIVE, 0.02 * np.sin(2 * math.pi * 2.0 * time), -0.05, 2e-5)


def judge_open_loop(result: OpenLoop) -> dict[str, float]:
    """Return how much of the time the teeth touch, and how fast they move relative to each other while they do."""
    half = 0.5 * NOMINAL_DRIVE.gear.backlash
    late = result.time > 0.25
    touching = np.abs(result.gap) >= 0.8 * half
    resting = late & touching
    return {
        "largest_gap_over_half_d": float(np.max(np.abs(result.gap[late]))) / half,
        "share_of_time_touching": float(np.mean(touching[late])),
        "median_relative_speed_touching": float(np.median(np.abs(result.gap_rate[resting]))),
        "largest_relative_speed": float(np.max(np.abs(result.gap_rate[late]))),
        "largest_force_N": float(np.max(np.abs(result.force[late]))),
        "median_force_touching_N": float(np.median(np.abs(result.force[resting]))),
    }


@dataclass(frozen=True)
class Reproduction:
    """All that the figures draw, and ``numbers``, all that the page says."""

    open_loop: OpenLoop
    steps: dict[str, Run]
    noisy: Run
    variations: dict[str, dict[str, Run]]
    numbers: dict[str, Any]


PARTS = 8
"""How often `reproduce` reports its progress."""


def reproduce(progress: Callable[[str], None]) -> Reproduction:
    """Compute everything; ``progress`` is told what has been done, `PARTS` times."""
    pushed = open_loop()
    progress("open loop")
    runs = {law: {name: respond(law, case) for name, case in CASES.items()} for law in sorted(LAWS)}
    table = {law: {name: judge(result, CASES[name]) for name, result in row.items()} for law, row in runs.items()}
    progress("laws and conditions")
    variations = {
        title: {name: respond("two_region", case) for name, case in cases.items()}
        for title, cases in VARIATIONS.items()
    }
    varied = {
        title: {name: judge(result, VARIATIONS[title][name]) for name, result in row.items()}
        for title, row in variations.items()
    }
    progress("robustness")
    numbers: dict[str, Any] = {"table": table, "variations": varied, "open_loop": judge_open_loop(pushed)}
    for name, compute in _SWEEPS.items():
        numbers[name] = compute()
        progress(name.replace("_", " "))
    steps = {law: runs[law]["nominal"] for law in runs}
    return Reproduction(pushed, steps, runs["two_region"]["1 % noise"], variations, numbers)


_SWEEPS: Mapping[str, Callable[[], Any]] = {
    "backlash_sweep": sweep_backlash,
    "damping_sweep": sweep_damping,
    "contact_laws": sweep_contact_laws,
    "inertia_sweep": sweep_inertia,
    "friction_boundary": friction_boundary,
}
