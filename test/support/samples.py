"""What the sensors of a drive in a test show: all of its state, or some signals of it, without any error."""

import math
from collections.abc import Collection

import numpy as np

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import CURRENT, STATE_NAMES, Measurement

EVERYTHING = STATE_NAMES


def sample_of(state: np.ndarray, measured: Collection[str] = EVERYTHING) -> Measurement:
    """Return the signals called ``measured`` of the nominal plant's state, nan for the others.

    The current comes of an effort in N m, as over the topic: that counts, to the last bit, in a limit cycle.
    """
    shown = state[:5] + [0.0 if name in measured else math.nan for name in STATE_NAMES]
    constant = NOMINAL_DRIVE.motor.torque_constant
    shown[CURRENT] = constant * shown[CURRENT] / constant
    return Measurement(shown)
