"""The interface of control laws: their own parameters, a design for a drive, a state and one compiled step.

The laws themselves are in `laws`, one file each. The step acts within the range that it is given, and nothing changes
its voltage afterwards: its memory agrees with what was applied.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from numba import float64

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.record import Array, Record, cell_of, view_of
from backlash_ros.foundation.signals import Estimate, Setpoint

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings

FAST_REGION, OVERDAMPED_REGION = 1, 2


class LawState(Record):
    """What every law's state begins with: a law's own record is derived from this one."""

    region: float = float(FAST_REGION)  # that acts; 1 for a law without regions


law_state_at = view_of(LawState)
REGION = cell_of(LawState, "region")
"""Index in every law's state of the region that acts, for Python, which reads it at every sample."""

LawStep = Callable[[Array, Array, Estimate, Array, float, float], float]
_flat = float64[::1]
LAW_SIGNATURE = float64(_flat, _flat, _flat, float64[:, ::1], float64, float64)
"""Arguments of every law's step: constants, state, estimate, path, smallest and largest voltage that the drive can
follow, V; it returns a voltage within them, V. Each row of the path is a `Setpoint`: this sample's first, then those of
the next samples, shape (`motion.setpoint.AHEAD`, 3)."""

TakeOver = Callable[[Array, Array, Estimate, Setpoint, float], None]
"""Arguments for a law with memory: constants, state (updated in place), estimate and setpoint of the last sample, and
the voltage that holds the load, V."""


def _remembers_nothing(_law: Array, _state: Array, _estimate: Estimate, _setpoint: Setpoint, _holding: float) -> None:
    """Keep the initial state."""


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A law designed for a drive: the same compiled ``step`` drives the motor and runs offline.

    ``constants`` and the initial ``state`` are rows of records; that of the state is derived from `LawState`. A law
    that replaces another one while the load is held starts with ``take_over``: plain Python, called once before its
    first step. ``shown`` has the indices in the state of what telemetry calls ``phase`` and ``flank``, of ``middle``,
    motor less load in the middle of the gap, rad at the output, and of ``load_torque``, N m. References that keep
    coming are followed ``ahead`` periods later, so that the law sees the path for so long.
    """

    step: LawStep
    constants: Array
    state: Array
    take_over: TakeOver = _remembers_nothing
    shown: Mapping[str, int] = field(default_factory=dict)
    ahead: int = 0


@dataclass(frozen=True)
class NoParameters(Validated):
    """The parameters of a law without parameters."""


class NamedLaw(NamedTuple):
    """A law that can be chosen: its title in figures and tables, its design function, its parameters' defaults.

    ``adapts``: whether it uses the learned backlash, so that a rattling load means wear. ``both_encoders``: whether it
    uses both encoders; if one is lost, the over-damped gains act. ``one_encoder``: whether it can also be designed for
    a drive that has one alone. ``identified``: whether it plans with load, friction and gap; until these are found, the
    over-damped gains act. ``design`` takes the drive, the servo's settings and the law's own parameters; ValueError if
    these allow no design.
    """

    title: str
    design: "Callable[[Drive, ServoSettings, Any], ControlLaw]"
    parameters: Validated = NoParameters()
    adapts: bool = False
    both_encoders: bool = False
    one_encoder: bool = False
    identified: bool = False
