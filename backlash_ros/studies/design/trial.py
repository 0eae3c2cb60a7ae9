"""Tries a choice of over-damped gains and width on one drive, by simulation, and judges it."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from backlash_ros.control import Gains, GainSet, ServoSettings
from backlash_ros.control.laws.two_region import TwoRegionParameters
from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.simulation import Run, Scenario, run
from backlash_ros.studies.design.uncertainty import Case
from backlash_ros.studies.judging import OVERSHOOT, PRECISE, QUIET, judge_move, recovery, threshold
from backlash_ros.studies.metrics import Array

LAW = "two_region"
STEP, SHORT_STEPS = 1.0, (5.0,)
"""The first step of the reference, rad, and those that follow, in gaps."""
LENGTH = 6.0
"""How long each step is held where a choice is judged, s."""
AIM, MARGIN = 0.4, 0.8
"""Shares of the bounds of `judging` for quiet and precise: what the search aims at, and what it still accepts."""

_GRID = 1e-3


@dataclass(frozen=True)
class Choice:
    """The over-damped ``gains``, and the ``width`` to either side in which they act, over the gap b."""

    gains: Gains
    width: float


@dataclass(frozen=True)
class Loop:
    """The drive as described, its surroundings, and the fast gains.

    ``rate`` in Hz; ``delay`` of the drive's samples and commands.
    """

    drive: Drive
    fast: Gains
    rate: float = 250.0
    sensors: Sensors = field(default_factory=Sensors)
    delay: Delay = field(default_factory=Delay)

    @property
    def count(self) -> float:
        """A count of the load's encoder, rad; 0 for an exact encoder."""
        return 2.0 * math.pi / self.sensors.load_counts if self.sensors.load_counts else 0.0

    def settings(self, choice: Choice) -> ServoSettings:
        """Return the settings of the controller."""
        chosen = GainSet(self.fast, choice.gains)
        settings = ServoSettings(chosen, period=1.0 / self.rate, loop_delay=self.delay.mean)
        settings = replace(settings, backlash_angle=self.drive.gear.backlash_angle)
        return settings.with_law(LAW, TwoRegionParameters(width=choice.width))


@dataclass(frozen=True)
class Outcome:
    """The worst figures of all steps: those of `judging.Move`, and ``precise``, when the load stays within b/10, s.

    ``failure`` says why a run did not reach its end: a latched fault, or a plant that cannot be integrated.
    """

    swing: float = math.inf
    error: float = math.inf
    overshoot: float = math.inf
    settle: float = LENGTH
    precise: float = LENGTH
    rise: float = math.nan
    failure: str = ""

    def excess(self, b: float, count: float, margin: float) -> float:
        """Return by how much swing and error exceed ``margin`` times their bounds; 0 if they do not."""
        if self.failure:
            return 100.0
        allowed = ((self.swing, QUIET), (self.error, PRECISE))
        shares = [seen / max(margin * bound, threshold(0.0, b, count)) for seen, bound in allowed]
        return min(100.0, sum(max(0.0, share - 1.0) for share in shares))

    def overrun(self, b: float, count: float) -> float:
        """Return by how much the overshoot exceeds its bound, as a share of it; 0 if it does not."""
        return min(100.0, max(0.0, self.overshoot / threshold(OVERSHOOT, b, count) - 1.0))


def targets_of(loop: Loop) -> list[float]:
    """Return the reference at each step, rad."""
    targets = [STEP]
    for step in SHORT_STEPS:
        targets.append(targets[-1] + step * loop.drive.gear.backlash_angle)
    return targets


def simulate(loop: Loop, choice: Choice, case: Case, length: float = LENGTH) -> Run:
    """Run the steps on a drive of the range; the controller assumes the drive as described.

    Parameters
    ----------
    length : of each step, s

    Raises
    ------
    IntegrationError
        If the plant cannot be integrated.
    """
    held = round(length * loop.rate)
    reference: Array = np.repeat(targets_of(loop), held)
    substeps = max(1, round(1.0 / (_GRID * loop.rate)))
    torque = np.full((), case.load_torque)
    sensors = replace(loop.sensors, motor_offset=0.0, load_offset=0.0)  # a zero moves the target alone
    scenario = Scenario(reference, torque, sensors=sensors, delay=loop.delay, substeps=substeps)
    return run(case.drive, loop.settings(choice), scenario, model=loop.drive)


def judge(loop: Loop, case: Case, done: Run) -> Outcome:
    """Judge the run of `simulate`, in units of the gap that the drive has."""
    if done.fault:
        return Outcome(failure=done.fault)
    targets = targets_of(loop)
    held = (done.time.size - 1) // len(targets)
    b, count = case.drive.gear.backlash_angle, loop.count
    moves, precise = [], []
    for number, target in enumerate(targets):
        part = slice(number * held, (number + 1) * held + 1)
        time, position = done.time[part] - done.time[part][0], done.load_angle[part]
        moves.append(judge_move(time, position, target, b, count))
        precise.append(recovery(time, position, target, b, count, PRECISE))
    swing, error, overshoot, settle = (
        max(getattr(move, name) for move in moves) for name in ("swing", "error", "overshoot", "settle")
    )
    return Outcome(swing, error, overshoot, settle, max(precise), moves[0].rise)


def attempt(loop: Loop, choice: Choice, case: Case, length: float = LENGTH) -> Outcome:
    """Try a choice on a drive of the range, with steps that are held for ``length``, s."""
    try:
        return judge(loop, case, simulate(loop, choice, case, length))
    except IntegrationError as error:
        return Outcome(failure=f"cannot be simulated: {error}")
