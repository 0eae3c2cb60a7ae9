"""What a control law is: parameters of its own, a design for a drive, a state and one compiled step.

The laws themselves are in `laws`, a file each. The step may act within the range that it is given, and nothing changes
its voltage afterwards: what it remembers is what was applied.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from numba import float64

from backlash_ros.drivetrain import Drive, Validated
from backlash_ros.drivetrain.signals import Array, Estimate, Setpoint

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

FAST_REGION, OVERDAMPED_REGION = 1, 2
REGION = 0
"""Where every law's state says which region acts; a law without regions leaves 1 there."""

LawStep = Callable[[Array, Array, Estimate, Setpoint, float, float], float]
_flat = float64[::1]
LAW_SIGNATURE = float64(_flat, _flat, _flat, _flat, float64, float64)
"""Of every law's step: constants, state, estimate, setpoint, least and largest voltage that the drive can follow, in V;
returns the voltage within them, V."""

TakeOver = Callable[[Array, Array, Estimate, Setpoint, float], None]
"""Of a law with memory: constants, state (updated in place), estimate and setpoint of the last sample, and the voltage
that holds the load against what acts on it, V."""


def _remembers_nothing(_law: Array, _state: Array, _estimate: Estimate, _setpoint: Setpoint, _holding: float) -> None:
    """Leave the state as it is at the start."""


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A law that was designed for a drive: the same compiled ``step`` drives the motor and runs offline.

    ``constants`` and the ``state`` to start with are arrays of one dimension; the state's first entry is the region.
    A law that follows another one while the load is held starts with ``take_over``: plain Python, called once, before
    its first step. ``shown`` says where in the state there is what telemetry names ``phase`` and ``flank``.
    """

    step: LawStep
    constants: Array
    state: Array
    take_over: TakeOver = _remembers_nothing
    shown: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class NoParameters(Validated):
    """The parameters of a law that has none."""


class NamedLaw(NamedTuple):
    """A law that can be chosen: its title in figures and tables, what designs it for a drive, its parameters' defaults.

    ``adapts``: whether it goes by the backlash that was learned, so that a load that rattles in the gap means wear;
    ``both_encoders``: whether it needs them, so that the over-damped gains act in its place where one is missing;
    ``identified``: whether it plans with load, friction and gap, so that those gains act until they were found.
    ``design`` takes the drive, the servo's settings and the law's own parameters, and raises ValueError where they do
    not allow it.
    """

    title: str
    design: "Callable[[Drive, ServoSettings, Any], ControlLaw]"
    parameters: Validated = NoParameters()
    adapts: bool = False
    both_encoders: bool = False
    identified: bool = False
