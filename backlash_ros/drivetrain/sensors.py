"""What a drive's sensors show of its state: which signals there are, counts, zero, errors of a turn, noise, speeds.

Offline runs, experiments and the simulator share it. Every random number is a function of seed, sample and signal
alone, so that a run does not depend on what ran before it or beside it.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import (
    CURRENT,
    OMEGA_L,
    OMEGA_M,
    STATE_NAMES,
    THETA_L,
    THETA_M,
    Measurement,
    PlantState,
)

POSITIONS = ("theta_m", "theta_l")
"""What most drives measure."""

_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Sensors(Validated):
    """The sensors of a drive; by default all signals, exactly.

    ``measured`` names the signals that there are, of `signals.STATE_NAMES`, one angle at least.
    ``speeds_from_positions``: the drive finds its speeds from its counted positions, over one sample.
    """

    section: ClassVar[str] = "sensors"

    measured: tuple[str, ...] = STATE_NAMES
    speeds_from_positions: bool = False
    motor_counts: float = quantity("counts per turn of the motor's encoder; 0: exact", "", at_most=2.0**40, default=0.0)
    load_counts: float = quantity("counts per turn of the load's encoder; 0: exact", "", at_most=2.0**40, default=0.0)
    motor_offset: float = quantity(
        "reading of the motor's encoder at theta_m = 0", "rad", at_least=-1e6, at_most=1e6, default=0.0
    )
    load_offset: float = quantity(
        "reading of the load's encoder at theta_l = 0", "rad", at_least=-1e6, at_most=1e6, default=0.0
    )
    motor_eccentricity: float = quantity(
        "amplitude of the motor encoder's once-per-turn error", "rad", at_most=1.0, default=0.0
    )
    load_eccentricity: float = quantity(
        "amplitude of the load encoder's once-per-turn error", "rad", at_most=1.0, default=0.0
    )
    load_ellipticity: float = quantity(
        "amplitude of the load encoder's twice-per-turn error", "rad", at_most=1.0, default=0.0
    )
    eccentricity_phase: float = quantity(
        "phase of the once-per-turn and twice-per-turn errors at theta = 0",
        "rad",
        at_least=-_TURN,
        at_most=_TURN,
        default=0.0,
    )
    motor_noise: float = quantity(
        "noise on the motor's angle, uniform within +- this value", "rad", at_most=1e3, default=0.0
    )
    load_noise: float = quantity(
        "noise on the load's angle, uniform within +- this value", "rad", at_most=1e3, default=0.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = [name for name in self.measured if name not in STATE_NAMES]
        if unknown or not set(self.measured) & set(POSITIONS):
            raise ValueError(
                f"sensors.measured must be of {list(STATE_NAMES)}, with theta_m or theta_l, got {list(self.measured)}"
            )

    def load_zero(self, theta_l: Array) -> Array:
        """Return what a perfect encoder with the same zero and eccentricity would read at load angles, rad."""
        phase = theta_l + self.eccentricity_phase
        once = theta_l + self.load_offset + self.load_eccentricity * np.sin(phase)
        return np.asarray(once + self.load_ellipticity * np.sin(theta_l + phase) if self.load_ellipticity else once)


class SensorConstants(NamedTuple):
    """The sensors as the compiled step reads them; ``missing_*`` is nan where there is no signal, else 0."""

    missing_theta_m: float
    missing_omega_m: float
    missing_theta_l: float
    missing_omega_l: float
    missing_current: float
    speeds_from_positions: bool
    motor_count: float
    load_count: float
    motor_offset: float
    load_offset: float
    motor_eccentricity: float
    load_eccentricity: float
    load_ellipticity: float
    eccentricity_phase: float
    motor_noise: float
    load_noise: float
    torque_constant: float
    seed: int


def sensor_constants(sensors: Sensors, torque_constant: float, seed: int = 0) -> SensorConstants:
    """Return the sensors of a motor with a torque constant (N m/A) for the compiled step, with their noise's seed."""

    def count(per_turn: float) -> float:
        return _TURN / per_turn if per_turn else 0.0

    missing = {name: 0.0 if name in sensors.measured else math.nan for name in STATE_NAMES}
    return SensorConstants(
        missing_theta_m=missing["theta_m"],
        missing_omega_m=missing["omega_m"],
        missing_theta_l=missing["theta_l"],
        missing_omega_l=missing["omega_l"],
        missing_current=missing["current"],
        speeds_from_positions=sensors.speeds_from_positions,
        motor_count=count(sensors.motor_counts),
        load_count=count(sensors.load_counts),
        motor_offset=float(sensors.motor_offset),
        load_offset=float(sensors.load_offset),
        motor_eccentricity=float(sensors.motor_eccentricity),
        load_eccentricity=float(sensors.load_eccentricity),
        load_ellipticity=float(sensors.load_ellipticity),
        eccentricity_phase=float(sensors.eccentricity_phase),
        motor_noise=float(sensors.motor_noise),
        load_noise=float(sensors.load_noise),
        torque_constant=float(torque_constant),
        seed=int(seed),
    )


@compiled
def uniform(seed: int, sample: int, stream: int) -> float:
    """Return a random number, even within [-1, 1), that depends on its three arguments alone (splitmix64)."""
    x = np.uint64(seed) * np.uint64(0xD1342543DE82EF95) + np.uint64(sample) * np.uint64(0x9E3779B97F4A7C15)
    x = x + np.uint64(stream) * np.uint64(0xBF58476D1CE4E5B9)
    for _ in range(2):
        x = x + np.uint64(0x9E3779B97F4A7C15)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        x = x ^ (x >> np.uint64(31))
    return float(x >> np.uint64(11)) * 2.0**-52 - 1.0


@compiled
def _read(angle: float, offset: float, eccentricity: float, phase: float, noise: float, count: float) -> float:
    shown = angle + offset + eccentricity * math.sin(angle + phase) + noise
    return float(np.round(shown / count) * count) if count > 0.0 else shown


NOISE_STREAMS = 2
"""Streams of random numbers that the sensors take, from 0 on."""


def sensor_memory() -> Array:
    """Return sensors that have shown nothing: the last two angles, and whether there are any."""
    return np.zeros(3)


@compiled
def read_sensors(
    sensors: SensorConstants, memory: Array, state: PlantState, sample: int, elapsed: float, out: Measurement
) -> None:
    """Write into ``out`` what the sensors show of ``state`` as their sample number ``sample``.

    Parameters
    ----------
    memory : from `sensor_memory`, updated in place
    elapsed : since the sample before was taken, s
    """
    noise_m = sensors.motor_noise * uniform(sensors.seed, sample, 0) if sensors.motor_noise > 0.0 else 0.0
    noise_l = sensors.load_noise * uniform(sensors.seed, sample, 1) if sensors.load_noise > 0.0 else 0.0
    phase = sensors.eccentricity_phase
    if sensors.load_ellipticity > 0.0:
        noise_l += sensors.load_ellipticity * math.sin(2.0 * state[THETA_L] + phase)
    motor = _read(state[THETA_M], sensors.motor_offset, sensors.motor_eccentricity, phase, noise_m, sensors.motor_count)
    load = _read(state[THETA_L], sensors.load_offset, sensors.load_eccentricity, phase, noise_l, sensors.load_count)
    speed_m, speed_l = state[OMEGA_M], state[OMEGA_L]
    if sensors.speeds_from_positions:
        known = memory[2] > 0.0 and elapsed > 0.0
        speed_m = (motor - memory[0]) / elapsed if known else 0.0
        speed_l = (load - memory[1]) / elapsed if known else 0.0
    memory[0], memory[1], memory[2] = motor, load, 1.0
    out[THETA_M] = motor + sensors.missing_theta_m
    out[OMEGA_M] = speed_m + sensors.missing_omega_m
    out[THETA_L] = load + sensors.missing_theta_l
    out[OMEGA_L] = speed_l + sensors.missing_omega_l
    # As it comes of an effort in N m, to the last bit: a limit cycle makes much of little.
    out[CURRENT] = sensors.torque_constant * state[CURRENT] / sensors.torque_constant + sensors.missing_current
