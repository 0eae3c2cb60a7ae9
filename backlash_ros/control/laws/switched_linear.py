"""Two linear compensators and a switch on the error, in the manner of Boneh & Yaniv.

J. Dyn. Syst. Meas. Control 121, 1999. Their aim is a smaller limit cycle, not its removal: near the target the same
lead compensator acts with a lower gain. It uses only position and speed of the load, not current or load torque, and
switches without hysteresis.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import (
    FAST_REGION,
    LAW_SIGNATURE,
    OVERDAMPED_REGION,
    ControlLaw,
    LawState,
    NamedLaw,
    law_state_at,
)
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array, Record, row_of, view_of
from backlash_ros.foundation.signals import OMEGA_L, POSITION, THETA_L, VELOCITY, Estimate

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings


class SwitchedLinearConstants(Record):
    """The compensator far from the target, and what changes near it."""

    position: float  # V/rad
    velocity: float  # V s/rad
    near: float  # rad, error below which the law is softer
    reduction: float  # share of the gain that is left there


_constants_at = view_of(SwitchedLinearConstants)


@dataclass(frozen=True)
class SwitchedLinearParameters(Validated):
    """How much softer the law is near the target."""

    section: ClassVar[str] = "laws.switched_linear"

    reduction: float = quantity(
        "gain near the target divided by the gain far from it", "", above=0, at_most=1, default=0.3
    )


@compiled_as(LAW_SIGNATURE)
def switched_linear_step(law: Array, state: Array, estimate: Estimate, path: Array, low: float, high: float) -> float:
    """V = g (k1 error + k2 speed error), with the reduced g where the error is smaller than the backlash."""
    constants = _constants_at(law)
    error = path[0, POSITION] - estimate[THETA_L]
    near = abs(error) < constants.near
    law_state_at(state).region = OVERDAMPED_REGION if near else FAST_REGION
    voltage = constants.position * error + constants.velocity * (path[0, VELOCITY] - estimate[OMEGA_L])
    return clamp(voltage * (constants.reduction if near else 1.0), low, high)


def switched_linear(_drive: Drive, settings: "ServoSettings", parameters: SwitchedLinearParameters) -> ControlLaw:
    """Design it from the fast gains' position and speed gain."""
    fast = settings.gains.fast
    constants = row_of(
        SwitchedLinearConstants,
        position=fast.position,
        velocity=fast.velocity,
        near=settings.backlash_angle,
        reduction=parameters.reduction,
    )
    return ControlLaw(switched_linear_step, constants, row_of(LawState))


LAWS = {
    "switched_linear": NamedLaw("switched linear (after Boneh & Yaniv)", switched_linear, SwitchedLinearParameters())
}
