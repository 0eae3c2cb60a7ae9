"""The controller without ROS: samples in, commands out. What the node and an offline session both call."""

import math
from dataclasses import replace

from backlash_ros.control.command import command_constants, command_of, voltage_range
from backlash_ros.control.law import REGION, ControlLaw
from backlash_ros.control.laws import design_law
from backlash_ros.control.learning import BacklashEstimate, BacklashLearner
from backlash_ros.control.limit_cycle import Array
from backlash_ros.control.monitor import DriveMonitor, Limits
from backlash_ros.control.observer import LOAD_TORQUE, THETA_L, THETA_M, observer_memory, observer_step
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive


class Servo:
    """The servo of one axis: observer, law and learner around one reference.

    After construction and after every `release` it holds the position of the first sample it sees. A ``fault``, found
    by its `DriveMonitor` or told by `fail`, is latched: 0 V until `reset`.
    """

    settings: ServoSettings
    _law: ControlLaw

    def __init__(self, drive: Drive, settings: ServoSettings, limits: Limits | None = None) -> None:
        self.drive = drive
        self.command = 0.0
        self.reference = math.nan
        self.fault = ""
        self._learner: BacklashLearner | None = None
        self._estimate = observer_memory()
        self._monitor = DriveMonitor(drive)
        self.use(settings, limits or Limits.of(drive))

    def use(self, settings: ServoSettings, limits: Limits | None = None) -> None:
        """Use ``settings`` from the next sample on; what the observer, and the same law, remember is kept."""
        self._monitor.use(settings, limits or self._monitor.limits)
        law, fast = design_law(self.drive, settings), design_law(self.drive, replace(settings, law="fast"))
        if not (hasattr(self, "settings") and self.settings.law == settings.law):
            self._memory = law.memory.copy()
        self._law, self._fast = law, fast
        self._fast_memory = fast.memory.copy()
        self._observer = settings.observer(self.drive)
        output, own = command_constants(self.drive), self._monitor.limits.command
        self._output = output._replace(limit=min(output.limit, own))
        self.settings = settings

    def hindrance(self, limits: Limits) -> str:
        """Return why ``limits`` cannot be used now: the reference is outside of them; empty where they can."""
        return limits.refusal(self.reference, self.reference) if self.holding else ""

    def release(self, reason: str) -> None:
        """Let go of the drive: command 0, forget what was observed, give up learning; hold where it next shows up."""
        self.command = 0.0
        self.reference = math.nan
        self._estimate = observer_memory()
        self._memory = self._law.memory.copy()
        self._monitor.start()
        if self._learner is not None and self._learner.result is None:
            self._learner.give_up(reason)

    def fail(self, fault: str) -> None:
        """Latch a fault, unless there is one: let go of the drive, 0 V until `reset`."""
        self.fault = self.fault or fault
        self.release(fault)

    def reset(self) -> None:
        """Forget the fault; hold the position of the next sample."""
        self.fault = ""
        self.release("reset")

    def refer(self, reference: float) -> str:
        """Take a reference, rad, and return an empty text; or why it is refused, which changes nothing."""
        if not math.isfinite(reference):
            return f"reference must be finite, in rad, got {reference}"
        for hindered, why in (
            (bool(self.fault), "while a fault is latched"),
            (self.learning, "while learning"),
            (not self.holding, "while no position is held"),
        ):
            if hindered:
                return f"reference {reference:g} rad came {why}"
        refusal = self._monitor.limits.refusal(reference, self.reference)
        if not refusal:
            self.reference = reference
        return refusal

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
        return int((self._fast_memory if self.learning else self._memory)[REGION])

    @property
    def load_torque_estimate(self) -> float:
        """Torque on the output shaft, N m; 0 with the load encoder alone."""
        return float(self._estimate[LOAD_TORQUE])

    def learning_refusal(self) -> str:
        """Return why learning would go beyond the limits from where the load is held; empty where it would not."""
        kick, limits = self.settings.learning.kick, self._monitor.limits
        refusals = (limits.refusal(self.reference + swing, self.reference) for swing in (-kick, kick))
        why = next(filter(None, refusals), "")
        return why and f"it swings by learning.kick = {kick:g} rad to either side, but {why}"

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
        self._memory = self._law.memory.copy()  # it has not seen what the learner did
        return result

    def update(self, measured: Array, elapsed: float | None = None) -> float:
        """Take one sample and return the command, V or A; 0 while a fault is latched and where no finite one follows.

        Parameters
        ----------
        measured : shape (5,): theta_m, omega_m, i, theta_l, omega_l (rad, rad/s, A), nan where not measured
        elapsed : since the sample before, s; the period by default
        """
        if self.fault:
            return 0.0
        fault = self._monitor.check(measured, self.command, elapsed or self.settings.period)
        if fault:
            self.fail(fault)
            return 0.0
        observer = self._observer
        if elapsed is not None and elapsed > 1.5 * observer.period:  # samples are missing
            observer = replace(self.settings, period=elapsed).observer(self.drive)
        observer_step(observer, self._estimate, measured, self.command)
        if not self.holding:
            self.reference = self._monitor.limits.clip(self.load_angle)
        offset = 0.0
        law, memory = self._law, self._memory
        if self._learner is not None:
            law, memory = self._fast, self._fast_memory
            offset = self._learner.update(
                self._estimate,
                has_motor=not math.isnan(measured[THETA_M]),
                has_load=not math.isnan(measured[THETA_L]),
            )
        low, high = voltage_range(self._output, self._estimate)
        voltage = law.step(law.constants, memory, self._estimate[:6], self.reference + offset, low, high)
        command = command_of(self._output, self._estimate, voltage)
        self.command = self._monitor.limits.soften(command, self.load_angle)
        if not math.isfinite(self.command + sum(self._estimate.tolist())):  # finite if and only if all are
            self.fail("no finite command follows from the joint states")
        return self.command
