"""What the sensors of a drive in a test show: all of its state, or some signals of it, without any error."""

import math
from collections.abc import Collection

import numpy as np

from backlash_ros.drivetrain.signals import STATE_NAMES, Measurement

EVERYTHING = STATE_NAMES


def sample_of(state: np.ndarray, measured: Collection[str] = EVERYTHING) -> Measurement:
    """Return the signals called ``measured`` of a plant's state, nan for the others."""
    return Measurement(state[:5] + [0.0 if name in measured else math.nan for name in STATE_NAMES])
