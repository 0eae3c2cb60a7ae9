"""The law's parameters: times of its moves and bandwidths of its loops, both in the law's unit of time (see `unit`)."""

from dataclasses import dataclass
from typing import ClassVar

from backlash_ros.foundation.quantity import Validated, quantity


@dataclass(frozen=True)
class PlannedParameters(Validated):
    """Times of its moves and bandwidths of its loops, as usual drives have them."""

    section: ClassVar[str] = "laws.planned"

    crossing_time: float = quantity(
        "time in which the motor crosses a gap of 0.02 rad; longer for a wider gap. This and the other four hold for "
        "usual drives: far slower or faster ones scale all five (docs/law.md)",
        "s",
        at_least=1e-3,
        at_most=10,
        default=0.022,
    )
    push_time: float = quantity(
        "time for which the load is pushed; longer if the motor is too weak",
        "s",
        at_least=1e-3,
        at_most=10,
        default=0.03,
    )
    brake_time: float = quantity(
        "time for which a load that is thrown is braked: longer by a weak motor, shorter where it soon stops by itself",
        "s",
        at_least=1e-3,
        at_most=10,
        default=0.08,
    )
    bandwidth: float = quantity(
        "bandwidth of the motor's own loop; up to twice as much where sampling and delay allow it",
        "rad/s",
        above=0,
        at_most=1e4,
        default=56.6,
    )
    torque_bandwidth: float = quantity(
        "bandwidth of the compensation for torques that the plan did not foresee; grows with bandwidth",
        "rad/s",
        above=0,
        at_most=1e4,
        default=40.0,
    )
