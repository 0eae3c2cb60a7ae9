"""The closed loop offline: the simulated drive and the tick, with the same compiled functions as the nodes."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np

from backlash_ros.control import Limits, Servo, ServoSettings
from backlash_ros.control.law import law_state_at
from backlash_ros.control.laws import lacks_encoder, law_of
from backlash_ros.control.motion.setpoint import Source, extent, plan_rejection, positions_at
from backlash_ros.control.settings import encoders_in
from backlash_ros.control.tick import TICK_SIGNATURE, Inputs, Tick, inputs_at, tick_memory_at
from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.drivetrain.constants import PlantConstants, plant_constants
from backlash_ros.drivetrain.delay import (
    PLAYER_SIGNATURE,
    Delay,
    Line,
    Player,
    delay_constants,
    line_of,
    player_for,
)
from backlash_ros.drivetrain.motion.integrator import (
    DEFAULT_TOLERANCE,
    DONE,
    REASONS,
    integration_at,
    integration_memory,
)
from backlash_ros.drivetrain.sensors import SensorConstants, Sensors, sensor_constants, sensor_memory
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.record import Array, size_of
from backlash_ros.foundation.signals import LOAD_TORQUE, THETA_L, Measurement, PlantState, Setpoint, at_rest
from backlash_ros.simulation.response import Run
from backlash_ros.simulation.simulated_drive import take_sample

_types: Any = numba.types
_typeof: Any = numba.typeof

_INPUTS = size_of(Inputs)


@dataclass(frozen=True)
class Scenario:
    """The inputs of a run, sample by sample.

    Parameters
    ----------
    reference : rad, shape (N,): a reference at rest at each sample
    load_torque : N m, shape (N,), or () for a constant one
    initial_state : of the plant
    sensors, delay, seed : between plant and controller; the seed of their randomness
    source : planned from the first sample on, instead of the reference, whose length still sets the duration
    known_load_torque : feed the true load torque forward, instead of the observer's estimate
    substeps : plant samples recorded per controller sample
    """

    reference: Array
    load_torque: Array = field(default_factory=lambda: np.zeros(()))
    initial_state: PlantState = field(default_factory=at_rest)
    sensors: Sensors = field(default_factory=Sensors)
    delay: Delay = field(default_factory=Delay)
    seed: int = 0
    source: Source | None = None
    known_load_torque: bool = False
    substeps: int = 1


class Moving(NamedTuple):
    """The drive that moves, as its player takes it: `delay.Player`."""

    plant: PlantConstants
    state: PlantState
    step: Array
    line: Line
    command_limit: float
    tolerance: float


class Sensing(NamedTuple):
    """The sensors, what they remember, and what they measured last."""

    sensors: SensorConstants
    sensed: Array
    measured: Measurement


class Controlling(NamedTuple):
    """The controller, as `Tick` takes it."""

    constants: Array
    memory: Array
    law: Array
    law_state: Array
    segments: Array


class Given(NamedTuple):
    """The inputs of a run, sample by sample: see `Scenario`; no ``references`` where a plan is followed."""

    references: Array
    load_torque: Array
    known_load_torque: bool


def _loop(
    play: Player,
    tick: Tick,
    moving: Moving,
    sensing: Sensing,
    controlling: Controlling,
    given: Given,
    states: Array,
    signals: Array,
) -> tuple[int, float, int]:
    """Fill ``states`` and ``signals``: command, region, load torque estimate, peak force, measured load angle.

    The one loop body offline. Returns status, time reached (s) and the sample at which a fault was latched, or -1.
    """
    plant, state, step, line, command_limit, tolerance = moving
    sensors, sensed, measured = sensing
    constants, memory, law, law_state, segments = controlling
    references, load_torque, known_load_torque = given
    inputs_row = np.zeros(_INPUTS)
    inputs = inputs_at(inputs_row)
    inputs.known_load_torque = np.nan
    inputs.pace = 1.0
    fault_sample = -1
    substeps = (states.shape[0] - 1) // load_torque.shape[0]
    for k in range(load_torque.shape[0]):
        inputs.elapsed = take_sample(sensors, sensed, line, k, measured)
        signals[k, 4] = measured[THETA_L]
        if known_load_torque:
            inputs.known_load_torque = load_torque[k]
        if references.shape[0] > 0:
            segments[0, 0] = references[k]
        command = 0.0
        if fault_sample < 0:
            command = tick(constants, memory, law, law_state, segments, measured, inputs_row)
            if tick_memory_at(memory).results.fault != 0.0:
                fault_sample = k
        load_torque_estimate = tick_memory_at(memory).observer.estimate[LOAD_TORQUE]
        signals[k, 0], signals[k, 1], signals[k, 2] = command, law_state_at(law_state).region, load_torque_estimate
        integration_at(step).peak_force = 0.0
        rows = states[k * substeps + 1 : (k + 1) * substeps + 1]
        command = min(max(command, -command_limit), command_limit)
        status, passed = play(plant, state, step, line, command, load_torque[k], tolerance, rows)
        if status != 0:
            return status, k * line.delay.period + passed, fault_sample
        signals[k, 3] = integration_at(step).peak_force
    return 0, load_torque.shape[0] * line.delay.period, fault_sample


def _planned(source: Source, state: PlantState, limits: Limits) -> Array:
    """Return the plan of a source from the load's position; ValueError if it exceeds the limits."""
    start = Setpoint(np.array([state[THETA_L], 0.0, 0.0]))
    segments = np.ascontiguousarray(source.segments(start), dtype=np.float64)
    if reason := plan_rejection(segments, limits, float(start[0]), extent(segments)[2:]):
        raise ValueError(reason)
    return segments


@cache
def _compiled_loop() -> Callable[..., tuple[int, float, int]]:
    """Compile the loop once for every law and contact: tick and integrator are arguments."""
    number, flat, table = _types.float64, _types.float64[::1], _types.float64[:, ::1]
    line = _typeof(line_of(delay_constants(Delay(), 1.0), at_rest()))
    sensors = _typeof(sensor_constants(Sensors(), 1.0))

    def tuple_of(kind: type[Any], *members: Any) -> Any:
        return _types.BaseTuple.from_types(members, kind)

    signature = _types.Tuple((_types.int64, number, _types.int64))(
        _types.FunctionType(PLAYER_SIGNATURE),
        _types.FunctionType(TICK_SIGNATURE),
        tuple_of(Moving, PLAYER_SIGNATURE.args[0], flat, flat, line, number, number),
        tuple_of(Sensing, sensors, flat, flat),
        tuple_of(Controlling, *TICK_SIGNATURE.args[:5]),
        tuple_of(Given, flat, flat, _types.boolean),
        *(table, table),
    )
    return compiled_as(signature)(_loop)


def _law_checked(drive: Drive, model: Drive, settings: ServoSettings, scenario: Scenario) -> str:
    """Return the law's name; ValueError if the model takes another command, or the sensors lack an encoder."""
    if model.command_interface != drive.command_interface:
        raise ValueError(
            f"command_interface of the model must be the drive's, {drive.command_interface!r}, "
            f"got {model.command_interface!r}"
        )
    if lacks_encoder(settings):
        raise ValueError(f"law = {settings.law!r} needs both encoders, got measured = {scenario.sensors.measured}")
    return law_of(model, settings)


def _start_of(scenario: Scenario) -> PlantState:
    """Return the initial state, with the energies that have not begun; ValueError if it is not finite."""
    state = PlantState(np.zeros(7))
    state[: scenario.initial_state.size] = scenario.initial_state
    if not np.all(np.isfinite(state)):
        raise ValueError(f"initial_state must be finite, got {scenario.initial_state.tolist()}")
    return state


def _inputs_of(scenario: Scenario) -> Given:
    """Return the inputs sample by sample; ValueError if one is not finite."""

    def samples(name: str, values: Array) -> Array:
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{name} must be finite throughout")
        return np.array(np.broadcast_to(values, scenario.reference.shape), dtype=np.float64)

    references = samples("reference", scenario.reference)
    load_torque = samples("load_torque", scenario.load_torque)
    if scenario.source is not None:
        references = np.empty(0)
    return Given(references, load_torque, scenario.known_load_torque)


def run(
    drive: Drive,
    settings: ServoSettings,
    scenario: Scenario,
    tolerance: float = DEFAULT_TOLERANCE,
    model: Drive | None = None,
    limits: Limits | None = None,
    *,
    watched: bool = True,
) -> Run:
    """Run one closed loop: ``drive`` moves, ``model`` (the same by default) is the drive as the controller knows it.

    Parameters
    ----------
    limits : of the controller; by default those of the model
    watched : whether the monitor is on; otherwise its faults have no effect

    Raises
    ------
    ValueError
        If the law that ``settings`` names does not exist or cannot be designed, an input is not finite, the source
        is refused, or the model takes another command than the drive.
    IntegrationError
        If the plant cannot be integrated; names the time and the state.
    """
    count, substeps = scenario.reference.size, scenario.substeps
    model, settings = model or drive, replace(settings, encoders=encoders_in(scenario.sensors.measured))
    law = _law_checked(drive, model, settings, scenario)
    servo, state = Servo(model, settings, limits, watched=watched), _start_of(scenario)
    states, signals = np.empty((count * substeps + 1, 5)), np.zeros((count, 5))
    states[0] = state[:5]
    segments = servo.segments if scenario.source is None else _planned(scenario.source, state, servo.limits)
    inputs = _inputs_of(scenario)
    line = line_of(delay_constants(scenario.delay, settings.period, scenario.seed), state)
    sensors = sensor_constants(scenario.sensors, drive.motor.torque_constant, scenario.seed)
    limit = float(drive.command_limit)
    status, reached, fault_sample = _compiled_loop()(
        player_for(drive),
        servo.tick,
        Moving(plant_constants(drive), state, integration_memory(), line, limit, float(tolerance)),
        Sensing(sensors, sensor_memory(), Measurement(np.empty(5))),
        Controlling(servo.constants, servo.memory.row, *servo.law_arrays, segments),
        inputs,
        states,
        signals,
    )
    if status != DONE:
        raise IntegrationError(REASONS[status], reached, state)
    time = np.arange(count * substeps + 1, dtype=np.float64) * (settings.period / substeps)
    setpoint = inputs.references if scenario.source is None else positions_at(segments, time[:-1:substeps])
    command, region, torque, force, measured = np.ascontiguousarray(signals.T)
    return Run(
        *(drive, law, time, states, setpoint, command, region, torque, force, measured),
        fault=servo.described_fault,
        fault_sample=fault_sample,
    )
