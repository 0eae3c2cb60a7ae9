"""A drive with delay: its samples are old when they arrive, and its commands act some time after they were sent.

Sample k arrives at k T and was taken at k T - d_s; the command that answers it acts from k T + d_c on. Both delays may
be any number of periods, also fractions, with uniform jitter. A command never acts before an older one. With jitter of
the stamps a sample was taken earlier or later than its stamp says.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numba
import numpy as np

from backlash_ros.drivetrain.constants import PLANT_TYPE, PlantConstants
from backlash_ros.drivetrain.motion.integrator import Advance, integrator_for
from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.drivetrain.sensors import NOISE_STREAMS, uniform
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array, Record, row_of, size_of, view_of
from backlash_ros.foundation.signals import PlantState, at_rest

LINE = 64
"""Largest number of samples and commands in transit."""

_SLIVER = 1e-9
"""Share of a period that rounding may leave, and no step is worth."""

_SAMPLE_STREAM, _COMMAND_STREAM, _STAMP_STREAM = range(NOISE_STREAMS, NOISE_STREAMS + 3)


@dataclass(frozen=True)
class Delay(Validated):
    """Delays of a drive, of samples and of commands; 0 by default."""

    section: ClassVar[str] = "delay"

    sample: float = quantity("delay from the measurement to the controller's tick", "s", at_most=1.0, default=0.0)
    command: float = quantity("delay from the controller's tick to the motor", "s", at_most=1.0, default=0.0)
    sample_jitter: float = quantity(
        "largest extra delay of a sample, uniformly distributed", "s", at_most=1.0, default=0.0
    )
    command_jitter: float = quantity(
        "largest extra delay of a command, uniformly distributed", "s", at_most=1.0, default=0.0
    )

    stamp_jitter: float = quantity(
        "largest time between the measurement and its stamp, uniformly distributed both ways; stamps are older by it",
        "s",
        at_most=1.0,
        default=0.0,
    )

    @property
    def mean(self) -> float:
        """Mean of both together, s: what a design takes into account."""
        return self.sample + self.command + 0.5 * (self.sample_jitter + self.command_jitter) + self.stamp_jitter

    def check_line(self, period: float) -> None:
        """Raise ValueError if more would be in transit than a simulation stores, at a period in s."""
        for way in ("sample", "command"):
            longest = getattr(self, way) + getattr(self, f"{way}_jitter")
            longest += 2.0 * self.stamp_jitter if way == "sample" else 0.0
            if longest > (LINE - 2) * period:
                raise ValueError(
                    f"delay.{way} + delay.{way}_jitter must be <= {LINE - 2} periods, {(LINE - 2) * period:g} s, "
                    f"got {longest:g}"
                )


class DelayConstants(NamedTuple):
    """The delay as the compiled step reads it, s."""

    period: float
    sample: float
    command: float
    sample_jitter: float
    command_jitter: float
    stamp_jitter: float
    seed: int


def delay_constants(delay: Delay, period: float, seed: int = 0) -> DelayConstants:
    """Return the delay for the compiled step, at a period in s."""
    delay.check_line(period)
    return DelayConstants(
        float(period),
        float(delay.sample),
        float(delay.command),
        float(delay.sample_jitter),
        float(delay.command_jitter),
        float(delay.stamp_jitter),
        int(seed),
    )


class InForce(Record):
    """Which command acts, and what comes next."""

    command: float = 0.0  # that acts, V or A
    number: float = -1.0  # of that command
    sample: float = 0.0  # number of the next command to be sent


class Sent(Record):
    """A command in transit."""

    command: float = 0.0  # V or A
    acts_at: float = 0.0  # s from the start


in_force_at, sent_at = view_of(InForce), view_of(Sent)


class Line(NamedTuple):
    """The delay, and the samples and commands in transit.

    ``taken`` (LINE, 7): states at which the next samples are taken, by number modulo LINE. ``sent`` (LINE, 2): the
    commands, each a `Sent`. ``in_force``: an `InForce`.
    """

    delay: DelayConstants
    taken: Array
    sent: Array
    in_force: Array


def line_of(delay: DelayConstants, state: PlantState) -> Line:
    """Return a line in which every sample from before the start shows ``state``, and no command acts."""
    return Line(delay, np.tile(state, (LINE, 1)), np.zeros((LINE, size_of(Sent))), row_of(InForce))


@compiled
def stamped_at(delay: DelayConstants, sample: int) -> float:
    """Return when a sample was taken by its stamp, s from the start."""
    late = delay.sample
    if delay.sample_jitter > 0.0:
        late += delay.sample_jitter * (0.5 + 0.5 * uniform(delay.seed, sample, _SAMPLE_STREAM))
    if delay.stamp_jitter > 0.0:
        late += delay.stamp_jitter
    return sample * delay.period - late


@compiled
def taken_at(delay: DelayConstants, sample: int) -> float:
    """Return when a sample was taken, s from the start: about its stamp, but never after it has arrived."""
    stamp = stamped_at(delay, sample)
    if delay.stamp_jitter > 0.0:
        stamp -= delay.stamp_jitter * uniform(delay.seed, sample, _STAMP_STREAM)
    return stamp


@compiled
def acts_at(delay: DelayConstants, sample: int) -> float:
    """Return when the command that answers a sample begins to act, s from the start."""
    late = delay.command
    if delay.command_jitter > 0.0:
        late += delay.command_jitter * (0.5 + 0.5 * uniform(delay.seed, sample, _COMMAND_STREAM))
    return sample * delay.period + late


_advance: Advance = unbound


@compiled
def _send(line: Line, command: float) -> int:
    """Send a command; return its number."""
    acting = in_force_at(line.in_force)
    k = int(acting.sample)
    acting.sample = k + 1
    sent = sent_at(line.sent[k % LINE])
    sent.command, sent.acts_at = command, acts_at(line.delay, k)
    return k


@compiled
def _next_event(line: Line, k: int, now: float, end: float) -> float:
    """Let the newest command act that has come ``now``; return when the next one comes, s, or ``end`` if none does."""
    begin, slack = k * line.delay.period, _SLIVER * line.delay.period
    acting = in_force_at(line.in_force)
    for j in range(max(int(acting.number) + 1, k - LINE + 1), k + 1):
        sent = sent_at(line.sent[j % LINE])
        due = sent.acts_at - begin
        if due <= now + slack:
            acting.command, acting.number = sent.command, j
        elif due < end - slack:
            end = due
    return end


@compiled
def _ahead(delay: DelayConstants) -> int:
    """Return how many of the next samples may be taken before the one that arrives now has been answered."""
    return 2 + int((delay.sample + delay.sample_jitter + 2.0 * delay.stamp_jitter) / delay.period)


def _play_period(
    plant: PlantConstants,
    state: PlantState,
    step: Array,
    line: Line,
    command: float,
    load_torque: float,
    tolerance: float,
    rows: Array,
) -> tuple[int, float]:
    """Send a command and move the plant on by one period, in place.

    Parameters
    ----------
    step : of `integrator.integration_memory`
    rows : shape (substeps, 5): filled with the states at the ends of equal parts of the period

    Returns
    -------
    (status, passed) : as `advance`
    """
    delay, k = line.delay, _send(line, command)
    begin, substeps, ahead = k * delay.period, rows.shape[0], _ahead(delay)
    slack = _SLIVER * delay.period
    now, row = 0.0, 0
    while True:
        following = _next_event(line, k, now, (row + 1) * delay.period / substeps)
        for j in range(k + 1, k + 1 + ahead):
            due = taken_at(delay, j) - begin
            if now + slack < due < following - slack:
                following = due
        acting = in_force_at(line.in_force).command
        status, passed = _advance(plant, state, step, acting, load_torque, following - now, tolerance)
        if status != 0:
            return status, now + passed
        now = following
        for j in range(k + 1, k + 1 + ahead):
            if abs(taken_at(delay, j) - begin - now) <= slack:
                line.taken[j % LINE, :] = state
        if now >= (row + 1) * delay.period / substeps - slack:
            rows[row, :] = state[:5]
            row += 1
            if row == substeps:
                return 0, delay.period


Player = Callable[[PlantConstants, PlantState, Array, Line, float, float, float, Array], tuple[int, float]]

_types: Any = numba.types
_typeof: Any = numba.typeof
_row, _table, _number = _types.float64[::1], _types.float64[:, ::1], _types.float64
PLAYER_SIGNATURE: Any = _types.Tuple((_types.int64, _number))(
    *(PLANT_TYPE, _row, _row),
    _typeof(line_of(delay_constants(Delay(), 1.0), at_rest())),
    *(_number, _number, _number, _table),
)
"""numba's signature of `Player`."""


def player_for(drive: Drive) -> Player:
    """Return the function that simulates a period of ``drive``, with the integrator of its contact law compiled in."""
    return _player_with(integrator_for(drive))


@cache
def _player_with(advance: Advance) -> Player:
    return specialize(_play_period, PLAYER_SIGNATURE, _advance=advance)
