"""Where a search of a recording of one encoder begins: gaps of any width, or about where the motor carries the load."""

import itertools
import math
from collections.abc import Iterator

import numpy as np

from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.memory import MotorSide
from backlash_ros.identification.fitting.parameters import parameters_at, parameters_of
from backlash_ros.identification.one_encoder.play import guess_in_play
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.regression import Guess, guess_of

WIDTHS = np.geomspace(0.003, 0.13, 12)
"""Gaps that are tried, rad; tuned."""
_INERTIAS = (0.1, 0.35, 1.0)
"""Inertias of the load over that of the motor that are tried beside a guess; tuned."""
_OTHER = 0.6
"""By how much, as ln, these have to differ from the guess; tuned."""
DELAYS = (0.25, 1.0)
"""Delays that are tried, in periods; tuned."""
_LEAST_INERTIA = 0.06
"""Least inertia of the load over that of the motor that a guess may have; tuned."""
_LARGEST_INERTIA = 1.2
"""Largest inertia of the load over that of the motor that a guess may have; tuned."""
_DRY = 2e-3
"""Share of the torque at standstill that dry friction has to have to be tried on either side."""
_HELD = 3e-3
"""Share of the torque at standstill that a load torque has to have to hold the load on a flank at the start."""
VISCOUS = 2.5e-3
"""Viscous friction of the load with which a search begins, N m s/rad; tuned."""
_LATE = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""Delays that a load in play is tried with, in periods; tuned."""
_WIDTHS_IN_PLAY = np.geomspace(0.003, 0.13, 24)
"""Gaps that a load in play is tried with, rad; tuned."""
_WIDER = (1.0, 1.2, 1.4, 1.7, 2.0)
"""Of a gap by play: the widths that are tried, since hard teeth show too narrow a gap; tuned."""
_HEAVIER = (1.0, 1.1, 1.2)
"""Of an inertia by play: those that are tried, since hard teeth show too light a load; tuned."""
_WITHIN = (-0.6, 0.0, 0.6)
"""Where in the gap, in half gaps, such a motion is tried to start; tuned."""
_LEAST_VISCOUS = 1e-3
"""Least viscous friction of the load with which such a search begins, N m s/rad; tuned."""


def widened(x: Array, factor: float) -> Array:
    """Return parameters with a gap that is wider by a factor, and the start at the same share of it."""
    wider = x.copy()
    there = parameters_at(wider)
    there.ln_half_gap += math.log(factor)
    there.offset *= factor
    return wider


class Starts:
    """The starts for one recording.

    Parameters
    ----------
    torque : of the motor at standstill, N m at the output
    period : of the samples, s
    seen : the recording, with the angle that was read as that of both shafts
    """

    def __init__(self, side: MotorSide, torque: float, period: float, seen: Recording) -> None:
        self._side, self._torque, self._period = side, torque, period
        guesses = (guess_of(side, seen, 0.5 * k * period) for k in range(3))
        self._guess: Guess = min(guesses, key=lambda guess: guess.misfit)

    def start(self, gap: float, inertia: float, coulomb_l: float, coulomb_m: float, delay: float = 0.5) -> Array:
        """Return a start; ``delay`` in periods."""
        held = self._guess.load_torque
        return parameters_of(
            ln_half_gap=math.log(0.5 * gap),
            offset=math.copysign(0.5 * gap, held) if abs(held) > _HELD * self._torque else 0.0,
            ln_load_inertia=math.log(inertia),
            ln_load_viscous=math.log(VISCOUS),
            load_coulomb=coulomb_l,
            motor_coulomb=coulomb_m,
            load_torque=self._guess.load_torque,
            delay=delay * self._period,
        )

    def anywhere(self) -> Iterator[Array]:
        """Yield gaps of any width, with light and heavy loads, and dry friction on either side."""
        unit, guess = self._side.inertia, self._guess
        near = min(max(guess.inertia, _LEAST_INERTIA * unit), _LARGEST_INERTIA * unit)
        inertias = [near, *(k * unit for k in _INERTIAS if abs(math.log(k * unit / near)) > _OTHER)]
        dry = guess.coulomb_l + guess.coulomb_m
        shares = (0.0, 0.5, 1.0) if dry > _DRY * self._torque else (0.0,)
        for inertia in inertias:
            for share in shares:
                for gap in WIDTHS:
                    for delay in DELAYS:
                        yield self.start(float(gap), inertia, (1.0 - share) * dry, share * dry, delay)

    def in_play(self, recording: Recording) -> Iterator[Array]:
        """Yield what is about where the motor, of which a recording has the angle, carries the load in play."""
        delays = [share * self._period for share in _LATE]
        gap, delay, load = guess_in_play(self._side, recording, _WIDTHS_IN_PLAY, delays)
        x = self.start(gap, load.inertia, load.coulomb_l, load.coulomb_m, delay / self._period)
        there = parameters_at(x)
        there.ln_load_viscous, there.load_torque = math.log(max(load.viscous, _LEAST_VISCOUS)), load.load_torque
        for wider, heavier, place in itertools.product(_WIDER, _HEAVIER, _WITHIN):
            other = widened(x, wider)
            there = parameters_at(other)
            there.offset = place * math.exp(there.ln_half_gap)
            there.ln_load_inertia += math.log(heavier)
            yield other
