"""Everything about the servo that can be tuned, as one immutable value."""

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace

from backlash_ros.control.design.gains import GainSet
from backlash_ros.control.design.stability import Margins, stability_margins
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.control.motion.profile_parameters import ProfileParameters
from backlash_ros.control.observer import ObserverConstants, observer_constants
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Quantity, Validated, quantity

BOTH, LOAD, MOTOR = ENCODERS = "both", "load", "motor"
"""The encoders that a drive may have: of both shafts, or of one alone."""
STOP, CONTINUE = ON_LOST_ENCODER = "stop", "continue"
"""What a servo does that has lost one of two encoders."""
AUTO = "auto"
"""The experiment that the encoders allow: `gap_probe` with both, else `relay`. Also the best law for what is known of
the drive: see `laws.law_of`."""

ZERO = Quantity(
    "reading of the load's angle at which the position of the axis is 0; ~/set_zero and ~/home set it", "rad", -1e6, 1e6
)
"""The zero of the axis, which is none of the settings: nothing in the tick depends on it."""


def encoders_in(measured: Collection[str]) -> str:
    """Return which of `ENCODERS` are among the names of the measured signals."""
    both = {"theta_m", "theta_l"} <= {*measured}
    return BOTH if both else LOAD if "theta_l" in measured else MOTOR


@dataclass(frozen=True)
class ServoSettings(Validated):
    """One immutable choice of everything that can be tuned: gains, law, rate, observer, learning and faults.

    ``backlash_angle`` is b as learned; while it is 0, unknown, the fast gains act alone. ``period`` is the time between
    samples, s; ``loop_delay`` is the time from the measurement to when its command acts, s, used by `margins`. ``law``
    names one of `laws.LAWS`, and ``experiment`` one of `experiments.EXPERIMENTS`, or they are `AUTO`.
    ``law_parameters`` and ``experiment_parameters`` are pairs of name and parameters, where these are not the defaults;
    ``thresholds`` are by default the drive's. ``renew``: whether wear is answered by learning again; a gap up to six
    times as wide as learned is then no fault. ``identified``: whether load and friction were found on this drive, so
    that a law may use them. ``encoders``: one of `ENCODERS`; a servo sees by its first sample which there are.
    ``on_lost_encoder``: one of `ON_LOST_ENCODER`, whether one that is lost is a fault, or the other one is enough.
    ``profile``: how the setpoint goes to a reference. ``largest_command``: what a law may plan with, V or A; a servo
    takes that of its limits.
    """

    gains: GainSet
    law: str = AUTO
    period: float = 0.004
    loop_delay: float = 0.0
    law_parameters: tuple[tuple[str, Validated], ...] = ()
    experiment: str = AUTO
    experiment_parameters: tuple[tuple[str, Validated], ...] = ()
    thresholds: FaultThresholds | None = None
    renew: bool = False
    identified: bool = False
    encoders: str = BOTH
    on_lost_encoder: str = STOP
    largest_command: float = math.inf
    profile: ProfileParameters = field(default_factory=ProfileParameters)
    backlash_angle: float = quantity(
        "backlash at the output shaft, within which the over-damped gains act; 0: unknown",
        "rad",
        at_least=0,
        at_most=3.2,
        default=0.0,
    )
    expected_load_torque: float = quantity(
        "load torque that the law of planned moves assumes while dry friction hides it; ~/identify sets it",
        "N m",
        at_least=-1e5,
        at_most=1e5,
        default=0.0,
    )
    expected_load_torque_angle: float = quantity(
        "reading of the load's angle at which expected_load_torque was found",
        "rad",
        at_least=-1e9,
        at_most=1e9,
        default=0.0,
    )
    expected_load_torque_slope: float = quantity(
        "growth of the load torque with the load's angle there, by a weight: the law of planned moves plans with it",
        "N m/rad",
        at_least=-1e5,
        at_most=1e5,
        default=0.0,
    )
    unexplained_motor_torque: float = quantity(
        "torque on the motor, at the output, that the drive as identified does not explain, such as cogging; "
        "the law of planned moves lands short by what it may do; ~/identify sets it",
        "N m",
        at_least=0,
        at_most=1e5,
        default=0.0,
    )
    unexplained_load_torque: float = quantity(
        "torque on the load that the drive as identified does not explain, such as that of a part on a spring; "
        "the law of planned moves lands short by what it may do; ~/identify sets it",
        "N m",
        at_least=0,
        at_most=1e5,
        default=0.0,
    )
    velocity_bandwidth: float = quantity(
        "bandwidth of the low-pass filter for speeds derived from positions",
        "rad/s",
        above=0,
        at_most=1e5,
        default=800.0,
    )
    torque_bandwidth: float = quantity(
        "bandwidth of the load torque estimate; 0 turns its feedforward off",
        "rad/s",
        at_least=0,
        at_most=1e4,
        default=40.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoders not in ENCODERS:
            raise ValueError(f"encoders must be one of {list(ENCODERS)}, got {self.encoders!r}")
        if self.on_lost_encoder not in ON_LOST_ENCODER:
            raise ValueError(
                f"faults.on_lost_encoder must be one of {list(ON_LOST_ENCODER)}, got {self.on_lost_encoder!r}"
            )

    def with_law(self, law: str, parameters: Validated | None = None) -> "ServoSettings":
        """Return the same settings with another law and, if given, its parameters."""
        own = {**dict(self.law_parameters), **({law: parameters} if parameters is not None else {})}
        return replace(self, law=law, law_parameters=tuple(sorted(own.items())))

    def with_experiment(self, experiment: str, parameters: Validated | None = None) -> "ServoSettings":
        """Return the same settings with another experiment and, if given, its parameters."""
        own = {**dict(self.experiment_parameters), **({experiment: parameters} if parameters is not None else {})}
        return replace(self, experiment=experiment, experiment_parameters=tuple(sorted(own.items())))

    def thresholds_of(self, drive: Drive) -> FaultThresholds:
        """Return the fault thresholds for ``drive``."""
        return self.thresholds or FaultThresholds.of(drive)

    def margins(self, drive: Drive) -> dict[str, Margins]:
        """Return the stability margins of each region's gains, by the region's name; see `stability_margins`."""
        gains = {"fast": self.gains.fast, "overdamped": self.gains.overdamped}
        return {region: stability_margins(drive, k, self.period, self.loop_delay) for region, k in gains.items()}

    def observer(self, drive: Drive) -> ObserverConstants:
        """Return the compiled observer's constants for ``drive``."""
        return observer_constants(
            drive, self.period, velocity_bandwidth=self.velocity_bandwidth, torque_bandwidth=self.torque_bandwidth
        )
