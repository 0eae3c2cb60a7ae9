"""Finds the most likely parameters for a recording of both encoders, with uncertainties.

The filter's innovations enter a pseudo-Huber loss, so that a single outlier has no effect. Levenberg and Marquardt's
method minimises it from many starts, at first with so much process noise that every start converges, then with less and
less.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.contacts.elastic import SpringContact
from backlash_ros.drivetrain.signals import Array
from backlash_ros.identification.filter import (
    COULOMB_L,
    COULOMB_M,
    DELAY,
    ECCENTRICITY,
    GAP_SLOPE,
    GRAVITY,
    LARGEST,
    LEAST,
    LN_HALF_GAP,
    LN_INERTIA,
    LN_TEETH,
    LN_VISCOUS,
    OFFSET,
    PARAMETERS,
    STATES,
    TORQUE,
    MotorSide,
    Noise,
    filter_with,
)
from backlash_ros.identification.newey_west import newey_west
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.regression import Guess, guess_of


class Stage(NamedTuple):
    """Variance of the motor's and of the load's speed per second, rad^2/s^3; share of the teeth's torque."""

    motor: float
    load: float
    teeth: float


STAGES = (Stage(1.0, 4.0, 0.05), Stage(0.3, 1.0, 0.035), Stage(0.09, 0.25, 0.02), Stage(0.03, 0.12, 0.013))
FITS = 1.15
"""Largest rms of the innovations, in their standard deviations, with which the model is accepted."""
_CALM, _KEPT, _WIDTHS, _DEEPEST = 0.4, 4, 25, 3
_RIVAL = 200.0
"""Cost by which a contact law may be worse at the beginning and still be tried on the whole recording."""
_WIDER, _ELSE, _AS_GOOD = 1.5, 0.1, 100.0
"""Factor by which the gap that was found is widened, to either side, to look for another one; by which share another
gap differs; and the cost by which it may be worse and still explain the recording as well."""
_STANDS_OUT = 4.0
"""Smallest slope of the load torque, in its standard deviations by the noise, that counts as one."""
_KNEE = 2.0
"""Standard deviations above which an innovation counts by its magnitude, not its square."""
_SMALL = 1e-12
"""Variance of a reading beside its counts, rad^2."""
PASSES = 1000
"""Passes of the filter over all of a recording after which a search ends."""


def _row(values: dict[int, float], default: float) -> Array:
    return np.array([values.get(index, default) for index in range(PARAMETERS)])


_INF = math.inf
_LOW = _row(
    {LN_HALF_GAP: -14, LN_TEETH: -5, LN_INERTIA: -25, LN_VISCOUS: -18, COULOMB_L: 0, COULOMB_M: 0, DELAY: 0}, -_INF
)
_HIGH = _row({LN_HALF_GAP: 1, LN_TEETH: 5, LN_INERTIA: 12, LN_VISCOUS: 12}, _INF)
_LARGEST = _row(
    {LN_HALF_GAP: 0.3, GAP_SLOPE: 0.1, LN_TEETH: 0.5, LN_INERTIA: 0.7, LN_VISCOUS: 1, ECCENTRICITY: 0.01}, _INF
)
_SPREAD = _row(
    {LN_HALF_GAP: 3, OFFSET: 1, GAP_SLOPE: 0.2, LN_TEETH: 0.02, LN_INERTIA: 3, LN_VISCOUS: 3, ECCENTRICITY: 0.005}, 1
)
_NONE, _WORTH = 1e-6, 0.05
"""Negligible dry friction, N m; and cost per sample that dry friction must save to be believed, since the filter's
steps leave errors that look like a thousandth of a newton metre."""
_FIRST, _MOVING = 0.02, 0.3
"""Time from which the first speeds are taken, s, and speed below which they count as 0, rad/s."""
_SPRING = 0.7
"""Prior standard deviations; larger for the force of a spring."""


def motor_side(drive: Drive, contact: Contact | None = None) -> MotorSide:
    """Return the motor of ``drive`` as the filter needs it, with its own teeth or others."""
    n, motor, gear = drive.gear.ratio, drive.motor, drive.gear
    K, R, current = motor.torque_constant, motor.resistance, drive.takes_current
    contact = contact or gear.contact
    return MotorSide(
        inertia=drive.reflected_inertia,
        viscous=motor.viscous_friction / n**2,
        rate=math.inf if current else R / motor.inductance,
        gain=K / n if current else K / (n * R),
        braking=0.0 if current else K * K / (n * n * R),
        load_radius=gear.load_radius,
        contact=contact.constants(gear.load_radius, drive.contact_mass),
    )


def count_of(angle: Array) -> float:
    """Return an encoder's count, rad: the smallest difference of its readings; close to 0 without quantization."""
    steps = np.diff(np.unique(np.round(angle[np.isfinite(angle)], 11)))
    return float(np.min(steps[steps > 1e-9], initial=1e-2))


def noise_of(counts: tuple[float, float], stage: Stage) -> Noise:
    """Return the variances that the filter takes, for both encoders' counts, rad."""
    motor, load = (count * count / 12.0 + _SMALL for count in counts)
    return Noise(motor, load, stage.motor, stage.load, stage.teeth**2)


def first_states(recording: Recording) -> Array:
    """Return room for the filter's states, shape (N, `STATES`), with initial speeds if it starts in motion."""
    states = np.zeros((recording.time.size, STATES))
    first = recording.time <= recording.time[0] + _FIRST
    for column, angle in ((1, recording.motor), (4, recording.load)):
        read = first & np.isfinite(angle)
        if np.sum(read) > 2:
            speed = float(np.polyfit(recording.time[read], angle[read], 1)[0])
            states[0, column] = speed if abs(speed) > _MOVING else 0.0
    return states


@dataclass
class Effort:
    """Samples that the filter may still process in one search: a time limit that is the same on any machine."""

    left: float = math.inf

    @property
    def spent(self) -> bool:
        """Whether none is left."""
        return self.left <= 0.0


@dataclass
class Problem:
    """One recording with one contact law, and the ``stages`` of decreasing process noise.

    When the ``effort`` is spent, the present solution stops where it is.
    """

    side: MotorSide
    contact: Contact
    recording: Recording
    prior: Array
    spread: Array
    counts: tuple[float, float]
    stages: Sequence[Stage] = STAGES
    effort: Effort = field(default_factory=Effort)
    innovations: Array = field(init=False)
    derivatives: Array = field(init=False)
    states: Array = field(init=False)

    def __post_init__(self) -> None:
        n = self.recording.time.size
        self.innovations, self.states = np.zeros((n, 2)), first_states(self.recording)
        self.derivatives = np.zeros((n, 2, PARAMETERS))

    def look(self, x: Array, stage: Stage) -> tuple[float, Array, Array]:
        """Return the cost, its gradient and Gauss and Newton's matrix; the variances count as if they were constant."""
        self.effort.left -= self.recording.time.size
        noise = noise_of(self.counts, stage)
        predict = filter_with(type(self.contact))  # type: ignore[arg-type]
        logs = predict(self.side, noise, x, *self.recording, self.innovations, self.derivatives, self.states)
        if not math.isfinite(logs):
            return math.inf, np.zeros(PARAMETERS), np.eye(PARAMETERS)
        nu, slopes = self.innovations[1:].ravel(), self.derivatives[1:].reshape(-1, PARAMETERS)
        root = np.sqrt(1.0 + (nu / _KNEE) ** 2)
        off = (x - self.prior) / self.spread
        cost = 2.0 * _KNEE**2 * float(np.sum(root - 1.0)) + logs + float(off @ off)
        weighed = slopes / root[:, None]
        return cost, weighed.T @ nu + off / self.spread, weighed.T @ slopes + np.diag(1.0 / self.spread**2)

    def solve(self, x: Array, stage: Stage, most: int, enough: float) -> "Minimum":
        """Minimise from ``x`` until a step gains less than ``enough`` or ``most`` steps are done."""
        damping = 1e-3
        cost, gradient, matrix = self.look(x, stage)
        for _ in range(most):
            if self.effort.spent or not math.isfinite(cost):
                break
            gain = 0.0
            for _ in range(6):
                step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), -gradient)
                new = np.clip(x + np.clip(step, -_LARGEST, _LARGEST), _LOW, _HIGH)
                found, slope, curved = self.look(new, stage)
                if found < cost:
                    gain = cost - found
                    x, cost, gradient, matrix = new, found, slope, curved
                    damping = max(0.1 * damping, 1e-6)
                    break
                damping = 10.0 * max(damping, 1e-4)
            if gain < enough:
                break
        sizes = _sizes(self.innovations[1:]) if math.isfinite(cost) else (math.inf, math.inf)
        return Minimum(cost, x, self, sizes)

    def descend(self, x: Array) -> "Minimum":
        """Minimise through all stages."""
        for stage in self.stages:
            x = self.solve(x, stage, 8, 0.5).x
        return self.solve(x, self.stages[-1], 20, 0.02)


class Minimum(NamedTuple):
    """The end of a minimisation: the cost, the parameters, the problem, and the rms of both innovations."""

    cost: float
    x: Array
    problem: Problem
    sizes: tuple[float, float]


def cost_of(found: Minimum) -> float:
    """Return the cost, to sort by."""
    return found.cost


def _sizes(innovations: Array) -> tuple[float, float]:
    """Return the rms of both columns by the loss."""
    mean = 2.0 * _KNEE**2 * np.mean(np.sqrt(1.0 + (innovations / _KNEE) ** 2) - 1.0, axis=0)
    return math.sqrt(mean[0]), math.sqrt(mean[1])


@dataclass(frozen=True)
class Fit:
    """The result: with one contact law the ``parameters`` of the filter, and their ``covariance``.

    ``rms`` of the innovations of both angles by the loss, 1 if the noise is as assumed; ``counts`` of both encoders,
    rad; ``torques``: smallest and largest torque of the teeth in a few samples, N m; ``start``: the first reading of
    the load, rad; ``exhausted``: whether the search ended after `PASSES` before it converged; ``rival``: another gap
    that explains the recording as well, rad, 0 if there is none.
    """

    contact: Contact
    parameters: Array
    covariance: Array
    rms: tuple[float, float]
    counts: tuple[float, float]
    torques: tuple[float, float]
    start: float = 0.0
    exhausted: bool = False
    rival: float = 0.0

    @property
    def gap(self) -> float:
        """The backlash where the load started, rad at the output."""
        return 2.0 * math.exp(self.parameters[LN_HALF_GAP])

    @property
    def delay(self) -> float:
        """Time from a sample to when its command acts, s."""
        return float(self.parameters[DELAY])

    @property
    def scale(self) -> float:
        """Relative scale error of the load's encoder."""
        return float(self.parameters[ECCENTRICITY])

    @property
    def load_torque(self) -> dict[str, Any]:
        """The load torque as `ServoSettings` expect it, by name: at the start, N m, there, rad, and its slope, N m/rad.

        A slope that does not stand out is 0: most loads have none.
        """
        slope, deviation = float(self.parameters[GRAVITY]), math.sqrt(max(self.covariance[GRAVITY, GRAVITY], 0.0))
        return {
            "expected_load_torque": float(self.parameters[TORQUE]),
            "expected_load_torque_angle": self.start,
            "expected_load_torque_slope": slope if abs(slope) > _STANDS_OUT * deviation else 0.0,
        }

    @property
    def gap_deviation(self) -> float:
        """Its standard deviation by the noise alone, rad."""
        return self.gap * math.sqrt(self.covariance[LN_HALF_GAP, LN_HALF_GAP])


def _half_gap(x: Array) -> float:
    return math.exp(x[LN_HALF_GAP])


def _resized(x: Array, side: float, half: float) -> Array:
    """Return ``x`` with half a gap of ``half``, rad, and the wall at ``side`` where it was."""
    other = x.copy()
    other[LN_HALF_GAP], other[OFFSET] = math.log(half), x[OFFSET] + side * (_half_gap(x) - half)
    return other


def _widths(x: Array, travel: float) -> list[Array]:
    """Return gaps of any width within a travel (rad), with one wall at its end and the other one anywhere."""
    halves = np.geomspace(0.05 * travel, 0.6 * travel, _WIDTHS)
    return [x, *(_resized(x, side, float(half)) for side in (1.0, -1.0) for half in halves)]


def _start(recording: Recording, guess: Guess, delay: float, inertia: float, share: float) -> Array:
    low, high = float(np.min(recording.travel)), float(np.max(recording.travel))
    return _row(
        {
            LN_HALF_GAP: math.log(max(0.5 * share * (high - low), 1e-5)),
            OFFSET: 0.5 * (low + high),
            LN_INERTIA: math.log(inertia),
            LN_VISCOUS: math.log(max(guess.viscous, 3e-4)),
            COULOMB_L: guess.coulomb_l,
            TORQUE: guess.load_torque,
            COULOMB_M: guess.coulomb_m,
            DELAY: delay,
        },
        0.0,
    )


def believed(start: Array, contact: Contact, torque: float, period: float) -> tuple[Array, Array]:
    """Return the prior: means and standard deviations."""
    prior, spread = start.copy(), _SPREAD.copy()
    prior[[GAP_SLOPE, LN_TEETH, GRAVITY, ECCENTRICITY]] = 0.0
    spread[[COULOMB_L, TORQUE, COULOMB_M]] = torque
    spread[GRAVITY] = 0.05 * torque
    spread[DELAY] = 2.0 * period
    if isinstance(contact, SpringContact):
        spread[LN_TEETH] = _SPRING
    return prior, spread


def compile_filters(contacts: Iterable[type[Contact]]) -> None:
    """Compile the functions of fits, so that processes that fit find the code."""
    drive = NOMINAL_DRIVE
    still, start = np.zeros(3), _row({LN_INERTIA: -7.0, LN_VISCOUS: -7.0, LN_HALF_GAP: -4.0}, 0.0)
    for law in contacts:
        side = motor_side(drive, law())
        recording = Recording(np.array([0.0, 0.004, 0.008]), still, still, still, still)
        Problem(side, law(), recording, start, np.ones(PARAMETERS), (1e-4, 1e-4)).look(start, STAGES[0])


def fit(drive: Drive, recording: Recording, contacts: Sequence[Contact], delays: Iterable[float], torque: float) -> Fit:
    """Return the best fit of a recording.

    Parameters
    ----------
    drive : for its motor and gear, which are taken as they are
    contacts : the laws to try
    delays : starting values of the time from a sample to when its command acts, s
    torque : the largest that may act, N m at the output

    Notes
    -----
    The search takes at most `PASSES` of the filter, and some hundred more to look for a wider gap and to end: seconds.
    """
    time, motor, load = recording[:3]
    effort = Effort(PASSES * time.size)
    side = motor_side(drive)
    period = float(np.median(np.diff(time)))
    counts = count_of(motor), count_of(load)
    guesses = sorted(
        ((guess_of(side, recording, delay), delay) for delay in delays),
        key=lambda pair: pair[0].misfit,
    )
    guessed = max(guesses[0][0].inertia, 0.02 * side.inertia)
    inertias = [guessed]
    inertias += [share * side.inertia for share in (0.08, 0.4) if abs(math.log(share * side.inertia / guessed)) > 0.7]

    def problem(contact: Contact, part: Recording, start: Array) -> Problem:
        prior, spread = believed(start, contact, torque, period)
        return Problem(motor_side(drive, contact), contact, part, prior, spread, counts, effort=effort)

    calm = recording.part(slice(math.ceil(_CALM * time.size)))

    def of_the_calm(contact: Contact) -> Minimum:
        """Return the result from the gentle beginning, which shows everything but perhaps the far flank."""
        starts = [
            _start(calm, guess, delay, inertia, share)
            for guess, delay in guesses[:3]
            for inertia in inertias
            for share in ((1.0, 0.5) if delay == guesses[0][1] else (1.0,))
        ]
        tried = sorted((problem(contact, calm, x).solve(x, STAGES[0], 6, 1.0) for x in starts), key=cost_of)
        for stage in STAGES[1:3]:  # with much noise a wrong law may look better than the right one
            tried = [each.problem.solve(each.x, stage, 6, 1.0) for each in tried[:_KEPT]]
        return min(tried, key=cost_of)

    def of_all(start: Minimum) -> list[Minimum]:
        """Return the result from the whole recording, starting from the most likely widths."""
        whole = problem(start.problem.contact, recording, start.x)
        widths = _widths(start.x, float(np.ptp(recording.travel)))
        scanned = sorted(((whole.look(x, STAGES[0])[0], k) for k, x in enumerate(widths)))
        return [whole.descend(widths[k]) for _, k in scanned[:_DEEPEST]]

    gentle = [of_the_calm(contact) for contact in contacts]
    cheapest = min(map(cost_of, gentle))
    ends = [end for start in gentle if start.cost <= cheapest + _RIVAL for end in of_all(start)]
    best = min(ends, key=cost_of)
    if max(best.sizes) > FITS:  # perhaps because of another law or the delay
        ends += [end for start in gentle if start.cost > cheapest + _RIVAL for end in of_all(start)]
        other = best = min(ends, key=cost_of)
        for _, delay in guesses:
            if max(best.sizes) > FITS and not effort.spent and abs(delay - other.x[DELAY]) > 0.2 * period:
                x = other.x.copy()
                x[DELAY] = delay
                best = min(best, other.problem.descend(x), key=cost_of)
    exhausted, effort.left = effort.spent, math.inf
    if exhausted or max(best.sizes) > FITS:
        return replace(fit_of(best), exhausted=exhausted)
    ends = [best, *(best.problem.descend(_resized(best.x, side, _WIDER * _half_gap(best.x))) for side in (1.0, -1.0))]
    best = min(ends, key=cost_of)
    return replace(fit_of(best), rival=_rival(best, ends))


def _rival(best: Minimum, ends: list[Minimum]) -> float:
    """Return another gap that explains the recording as well as the best one, rad; 0 if there is none.

    If the load met one flank only, the fit puts the far one somewhere within the travel, and nowhere better than
    elsewhere.
    """
    gap = _half_gap(best.x)
    for end in ends:
        if end.cost < best.cost + _AS_GOOD and abs(_half_gap(end.x) / gap - 1.0) > _ELSE:
            return 2.0 * _half_gap(end.x)
    return 0.0


def fit_of(end: Minimum) -> Fit:
    """Return the result at the minimum, without dry friction that is not seen, and its uncertainty."""
    spread = end.problem.spread
    end = _without_what_is_not_seen(end)
    _, _, matrix = end.problem.look(end.x, end.problem.stages[-1])
    # Friction that was left out might exist, as far as the recording shows.
    bent = np.linalg.inv(matrix + np.diag(spread**-2 - end.problem.spread**-2))
    least, largest = np.sort(end.problem.states[1:, LEAST]), np.sort(end.problem.states[1:, LARGEST])
    return Fit(
        contact=end.problem.contact,
        parameters=end.x,
        covariance=bent @ _scatter(end.problem) @ bent + bent,
        rms=end.sizes,
        counts=end.problem.counts,
        torques=(float(least[2]), float(largest[-3])),
        start=float(end.problem.recording.load[0]),
    )


def _without_what_is_not_seen(end: Minimum) -> Minimum:
    """Return a minimum without dry friction, of either side, that explains almost nothing."""
    for index in (COULOMB_M, COULOMB_L):
        prior, spread, x = end.problem.prior.copy(), end.problem.spread.copy(), end.x.copy()
        prior[index], spread[index], x[index] = 0.0, _NONE, 0.0
        found = replace(end.problem, prior=prior, spread=spread).solve(x, end.problem.stages[-1], 8, 0.02)
        if found.cost < end.cost + _WORTH * found.problem.recording.time.size:
            end = found
    return end


_TOGETHER = 13
"""Number of samples beyond which innovations are uncorrelated."""


def _scatter(problem: Problem) -> Array:
    """Return the covariance of the gradient."""
    nu = problem.innovations[1:]
    scores = np.einsum("ki,kij->kj", nu / np.sqrt(1.0 + (nu / _KNEE) ** 2), problem.derivatives[1:])
    return newey_west(scores, _TOGETHER)
