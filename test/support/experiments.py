"""For tests of experiments: one that is under way, and encoders that break on the way."""

import math
from collections.abc import Callable

from backlash_ros.control import Servo
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement
from backlash_ros.simulation import SimulatedDrive

Broken = Callable[[Measurement, Measurement, int], None]
"""Changes a sample in place, by what was shown before and for one signal."""


def play(servo: Servo, plant: SimulatedDrive, samples: int, torque: float = 0.0) -> float:
    """Go on, until an outcome is there; return how far the load went from 0, rad."""
    way = 0.0
    for _ in range(samples):
        plant.advance(servo.update(plant.sample(), plant.elapsed), torque)
        way = max(way, abs(float(plant.state[THETA_L])))
        if servo.experimenting and not servo.experiment:
            break
    return way


def frozen(sample: Measurement, before: Measurement, signal: int) -> None:
    sample[signal] = before[signal]


def reversed_(sample: Measurement, _before: Measurement, signal: int) -> None:
    sample[signal] *= -1.0


def swapped(sample: Measurement, _before: Measurement, _signal: int) -> None:
    sample[[THETA_M, THETA_L]] = sample[[THETA_L, THETA_M]]


def stuck_bit(sample: Measurement, _before: Measurement, signal: int) -> None:
    count = 2.0 * math.pi / 4096.0
    sample[signal] = (round(float(sample[signal]) / count) | 32) * count


def missing(sample: Measurement, _before: Measurement, signal: int) -> None:
    sample[signal] = math.nan
