"""The fastest over-damped gains and width that stay quiet over a range of drives, found by simulation.

Near the target one flank pushes the load, and only the load's own friction stops it. In contact the slow pole of the
loop, at the output, is lambda = k1/(k2 + K_m/n + n (R + k3) B_e/K_m). A load that is pushed this way stays on its flank
up to lambda = B_l/J_l, and further with dry friction. The search therefore begins around what the least damped load of
the range allows.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from backlash_ros.control import Gains, check_stable, design_gains
from backlash_ros.control.design.describing_function import PredictedCycle, predict_limit_cycle
from backlash_ros.control.design.start import default_weights
from backlash_ros.drivetrain import Drive, rigid_model
from backlash_ros.studies.design.trial import AIM, LENGTH, MARGIN, Choice, Loop, Outcome, attempt
from backlash_ros.studies.design.uncertainty import Case, Uncertainty
from backlash_ros.studies.judging import PRECISE, QUIET
from backlash_ros.studies.metrics import SETTLED, TAIL, Array

_SAMPLES, _BATCHES = 64, 4
"""Choices in the first, evenly spread batch (Sobol, a power of 2); batches that are tried while none is quiet."""
_BEST = 3
"""Choices that each refinement starts from."""
_SIZES = (0.15, 0.08)
"""Steps of the refinements, over the range of each direction."""
_ROUNDS, _MOST_ROUNDS = 6, 16
"""Rounds that each add the drive on which the best choice fails to those that choices are tried on."""
_CREEPS = 4.0
"""How long the search holds a step: time constants of the slowest load on its flank, in addition to 2 s."""
_SLACK = 1.25
"""Factor by which the whole range may be slower than the drives that choices were tried on."""

_ADVICE = "narrow the range, add friction to the load, or take another law (planned, cascade)"

_RATE = (0.15, 2.0)
"""The slow pole, divided by the largest that keeps the load on its flank."""
_LEAD = (-0.3, 0.6)
"""k2 over the back-EMF's gain, K_m/n."""
_WINDING = (0.5, 4.0)
"""(R + k3)/R: below 1 the motor is stiffer against the load, above it gives way."""
_WIDTH = (0.4, 4.0)
Outcomes = tuple[tuple[Case, Outcome], ...]
"""What a choice does on each drive of a range."""
_LOWER, _UPPER = np.array([_RATE, _LEAD, _WINDING, _WIDTH]).T
_GEOMETRIC = _LOWER > 0


class NothingQuietError(ValueError):
    """No choice could be tried to the end: each is unstable, or oscillates in contact."""


@dataclass(frozen=True)
class Design:
    """The choice, and its outcome and that of the default choice on each drive of the range.

    ``refusal``: the worst drive in words if the choice, the best that was found, is not quiet on all of them.
    """

    loop: Loop
    uncertainty: Uncertainty
    choice: Choice
    outcomes: Outcomes
    default: Choice
    default_outcomes: Outcomes
    refusal: str = ""


def default_choice(loop: Loop) -> Choice:
    """Return the default gains and width of a controller."""
    weights = default_weights(loop.drive, 1.0 / loop.rate, loop.delay.mean)["overdamped"]
    return Choice(design_gains("overdamped", loop.drive, weights), 1.0)


def flank_rate(drive: Drive) -> float:
    """Return the fastest slow pole, 1/s, with which a load that is b/4 from its target stays on the flank that pushes.

    Its deceleration, lambda^2 e, is then that of its friction, (B_l lambda e + tau_c)/J_l.
    """
    load = drive.load
    viscous, dry = load.viscous_friction / load.inertia, load.coulomb_friction / load.inertia
    return 0.5 * (viscous + math.sqrt(viscous**2 + 4.0 * dry / (SETTLED * drive.gear.backlash_angle)))


def predicted_cycle(loop: Loop, drive: Drive, choice: Choice) -> PredictedCycle | None:
    """Return the limit cycle that harmonic balance predicts for the over-damped gains, or None.

    Dry friction is replaced by the viscous friction that takes the same energy (its describing function,
    4 tau_c/(pi omega)) from the cycle without dry friction.
    """
    period, delay = 1.0 / loop.rate, loop.delay.mean
    cycle = predict_limit_cycle(drive, choice.gains, period, delay)
    load, motor, n = drive.load, drive.motor, drive.gear.ratio
    if cycle is None or not (load.coulomb_friction or motor.coulomb_friction):
        return cycle
    per_torque = 4.0 / math.pi * cycle.period / (math.pi * cycle.amplitude)  # over the load's largest speed
    on_load, on_motor = per_torque * load.coulomb_friction, n * per_torque * motor.coulomb_friction
    damped = replace(
        drive,
        load=replace(load, viscous_friction=load.viscous_friction + on_load),
        motor=replace(motor, viscous_friction=motor.viscous_friction + on_motor),
    )
    return predict_limit_cycle(damped, choice.gains, period, delay)


def braking_rate(drive: Drive) -> float:
    """Return the rate, 1/s, at which friction and back-EMF brake motor and load at 0 V."""
    per_speed = drive.motor.torque_constant / drive.gear.ratio
    return (per_speed**2 / drive.motor.resistance + drive.effective_friction) / drive.effective_inertia


def slow_pole(drive: Drive, gains: Gains) -> float:
    """Return the rate, 1/s, at which the load creeps to its target in contact, far below the loop's other poles."""
    per_speed = drive.motor.torque_constant / drive.gear.ratio
    friction = drive.effective_friction * (drive.motor.resistance + gains.current) / per_speed
    return gains.position / (gains.velocity + per_speed + friction)


def _choice(loop: Loop, scale: float, point: Array) -> Choice | None:
    """Return the choice at a point of the search, shape (4,), or None if it oscillates in contact or is unstable."""
    rate, lead, winding, width = (float(value) for value in point)
    drive = loop.drive
    per_speed = drive.motor.torque_constant / drive.gear.ratio
    k3 = 0.0 if drive.takes_current else (winding - 1.0) * drive.motor.resistance
    unit = slow_pole(drive, Gains(1.0, lead * per_speed, k3))
    gains = Gains(rate * scale / unit, lead * per_speed, k3)
    a, b = rigid_model(drive)
    poles = np.linalg.eigvals(a - b[:, :1] @ gains.as_array()[None, :])
    slowest = poles[np.argsort(np.abs(poles))[:2]]
    if np.any(np.abs(slowest.imag) > 1e-9 * np.abs(slowest)):
        return None
    try:
        check_stable("gains.overdamped.k", drive, gains, 1.0 / loop.rate, loop.delay.mean)
    except ValueError:
        return None
    return Choice(gains, width)


def _point(drive: Drive, choice: Choice, scale: float) -> Array:
    """Return the point of the search for a choice, shape (4,): the inverse of `_choice`."""
    per_speed, gains = drive.motor.torque_constant / drive.gear.ratio, choice.gains
    winding = 1.0 if drive.takes_current else 1.0 + gains.current / drive.motor.resistance
    return np.array([slow_pole(drive, gains) / scale, gains.velocity / per_speed, winding, choice.width])


class _Search:
    """Points of the search, shape (4,), with their cost on the trial drives."""

    def __init__(self, loop: Loop, trials: list[Case], progress: Callable[[str, float], None], most: int) -> None:
        self._loop, self._trials = loop, trials
        self._progress, self._done, self._most = progress, 0, most
        slowest = min(flank_rate(case.drive) for case in trials)
        self.scale = min(slowest, 0.25 * braking_rate(loop.drive))  # above that it oscillates in contact
        self._length = min(LENGTH, TAIL + _CREEPS / slowest + 1.0)
        self._outcomes: dict[tuple[Choice, int], float] = {}
        self._cycles: dict[Choice, bool] = {}
        self.found: list[tuple[float, Array, Choice]] = []
        self.swinging: tuple[float, Choice] | None = None
        """Cost and choice of the best one with a predicted limit cycle, which is never among those found."""

    @property
    def first(self) -> Case:
        """The first of the trials, on which limit cycles are predicted."""
        return self._trials[0]

    def tell(self, what: str) -> None:
        """Report one more trial, and what it is, with the share of all trials that there can be."""
        self._done += 1
        self._progress(what, min(1.0, self._done / self._most))

    def try_point(self, point: Array) -> None:
        """Try a point, and keep it if it is among the best."""
        self.tell("trying gains")
        choice = _choice(self._loop, self.scale, point)
        if choice is not None:
            self._keep(point, choice)

    def _keep(self, point: Array, choice: Choice) -> None:
        bound = self.found[-1][0] if len(self.found) >= 4 * _BEST else math.inf
        cost = self._cost(choice, bound)
        if cost >= bound:
            return
        if self._swings(choice):
            if self.swinging is None or cost < self.swinging[0]:
                self.swinging = cost, choice
        else:
            self.found.append((cost, point, choice))
            self.found.sort(key=lambda each: each[0])
            del self.found[4 * _BEST :]

    def _swings(self, choice: Choice) -> bool:
        """Return whether a limit cycle is predicted on the first of the trials."""
        if choice not in self._cycles:
            self._cycles[choice] = predicted_cycle(self._loop, self.first.drive, choice) is not None
        return self._cycles[choice]

    def _cost(self, choice: Choice, bound: float) -> float:
        """Return the worst cost over the trials; if that is not below ``bound``, any cost that is not."""
        worst = 0.0
        for number, case in enumerate(self._trials):
            if (choice, number) not in self._outcomes:
                self._outcomes[choice, number] = self._tried(choice, case)
            worst = max(worst, self._outcomes[choice, number])
            if worst >= bound:
                break
        return worst

    def _tried(self, choice: Choice, case: Case) -> float:
        return cost_of(self._loop, case, attempt(self._loop, choice, case, self._length))

    def add_trial(self, case: Case) -> None:
        """Add a drive to the trials, or hold the steps longer if it is one already; try all that was found again."""
        if case not in self._trials:
            self._trials.append(case)
        elif self._length < LENGTH:
            self._length = LENGTH
            self._outcomes.clear()
        found, self.found = self.found, []
        for _, point, choice in found:
            self._keep(point, choice)

    def refine(self, *sizes: float) -> None:
        """Try the neighbours of the best at each distance of ``sizes``."""
        for size in sizes:
            for _, point, _ in self.found[:_BEST]:
                for neighbour in _neighbours(point, size):
                    self.try_point(neighbour)


def _spread(share: Array) -> Array:
    """Return the point of the search at shares from 0 to 1 of the ranges, shape (4,); `_LEAD` is linear."""
    point: Array = _LOWER + (_UPPER - _LOWER) * share
    point[_GEOMETRIC] = _LOWER[_GEOMETRIC] * (_UPPER / _LOWER)[_GEOMETRIC] ** share[_GEOMETRIC]
    return point


def _shares(point: Array) -> Array:
    """Return the position of a point in the ranges, shares from 0 to 1: the inverse of `_spread`."""
    share: Array = (point - _LOWER) / (_UPPER - _LOWER)
    share[_GEOMETRIC] = np.log(point[_GEOMETRIC] / _LOWER[_GEOMETRIC]) / np.log((_UPPER / _LOWER)[_GEOMETRIC])
    return share


def _neighbours(point: Array, size: float) -> Iterator[Array]:
    """Yield points to either side in each direction, ``size`` of the range away."""
    share = _shares(point)
    for axis, step in product(range(4), (-size, size)):
        moved = share.copy()
        moved[axis] = np.clip(moved[axis] + step, 0.0, 1.0)
        yield _spread(moved)


def cost_of(loop: Loop, case: Case, outcome: Outcome) -> float:
    """Return the settling time, s, plus large penalties for swing, error and overshoot."""
    b = case.drive.gear.backlash_angle
    return outcome.settle + 10.0 * outcome.excess(b, loop.count, AIM) + 2.0 * outcome.overrun(b, loop.count)


def design(
    loop: Loop, uncertainty: Uncertainty, progress: Callable[[str, float], None] = lambda _what, _share: None
) -> Design:
    """Choose over-damped gains and width.

    Choices are tried on a few drives: the one as described, the least damped load and the most damped one. The best
    choice is then judged on the whole range. A drive on which it fails or takes much longer is added to the few.

    Parameters
    ----------
    progress : called with what is done next, and with the share done, from 0 to 1, of the longest search there can be

    Returns
    -------
    The best choice that was found; if it is not quiet and precise on all drives of the range, its ``refusal`` says so.

    Raises
    ------
    NothingQuietError
        If there is no choice at all.
    ValueError
        If the load has no encoder, which the region needs, or if the fast gains are unstable.
    """
    if "theta_l" not in loop.sensors.measured:
        raise ValueError(
            f"sensors.measured must have theta_l: the region is around the load's target, got {loop.sensors.measured}"
        )
    check_stable("gains.fast.k", loop.drive, loop.fast, 1.0 / loop.rate, loop.delay.mean)
    cases = uncertainty.cases(loop.drive)
    refinement = 8 * _BEST
    most = _BATCHES * _SAMPLES + len(_SIZES) * refinement + _MOST_ROUNDS * (len(cases) + refinement) + len(cases)
    search = _Search(loop, _first_trials(cases), progress, most)

    def judged(choice: Choice) -> Outcomes:
        outcomes = []
        for case in cases:
            search.tell("judging the range")
            outcomes.append((case, attempt(loop, choice, case)))
        return tuple(outcomes)

    _spread_out(search, loop)
    best = _best_on_the_range(search, loop, judged) or _least_swinging(search, judged)
    default = default_choice(loop)
    return Design(loop, uncertainty, best.choice, best.outcomes, default, judged(default), best.refusal)


@dataclass(frozen=True)
class _Judged:
    """A choice, its outcomes on the whole range, the worst cost there, and why it is refused, if it is."""

    choice: Choice
    outcomes: Outcomes
    cost: float
    refusal: str


def _first_trials(cases: Sequence[Case]) -> list[Case]:
    """Return the few drives to try on: as described, the least damped load, and the most damped one."""
    by_flank = sorted((case for case in cases if not case.load_torque), key=lambda case: flank_rate(case.drive))
    return list(dict.fromkeys([by_flank[0], cases[0], by_flank[-1]]))


def _spread_out(search: _Search, loop: Loop) -> None:
    """Try the default choice, and points over the whole search until one is quiet; then the neighbours of the best."""
    from scipy.stats import qmc  # noqa: PLC0415 - slow to load, and most who import this need it not

    search.try_point(_point(loop.drive, default_choice(loop), search.scale))
    sampler = qmc.Sobol(4, scramble=False)
    for _ in range(_BATCHES):
        for share in sampler.random(_SAMPLES):
            search.try_point(_spread(share))
        if search.found and search.found[0][0] < LENGTH:
            break
    search.refine(*_SIZES)


def _best_on_the_range(search: _Search, loop: Loop, judged: Callable[[Choice], Outcomes]) -> _Judged | None:
    """Return the best of the choices found, judged on the whole range, or None if none was found.

    While the best of a round fails on a drive or is slow there, that drive is added to the trials.
    """
    best: _Judged | None = None
    for number in range(_MOST_ROUNDS):
        if not search.found:
            break
        cost, _, choice = search.found[0]
        outcomes = judged(choice)
        costs = [cost_of(loop, *each) for each in outcomes]
        found = _Judged(choice, outcomes, max(costs), _refusal(loop, outcomes))
        good = not found.refusal and (number >= _ROUNDS - 1 or found.cost <= _SLACK * cost)
        if good or best is None or (bool(found.refusal), found.cost) < (bool(best.refusal), best.cost):
            best = found
        if good:
            break
        search.add_trial(outcomes[int(np.argmax(costs))][0])
        search.refine(_SIZES[-1])
    return best


def _least_swinging(search: _Search, judged: Callable[[Choice], Outcomes]) -> _Judged:
    """Return the best choice that has a limit cycle; NothingQuietError without one."""
    if search.swinging is None:
        raise NothingQuietError(f"no gains can be tried: all are unstable, or oscillate in contact; {_ADVICE}")
    refusal = f"no gains are without a limit cycle: with {search.first.label}; {_ADVICE}"
    return _Judged(search.swinging[1], judged(search.swinging[1]), 0.0, refusal)


def _refusal(loop: Loop, outcomes: Outcomes) -> str:
    """Return the worst drive in words if a choice is not quiet on the whole range, else an empty text."""

    def excess(each: tuple[Case, Outcome]) -> float:
        return each[1].excess(each[0].drive.gear.backlash_angle, loop.count, MARGIN)

    case, outcome = max(outcomes, key=excess)
    if not excess((case, outcome)):
        return ""
    what = (
        f"the run ends with a fault ({outcome.failure})"
        if outcome.failure
        else f"the load swings by {outcome.swing:.2f} b and ends {outcome.error:.2f} b off its target, "
        f"where {MARGIN * QUIET:.2g} b and {MARGIN * PRECISE:.2g} b were allowed"
    )
    return f"no gains are quiet on every drive of the range: with {case.label} {what}; {_ADVICE}"
