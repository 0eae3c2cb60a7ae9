"""The closed loop offline: plant, observer and law, the compiled functions that the nodes run."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from backlash_ros.control import ServoSettings, design_law
from backlash_ros.control.command import CommandConstants, command_constants, command_of, voltage_range
from backlash_ros.control.law import LAW_SIGNATURE, REGION, LawStep
from backlash_ros.control.observer import LOAD_TORQUE, ObserverConstants, observer_memory, observer_step
from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.drivetrain.compiled import compiled_as
from backlash_ros.drivetrain.constants import PlantConstants, plant_constants
from backlash_ros.drivetrain.integrator import (
    ADVANCE_SIGNATURE,
    DEFAULT_TOLERANCE,
    DONE,
    PEAK_FORCE,
    REASONS,
    Advance,
    integrator_for,
)
from backlash_ros.drivetrain.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M, PlantState

Array = NDArray[np.float64]

_numba: Any = numba
_types: Any = numba.types


@dataclass(frozen=True)
class Scenario:
    """What happens to the loop, sample by sample.

    Parameters
    ----------
    reference : rad, shape (N,)
    load_torque : N m, shape (N,), or () for one that holds throughout
    initial_state : shape (5,), as `dynamics.STATE_NAMES`
    measured : which of theta_m, omega_m, i, theta_l, omega_l the drive measures
    angle_noise : added to the measured load angle, rad, shape (N,) or ()
    encoder_bits : resolution of both encoders, counts per turn as a power of two; None for exact angles
    known_load_torque : feed the true load torque forward in place of the observer's estimate
    substeps : plant samples recorded per controller sample
    """

    reference: Array
    load_torque: Array = field(default_factory=lambda: np.zeros(()))
    initial_state: Array = field(default_factory=lambda: np.zeros(5))
    measured: Sequence[bool] = (True, True, True, True, True)
    angle_noise: Array = field(default_factory=lambda: np.zeros(()))
    encoder_bits: int | None = None
    known_load_torque: bool = False
    substeps: int = 1


@dataclass(frozen=True)
class Run:
    """A closed-loop run: ``substeps`` plant samples per controller sample, from t = 0 on.

    ``state`` (N * substeps + 1, 5) at ``time``; ``command`` (V or A), ``region`` and ``load_torque_estimate`` (N,) per
    controller sample; ``peak_force`` (N,), the largest contact force within each controller period, N.
    """

    time: Array
    state: Array
    command: Array
    region: Array
    load_torque_estimate: Array
    peak_force: Array

    @property
    def load_angle(self) -> Array:
        """theta_l at ``time``, rad."""
        return self.state[:, THETA_L]

    def gap(self, drive: Drive) -> Array:
        """R1 theta_m - R2 theta_l at ``time``, m."""
        return drive.gear.motor_radius * self.state[:, THETA_M] - drive.gear.load_radius * self.state[:, THETA_L]


def _loop(
    plant: PlantConstants,
    advance: Advance,
    law_step: LawStep,
    constants: Array,
    memory: Array,
    observer: ObserverConstants,
    output: CommandConstants,
    reference: Array,
    load_torque: Array,
    angle_noise: Array,
    resolution: float,
    missing: Array,
    known_load_torque: bool,
    substeps: int,
    tolerance: float,
    states: Array,
    signals: Array,
    estimate: Array,
) -> tuple[int, float, int]:
    """Fill ``states`` after its first and ``signals``: command, region, load torque estimate, peak force."""
    state: PlantState = np.zeros(7)  # type: ignore[assignment]
    state[:5] = states[0]
    step = np.zeros(2)
    measured, seen = np.empty(5), np.empty(6)
    command = 0.0
    part = observer.period / substeps
    for k in range(reference.shape[0]):
        measured[0], measured[1], measured[2] = state[THETA_M], state[OMEGA_M], state[CURRENT]
        measured[3], measured[4] = state[THETA_L] + angle_noise[k], state[OMEGA_L]
        if resolution > 0.0:
            measured[0] = np.round(measured[0] / resolution) * resolution
            measured[3] = np.round(measured[3] / resolution) * resolution
        for j in range(5):
            measured[j] += missing[j]
        observer_step(observer, estimate, measured, command)
        seen[:] = estimate[:6]
        if known_load_torque:
            seen[LOAD_TORQUE] = load_torque[k]
        low, high = voltage_range(output, seen)
        voltage = law_step(constants, memory, seen, reference[k], low, high)
        command = command_of(output, seen, voltage)
        signals[k, 0], signals[k, 1], signals[k, 2] = command, memory[REGION], estimate[LOAD_TORQUE]
        step[PEAK_FORCE] = 0.0
        for j in range(substeps):
            status, passed = advance(plant, state, step, command, load_torque[k], part, tolerance)
            states[k * substeps + j + 1] = state[:5]
            if status != DONE:
                return status, k * observer.period + j * part + passed, k * substeps + j + 1
        signals[k, 3] = step[PEAK_FORCE]
    return DONE, reference.shape[0] * observer.period, states.shape[0] - 1


def encoder_step(bits: int | None) -> float:
    """Return the smallest angle that an encoder of 2**bits counts per turn tells apart, rad; 0 for exact angles."""
    return 2 * np.pi / 2**bits if bits else 0.0


@functools.cache
def _compiled_loop(plant_type: Any, observer_type: Any, output_type: Any) -> Callable[..., tuple[int, float, int]]:
    """Compile the loop once for every law: a law's step is an argument, so that a new law needs no new loop."""
    integer, number, boolean = _types.int64, _types.float64, _types.boolean
    flat, table = number[::1], number[:, ::1]
    signature = _types.Tuple((integer, number, integer))(
        *(
            plant_type,
            _types.FunctionType(ADVANCE_SIGNATURE),
            _types.FunctionType(LAW_SIGNATURE),
            flat,
            flat,
            observer_type,
            output_type,
        ),
        *(flat, flat, flat, number, flat, boolean, integer, number, table, table, flat),
    )
    return compiled_as(signature)(_loop)


def run(
    drive: Drive,
    settings: ServoSettings,
    scenario: Scenario,
    tolerance: float = DEFAULT_TOLERANCE,
    model: Drive | None = None,
) -> Run:
    """Run one closed loop: ``drive`` is what moves, ``model`` (the same by default) what the controller takes it for.

    Raises
    ------
    ValueError
        If the law that ``settings`` names does not exist or cannot be designed, an input is not finite, or the model
        takes another command than the drive.
    IntegrationError
        If the plant cannot be integrated; names the time and the state.
    """
    count, substeps = scenario.reference.size, scenario.substeps
    model = model or drive
    if model.command_interface != drive.command_interface:
        raise ValueError(
            f"command_interface of the model must be the drive's, {drive.command_interface!r}, "
            f"got {model.command_interface!r}"
        )
    law = design_law(model, settings)
    states = np.empty((count * substeps + 1, 5))
    states[0] = scenario.initial_state
    signals = np.zeros((count, 4))

    def samples(name: str, values: Array) -> Array:
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{name} must be finite throughout")
        return np.array(np.broadcast_to(values, (count,)), dtype=np.float64)

    plant, observer, output = (
        plant_constants(drive),
        settings.observer(model),
        command_constants(model),
    )
    status, reached, row = _compiled_loop(*(_numba.typeof(each) for each in (plant, observer, output)))(
        plant,
        integrator_for(drive),
        law.step,
        law.constants,
        law.memory.copy(),
        observer,
        output,
        samples("reference", scenario.reference),
        samples("load_torque", scenario.load_torque),
        samples("angle_noise", scenario.angle_noise),
        encoder_step(scenario.encoder_bits),
        np.where(scenario.measured, 0.0, np.nan),
        scenario.known_load_torque,
        substeps,
        tolerance,
        states,
        signals,
        observer_memory(),
    )
    if status != DONE:
        raise IntegrationError(REASONS[status], reached, states[row])
    time = np.arange(count * substeps + 1, dtype=np.float64) * (settings.period / substeps)
    return Run(time, states, *np.ascontiguousarray(signals.T))
