"""Lost motion as values: the curve recorded on an output at rest, and its results, also in words."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from backlash_ros.foundation.record import Array
from backlash_ros.identification.locked_output.ramps import Ramps

ARCMIN = math.pi / 10800.0
"""rad."""


class Curve(NamedTuple):
    """Samples: s; n theta_m and theta_l, rad; torque that the motor makes, N m at the output; number of the branch."""

    time: Array
    motor: Array
    load: Array
    torque: Array
    branch: Array


@dataclass(frozen=True)
class LostMotion:
    """Results of the curve, at the output: rad, N m and N m/rad, with standard uncertainties; 0 if not found.

    ``gap`` is that of ``contact``, which holds where the teeth bear ``gap_torque``, 0 for a spring; ``lost_motion`` is
    between plus and minus ``at``, without friction; ``stiffness`` of the negative and the positive flank, from half of
    ``torque`` on; ``friction`` of the motor and ``loss``, a share of the teeth's torque, are half the width of the
    hysteresis. ``angles`` over ``torques`` is the curve itself, ``modelled`` the fit, nan where the teeth bear little;
    ``ramps`` is what the curve shows without a model.
    """

    valid: bool
    reason: str
    gap: float = 0.0
    gap_uncertainty: float = 0.0
    lost_motion: float = 0.0
    lost_motion_uncertainty: float = 0.0
    at: float = 0.0
    stiffness: tuple[float, float] = (0.0, 0.0)
    stiffness_uncertainty: tuple[float, float] = (0.0, 0.0)
    friction: float = 0.0
    friction_uncertainty: float = 0.0
    loss: float = 0.0
    torque: float = 0.0
    contact: str = ""
    gap_torque: float = 0.0
    torques: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    angles: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    modelled: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    ramps: Ramps | None = field(default=None, repr=False, compare=False)

    def in_words(self) -> str:
        """Return the figures as gearbox makers state them."""
        held = f" where the teeth bear {self.gap_torque:.2g} N m" if self.gap_torque else ""
        flanks = zip(("negative", "positive"), self.stiffness, self.stiffness_uncertainty, strict=True)
        stiff = " and ".join(_stiffness_in_words(*each) for each in flanks)
        return (
            f"gap {self.gap / ARCMIN:.4g} +- {self.gap_uncertainty / ARCMIN:.2g} arcmin with teeth by the "
            f"{self.contact} law{held}, lost motion {self.lost_motion:.4g} +- {self.lost_motion_uncertainty:.2g} rad "
            f"({self.lost_motion / ARCMIN:.4g} arcmin) between +-{self.at:.3g} N m. Stiffness up to "
            f"{self.torque:.3g} N m: {stiff}; friction of the motor {self.friction:.2g} N m at the output"
        )


def _stiffness_in_words(flank: str, stiffness: float, uncertainty: float) -> str:
    if not uncertainty < 0.3 * stiffness:
        return f"more than can be seen on the {flank} flank"
    return f"{stiffness:.4g} +- {uncertainty:.2g} N m/rad ({stiffness * ARCMIN:.3g} N m/arcmin) on the {flank} flank"
