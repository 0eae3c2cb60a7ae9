"""The task: learn the gap, then with each law a step of 1 rad, one of 5 b, and a hold while the load torque changes."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from backlash_ros.control import (
    AUTO,
    BacklashEstimate,
    Servo,
    ServoSettings,
)
from backlash_ros.control.design.choice import Choice, Tuning, given_sets
from backlash_ros.control.design.start import emulated
from backlash_ros.control.experiment import DriveEstimate
from backlash_ros.control.laws import BEST, UNTIL_THEN
from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.parameters import drive_of, to_use
from backlash_ros.foundation.signals import THETA_L, THETA_M
from backlash_ros.simulation import Run, Scenario, SimulatedDrive, excite, run
from backlash_ros.studies.design.search import NothingQuietError, design
from backlash_ros.studies.design.trial import Loop
from backlash_ros.studies.design.uncertainty import Uncertainty
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.judging import (
    OVERSHOOT,
    PRECISE,
    QUIET,
    Move,
    judge_move,
    recovery,
    threshold,
)
from backlash_ros.studies.metrics import Array

STAND, STEP, SHORT, HOLD = 1.0, 6.0, 6.0, 10.0
"""Lengths of the parts, s: the load is held where it stands, steps by 1 rad, steps by 5 b, and is held there."""
CHANGE = STAND + STEP + SHORT + 0.5 * HOLD
"""When the load torque changes, s."""
LENGTH = STAND + STEP + SHORT + HOLD
SHORT_STEP = 5.0
"""In mean backlashes."""
INERTIA_NEAR, GAP_NEAR, EFFORT_NEAR, DELAY_NEAR = 0.05, 0.03, 0.1, 0.25
"""Largest errors that count as close: shares of inertia, gap and friction, and of a period; or one count."""
PAPERS_LAWS = ("fast", "overdamped", "two_region")
IDENTIFY = "identify"
"""The experiment of ``~/identify``."""
DESIGNED = "designed"
"""The two-region law with gains and width by `backlash design`; accepted like the name of a law."""
SPEEDS = 1.0, 10.0
"""Speeds of the load, rad/s, at which its viscous and dry friction together are judged."""

_GRID = 1e-3
"""Largest time between the states that are judged, s."""


@dataclass(frozen=True)
class Task:
    """Everything that the evaluation of one drive depends on, except the drive's number.

    ``experiments``: by default what ``~/identify`` runs if the model is ``identified``, else what ``~/learn`` does.
    ``laws``: by default the paper's and the default law, which comes last and is judged. ``effects``: what every drive
    has, of `effects.EFFECTS`, in addition to what the population draws.
    """

    seed: int
    population: str = "full"
    model: str = "nominal"
    encoders: str = "both"
    experiments: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    around: Drive | None = None
    effects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.experiments:
            object.__setattr__(self, "experiments", (IDENTIFY if self.model == "identified" else AUTO,))
        if not self.laws:
            object.__setattr__(self, "laws", tuple(dict.fromkeys((*PAPERS_LAWS, self.default_law))))

    @property
    def default_law(self) -> str:
        """The law that a controller has in use by default, once it has learned the drive."""
        return UNTIL_THEN if self.model == "nominal" else BEST

    @property
    def played(self) -> tuple[str, ...]:
        """The laws to run; always with the fast one, since ratios refer to it."""
        return tuple(dict.fromkeys(("fast", *self.laws)))

    def member(self, number: int) -> Member:
        """Return the drive with a number."""
        return draw_member(self.seed, number, self.population, self.encoders, self.around, self.effects)


@dataclass(frozen=True)
class Learned:
    """The result of learning.

    ``angle``: the learned gap with its standard ``uncertainty``; ``gap``: the true one at that place, rad;
    ``experiment``: the one that found it, or the last that was tried; ``time``: of all experiments, s; ``swing``:
    largest distance of the load from its start, rad. ``identified``: whether the drive then counts as such. What an
    identification found of it follows, nan where it found nothing, and whether all of it, and the ratio of both
    inertias, is close to the truth.
    """

    valid: bool = False
    angle: float = math.nan
    uncertainty: float = math.nan
    gap: float = math.nan
    experiment: str = ""
    method: str = ""
    reason: str = ""
    fault: str = ""
    time: float = math.nan
    swing: float = math.nan
    identified: bool = False
    all_close: bool = False
    ratio_close: bool = False
    inertia: float = math.nan
    viscous_friction: float = math.nan
    coulomb_friction: float = math.nan
    delay: float = math.nan


@dataclass(frozen=True)
class Verdict:
    """The verdict on one law on one drive; by default that of a failed run.

    ``failure`` says why there was no run. ``peak_force``: largest between the teeth in the step of 1 rad, N;
    ``recover``: time from the change of the load torque until the load stays near its target, s.
    """

    quiet: bool = False
    precise: bool = False
    overshoot_ok: bool = False
    faulted: bool = True
    fault: str = ""
    fault_time: float = math.nan
    failure: str = ""
    step: Move = field(default_factory=lambda: Move(settle=STEP, rise=STEP))
    short: Move = field(default_factory=lambda: Move(settle=SHORT, rise=SHORT))
    peak_force: float = math.nan
    recover: float = 0.5 * HOLD


def _tuning(rate: float) -> Tuning:
    """Return the rules of a controller with the default gains."""
    return Tuning(given_sets({}), rate)


def settings_for(model: Drive, member: Member, delay: float | None = None) -> ServoSettings:
    """Return the settings of a controller node that knows only a drive, its rate and its delay.

    ``delay`` in s; the true one by default.

    Raises
    ------
    ValueError
        If a controller does not start, such as one with gains that are unstable at that rate.
    """
    period, delay = 1.0 / member.rate, member.delay.mean if delay is None else delay
    start = _tuning(member.rate).start({"loop_delay": delay}, model)
    return ServoSettings(start.settings.gains, period=period, loop_delay=delay)


def designed_settings(model: Drive, member: Member, settings: ServoSettings) -> ServoSettings:
    """Return ``settings`` with what `backlash design` chooses for the drive that the controller assumes.

    Rate and counts are known from the data sheet. If no quiet gains are found, the default gains stay.
    """
    sensors = replace(member.sensors, load_eccentricity=0.0, motor_eccentricity=0.0)
    known = emulated(model, settings.period, settings.loop_delay)
    loop = Loop(known, settings.gains.fast, member.rate, sensors, Delay(command=settings.loop_delay))
    try:
        found = design(loop, Uncertainty())
    except NothingQuietError:
        return settings
    if found.refusal:
        return settings
    return replace(loop.settings(found.choice), backlash_angle=settings.backlash_angle)


def first_reading(member: Member) -> float:
    """Return the first reading of the load's angle, rad; from the motor's encoder if the load has none."""
    shown = SimulatedDrive(member.drive, 1.0 / member.rate, sensors=member.sensors).sample()
    return float(shown[THETA_M] * member.drive.gear.ratio if math.isnan(shown[THETA_L]) else shown[THETA_L])


def true_reading(member: Member, theta_l: Array) -> Array:
    """Return the readings of a perfect load encoder with the same zero and eccentricity at load angles, rad.

    If the load has no encoder, the zero is that of the motor's encoder, at the output.
    """
    if "theta_l" in member.sensors.measured:
        return member.sensors.load_zero(theta_l)
    return theta_l + member.sensors.motor_offset * member.drive.gear.ratio


class _Watched(SimulatedDrive):
    """A simulated drive that remembers how far its load went."""

    swing = 0.0

    def advance(self, command: float, load_torque: float = 0.0) -> None:
        """Go on to the next sample."""
        super().advance(command, load_torque)
        self.swing = max(self.swing, abs(float(self.state[THETA_L])))


def learn(
    member: Member, model: Drive, settings: ServoSettings, experiments: tuple[str, ...]
) -> tuple[Learned, BacklashEstimate | None]:
    """Let a controller learn the gap: the experiments one after the other, until one finds it.

    Returns the result, and what the last experiment found, which may be everything but the gap.
    """
    result, spent, swing = Learned(), 0.0, 0.0
    found: BacklashEstimate | None = None
    for name in experiments:
        servo = Servo(model, settings)
        plant = _Watched(member.drive, settings.period, sensors=member.sensors, delay=member.delay)
        try:
            outcome = excite(servo, plant, name, load_torque=member.load_torque)
        except IntegrationError as error:
            return Learned(experiment=name, reason=f"not simulated: {error}", time=spent + plant.time), None
        spent, swing = spent + plant.time, max(swing, plant.swing)
        result = Learned(
            gap=member.gap_at(float(plant.state[THETA_L]), plant.time),
            experiment=name,
            reason=outcome.reason,
            fault=servo.fault,
            time=spent,
            swing=swing,
        )
        found = outcome if isinstance(outcome, BacklashEstimate) and outcome.valid else None
        if found is not None and found.angle > 0.0:
            result = replace(
                result, valid=True, angle=found.angle, uncertainty=found.uncertainty, method=found.method.value
            )
            break
    return result, found


def _judge_identified(member: Member, result: Learned, estimate: BacklashEstimate, used: Choice) -> Learned:
    """Return what was identified in addition to the gap, and whether all of it is close to the truth.

    ``used``: the controller that uses it.
    """
    truth, found = member.drive.load, estimate.parameters
    names = "load.inertia", "load.viscous_friction", "load.coulomb_friction", "loop_delay"
    inertia, viscous, dry, delay = (float(found.get(name, math.nan)) for name in names)
    ratio = inertia / used.drive.reflected_inertia
    true_ratio = truth.inertia / member.drive.as_built.reflected_inertia
    near = [
        abs(inertia / truth.inertia - 1.0) <= INERTIA_NEAR,
        abs(result.angle - result.gap) <= max(GAP_NEAR * result.gap, member.load_count),
        abs(delay - member.delay.mean) <= DELAY_NEAR / member.rate,
    ]
    for speed in SPEEDS:
        effort = truth.viscous_friction * speed + truth.coulomb_friction
        near.append(abs(viscous * speed + dry - effort) <= EFFORT_NEAR * effort)
    return replace(
        result,
        identified=used.settings.identified,
        all_close=all(near),
        ratio_close=abs(ratio / true_ratio - 1.0) <= INERTIA_NEAR,
        inertia=inertia,
        viscous_friction=viscous,
        coulomb_friction=dry,
        delay=delay,
    )


def scenario_of(member: Member) -> Scenario:
    """Return the task as references and load torques, sample by sample."""
    time = np.arange(round(LENGTH * member.rate)) / member.rate
    slack = 0.5 / member.rate
    start, b = first_reading(member), member.drive.gear.backlash_angle
    reference: Array = start + 1.0 * (time > STAND - slack) + SHORT_STEP * b * (time > STAND + STEP - slack)
    torque = np.where(time > CHANGE - slack, member.load_torque + member.torque_change, member.load_torque)
    substeps = max(1, round(1.0 / (_GRID * member.rate)))
    return Scenario(reference, torque, sensors=member.sensors, delay=member.delay, substeps=substeps)


def judge_run(member: Member, scenario: Scenario, done: Run) -> Verdict:
    """Judge one law's run of the task."""
    b, count = member.drive.gear.backlash_angle, member.load_count
    position, time = true_reading(member, done.load_angle), done.time
    start = float(scenario.reference[0])
    targets = start + 1.0, float(scenario.reference[-1])

    def part(begin: float, length: float) -> tuple[Array, Array]:
        first, last = np.searchsorted(time, (begin - 1e-6, begin + length + 1e-6))
        return time[first:last] - time[first], position[first:last]

    step = judge_move(*part(STAND, STEP), targets[0], b, count)
    short = judge_move(*part(STAND + STEP, SHORT), targets[1], b, count)
    faulted = bool(done.fault)
    rising = slice(round(STAND * member.rate), round((STAND + STEP) * member.rate))
    return Verdict(
        quiet=not faulted and max(step.swing, short.swing) <= threshold(QUIET, b, count),
        precise=not faulted and max(step.error, short.error) <= threshold(PRECISE, b, count),
        overshoot_ok=not faulted and max(step.overshoot, short.overshoot) <= threshold(OVERSHOOT, b, count),
        faulted=faulted,
        fault=done.fault,
        fault_time=done.fault_sample / member.rate if faulted else math.nan,
        step=replace(step, settle=STEP) if faulted else step,
        short=replace(short, settle=SHORT) if faulted else short,
        peak_force=float(np.max(done.peak_force[rising])),
        recover=0.5 * HOLD if faulted else recovery(*part(CHANGE, 0.5 * HOLD), targets[1], b, count),
    )


@dataclass(frozen=True)
class Ready:
    """A drive that was learned, or not, and the controller that knows it: as described, and as it treats it."""

    learned: Learned
    settings: ServoSettings
    model: Drive
    known: Drive


class NotReadyError(ValueError):
    """No controller starts, with what was learned until then."""

    def __init__(self, reason: str, learned: Learned) -> None:
        super().__init__(reason)
        self.learned = learned


def prepare(task: Task, member: Member) -> Ready:
    """Let a controller learn a drive, or identify it if the task says so, and use what it found.

    Raises
    ------
    NotReadyError
        If a controller does not start with what is told.
    """
    model = told_model(member, task.model, task.around)
    tuning, delay = _tuning(member.rate), 0.0 if task.model == "identified" else member.delay.mean
    try:
        choice = tuning.start({"loop_delay": delay, "identified": task.model == "true"}, model)
    except ValueError as error:
        raise NotReadyError(str(error), Learned(reason=str(error))) from error
    learned, found = learn(member, choice.drive, choice.settings, task.experiments)
    if found is not None:
        learned, choice = _put_in_use(member, tuning, choice, learned, found)
    return Ready(learned, choice.settings, drive_of(choice.values), choice.drive)


def _put_in_use(
    member: Member, tuning: Tuning, choice: Choice, learned: Learned, found: BacklashEstimate
) -> tuple[Learned, Choice]:
    """Return the controller with what it found, or as it was if it cannot use that."""
    try:
        used = tuning.choice({**choice.values, **tuning.completed(to_use(found.parameters), choice)})
    except ValueError as error:
        return replace(learned, valid=False, reason=f"it could not be used: {error}"), choice
    if isinstance(found, DriveEstimate):
        learned = _judge_identified(member, learned, found, used)
    return learned, used


def perform(task: Task, number: int, laws: tuple[str, ...]) -> tuple[Learned, dict[str, Verdict], dict[str, Run]]:
    """Evaluate one drive: return the result of learning, and the verdict and the run of each law, if it ran."""
    member = task.member(number)
    try:
        ready = prepare(task, member)
    except NotReadyError as error:
        return error.learned, dict.fromkeys(laws, Verdict(failure=str(error))), {}
    verdicts: dict[str, Verdict] = {}
    runs: dict[str, Run] = {}
    settings, scenario = ready.settings, scenario_of(member)
    for law in laws:
        try:
            if law == DESIGNED:
                chosen = designed_settings(ready.model, member, settings) if ready.learned.valid else settings
            else:
                chosen = settings.with_law(law)
            runs[law] = run(member.drive, chosen, scenario, model=ready.known)
            verdicts[law] = judge_run(member, scenario, runs[law])
        except (ValueError, IntegrationError) as error:  # noqa: PERF203 - a law that fails has its verdict
            verdicts[law] = Verdict(failure=str(error))
    return ready.learned, verdicts, runs


def evaluate_drive(task: Task, number: int) -> dict[str, Any]:
    """Return the results of one drive as the journal keeps them: ``learned``, and ``laws`` by name."""
    learned, verdicts, _ = perform(task, number, task.played)
    return {"learned": asdict(learned), "laws": {law: asdict(verdict) for law, verdict in verdicts.items()}}
