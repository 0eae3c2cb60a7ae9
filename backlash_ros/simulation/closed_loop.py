"""The closed loop offline: plant, observer and law, the compiled functions that the nodes run."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from backlash_ros.control import ServoSettings
from backlash_ros.control.law import LawConstants, law_memory, law_step
from backlash_ros.control.observer import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    THETA_L,
    ObserverConstants,
    observer_memory,
    observer_step,
)
from backlash_ros.drivetrain import Drive, IntegrationError, compiled
from backlash_ros.drivetrain.dynamics import State
from backlash_ros.drivetrain.integrator import DEFAULT_TOLERANCE, DONE, advance
from backlash_ros.drivetrain.parameters import PlantConstants

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scenario:
    """What happens to the loop: reference (rad) and load torque (N m) of each sample.

    Parameters
    ----------
    reference, load_torque : arrays, shape (N,); a load torque of shape () holds throughout
    measured : which of theta_m, omega_m, i, theta_l, omega_l the drive measures
    known_load_torque : feed the true load torque forward in place of the observer's estimate
    substeps : plant samples recorded per controller sample
    """

    reference: Array
    load_torque: Array = field(default_factory=lambda: np.zeros(()))
    initial_state: State = field(default_factory=lambda: np.zeros(5))
    measured: Sequence[bool] = (True, True, True, True, True)
    known_load_torque: bool = False
    substeps: int = 1


@dataclass(frozen=True)
class Run:
    """A closed-loop run: ``substeps`` plant samples per controller sample, from t = 0 on.

    ``state`` (N * substeps + 1, 5) at ``time``; ``voltage``, ``region`` and ``load_torque_estimate`` (N,) per
    controller sample.
    """

    time: Array
    state: Array
    voltage: Array
    region: Array
    load_torque_estimate: Array

    @property
    def load_angle(self) -> Array:
        """theta_l at ``time``, rad."""
        return self.state[:, 2]

    def gap(self, drive: Drive) -> Array:
        """R1 theta_m - R2 theta_l at ``time``, m."""
        return drive.gear.motor_radius * self.state[:, 0] - drive.gear.load_radius * self.state[:, 2]


@compiled
def _run(
    plant: PlantConstants,
    law: LawConstants,
    observer: ObserverConstants,
    reference: Array,
    load_torque: Array,
    measures: Array,
    known_load_torque: bool,
    substeps: int,
    tolerance: float,
    states: Array,
    signals: Array,
    region_memory: Array,
    estimate: Array,
) -> tuple[int, float]:
    """Fill ``states`` and ``signals`` (voltage, region, load torque estimate); states[0] is the start."""
    state = states[0].copy()
    step = np.zeros(1)
    measured = np.empty(5)
    voltage = 0.0
    part = observer.period / substeps
    for k in range(reference.shape[0]):
        for j in range(5):
            measured[j] = np.nan
        if measures[0] > 0:
            measured[0] = state[0]
        if measures[1] > 0:
            measured[1] = state[1]
        if measures[2] > 0:
            measured[2] = state[4]
        if measures[3] > 0:
            measured[3] = state[2]
        if measures[4] > 0:
            measured[4] = state[3]
        observer_step(observer, estimate, measured, voltage)
        torque = load_torque[k] if known_load_torque else estimate[LOAD_TORQUE]
        voltage = law_step(
            law, region_memory, estimate[THETA_L], estimate[OMEGA_L], estimate[CURRENT], reference[k], torque
        )
        signals[k, 0], signals[k, 1], signals[k, 2] = voltage, region_memory[0], estimate[LOAD_TORQUE]
        for j in range(substeps):
            status, passed = advance(plant, state, step, voltage, load_torque[k], part, tolerance)
            states[k * substeps + j + 1] = state
            if status != DONE:
                return status, k * observer.period + j * part + passed
    return DONE, reference.shape[0] * observer.period


def run(drive: Drive, settings: ServoSettings, scenario: Scenario, tolerance: float = DEFAULT_TOLERANCE) -> Run:
    """Run one closed loop.

    Raises
    ------
    IntegrationError
        If the plant cannot be integrated; names the time and the state.
    """
    count, substeps = scenario.reference.size, scenario.substeps
    states = np.empty((count * substeps + 1, 5))
    states[0] = scenario.initial_state
    signals = np.empty((count, 3))
    status, reached = _run(
        drive.constants(),
        settings.law(drive),
        settings.observer(drive),
        np.ascontiguousarray(scenario.reference, dtype=float),
        np.ascontiguousarray(np.broadcast_to(scenario.load_torque, (count,)), dtype=float),
        np.array(scenario.measured, dtype=float),
        scenario.known_load_torque,
        substeps,
        tolerance,
        states,
        signals,
        law_memory(),
        observer_memory(),
    )
    time = np.arange(count * substeps + 1, dtype=np.float64) * (settings.period / substeps)
    if status != DONE:
        raise IntegrationError("the plant could not be integrated", reached, states[round(reached / settings.period)])
    return Run(time, states, signals[:, 0], signals[:, 1], signals[:, 2])
