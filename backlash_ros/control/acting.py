"""The law in action and the experiment beside it, each with its present state."""

import math
from typing import Protocol, runtime_checkable

import numpy as np

from backlash_ros.control.experiment import Deferred, Excitation, NamedExperiment, Outcome, Refusal
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, ControlLaw
from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.beat import Beat
from backlash_ros.control.tick import tick_with
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, THETA_M, Estimate, Measurement, Setpoint


@compiled_as(LAW_SIGNATURE)
def _idle(_law: Array, _state: Array, _estimate: Estimate, _path: Array, low: float, high: float) -> float:
    """Ask for 0 V, or for the voltage nearest to it in the range."""
    return float(min(max(0.0, low), high))


IDLE = ControlLaw(_idle, np.zeros(1), np.array([float(FAST_REGION)]))
"""The law of an experiment that acts alone."""


class ActingLaw:
    """A designed law with its state, and the tick compiled with it."""

    def __init__(self, law: ControlLaw) -> None:
        self.law = law
        self.state = law.state.copy()
        self.tick = tick_with(law.step)

    def redesign(self, law: ControlLaw) -> None:
        """Take another design; the state is kept if the law is the same."""
        self.law, self.tick = law, tick_with(law.step)
        if self.state.shape != law.state.shape:
            self.state = law.state.copy()

    def start(self) -> None:
        """Start again: the state is updated in place."""
        self.state[:] = self.law.state

    def take_over(self, estimate: Estimate, setpoint: Setpoint, holding: float) -> None:
        """Take over from another law, which holds the load with ``holding`` V."""
        self.law.take_over(self.law.constants, self.state, estimate, setpoint, holding)


def swing_of(chosen: NamedExperiment, parameters: Validated) -> float:
    """Return how far an experiment may move the load to either side, rad; 0 if it sets no limit."""
    return at_once(chosen, parameters) + (0.5 * float(getattr(parameters, chosen.turn)) if chosen.turn else 0.0)


def at_once(chosen: NamedExperiment, parameters: Validated) -> float:
    """Return how far an experiment may move the load at once, rad; 0 if it sets no limit."""
    return float(getattr(parameters, chosen.swing)) if chosen.swing else 0.0


def swing_name(chosen: NamedExperiment, parameters: Validated) -> str:
    """Return which parameters say how far an experiment may move the load to either side."""
    half = f"half of {parameters.section}.{chosen.turn} and " if chosen.turn else ""
    return f"{half}{parameters.section}.{chosen.swing}"


@runtime_checkable
class Tripped(Protocol):
    """A run of an experiment that waits for a switch; ``tripped``: it has closed."""

    tripped: bool

    def trip(self) -> None:
        """Take it that the switch has closed."""
        ...


class ActingExperiment:
    """One run of an experiment and the law that acts meanwhile; if the experiment fails, the motor stays controlled.

    Parameters
    ----------
    name, chosen, parameters : the experiment and its parameters
    law : the law that it names, as designed for the drive, or `IDLE`
    calm : the over-damped law, which takes over when the experiment asks for it
    drive, period, limits : those of the run; the sample period in s
    """

    def __init__(
        self,
        name: str,
        chosen: NamedExperiment,
        parameters: Validated,
        law: ControlLaw,
        calm: ControlLaw,
        drive: Drive,
        period: float,
        limits: Limits,
    ) -> None:
        self.name, self.acting, self._calm = name, ActingLaw(law), calm
        self._run = chosen.make(drive, parameters, period, limits)
        self._swing, self._swing_name = swing_of(chosen, parameters), swing_name(chosen, parameters)
        self.finds_zero = chosen.finds_zero
        self._goes_away = bool(chosen.turn) or chosen.finds_zero
        self._ratio, self._period, self._start = drive.gear.ratio, period, math.nan
        self._broken: Refusal | None = None
        self._beat = Beat(period)

    @property
    def outcome(self) -> Outcome | Deferred | None:
        """How it ended, or the work that will tell; None while it runs."""
        return self._broken or self._run.outcome

    @property
    def left_away(self) -> bool:
        """Whether it ended at a place that may be far from where it began."""
        return self._goes_away and not isinstance(self.outcome, Deferred)

    @property
    def progress(self) -> float:
        """Progress, from 0 to 1."""
        return self._run.progress

    def cancel(self, reason: str) -> None:
        """End it without a result."""
        try:
            self._run.cancel(reason)
        except Exception as error:
            self._broken = Refusal(f"{reason}; and it could not be cancelled: {error!r}")

    def trip(self) -> None:
        """Tell it that its switch has closed, if it waits for one."""
        if isinstance(self._run, Tripped):
            self._run.trip()

    @property
    def tripped(self) -> bool:
        """Whether the switch that it waits for has closed."""
        return isinstance(self._run, Tripped) and self._run.tripped

    def answered(self, at: float) -> None:
        """Note when the newest sample was answered, s of a steady clock."""
        self._beat.answered(at)

    def excite(self, measured: Measurement, estimate: Estimate, command: float, elapsed: float) -> Excitation:
        """Take a sample and return the excitation; end the run if that or the load's motion is too large."""
        if self._broken is not None:
            return Excitation()
        periods, late = self._beat.sample(elapsed)
        load = self._ratio * measured[THETA_M] if math.isnan(measured[THETA_L]) else measured[THETA_L]
        if math.isnan(self._start):
            self._start = load
        if (way := abs(load - self._start)) > self._swing > 0.0:
            self.cancel(
                f"the load moved {way:.3g} rad from its position at the start, "
                f"beyond {self._swing_name} = {self._swing:g} rad"
            )
            return Excitation()
        try:
            wanted = self._run.step(measured, estimate, command, self._period * periods, late)
        except Exception as error:
            self._broken = Refusal(f"it failed: {error!r}")
            return Excitation()
        if abs(wanted.offset) <= self._swing and math.isfinite(wanted.torque):
            if wanted.calm and self.acting.law is not self._calm:
                self.acting = ActingLaw(self._calm)
            return wanted
        self.cancel(
            f"it asked for an offset of {wanted.offset:g} rad and a torque of {wanted.torque:g} N m, "
            f"but is allowed +-{self._swing:g} rad and a finite torque"
        )
        return Excitation()
