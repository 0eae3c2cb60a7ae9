"""The encoders of an axis: which there are, and which one is lost while the other goes on."""

import math

import numpy as np

from backlash_ros.control.memory import TickRow
from backlash_ros.control.observer import ObserverConstants, keep_estimate
from backlash_ros.control.settings import BOTH, LOAD, MOTOR
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Estimate, Measurement
from backlash_ros.gates.faults import Fault

_SHAFT = {Fault.MOTOR_JUMP: MOTOR, Fault.MOTOR_SPEED: MOTOR, Fault.LOAD_JUMP: LOAD, Fault.LOAD_SPEED: LOAD}
"""Faults that name the encoder that lies."""
_STANDS = 0.5
"""Share of how far the shafts may move apart: one that moves so far alone shows that the other's encoder is lost."""
_OTHER = {MOTOR: LOAD, LOAD: MOTOR}
_ANGLES = {MOTOR: (THETA_M, OMEGA_M), LOAD: (THETA_L, OMEGA_L)}


def encoders_of(measured: Measurement) -> str:
    """Return which encoders a sample shows: one of `ENCODERS`."""
    no_motor, no_load = math.isnan(measured[THETA_M]), math.isnan(measured[THETA_L])
    return BOTH if no_motor == no_load else LOAD if no_motor else MOTOR


class Encoders:
    """Which encoders there were at the first sample, which one is ``lost`` since, and what the other one measures.

    The two encoders may have different zeros. Once the load's is lost, the motor's angle is shifted to the load's zero,
    so that the load stays where it was believed to be; half a gap is the most by which that is wrong.
    """

    def __init__(self, ratio: float) -> None:
        self._ratio = ratio
        self.forget()

    def forget(self) -> None:
        """Forget all: the next sample shows which encoders there are."""
        self.first, self.lost = "", ""
        self._apart = self._shift = 0.0
        self._readings = np.full(2, math.nan)  # rad at the output: of motor and load at the sample before
        self._others = np.full(2, math.nan)  # rad: the other's reading when that of each last changed
        self._alone = np.zeros(2)  # rad: how far the other shaft has gone from there

    @property
    def used(self) -> str:
        """The encoders that the law sees: one of `ENCODERS`; empty before the first sample."""
        return _OTHER.get(self.lost, self.first)

    def look(self, measured: Measurement, middle: float) -> None:
        """Note a sample that showed no fault; ``middle``: motor less load in the middle of the gap, nan if unknown."""
        now = np.array([self._ratio * measured[THETA_M], measured[THETA_L]])
        self._others = np.where(now == self._readings, self._others, now[::-1])
        self._readings, self._alone = now, np.abs(now[::-1] - self._others)
        # An encoder that stands still while the other shaft moves may be lost: the zeros are those from before.
        if not (self._alone > 0.0).any():
            self._apart = now[0] - now[1] if math.isnan(middle) else middle

    def lost_by(self, fault: Fault, apart: float) -> str:
        """Return which encoder a fault shows as lost; empty if it does not tell.

        The sample with the fault itself does not count: where one shaft rests, a leap of the other's encoder looks the
        same. ``apart``: how far the shafts may move apart, rad.
        """
        if self.used != BOTH:
            return ""
        if fault == Fault.ENCODERS_DISAGREE:
            stands = [side for side, alone in zip(_ANGLES, self._alone, strict=True) if alone > _STANDS * apart]
            return stands[0] if len(stands) == 1 else ""
        return _SHAFT.get(fault, "")

    def lose(self, side: str) -> None:
        """Go on without ``side``."""
        self.lost, self._shift = side, self._apart

    def seen(self, measured: Measurement) -> Measurement:
        """Return a sample without the encoder that is lost, in the load's zero."""
        if not self.lost:
            return measured
        kept = Measurement(measured.copy())
        kept[[*_ANGLES[self.lost]]] = math.nan
        kept[THETA_M] -= self._shift / self._ratio
        return kept

    def shifted(self, estimate: Estimate) -> Estimate:
        """Return an estimate of both shafts in the load's zero."""
        kept = Estimate(estimate.copy())
        kept[THETA_M] -= self._shift / self._ratio
        return kept

    def go_on(self, observer: ObserverConstants, memory: TickRow) -> None:
        """Let the tick's observers go on with the other encoder alone, through the rigid gear."""
        shift, monitor, motor = self._shift, memory.monitor, memory.plausibility.motor
        monitor.motor_angle -= shift
        motor.believed -= shift
        motor.reading -= shift
        for observed in (memory.observer, monitor.observer):
            estimate = Estimate(observed.estimate)
            estimate[THETA_M] -= shift / self._ratio
            if self.lost == LOAD:
                estimate[[THETA_L, OMEGA_L]] = self._ratio * estimate[[THETA_M, OMEGA_M]]
            else:
                estimate[[THETA_M, OMEGA_M]] = estimate[[THETA_L, OMEGA_L]] / self._ratio
            keep_estimate(observer, observed)
