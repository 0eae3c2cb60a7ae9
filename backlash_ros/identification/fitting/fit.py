"""Finds the likeliest parameters and noise for a recording of both encoders, with uncertainties.

The free law of the teeth is tried from many widths, walls, inertias and delays with much noise and in coarse steps; the
best of them are improved, with the noise in turn. The told law begins where the free one ended. Then another gap is
looked for with more noise, and a better model with less.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.foundation.record import Array, row_of
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.fitting.candidates import Candidate, Shape, free_teeth, told_contact, told_teeth
from backlash_ros.identification.fitting.memory import COARSE, Results, trace_at
from backlash_ros.identification.fitting.parameters import (
    Parameters,
    parameters_at,
    parameters_of,
    place_of,
    places_of,
)
from backlash_ros.identification.fitting.problem import (
    KNEE,
    LEAST_NOISE,
    MOST_NOISE,
    Beliefs,
    Effort,
    Point,
    Problem,
    Unexplained,
    loss_of,
    motor_side,
    unexplained_at,
)
from backlash_ros.identification.newey_west import newey_west
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.regression import Guess, guess_of

PASSES = 400.0
"""Passes of the filter over all of a recording after which a search ends: seconds of work."""
LOUD = np.log(row_of(Unexplained, motor=1.8e-2, load=3.7e-2, teeth=0.1, timing=1e-2))
"""Noise with which the search begins: large, so that a poor start lets the search see far; tuned."""
_WIDTHS = (1.1, 0.9, 0.75, 0.6, 0.45, 0.3, 0.18)
"""Gaps to begin with, as shares of the shafts' relative travel; tuned."""
_INERTIAS = (0.1, 0.4)
"""Inertias of the load over that of the motor that are tried beside a guess; tuned."""
_OTHER = 0.7
"""By how much, as ln, these have to differ from the guess: a factor of two."""
_LIGHTEST = 0.03
"""Least inertia of the load over that of the motor that a guess may have; tuned."""
_HEAVIEST = 30.0
"""Largest inertia of the load over that of the motor that a guess may have; tuned."""
_KEPT = 3
"""Number of starts that are improved; tuned."""
_APART = 0.03
"""By how much, as ln, two gaps differ to count as two: 3 %."""
_HOPELESS = 3000.0
"""Cost by which a start is worse than the best one and still improved; tuned."""
_TOLD = 0.02
"""Cost for each sample by which the told law must be better than the free one; tuned."""
_MOST_TEETH = 0.06
"""Largest unexplained share of the teeth's torque with which the told law is believed, if the free law has it, too."""
_LEAST_EXPONENT = -0.1
"""Smallest exponent of the free law, as logarithm: a little below that of a straight line; tuned."""
_MOST_EXPONENT = 0.9
"""Largest exponent of the free law, as logarithm, 2.5, where Hertz's teeth have 1.5; tuned."""
_MOST_LOSS = 0.95
"""Largest loss of a gear, a share; tuned."""
_SOME_LOSS = 0.02
"""Loss with which the search for one begins; tuned."""
_OPPOSITE = 60.0
"""Cost for each sample by which the command of the other sign is worse, at least, where it is not looked into."""
_ELSEWHERE = 12
"""Number of other gaps that are looked at; tuned."""
_NARROWEST = 0.05
"""Half of the smallest of them, a share of the travel; tuned."""
_WIDEST = 0.6
"""Half of the largest of them, a share of the travel: at 0.5 the gap is the travel itself."""
_QUIETER = np.array([[0.0, 0.0, 1.4, 0.0], [1.0, 1.0, 1.4, 1.4]])
"""What the noise is lowered by, as logarithms, to look for a better model: of the teeth alone, then all; tuned."""
_LOUDER = 0.7
"""By how much, as logarithm, a noise is above its least for that: a factor of two."""
_TOGETHER = 13
"""Number of samples beyond which innovations are uncorrelated."""
_STEEPEST = 0.2
"""Largest growth of the load torque with the load's angle that is a weight's, as a share of the stall torque, 1/rad."""
_STANDS_OUT = 4.0
"""Smallest slope of the load torque, in its standard deviations by the noise, that counts as one."""
_INF = math.inf
_WALLS = ("ln_half_gap", "offset")
"""What says where the flanks are."""


def shape_of(teeth: Candidate, parameters: Array) -> Shape:
    """Return the shape of the teeth by the parameters."""
    x = parameters_at(parameters)
    stiffness, damping, rebound, exponent = (
        math.exp(value) for value in (x.ln_stiffness, x.ln_damping, x.ln_rebound, x.ln_exponent)
    )
    return Shape(stiffness, damping, rebound, exponent, teeth.depth)


class Law(NamedTuple):
    """The end of a search with one law of the teeth: the gap, rad, and its cost for each sample."""

    gap: float
    cost: float


@dataclass(frozen=True)
class Fit:
    """The likeliest parameters of the filter, and their ``covariance``; ``by_noise``: what it would be by noise alone.

    ``teeth`` as they were fitted; ``noise``: the unexplained torque of motor and load, as shares of the stall torque,
    of the teeth, as a share, and of the time, as a share of a period; ``rms`` of both innovations, in standard
    deviations by that noise; ``counts`` of both encoders, rad; ``torques``: smallest and largest torque of the teeth
    in a few samples, N m; ``start``: the first reading of the load, rad; ``laws``: the ends with each law;
    ``exhausted``: whether the search ended after `PASSES` before it converged; ``load_radius`` R2, m, and
    ``standstill_torque``, N m, of the drive.
    """

    teeth: Candidate
    parameters: Array
    covariance: Array
    by_noise: Array
    noise: tuple[float, float, float, float]
    rms: tuple[float, float]
    counts: tuple[float, float]
    torques: tuple[float, float]
    load_radius: float
    standstill_torque: float
    start: float = 0.0
    laws: tuple[Law, ...] = ()
    exhausted: bool = False

    @property
    def values(self) -> Parameters:
        """The parameters by name."""
        return parameters_at(self.parameters)

    def variance(self, name: str, other: str = "") -> float:
        """Return the variance of a parameter, or its covariance with another one."""
        return float(self.covariance[place_of(name), place_of(other or name)])

    @property
    def gap(self) -> float:
        """The backlash where the load started, rad at the output."""
        return 2.0 * math.exp(self.values.ln_half_gap)

    @property
    def delay(self) -> float:
        """Time from a sample to when its command acts, s."""
        return float(self.values.delay)

    @property
    def scale(self) -> float:
        """Relative scale error of the load's encoder."""
        return float(self.values.load_scale_error)

    @property
    def shape(self) -> Shape:
        """The teeth's stiffness, damping, rebound and exponent."""
        return shape_of(self.teeth, self.parameters)

    @property
    def steeper(self) -> bool:
        """Whether the free law would be steeper if it might: teeth that it does not contain."""
        return steeper(self.teeth, self.parameters)

    @property
    def bearing(self) -> float:
        """Half of what the less loaded flank bore, N m: where the wind-up of the free law is stated."""
        return 0.5 * max(min(-self.torques[0], self.torques[1]), 1e-6)

    def wind_up(self) -> tuple[float, float]:
        """Return the free teeth's wind-up where they bear `bearing`, and its standard deviation, rad/(N m)."""
        shape, torque = self.shape, self.bearing
        depth = self.teeth.twist(shape, 0.0, torque)
        log = math.log(torque * shape.exponent / (shape.stiffness * shape.depth))
        slopes = np.array([-1.0, 1.0 - log]) / shape.exponent
        places = places_of("ln_stiffness", "ln_exponent")
        part = self.covariance[np.ix_(places, places)]
        return depth / torque, depth / torque * math.sqrt(max(float(slopes @ part @ slopes), 0.0))

    @property
    def contact(self) -> Contact:
        """The teeth as a contact law of a drive; for the free law the spring and damper like it at `bearing`."""
        shape = self.shape
        if self.teeth.contact is not None:
            return _scaled(self.teeth.contact, shape.stiffness)
        damping = shape.damping + 0.5 * shape.rebound * self.bearing
        return ElasticContact(
            wind_up=min(max(self.wind_up()[0], 1e-9), 1e3), damping=min(damping / self.load_radius**2, 1e8)
        )

    @property
    def load_torque(self) -> dict[str, Any]:
        """The load torque as `ServoSettings` expect it, by name: at the start, N m, there, rad, and its slope, N m/rad.

        A slope that does not stand out is 0: most loads have none. So is one that is steeper than that of a weight
        which the motor moves: a load that is not rigid shows such slopes.
        """
        slope, deviation = float(self.values.load_torque_slope), math.sqrt(max(self.variance("load_torque_slope"), 0.0))
        weight = _STANDS_OUT * deviation < abs(slope) <= _STEEPEST * self.standstill_torque
        return {
            "expected_load_torque": float(self.values.load_torque),
            "expected_load_torque_angle": self.start,
            "expected_load_torque_slope": slope if weight else 0.0,
        }

    @property
    def unexplained(self) -> dict[str, float]:
        """The torques that nothing explains as `ServoSettings` have them, by name, N m.

        The motor's is what exceeds the errors of the filter itself.
        """
        motor, load = self.noise[0] - math.exp(unexplained_at(LEAST_NOISE).motor), self.noise[1]
        return {
            "unexplained_motor_torque": max(motor, 0.0) * self.standstill_torque,
            "unexplained_load_torque": load * self.standstill_torque,
        }

    @property
    def pull(self) -> float:
        """How much the errors that are left pull the gap, over what the noise would: less than 1 by a true model.

        By Huber's sandwich over the covariance by noise alone.
        """
        at = place_of("ln_half_gap")
        return math.sqrt(max(self.variance("ln_half_gap") / float(self.by_noise[at, at]) - 1.0, 0.0))

    @property
    def gap_deviation(self) -> float:
        """Its standard deviation by the noise and by the errors that are left, rad."""
        return self.gap * math.sqrt(self.variance("ln_half_gap"))


def _scaled(contact: Contact, force: float) -> Contact:
    """Return teeth with the force scaled by a factor."""
    powers = {"stiffness": 1, "damping": 1, "wind_up": -1}
    changes = {
        part.name: getattr(contact, part.name) * force ** powers[part.name]
        for part in fields(contact)
        if part.name in powers
    }
    return replace(contact, **changes)


def steeper(teeth: Candidate, parameters: Array) -> bool:
    """Return whether the free law would be steeper if it might: teeth that it does not contain."""
    return teeth.free and bool(parameters_at(parameters).ln_exponent > _MOST_EXPONENT - 0.05)


def half_gap_of(parameters: Array) -> float:
    """Return half the gap, rad."""
    return math.exp(parameters_at(parameters).ln_half_gap)


def resized(parameters: Array, way: float, half: float) -> Array:
    """Return parameters with half a gap of ``half``, rad, and the wall at the side of ``way`` where it was."""
    other = parameters.copy()
    x = parameters_at(other)
    x.offset += way * (half_gap_of(parameters) - half)
    x.ln_half_gap = math.log(half)
    return other


class Found(NamedTuple):
    """A point and the problem that it belongs to."""

    point: Point
    problem: Problem


def _cost(found: Found) -> float:
    return found.point.cost


def _ln_apart(one: Point, other: Point) -> float:
    """Return how far the gaps of two points differ, as a logarithm."""
    return float(abs(parameters_at(one.parameters).ln_half_gap - parameters_at(other.parameters).ln_half_gap))


class Search:
    """The search in one recording of both encoders.

    Parameters
    ----------
    drive : for its motor and gear, and the told law of the teeth
    torque : the largest that may act, N m at the output
    delays : starting values of the time from a sample to when its command acts, s
    """

    def __init__(self, drive: Drive, recording: Recording, torque: float, delays: Iterable[float]) -> None:
        self.recording, self.torque, self.side = recording, torque, motor_side(drive)
        self.counts = count_of(recording.motor), count_of(recording.load)
        self.effort = Effort(PASSES)
        travel = recording.travel
        self.middle = 0.5 * float(np.min(travel) + np.max(travel))
        self.travel = max(float(np.ptp(travel)), 1e-6)
        self.free = free_teeth(0.025 * self.travel)
        self.told = told_teeth(drive, told_contact(drive))
        self._drive = drive
        self._period = float(np.median(np.diff(recording.time)))
        self._guesses = sorted(
            ((guess_of(self.side, recording, delay), delay) for delay in delays), key=lambda pair: pair[0].misfit
        )

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.recording.time.size

    def _start(self, guess: Guess, delay: float, inertia: float, share: float, way: float) -> Array:
        """Return the free law's parameters with a gap of a ``share`` of the travel, at its end of one ``way``."""
        half, side = 0.5 * share * self.travel, self.side
        stiffness = 0.25 * self.torque / (0.1 * half)
        mass = inertia * side.inertia / (inertia + side.inertia)
        return parameters_of(
            ln_half_gap=math.log(half),
            offset=self.middle + way * (0.5 * self.travel - half),
            ln_stiffness=math.log(stiffness),
            ln_damping=math.log(0.2 * math.sqrt(stiffness * mass)),
            ln_rebound=math.log(2.0 * math.sqrt(side.inertia / (self.torque * self.travel))),
            ln_exponent=0.12,
            ln_load_inertia=math.log(inertia),
            ln_load_viscous=math.log(max(guess.viscous, 5e-5 * self.torque)),
            load_coulomb=guess.coulomb_l,
            load_torque=guess.load_torque,
            motor_coulomb=guess.coulomb_m,
            delay=delay,
        )

    def _clipped(self, inertia: float) -> float:
        return min(max(inertia, _LIGHTEST * self.side.inertia), _HEAVIEST * self.side.inertia)

    def problem(self, teeth: Candidate, start: Array) -> Problem:
        """Return the problem with some teeth, to begin at ``start``."""
        return Problem(
            self.side, teeth, self.recording, self.torque, self._beliefs(teeth, start), self.counts, self.effort
        )

    def _beliefs(self, teeth: Candidate, start: Array) -> Beliefs:
        stiffness = math.log(self.torque / self.travel) if teeth.free else 0.0
        return Beliefs(
            mean=self._mean(teeth, start),
            spread=self._spread(free=teeth.free),
            low=self._low(parameters_at(start), stiffness, free=teeth.free),
            high=self._high(parameters_at(start), stiffness, free=teeth.free),
            largest=parameters_of(
                _INF,
                ln_half_gap=0.3,
                gap_slope=0.1,
                ln_stiffness=0.7,
                ln_damping=0.7,
                ln_rebound=1.0,
                ln_exponent=0.2,
                ln_load_inertia=0.7,
                ln_load_viscous=1.0,
                gear_loss=0.1,
                load_scale_error=0.01,
                ln_motor_gain=0.2,
                ln_motor_braking=0.2,
            ),
        )

    @staticmethod
    def _mean(teeth: Candidate, start: Array) -> Array:
        """Return what is expected: the start, a motor as told, and an even gap without a loss."""
        mean = start.copy()
        x = parameters_at(mean)
        x.gap_slope = x.load_torque_slope = x.load_scale_error = x.gear_loss = 0.0
        x.ln_motor_gain = x.ln_motor_braking = 0.0
        x.ln_exponent = 0.15 if teeth.free else 0.0
        if not teeth.free:
            x.ln_stiffness = x.ln_damping = x.ln_rebound = 0.0
        return mean

    def _spread(self, *, free: bool) -> Array:
        """Return how far from that the parameters may be; the force of a told law is known to 5 %."""
        return parameters_of(
            1.0,
            ln_half_gap=3.0,
            offset=1.0,
            gap_slope=0.2,
            ln_stiffness=2.0 if free else 0.05,
            ln_damping=2.0,
            ln_rebound=2.0,
            ln_exponent=0.2,
            ln_load_inertia=3.0,
            ln_load_viscous=3.0,
            load_coulomb=self.torque,
            load_torque=self.torque,
            load_torque_slope=0.05 * self.torque,
            motor_coulomb=self.torque,
            gear_loss=0.1,
            load_scale_error=0.005,
            delay=2.0 * self._period,
            ln_motor_gain=0.15,
            ln_motor_braking=0.15,
        )

    def _low(self, start: Parameters, stiffness: float, *, free: bool) -> Array:
        """Return the least values: far below those of any drive, and no friction, loss or delay below 0."""
        return parameters_of(
            -_INF,
            ln_half_gap=math.log(1e-3 * self.travel),
            ln_stiffness=stiffness - (3.0 if free else 1.0),
            ln_damping=start.ln_damping - 12.0,
            ln_rebound=start.ln_rebound - 7.0,
            ln_exponent=_LEAST_EXPONENT,
            ln_load_inertia=math.log(self.side.inertia) - 9.0,
            ln_load_viscous=math.log(1e-7 * self.torque),
            load_torque=-20.0 * self.torque,
            load_coulomb=0.0,
            motor_coulomb=0.0,
            gear_loss=0.0,
            delay=0.0,
            ln_motor_gain=-1.0,
            ln_motor_braking=-1.0,
            dead_band=0.0,
        )

    def _high(self, start: Parameters, stiffness: float, *, free: bool) -> Array:
        """Return the largest values: far above those of any drive; no loss, which `with_losses` allows later."""
        return parameters_of(
            _INF,
            ln_half_gap=math.log(3.0 * self.travel),
            ln_stiffness=stiffness + (12.0 if free else 1.0),
            ln_damping=start.ln_damping + 7.0,
            ln_rebound=start.ln_rebound + 6.0,
            ln_exponent=_MOST_EXPONENT,
            ln_load_inertia=math.log(self.side.inertia) + 7.0,
            ln_load_viscous=math.log(1e2 * self.torque),
            load_torque=20.0 * self.torque,
            gear_loss=0.0,
            delay=20.0 * self._period,
            ln_motor_gain=1.0,
            ln_motor_braking=1.0,
            dead_band=0.0,
        )

    def starts(self) -> Iterable[Array]:
        """Yield gaps of any width, in the middle of the travel or at its ends, with light and heavy loads."""
        unit = self.side.inertia
        for rank, (guess, delay) in enumerate(self._guesses[:2]):
            near = self._clipped(guess.inertia)
            others = [share * unit for share in _INERTIAS if abs(math.log(share * unit / near)) > _OTHER]
            for inertia in (near, *others) if rank == 0 else (near,):
                for share in _WIDTHS:
                    for way in (0.0, 1.0, -1.0) if share < 1.0 else (0.0,):
                        yield self._start(guess, delay, inertia, share, way)

    def of_free(self) -> Found | None:
        """Return the free law's end; None if every start leaves all bounds."""
        tried = []
        for k, start in enumerate(self.starts()):
            problem = self.problem(self.free, start)
            tried.append((problem.cost(start, LOUD, COARSE), k, Found(Point(_INF, start, LOUD), problem)))
        best = sorted(each for each in tried if math.isfinite(each[0]))[:_KEPT]
        ends = sorted((Found(f.problem.solve(f.point, 5, 3.0, COARSE), f.problem) for *_, f in best), key=_cost)
        if not ends or not math.isfinite(_cost(ends[0])):
            return None
        first = ends[0]
        others = [
            end
            for end in ends[1:]
            if _ln_apart(end.point, first.point) > _APART and _cost(end) < _cost(first) + _HOPELESS
        ]
        found = []
        for point, problem in (first, *others[:1]):
            begun = problem.tune(problem.solve(point, 4, 1.0), 2, 1.0)
            found.append(Found(problem.settle(begun, 3, 3, 2.0), problem))
        point, problem = min(found, key=_cost)
        return self.with_losses(Found(problem.settle(point, 6, 4, 2.0), problem))

    def with_losses(self, found: Found) -> Found:
        """Return where the search ends with a gear that may lose torque: from the start, losses lead it astray."""
        high = found.problem.beliefs.high.copy()
        parameters_at(high).gear_loss = _MOST_LOSS
        problem = replace(found.problem, beliefs=found.problem.beliefs._replace(high=high))
        start = found.point.parameters.copy()
        parameters_at(start).gear_loss = _SOME_LOSS
        end = problem.settle(Point(_INF, start, found.point.noise), 3, 4, 2.0)
        return Found(min(found.point, end, key=lambda point: point.cost), problem)

    def of_told(self, free: Point) -> Found:
        """Return the told law's end, from where the free law ended."""
        start = free.parameters.copy()
        x = parameters_at(start)
        x.ln_stiffness = x.ln_damping = x.ln_rebound = x.ln_exponent = 0.0
        problem = self.problem(self.told, start)
        tried = [resized(start, 0.0, factor * half_gap_of(start)) for factor in (0.9, 1.0, 1.12, 1.25)]
        costs = [problem.cost(parameters, free.noise) for parameters in tried]
        begun = Point(_INF, tried[int(np.argmin(costs))], free.noise)
        end = problem.settle(problem.solve(begun, 5, 1.0), 2, 3, 2.0)
        found, outside = Found(end, problem), steeper(self.free, free.parameters)
        return self.with_losses(found) if end.cost < free.cost or outside else found

    def elsewhere(self, found: Found) -> Found:
        """Return a likelier point with another gap, if there is one."""
        best, problem = found
        loud = np.minimum(best.noise + 1.15, MOST_NOISE)
        scan: list[tuple[float, int, Array]] = []
        for half in np.geomspace(_NARROWEST, _WIDEST, _ELSEWHERE) * self.travel:
            if abs(math.log(half / half_gap_of(best.parameters))) > 3.0 * _APART:
                for way in (1.0, -1.0):
                    other = resized(best.parameters, way, float(half))
                    scan.append((problem.cost(other, loud, COARSE), len(scan), other))
        limit = problem.cost(best.parameters, loud, COARSE) + 100.0
        for cost, _, other in sorted(scan, key=lambda each: each[:2])[:2]:
            if not math.isfinite(cost) or self.effort.spent:
                continue
            end = problem.solve(Point(cost, other, loud), 5, 2.0, COARSE)
            if end.cost < limit and _ln_apart(end, best) > _APART:
                end = problem.settle(problem.tune(end, 2, 2.0), 4, 3, 2.0)
                best = min(best, end, key=lambda point: point.cost)
        return Found(best, problem)

    def quieter(self, found: Found) -> Found:
        """Return a likelier point with less noise, if there is one."""
        best, problem = found
        for lower in _QUIETER:
            noise = np.maximum(best.noise - lower, LEAST_NOISE)
            if self.effort.spent or np.all(best.noise - noise < _LOUDER):
                continue
            end = problem.solve(Point(_INF, best.parameters, noise), 6, 2.0)
            if math.isfinite(end.cost):
                end = problem.settle(problem.tune(end, 1, 2.0), 2, 4, 2.0)
                best = min(best, end, key=lambda point: point.cost)
        return Found(best, problem)

    def reversed(self, found: Found) -> bool:
        """Return whether the motion is explained better by the command of the other sign."""
        recording = self.recording._replace(command=-self.recording.command)
        problem = replace(found.problem, recording=recording, effort=Effort())
        least = found.point.cost + _OPPOSITE * self.size
        if problem.cost(found.point.parameters, found.point.noise) > least:
            return False
        other = Search(self._drive, recording, self.torque, [delay for _, delay in self._guesses]).of_free()
        return other is not None and other.point.cost < found.point.cost

    def without_far_flank(self, found: Found, enough: float) -> float:
        """Return by how much a model without a far flank is worse.

        It is infinite if no torque holds the load on one flank. The search ends once it is less than ``enough``.
        """
        best, x = found.point, parameters_at(found.point.parameters)
        torque = float(x.load_torque)
        if abs(torque) < max(0.5 * x.load_coulomb, 0.01 * self.torque):
            return _INF
        other = resized(best.parameters, -math.copysign(1.0, torque), 2.0 * self.travel)
        beliefs, low = found.problem.beliefs, found.problem.beliefs.low.copy()
        parameters_at(low).ln_half_gap = math.log(0.65 * self.travel)
        problem = replace(found.problem, beliefs=beliefs._replace(low=low), effort=Effort(60.0))
        point = problem.solve(Point(_INF, other, np.maximum(best.noise, LOUD)), 5, 2.0, COARSE)
        point = problem.tune(point, 2, 2.0)
        for _ in range(4):
            before = point.cost
            point = problem.settle(point, 1, 3, 2.0)
            if point.cost < best.cost + enough or not point.cost < before - 0.02 * enough:
                break
        return point.cost - best.cost

    def flanks_by_halves(self, found: Found) -> list[tuple[float, float]]:
        """Return by how much each flank differs between both halves of the recording, and its deviation, rad."""
        best = found.point
        middle = _calm(self.recording)
        beliefs = found.problem.beliefs
        tight = parameters_of(1e-7, ln_half_gap=3.0, offset=1.0)
        places = []
        found.problem.cost(best.parameters, best.noise)
        states = found.problem.results.states[[0, middle]].copy()
        for rows, state in zip((slice(0, middle + 1), slice(middle, self.size)), states, strict=True):
            part = replace(
                found.problem,
                recording=self.recording.part(rows),
                beliefs=beliefs._replace(mean=best.parameters, spread=tight),
                effort=Effort(40.0),
                whole=self.size,
            )
            part.results.states[0] = state
            end = part.solve(best, 10, 0.1)
            cost, _, matrix = part.look(end.parameters, best.noise)
            if not math.isfinite(cost):
                return [(_INF, 0.0)] * 2
            covariance, half = np.linalg.inv(matrix), half_gap_of(end.parameters)
            by = [np.array([side * half, 1.0]) for side in (1.0, -1.0)]
            block = covariance[np.ix_(places_of(*_WALLS), places_of(*_WALLS))]
            deviations = [math.sqrt(max(float(each @ block @ each), 0.0)) for each in by]
            places.append(
                [
                    (parameters_at(end.parameters).offset + side * half, d)
                    for side, d in zip((1, -1), deviations, strict=True)
                ]
            )
        return [(abs(a[0] - b[0]), max(a[1], b[1])) for a, b in zip(*places, strict=True)]

    def result(self, found: Found, laws: Sequence[Law]) -> Fit:
        """Return the fit at the end of a search."""
        fitted = fit_of(found, laws, self._drive)
        return replace(fitted, exhausted=self.effort.spent)


def _calm(recording: Recording) -> int:
    """Return the row near the middle around which the shafts move least, with both angles."""
    size = recording.time.size
    rows = range(int(0.35 * size), max(int(0.65 * size), int(0.35 * size) + 1))
    both = recording.motor + recording.load

    def motion(row: int) -> float:
        near = slice(max(row - 4, 0), row + 8)
        moved = np.ptp(recording.motor[near]) + np.ptp(recording.load[near])
        return float(moved) if math.isfinite(moved) else _INF

    return min((row for row in rows if math.isfinite(both[row])), key=motion, default=int(0.5 * size))


def torques_of(results: Results) -> tuple[float, float]:
    """Return the smallest and the largest torque of the teeth in a few samples, N m, after a pass of the filter."""
    traces = [trace_at(row) for row in results.states[1:]]
    least = np.sort([trace.least_torque for trace in traces])
    largest = np.sort([trace.largest_torque for trace in traces])
    few = min(2, least.size - 1)
    return float(least[few]), float(largest[-1 - few])


def fit_of(found: Found, laws: Sequence[Law], drive: Drive) -> Fit:
    """Return the result at a point, and its uncertainty by Huber's sandwich with Newey and West's scores."""
    point, problem = found
    _, gradient, matrix = problem.look(point.parameters, point.noise)
    innovations = problem.results.innovations[1:]
    weighed = innovations / np.sqrt(1.0 + (innovations / KNEE) ** 2)
    # What is pressed against a bound, such as a loss of 0, is there, and makes nothing else uncertain.
    held = problem.pressed(point.parameters, gradient)
    apart = np.diag(np.diag(matrix))
    bent = np.linalg.inv(np.where(held[:, None] | held, apart, matrix))
    scores = newey_west(np.einsum("ki,kij->kj", weighed, problem.results.derivatives[1:]), _TOGETHER)
    sizes = np.sqrt(np.mean(loss_of(innovations), axis=0))
    motor, load, share, timing = (float(value) for value in np.exp(point.noise))
    return Fit(
        teeth=problem.teeth,
        parameters=point.parameters,
        covariance=bent @ scores @ bent + bent,
        by_noise=bent,
        noise=(
            motor,
            load * math.exp(parameters_at(point.parameters).ln_load_inertia) / problem.side.inertia,
            share,
            timing,
        ),
        rms=(float(sizes[0]), float(sizes[1])),
        counts=problem.counts,
        torques=torques_of(problem.results),
        load_radius=drive.gear.load_radius,
        standstill_torque=drive.standstill_torque(),
        start=float(problem.recording.load[0]),
        laws=tuple(laws),
    )


def search_all(
    drive: Drive, recording: Recording, torque: float, delays: Iterable[float]
) -> tuple[Search, Found, list[Law]] | None:
    """Return the likeliest point of both laws and how it was found; None if no start explains anything.

    Parameters
    ----------
    drive : for its motor and gear, and the told law of the teeth
    delays : starting values of the time from a sample to when its command acts, s
    torque : the largest that may act, N m at the output

    Notes
    -----
    The search takes at most `PASSES` of the filter: seconds.
    """
    search = Search(drive, recording, torque, delays)
    free = search.of_free()
    if free is None:
        return None
    told = search.of_told(free.point)
    laws = [Law(2.0 * half_gap_of(f.point.parameters), f.point.cost / search.size) for f in (free, told)]
    explains = unexplained_at(told.point.noise).teeth < math.log(_MOST_TEETH) or steeper(
        search.free, free.point.parameters
    )
    better = laws[1].cost < laws[0].cost - _TOLD and explains
    best = told if better else free
    best = search.quieter(search.elsewhere(best))
    return search, Found(best.problem.settle(best.point, 6, 8, 0.5), best.problem), laws


def fit(drive: Drive, recording: Recording, torque: float, delays: Iterable[float]) -> Fit | None:
    """Return the likeliest fit of a recording: see `search_all`."""
    found = search_all(drive, recording, torque, delays)
    return None if found is None else found[0].result(found[1], found[2])


def compile_filters(contacts: Iterable[type[Contact]]) -> None:
    """Compile the functions of fits, so that processes that fit find the code."""
    drive, still = NOMINAL_DRIVE, np.zeros(3)
    recording = Recording(np.array([0.0, 0.004, 0.008]), still, still, still, still)
    start, wide = parameters_of(ln_load_inertia=-7.0, ln_load_viscous=-7.0, ln_half_gap=-4.0), parameters_of(1.0)
    beliefs = Beliefs(start, wide, -wide, wide, wide)
    for teeth in (free_teeth(1e-3), *(told_teeth(drive, law()) for law in contacts)):
        Problem(motor_side(drive), teeth, recording, 1.0, beliefs, (1e-4, 1e-4)).look(start, LOUD)
