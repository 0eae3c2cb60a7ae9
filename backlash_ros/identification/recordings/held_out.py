"""How well an identified drive explains data that it was not fitted to, compared with the drive as given."""

import math
from dataclasses import dataclass

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.candidates import Candidate, told_teeth
from backlash_ros.identification.fitting.fit import Fit
from backlash_ros.identification.fitting.memory import motion_of, trace_at
from backlash_ros.identification.fitting.parameters import parameters_at, parameters_of
from backlash_ros.identification.fitting.problem import Beliefs, Problem, motor_side
from backlash_ros.identification.recording import Recording

SHARE = 0.75
"""Share of the recording's time that a fit uses before it is scored on the rest."""
_FREE = 1.0
"""Time between the starts of free simulations, s."""


@dataclass(frozen=True)
class Score:
    """How a fit to the first part of a recording explains the rest, from ``start`` s on, ``length`` s long.

    ``rms`` of the prediction errors, in standard deviations, the worse of both encoders; ``error`` of the load's angle
    (rms, rad) in simulations from the commands alone, for ``free`` s each; ``told_*`` for the drive as given.
    """

    start: float
    length: float
    free: float
    rms: float
    error: float
    told_rms: float
    told_error: float


def told_parameters(drive: Drive, recording: Recording) -> Array:
    """Return the filter's parameters of a drive as given: no load torque, no delay, the gap around the load."""
    told = parameters_of()
    x = parameters_at(told)
    x.ln_half_gap = math.log(0.5 * drive.gear.backlash_angle)
    x.offset = 0.5 * float(np.min(recording.travel) + np.max(recording.travel))
    x.ln_load_inertia = math.log(drive.load.inertia)
    x.ln_load_viscous = math.log(max(drive.load.viscous_friction, 1e-9))
    x.load_coulomb, x.motor_coulomb = drive.load.coulomb_friction, drive.motor.coulomb_friction / drive.gear.ratio
    return told


def follow(
    drive: Drive,
    found: Fit,
    recording: Recording,
    state: Array | None = None,
    told: tuple[Candidate, Array] | None = None,
) -> tuple[Array, Array]:
    """Return innovations and states of one pass of the filter with a fit's noise, from a ``state`` on if there is one.

    Parameters
    ----------
    told : other teeth and parameters than those of the fit
    """
    teeth, parameters = told or (found.teeth, found.parameters)
    none = parameters_of()
    beliefs = Beliefs(none, none + 1.0, none, none, none)
    problem = Problem(motor_side(drive), teeth, recording, drive.standstill_torque(), beliefs, found.counts)
    if state is not None:
        problem.results.states[0] = state
    motor, load, share, timing = found.noise
    load *= problem.side.inertia / math.exp(found.values.ln_load_inertia)
    results = problem.results
    if math.isinf(problem.cost(parameters, np.log([motor, load, share, timing]))):
        results.innovations[:], results.states[:] = math.inf, math.inf
    read = np.isfinite(np.stack((recording.motor, recording.load), axis=1))
    read[0] = False
    return np.where(read, results.innovations, math.nan), results.states


def _as_told(drive: Drive, parameters: Array) -> tuple[Candidate, Array]:
    return told_teeth(drive, drive.gear.contact), parameters


def _rms(
    drive: Drive, found: Fit, recording: Recording, start: float, told: tuple[Candidate, Array] | None = None
) -> float:
    """Return the rms of `Score` from ``start`` on; infinite if the model cannot follow."""
    innovations, _ = follow(drive, found, recording, told=told)
    rest = innovations[recording.time >= start]
    return math.sqrt(max(float(np.nanmean(np.square(rest[:, column]))) for column in (0, 1)))


def _begins(recording: Recording, start: float) -> list[float]:
    """Return when the free simulations start, s."""
    last = max(float(recording.time[-1]) - 0.5 * _FREE, start)
    return [float(begin) for begin in np.arange(start, last + 1e-9, _FREE)]


def _error(misses: list[Array]) -> float:
    return math.sqrt(float(np.nanmean(np.square(np.concatenate(misses)))))


def _free(drive: Drive, found: Fit, recording: Recording, begin: float) -> tuple[int, int, Array]:
    """Return the first row of a free simulation, the row after its last, and its states."""
    time, motor, load = recording[:3]
    first, end = (int(k) for k in np.searchsorted(time, (begin, begin + _FREE)))
    unseen = [angle[:end].copy() for angle in (motor, load)]
    for angle in unseen:
        angle[first:] = math.nan
    blind = recording.part(slice(end))._replace(motor=unseen[0], load=unseen[1])
    _, states = follow(drive, found, blind)
    return first, end, states[first:]


def free_simulations(drive: Drive, found: Fit, recording: Recording) -> list[Recording]:
    """Return the free simulations by which a fit to the `first_part` of a recording is scored, in their order."""
    first, last = float(recording.time[0]), float(recording.time[-1])
    result = []
    for begin in _begins(recording, first + SHARE * (last - first)):
        row, end, states = _free(drive, found, recording, begin)
        motion = motion_of(states)
        result.append(recording.part(slice(row, end))._replace(motor=motion.motor_angle, load=motion.load_angle))
    return result


def _errors(drive: Drive, found: Fit, recording: Recording, start: float) -> tuple[float, float]:
    """Return the errors of `Score`: of the identified drive, and of the drive as given from the same states."""
    load = recording.load
    own: list[Array] = []
    other: list[Array] = []
    as_told = told_parameters(drive, recording)
    for begin in _begins(recording, start):
        first, end, states = _free(drive, found, recording, begin)
        own.append(motion_of(states).load_angle - load[first:end])
        state = trace_at(states[0]).state
        angles = [np.full(end - first, math.nan) for _ in range(2)]
        angles[0][0], angles[1][0] = state.motor_angle, state.load_angle
        placed, half = as_told.copy(), 0.5 * drive.gear.backlash_angle
        apart = state.motor_angle - state.load_angle
        inside = min(max(apart - found.values.offset, -0.9 * half), 0.9 * half)
        parameters_at(placed).offset = apart - inside
        alone = recording.part(slice(first, end))._replace(motor=angles[0], load=angles[1])
        _, states = follow(drive, found, alone, states[0], _as_told(drive, placed))
        other.append(motion_of(states).load_angle - load[first:end])
    return _error(own), _error(other)


def first_part(recording: Recording) -> Recording:
    """Return the part that a fit uses before it is scored."""
    end = recording.time[0] + SHARE * (recording.time[-1] - recording.time[0])
    return recording.part(slice(int(np.searchsorted(recording.time, end))))


def score(drive: Drive, found: Fit, recording: Recording) -> Score:
    """Return how well a fit to the `first_part` of a recording explains the rest.

    Parameters
    ----------
    drive : as given; the fit took its motor and gear from it
    """
    first, last = float(recording.time[0]), float(recording.time[-1])
    start = first + SHARE * (last - first)
    error, told_error = _errors(drive, found, recording, start)
    rms = _rms(drive, found, recording, start)
    told_rms = _rms(drive, found, recording, start, _as_told(drive, told_parameters(drive, recording)))
    return Score(start - first, last - start, min(_FREE, last - start), rms, error, told_rms, told_error)
