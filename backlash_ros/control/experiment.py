"""The interface of experiments: plain Python beside the tick that excites the drive and ends in a result or a refusal.

The experiments themselves are in `experiments`, one file each.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple, Protocol

from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.markup import pairs
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.signals import Estimate, Measurement
from backlash_ros.identification.fitting.fit import Fit
from backlash_ros.identification.gap_map import GapMap
from backlash_ros.identification.locked_output.lost_motion import LostMotion
from backlash_ros.identification.recordings.findings import Finding


class Excitation(NamedTuple):
    """The excitation for one sample: an ``offset`` on the setpoint, rad, and a ``torque`` at the output, N m.

    The torque is the motor's, at standstill, added to the law's; both together stay within the range. ``calm`` asks for
    the over-damped law from now on, to bring the load to rest.
    """

    offset: float = 0.0
    torque: float = 0.0
    calm: bool = False


class Outcome(Protocol):
    """How an experiment ended: whether it has a result, and from what, or why not."""

    @property
    def valid(self) -> bool:
        """Whether there is a result."""
        ...

    @property
    def reason(self) -> str:
        """The data that the result comes from, or why there is none."""
        ...


@dataclass(frozen=True)
class Refusal:
    """The outcome of an experiment that failed."""

    reason: str
    valid: bool = False


@dataclass(frozen=True)
class Deferred:
    """The outcome of an experiment that has ended but needs computation: ``work`` does it, in any process."""

    work: Callable[[], Outcome]


class Method(Enum):
    """How an estimate was made."""

    GAP_TRAVEL = "gap_travel"
    LOAD_AMPLITUDE = "load_amplitude"
    GAP_PROBE = "gap_probe"
    RELAY = "relay"
    GAP_MAP = "gap_map"
    HYSTERESIS = "hysteresis"
    IDENTIFY = "identify"
    HOMING = "homing"
    SET_ZERO = "set_zero"


def _in_words(value: float, uncertainty: float, unit: str) -> str:
    """Return a value with its standard uncertainty, if known, and no more digits than that leaves a meaning."""
    if uncertainty > 0.0:
        return f"{round(value, 1 - math.floor(math.log10(uncertainty))):.6g} ± {uncertainty:.1g} {unit}".rstrip()
    return f"{value:.6g} {unit}".rstrip()


@dataclass(frozen=True)
class BacklashEstimate:
    """What learning found: ``angle`` and standard ``uncertainty``, rad at the output, both 0 unless ``valid``.

    ``uncertainty`` is also 0 if the method gives none. ``amplitude`` (rad), ``period`` (s) and ``cycles`` are those of
    a limit cycle; ``fit`` is the result of a gap probe, valid or not. ``map`` has the gaps around the turn; ``angle``
    is then the largest, and ``fit`` that of the most certain place. ``lost_motion`` comes from an output at rest.
    """

    angle: float
    method: Method
    valid: bool
    reason: str
    uncertainty: float = 0.0
    amplitude: float = 0.0
    period: float = 0.0
    cycles: int = 0
    fit: Fit | None = field(default=None, repr=False, compare=False)
    map: GapMap | None = None
    lost_motion: LostMotion | None = field(default=None, repr=False, compare=False)

    @property
    def parameters(self) -> dict[str, Any]:
        """What it sets: values by the names of parameters."""
        return {"backlash_angle": self.angle}

    @property
    def uncertainties(self) -> dict[str, float]:
        """Standard uncertainties of what it sets, by name, where they are known."""
        return {"backlash_angle": self.uncertainty} if self.uncertainty > 0.0 else {}

    def _repr_html_(self) -> str:
        """Return what was learned, and from what, or why nothing was, as a table for notebooks."""
        rows = self._found() if self.valid else [("result", "none")]
        return pairs([*rows, ("from" if self.valid else "because", self.reason), ("method", self.method.value)])

    def _found(self) -> list[tuple[str, str]]:
        return [("backlash b", _in_words(self.angle, self.uncertainty, "rad"))]


@dataclass(frozen=True)
class DriveEstimate(BacklashEstimate):
    """What identification found: load, friction, teeth and delay, and the gap, 0 if it was not found.

    ``findings`` have every quantity, or the reason why it is missing. ``drive`` has the values that are parameters, by
    name, beside ``backlash_angle``, and ``deviations`` their standard uncertainties as far as known.
    """

    drive: Mapping[str, Any] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    @property
    def parameters(self) -> dict[str, Any]:
        """What it sets: values by the names of parameters."""
        return {**self.drive, **(super().parameters if self.angle > 0.0 else {})}

    @property
    def uncertainties(self) -> dict[str, float]:
        """Standard uncertainties of what it sets, by name, where they are known."""
        return {**self.deviations, **super().uncertainties}

    def _found(self) -> list[tuple[str, str]]:
        return [
            (f"{each.what}, {each.symbol}", each.why or _in_words(each.value, each.uncertainty, each.unit))
            for each in self.findings
        ]


@dataclass(frozen=True)
class ZeroEstimate(BacklashEstimate):
    """Where the axis' zero is: ``zero``, a reading of the load's angle, rad."""

    zero: float = 0.0

    @property
    def parameters(self) -> dict[str, Any]:
        """What it sets: values by the names of parameters."""
        return {"zero": self.zero}

    @property
    def uncertainties(self) -> dict[str, float]:
        """Nothing is known of them."""
        return {}

    def _found(self) -> list[tuple[str, str]]:
        return [("reading at the zero", _in_words(self.zero, 0.0, "rad"))]


class Experiment(Protocol):
    """One run of an experiment.

    It is stepped before each tick, so that its excitation acts in the sample that it has just seen.
    """

    @property
    def outcome(self) -> Outcome | Deferred | None:
        """How it ended, or the work that will tell; None while it runs."""
        ...

    @property
    def progress(self) -> float:
        """Progress, from 0 to 1."""
        ...

    def step(
        self, measured: Measurement, estimate: Estimate, command: float, elapsed: float, late: float
    ) -> Excitation:
        """Take a sample and return the excitation for it; none once there is an outcome.

        Parameters
        ----------
        measured : this sample
        estimate, command : the observer's estimate at the previous sample, and the command since then, V or A
        elapsed : since the previous sample, s, in whole periods: stamps jitter, the drive's period does not
        late : how much later than usual that command was sent, s; 0 if it was on time
        """
        ...

    def cancel(self, reason: str) -> None:
        """End at once, without a result, for ``reason``."""
        ...


class NamedExperiment(NamedTuple):
    """An experiment that can be chosen.

    Parameters
    ----------
    title : in words
    make : starts a run for a drive, its own parameters, the period of the samples, s, and the limits in force
    parameters : the defaults
    swing : name of the parameter that limits how far load and setpoint may go to either side, rad: the servo ends an
        experiment that goes farther; "" for none
    turn : name of the parameter for the range over which the load moves in addition, rad, half of it to either side,
        slowly and without a leap, so that ``limits.step`` does not apply; "" for none. If such a run does not come
        back, the load is held where the run ends
    law : the law that acts meanwhile, with its own state; "" for none, so that the experiment's torque acts alone
    finds_zero : whether it looks for the axis' zero, far from where it began: the load is held where the run ends, and
        the ends of the travel, which are not known before, do not count
    refusal : returns why a run cannot begin with a drive, parameters, limits and fault thresholds, empty if it can;
        None if there is never a reason
    """

    title: str
    make: Callable[[Drive, Any, float, Limits], Experiment]
    parameters: Validated
    swing: str = ""
    turn: str = ""
    law: str = "fast"
    finds_zero: bool = False
    refusal: Callable[[Drive, Any, Limits, FaultThresholds], str] | None = None
