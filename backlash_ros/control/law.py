"""What a control law is: a value with constants, a memory and one compiled step. The laws themselves are in `laws`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import float64
from numpy.typing import NDArray

from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive

Array = NDArray[np.float64]

FAST_REGION, OVERDAMPED_REGION = 1, 2
REGION = 0
"""Where every law's memory says which region acts; a law without regions leaves 1 there."""

LawStep = Callable[[Array, Array, Array, float, float, float], float]
LAW_SIGNATURE = float64(float64[::1], float64[::1], float64[::1], float64, float64, float64)
"""Of every law's step: constants, memory, the observer's estimate, reference in rad, least and largest voltage that the
drive can follow, in V; returns the voltage within them, V.

The estimate is theta_m, omega_m, i, theta_l, omega_l, load torque (rad, rad/s, A, N m), as `observer` orders it.
"""


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A controller: the same compiled ``step`` drives the motor and runs offline.

    ``constants`` and the ``memory`` to start with are arrays of one dimension; the memory's first entry is the region.
    """

    step: LawStep
    constants: Array
    memory: Array


class NamedLaw(NamedTuple):
    """A law that can be chosen: its title in figures and tables, and what designs it for a drive.

    ``design`` raises ValueError where the settings do not allow it.
    """

    title: str
    design: Callable[[Drive, ServoSettings], ControlLaw]
