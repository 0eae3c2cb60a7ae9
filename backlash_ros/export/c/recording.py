"""A recording of the offline loop for the self-test in C: references, plans, lost samples and readings, faults, resets.

The servo of this package holds the simulated drive of the same file; each command and each fault is kept.
"""

from dataclasses import dataclass, field
from itertools import cycle
from typing import NamedTuple

import numpy as np

from backlash_ros.control import Servo
from backlash_ros.control.design.choice import Choice
from backlash_ros.control.motion.setpoint import Polynomials, joined
from backlash_ros.drive_file.drive_file import Surroundings
from backlash_ros.drivetrain import Drive
from backlash_ros.export.sides import speed_limits
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement, at_rest
from backlash_ros.simulation.simulated_drive import SimulatedDrive

NO_EVENT, SET_REFERENCE, FOLLOW, APPLIED, RESET = "NO_EVENT", "SET_REFERENCE", "FOLLOW", "APPLIED", "RESET"
"""What happens before a step, as the self-test calls it."""
PLAN_ROWS = 2
"""Rows of each plan that is followed."""

_WAY = 0.5
"""Largest way of a move, rad, where the travel and ``limits.step`` allow it."""
_APART = 40, 160
"""Least and largest number of samples from one event to the next."""
_QUICK, _QUICK_APART = 12, 5
"""References that keep coming: how many, and samples between them."""
_SEED = 36
_JUMP = 30.0
"""By how much the encoders jump, rad: a fault."""
_SPEED, _SHORTEST = 0.1, 0.1
"""Mean speed of a plan, as a share of the largest, and time that is added to each of its rows, s."""
_ORDER = (
    *("reference", "reference", "plan", "plan", "stream", "late", "reference", "disabled", "plan", "lost", "reset"),
    *("reference", "jump", "reset"),
)
"""What happens in turn. ``late``: a sample is missing; ``disabled``: the drive takes no command for a period; ``lost``:
the load's encoder; ``jump``: the encoders jump."""


class Step(NamedTuple):
    """One sample: what happened before it, with its value, the time since the sample before, s, and the answer."""

    event: str
    value: float
    elapsed: float
    sample: tuple[float, ...]
    command: float
    fault: int


@dataclass
class Recording:
    """All steps, and the rows of the plans that were followed, shape (7,) each."""

    steps: list[Step] = field(default_factory=list)
    plans: list[Array] = field(default_factory=list)


def way_of(choice: Choice) -> tuple[float, float]:
    """Return where a drive is shown, rad, 0 if its travel allows that, and how far it goes from there."""
    limits = choice.limits
    travel = limits.position_upper - limits.position_lower
    way = min(_WAY, 0.2 * travel, 0.4 * limits.step)
    return min(max(0.0, limits.position_lower + 2.0 * way), limits.position_upper - 2.0 * way), way


def record(choice: Choice, drive: Drive, around: Surroundings, steps: int) -> Recording:
    """Record ``steps`` samples of the servo of ``choice`` and of ``drive``, simulated with its sensors and its delay.

    Raises
    ------
    IntegrationError
        If the drive cannot be simulated.
    """
    return _Play(choice, drive, around).played(steps)


class _Play:
    """The loop, and what happens in it."""

    def __init__(self, choice: Choice, drive: Drive, around: Surroundings) -> None:
        self._servo = Servo(choice.drive, choice.settings, choice.limits)
        self._middle, self._way = way_of(choice)
        start = at_rest(self._middle, self._middle / drive.gear.ratio)
        sensors, delay = around.sensors, around.delay
        self._plant = SimulatedDrive(
            drive, choice.settings.period, sensors=sensors, delay=delay, seed=_SEED, state=start
        )
        self._random, self._recording = np.random.default_rng(_SEED), Recording()
        thresholds = choice.settings.thresholds_of(choice.drive)
        self._speed = _SPEED * min(thresholds.velocity, speed_limits(drive)[1])
        both = {"theta_m", "theta_l"} <= set(sensors.measured)
        self._order = cycle(what for what in _ORDER if both or what != "lost")
        self._due, self._quick = 0, 0
        self._jumped = self._lost = self._disabled = False

    def played(self, steps: int) -> Recording:
        """Play and return what was recorded."""
        self._due = self._pause()
        for k in range(steps):
            event, value, elapsed = self._happen(k)
            sample = self._read()
            elapsed += self._plant.elapsed
            command = self._servo.update(sample, elapsed)
            answer = command, int(self._servo.latched)
            self._recording.steps.append(Step(event, value, elapsed, tuple(sample.tolist()), *answer))
            self._plant.advance(0.0 if self._disabled else command)
        return self._recording

    def _pause(self) -> int:
        return int(self._random.integers(*_APART))

    def _read(self) -> Measurement:
        """Return the sample, as it is read wrongly or not at all for a while."""
        sample = Measurement(self._plant.sample().copy())
        if self._jumped:
            sample[THETA_M] += _JUMP
            sample[THETA_L] += _JUMP
        if self._lost:
            sample[THETA_L] = np.nan
        return sample

    def _happen(self, k: int) -> tuple[str, float, float]:
        """Return what happens before sample ``k``, with its value, and the time by which it is late, s."""
        if self._disabled:
            self._disabled, self._servo.command = False, 0.0
            return APPLIED, 0.0, 0.0
        if self._quick and k % _QUICK_APART == 0:
            self._quick -= 1
            return *self._refer(), 0.0
        if k < self._due:
            return NO_EVENT, 0.0, 0.0
        self._due = k + self._pause()
        what = next(self._order)
        self._disabled, self._quick = what == "disabled", _QUICK if what == "stream" else 0
        if what == "late":
            self._plant.sample()
            late = self._plant.elapsed
            self._plant.advance(self._servo.command)
            return NO_EVENT, 0.0, late
        if what in ("jump", "lost"):
            self._jumped, self._lost = what == "jump", what == "lost"
        if what == "reset":
            self._jumped = self._lost = False
            self._servo.reset()
            return RESET, 0.0, 0.0
        happens = {"reference": self._refer, "plan": self._follow}.get(what)
        return *(happens() if happens else (NO_EVENT, 0.0)), 0.0

    def _place(self) -> float:
        return self._middle + float(self._random.uniform(-self._way, self._way))

    def _refer(self) -> tuple[str, float]:
        place = self._place()
        return (NO_EVENT, 0.0) if self._servo.set_reference(place) else (SET_REFERENCE, place)

    def _follow(self) -> tuple[str, float]:
        """Follow a plan over a place at a speed to another place at rest."""
        states = np.zeros((PLAN_ROWS + 1, 3))
        states[0] = self._servo.memory.setpoint
        states[1:, 0] = self._place(), self._place()
        durations = np.abs(np.diff(states[:, 0])) / self._speed + _SHORTEST
        states[1, 1] = 0.5 * (states[2, 0] - states[0, 0]) / np.sum(durations)
        rows = np.hstack([joined(states[:-1], states[1:], durations), durations[:, None]])
        if self._servo.follow(Polynomials(rows)):
            return NO_EVENT, 0.0
        self._recording.plans.extend(rows)
        return FOLLOW, float(len(self._recording.plans) - PLAN_ROWS)
