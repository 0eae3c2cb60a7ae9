"""Everything about the servo that can be tuned, as one immutable value."""

from dataclasses import dataclass, replace

from backlash_ros.control.design.gains import GainSet
from backlash_ros.control.design.stability import Margins, stability_margins
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.control.observer import ObserverConstants, observer_constants
from backlash_ros.drivetrain import Drive, Validated, quantity

AUTO = "auto"
"""The experiment that takes what the encoders allow: the gap's own where there are both, else the limit cycle."""


@dataclass(frozen=True)
class ServoSettings(Validated):
    """One immutable choice of everything that can be tuned: gains, law, rate, observer, learning and faults.

    ``backlash_angle`` is b as learned; while it is 0, not known, the fast gains act alone. ``period`` is the time
    between samples, s; ``loop_delay`` that from measuring to when the command acts, s, with which `margins` judges the
    gains; ``law`` names one of `laws.LAWS`, and ``experiment`` one of `experiments.EXPERIMENTS`, or is `AUTO`;
    ``law_parameters`` and ``experiment_parameters`` have the parameters of those whose defaults do not hold, as pairs
    of name and value; ``thresholds`` are those of the drive by default. ``renew``: whether wear is answered by learning
    anew, which takes a gap for no fault that is up to six times as wide as it was learned. ``identified``: whether load
    and friction of the drive were found on it, so that a law may plan with them.
    """

    gains: GainSet
    law: str = "two_region"
    period: float = 0.004
    loop_delay: float = 0.0
    law_parameters: tuple[tuple[str, Validated], ...] = ()
    experiment: str = AUTO
    experiment_parameters: tuple[tuple[str, Validated], ...] = ()
    thresholds: FaultThresholds | None = None
    renew: bool = False
    identified: bool = False
    backlash_angle: float = quantity(
        "backlash at the output shaft, within which the over-damped gains act; 0 while not known",
        "rad",
        at_least=0,
        at_most=3.2,
        default=0.0,
    )
    expected_load_torque: float = quantity(
        "load torque that law two_encoder expects where dry friction hides it, as it was found with the drive",
        "N m",
        at_least=-1e5,
        at_most=1e5,
        default=0.0,
    )
    velocity_bandwidth: float = quantity(
        "bandwidth of the low-pass where a speed is found from position", "rad/s", above=0, at_most=1e5, default=800.0
    )
    torque_bandwidth: float = quantity(
        "bandwidth of the load torque estimate; 0 turns its feedforward off",
        "rad/s",
        at_least=0,
        at_most=1e4,
        default=40.0,
    )

    def with_law(self, law: str, parameters: Validated | None = None) -> "ServoSettings":
        """Return the same settings with another law and, where given, its parameters."""
        own = {**dict(self.law_parameters), **({law: parameters} if parameters is not None else {})}
        return replace(self, law=law, law_parameters=tuple(sorted(own.items())))

    def with_experiment(self, experiment: str, parameters: Validated | None = None) -> "ServoSettings":
        """Return the same settings with another experiment and, where given, its parameters."""
        own = {**dict(self.experiment_parameters), **({experiment: parameters} if parameters is not None else {})}
        return replace(self, experiment=experiment, experiment_parameters=tuple(sorted(own.items())))

    def thresholds_of(self, drive: Drive) -> FaultThresholds:
        """Return beyond what ``drive`` latches a fault."""
        return self.thresholds or FaultThresholds.of(drive)

    def margins(self, drive: Drive) -> dict[str, Margins]:
        """Return how far each region's gains are from unstable, by the region's name; see `stability_margins`."""
        gains = {"fast": self.gains.fast, "overdamped": self.gains.overdamped}
        return {region: stability_margins(drive, k, self.period, self.loop_delay) for region, k in gains.items()}

    def observer(self, drive: Drive) -> ObserverConstants:
        """Return the compiled observer's constants for ``drive``."""
        return observer_constants(
            drive, self.period, velocity_bandwidth=self.velocity_bandwidth, torque_bandwidth=self.torque_bandwidth
        )
