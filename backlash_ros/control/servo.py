"""The controller without ROS: samples in, voltages out. What the node and an offline session both call."""

import math
from dataclasses import dataclass, field, replace

from backlash_ros.control.gains import GainSet
from backlash_ros.control.law import LawConstants, Mode, law_constants, law_memory, law_step
from backlash_ros.control.learning import BacklashEstimate, BacklashLearner, LearningSettings
from backlash_ros.control.limit_cycle import Array
from backlash_ros.control.observer import (
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    THETA_L,
    THETA_M,
    ObserverConstants,
    observer_constants,
    observer_memory,
    observer_step,
)
from backlash_ros.drivetrain import Drive, Validated, quantity


@dataclass(frozen=True)
class ServoSettings(Validated):
    """One immutable choice of everything that can be tuned: gains, regions, rate, observer and learning.

    ``backlash_angle`` is b as learned; while it is 0, not known, the fast gains act alone. ``period`` is the time
    between samples, s.
    """

    gains: GainSet
    mode: Mode = Mode.TWO_REGION
    period: float = 0.004
    learning: LearningSettings = field(default_factory=LearningSettings)
    backlash_angle: float = quantity(
        "backlash at the output shaft, within which the over-damped gains act; 0 while not known",
        "rad",
        at_least=0,
        at_most=3.2,
        default=0.0,
    )
    hysteresis: float = quantity(
        "the over-damped region is left at (1 + hysteresis) backlash_angle", "", at_least=0, at_most=10, default=0.1
    )
    min_dwell: float = quantity("least time in a region", "s", at_least=0, at_most=10, default=0.02)
    velocity_bandwidth: float = quantity(
        "bandwidth of the tracking filter where a speed is not measured", "rad/s", above=0, at_most=1e5, default=800.0
    )
    torque_bandwidth: float = quantity(
        "bandwidth of the load torque estimate; 0 turns its feedforward off",
        "rad/s",
        at_least=0,
        at_most=1e4,
        default=40.0,
    )

    def law(self, drive: Drive) -> LawConstants:
        """Return the compiled law's constants for ``drive``."""
        return law_constants(
            drive,
            self.gains,
            self.mode,
            self.backlash_angle,
            period=self.period,
            hysteresis=self.hysteresis,
            min_dwell=self.min_dwell,
        )

    def observer(self, drive: Drive) -> ObserverConstants:
        """Return the compiled observer's constants for ``drive``."""
        return observer_constants(
            drive, self.period, velocity_bandwidth=self.velocity_bandwidth, torque_bandwidth=self.torque_bandwidth
        )


class Servo:
    """Two-region servo of one axis: observer, law and learner around one reference.

    After construction and after every `release` it holds the position of the first sample it sees.
    """

    def __init__(self, drive: Drive, settings: ServoSettings) -> None:
        self.drive = drive
        self.voltage = 0.0
        self.reference = math.nan
        self.learned: BacklashEstimate | None = None
        self._learner: BacklashLearner | None = None
        self._estimate = observer_memory()
        self._region = law_memory()
        self.use(settings)

    def use(self, settings: ServoSettings) -> None:
        """Use ``settings`` from the next sample on; the state of observer and region is kept."""
        self.settings = settings
        learning = replace(settings, mode=Mode.FAST)
        self._laws = settings.law(self.drive), learning.law(self.drive)
        self._observer = settings.observer(self.drive)

    def release(self, reason: str) -> None:
        """Let go of the drive: 0 V, forget what was observed, give up learning; hold where it next shows up."""
        self.voltage = 0.0
        self.reference = math.nan
        self._estimate = observer_memory()
        self._region = law_memory()
        if self._learner is not None and self._learner.result is None:
            self._learner.give_up(reason)

    @property
    def holding(self) -> bool:
        """Whether a sample has been seen since the last `release`."""
        return not math.isnan(self.reference)

    @property
    def learning(self) -> bool:
        """Whether a learning run is under way."""
        return self._learner is not None

    @property
    def load_angle(self) -> float:
        """theta_l, rad."""
        return float(self._estimate[THETA_L])

    @property
    def tracking_error(self) -> float:
        """theta_l - reference, rad."""
        return self.load_angle - self.reference

    @property
    def region(self) -> int:
        """1 where the fast gains act, 2 where the over-damped ones do."""
        return int(self._region[0])

    @property
    def load_torque_estimate(self) -> float:
        """Torque on the output shaft, N m; 0 with the load encoder alone."""
        return float(self._estimate[LOAD_TORQUE])

    def start_learning(self) -> None:
        """Start to learn the backlash at the next sample; the result shows in `take_learned`."""
        if self._learner is not None:
            raise RuntimeError("already learning")
        self._learner = BacklashLearner(self.drive, self.settings.learning, self.settings.period)

    def take_learned(self) -> BacklashEstimate | None:
        """Return the result of a learning run that has ended, once; None while there is none."""
        if self._learner is None or self._learner.result is None:
            return None
        result, self._learner = self._learner.result, None
        return result

    def update(self, measured: Array) -> float:
        """Take one sample and return the voltage, V.

        Parameters
        ----------
        measured : shape (5,): theta_m, omega_m, i, theta_l, omega_l (rad, rad/s, A), nan where not measured
        """
        observer_step(self._observer, self._estimate, measured, self.voltage)
        if not self.holding:
            self.reference = self.load_angle
        offset = 0.0
        law = self._laws[0]
        if self._learner is not None:
            law = self._laws[1]
            offset = self._learner.update(
                self._estimate,
                has_motor=not math.isnan(measured[THETA_M]),
                has_load=not math.isnan(measured[THETA_L]),
            )
        self.voltage = law_step(
            law,
            self._region,
            self._estimate[THETA_L],
            self._estimate[OMEGA_L],
            self._estimate[CURRENT],
            self.reference + offset,
            self._estimate[LOAD_TORQUE],
        )
        return self.voltage
