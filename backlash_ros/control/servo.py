"""The controller without ROS: samples in, commands out. The node and offline runs both call it."""

import math

import numpy as np

from backlash_ros.control.acting import IDLE, ActingExperiment, ActingLaw, at_once, swing_name, swing_of
from backlash_ros.control.command_range import range_constants
from backlash_ros.control.experiment import Deferred, Excitation, NamedExperiment, Outcome
from backlash_ros.control.experiments import EXPERIMENTS
from backlash_ros.control.law import REGION, ControlLaw
from backlash_ros.control.laws import LAWS, design_law, law_of
from backlash_ros.control.limits import Limits
from backlash_ros.control.memory import InputRow, TickRow
from backlash_ros.control.monitoring.bounds import monitor_constants
from backlash_ros.control.monitoring.faults import describe_fault
from backlash_ros.control.monitoring.monitor import forget_ends
from backlash_ros.control.monitoring.plausibility import plausibility_constants
from backlash_ros.control.motion.moving_reference import motion_constants
from backlash_ros.control.motion.setpoint import DURATION, AtRest, Source, extent, plan_rejection
from backlash_ros.control.observer import keep_estimate
from backlash_ros.control.settings import AUTO, ServoSettings
from backlash_ros.control.tick import NOT_BEGUN, Tick, TickConstants
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.record import Array, row_of
from backlash_ros.foundation.signals import (
    LOAD_TORQUE,
    OMEGA_L,
    POSITION,
    THETA_L,
    THETA_M,
    Estimate,
    Measurement,
    Setpoint,
)
from backlash_ros.gates.faults import Fault

_OTHER, _SLOW = 3.0, 0.02
"""Factor by which what a command's size depends on may change while the load moves, and share of faults.velocity below
which the load counts as at rest."""


class Servo:
    """The servo of one axis: the tick with a plan of the setpoint, and an experiment beside it.

    After construction and after every `release` it holds the position of the first sample. A fault, found by the tick
    or reported by `fail`, is ``latched``, with its text in ``fault``: 0 V until `reset`. ``law`` is the name of the law
    in use, also where the settings leave the choice to `AUTO`.

    Parameters
    ----------
    drive : the drive as the controller knows it
    limits : `Limits.of` the drive by default
    watched : whether the monitor is on; offline runs may do without it
    """

    settings: ServoSettings
    limits: Limits
    law: str
    constants: Array
    _chosen: ActingLaw

    def __init__(
        self, drive: Drive, settings: ServoSettings, limits: Limits | None = None, *, watched: bool = True
    ) -> None:
        self.drive = drive
        self.latched, self.fault = Fault.NONE, ""
        self.memory, self._inputs = TickRow(), InputRow()
        self.estimate: Estimate = self.memory.estimate
        self._watched = watched
        self._experiment: ActingExperiment | None = None
        self._outcome: Outcome | Deferred | None = None
        self._calming: ActingLaw | None = None
        self._hold()
        self.use(settings, limits or Limits.of(drive))

    def _hold(self) -> None:
        """Hold the position of the next sample."""
        self.segments = AtRest(math.nan).segments(self.memory.setpoint)
        self._end: float | None = None
        self._reach: tuple[float, float] | None = None

    def _hold_at(self, angle: float) -> None:
        """Hold a load that is far from its reference at an angle, rad, so that it does not jump back."""
        self.segments = AtRest(angle).segments(self.memory.setpoint)
        self.memory.setpoint[:] = angle, 0.0, 0.0
        self.memory.plan_time = NOT_BEGUN
        self._end = self._reach = None

    # Tuning.

    def use(self, settings: ServoSettings, limits: Limits | None = None, drive: Drive | None = None) -> None:
        """Use ``settings`` from the next sample on; the memory of the observer, and of an unchanged law, is kept.

        A new law starts with the voltage that holds the load. A new ``drive`` may have another load, friction and
        teeth, but must have the same motor, reduction and command. A running experiment keeps its settings.

        Raises
        ------
        ValueError
            If the law cannot be designed; nothing changes.
        """
        limits, drive = limits or self.limits, drive or self.drive
        law, observer = design_law(drive, settings), settings.observer(drive)
        self.constants = row_of(
            TickConstants,
            observer=observer,
            monitor=monitor_constants(
                drive,
                limits,
                settings.thresholds_of(drive),
                settings.period,
                settings.velocity_bandwidth,
                settings.backlash_angle,
                min(settings.gains.fast.position, settings.gains.overdamped.position),
                may_grow=settings.renew,
            ),
            plausibility=plausibility_constants(drive),
            range=range_constants(drive, limits),
            motion=motion_constants(drive, limits),
            watched=float(self._watched),
        )
        if drive != self.drive:
            keep_estimate(observer, self.memory.observer)
            keep_estimate(observer, self.memory.monitor.observer)
            self.drive = drive
        named = hasattr(self, "settings") and self.settings.law == settings.law
        self.law = law_of(drive, settings)
        if named and self._chosen.law.step is law.step:  # another law may have replaced it
            self._chosen.redesign(law)
            if self.calmed:
                self._calming = None
                self._begin(self._chosen)
        else:
            self._chosen, self._calming = ActingLaw(law), None
            self._begin(self._chosen)
        if limits != getattr(self, "limits", None):
            forget_ends(self.memory.monitor)
        self.settings, self.limits = settings, limits

    def rejection_reason(self, limits: Limits, drive: Drive | None = None) -> str:
        """Return why ``limits`` or a new ``drive`` cannot be used now; empty if they can.

        Limits are refused if the plan goes outside of them, except a load that was found outside and is held there. A
        drive is refused while the load moves, since a wrong unit would accelerate it.
        """
        if not self.holding:
            return ""
        new, old = drive or self.drive, self.drive
        factors = {
            "load.inertia must change the inertia at the output": new.effective_inertia / old.effective_inertia,
            "motor.torque_constant must change": new.motor.torque_constant / old.motor.torque_constant,
            "motor.resistance must change": new.motor.resistance / old.motor.resistance,
        }
        moves = abs(self.estimate[OMEGA_L]) > _SLOW * self.settings.thresholds_of(old).velocity
        for what, factor in factors.items():
            if moves and not 1.0 / _OTHER <= factor <= _OTHER:
                return f"{what} by a factor of {_OTHER:g} at most while the load moves, got {factor:.3g}"
        reasons = (
            limits.rejection_reason(each, each)
            for each in self._extremes
            if not self.limits.rejection_reason(each, each)
        )
        return next(filter(None, reasons), "")

    def _begin(self, acting: ActingLaw) -> None:
        """Start a law again; if the load is held, from the voltage that holds it."""
        acting.start()
        if self.holding:
            acting.take_over(self.estimate, self.memory.setpoint, self.holding_voltage)

    @property
    def _acting(self) -> ActingLaw:
        """The law that acts without an experiment."""
        return self._calming or self._chosen

    @property
    def calmed(self) -> bool:
        """Whether the over-damped gains act instead of the law."""
        return self._calming is not None

    def calm(self) -> None:
        """Let the over-damped gains act instead of the law, until other settings are used or the load is released.

        This is the answer to wear, and to a missing encoder if the law needs both.
        """
        if not self.calmed and self.holding:
            self._calming = ActingLaw(self._overdamped())
            self._begin(self._calming)

    def _overdamped(self) -> ControlLaw:
        return design_law(self.drive, self.settings.with_law("overdamped"))

    # Holding and faults.

    def release(self, reason: str) -> None:
        """Release the drive: command 0, reset the observer, end an experiment; hold the position of the next sample."""
        self.memory.forget()
        self._calming = None
        self._chosen.start()
        self._hold()
        self.cancel(reason)

    def fail(self, fault: Fault, why: str) -> None:
        """Latch a fault, unless one is latched: release the drive, 0 V until `reset`."""
        if not self.latched:
            self.latched, self.fault = fault, why
        self.release(why)

    def reset(self) -> None:
        """Forget the fault; hold the position of the next sample."""
        self.latched, self.fault = Fault.NONE, ""
        self.release("reset")

    # The reference.

    def set_reference(self, reference: float) -> str:
        """Take a reference at rest, rad, and return an empty text; or change nothing and return why it is refused."""
        if not math.isfinite(reference):
            return f"reference must be finite, in rad, got {reference}"
        return self.follow(AtRest(reference))

    def follow(self, source: Source) -> str:
        """Plan ``source`` from the present setpoint on; return an empty text, or why it is refused."""
        segments = np.ascontiguousarray(source.segments(Setpoint(self.memory.setpoint.copy())), dtype=np.float64)
        _, end, least, largest = extent(segments)
        for hindered, why in (
            (bool(self.latched), f"while {self.latched.name} is latched: call reset_fault"),
            (self.experimenting, "while learning"),
            (not self.holding, "while no position is held"),
        ):
            if hindered:
                return f"reference {end:g} rad came {why}"
        # References that keep coming are ahead of the setpoint: each counts from the one that was taken before.
        taken = float(self.memory.motion.reference)
        if reason := plan_rejection(segments, self.limits, self._position if math.isnan(taken) else taken):
            return reason
        self.segments, self._end = segments, end
        self._reach = least, largest
        self.memory.plan_time = NOT_BEGUN
        return ""

    @property
    def _position(self) -> float:
        """The position of the setpoint, rad, without an experiment's offset."""
        return float(self.memory.setpoint[POSITION] - self._inputs.offset)

    @property
    def _extremes(self) -> tuple[float, float]:
        """Smallest and largest position of the plan, rad, until its end."""
        over = self.memory.plan_time >= np.sum(self.segments[:, DURATION])
        return (self.reference, self.reference) if self._reach is None or over else self._reach

    @property
    def reference(self) -> float:
        """The end of the plan, rad; nan while no position is held."""
        return float(self.segments[0, 0]) if self._end is None else self._end

    @property
    def holding(self) -> bool:
        """Whether a sample has been seen since the last `release`."""
        return not math.isnan(self.segments[0, 0])

    # Results of the tick.

    @property
    def command(self) -> float:
        """The command in force, V or A."""
        return float(self.memory.command)

    @command.setter
    def command(self, value: float) -> None:
        self.memory.command = value

    @property
    def load_angle(self) -> float:
        """theta_l, rad."""
        return float(self.estimate[THETA_L])

    @property
    def tracking_error(self) -> float:
        """Setpoint - theta_l, rad, without an experiment's offset."""
        return self._position - self.load_angle

    @property
    def region(self) -> int:
        """1 while the fast gains act, 2 while the over-damped ones do."""
        return int(self._stepped.state[REGION])

    @property
    def _stepped(self) -> ActingLaw:
        """The law that acts now, also in an experiment."""
        return self._experiment.acting if self._experiment else self._acting

    def shown(self, name: str) -> int:
        """Return the "phase" or "flank" of the law that acts; 0 if it has none."""
        at = self._stepped.law.shown.get(name)
        return 0 if at is None else int(self._stepped.state[at])

    @property
    def load_torque_estimate(self) -> float:
        """Torque on the output shaft, N m; 0 with the load encoder alone."""
        return float(self.estimate[LOAD_TORQUE])

    @property
    def holding_voltage(self) -> float:
        """Voltage that holds the load, V; 0 if the monitor, which finds the load torque, is off.

        It does not use the law's estimate: there is none with one encoder, and ``torque_bandwidth`` may be 0.
        """
        drive = self.drive
        reach = drive.standstill_torque(self.limits.command)
        torque = min(max(float(self.memory.monitor.unexplained_torque), -reach), reach)
        return -torque * drive.gear.ratio * drive.motor.resistance / drive.motor.torque_constant

    @property
    def described_fault(self) -> str:
        """The fault that the tick has found, in words; empty for none."""
        fault, thresholds = Fault(int(self.memory.fault)), self.settings.thresholds_of(self.drive)
        return describe_fault(fault, self.memory.details, self.limits, thresholds) if fault else ""

    # Experiments.

    @property
    def experimenting(self) -> bool:
        """Whether an experiment is running, or its outcome has not been taken."""
        return self._experiment is not None or self._outcome is not None

    @property
    def experiment(self) -> str:
        """The name of the experiment that is running; empty if none is."""
        return "" if self._experiment is None else self._experiment.name

    @property
    def progress(self) -> float:
        """Its progress, from 0 to 1; 0 if none is running."""
        return 0.0 if self._experiment is None else self._experiment.progress

    @property
    def excitation(self) -> Excitation:
        """The experiment's excitation for the last sample."""
        return Excitation(float(self._inputs.offset), float(self._inputs.torque))

    def _named(self, name: str) -> tuple[str, NamedExperiment]:
        """Return an experiment by name, or that of the settings; `AUTO` chooses by the encoders of the last sample."""
        name = name or self.settings.experiment
        if name == AUTO:
            name = "relay" if np.isnan(self.memory.used[[THETA_M, THETA_L]]).any() else "gap_probe"
        return name, EXPERIMENTS.choose("learning.experiment", name, AUTO)

    def experiment_refusal(self, name: str = "", parameters: Validated | None = None) -> str:
        """Return why an experiment cannot begin, or would exceed the limits from the held position."""
        name, chosen = self._named(name)
        parameters = parameters or self._parameters_of(name)
        thresholds = self.settings.thresholds_of(self.drive)
        if chosen.refusal and (why := chosen.refusal(self.drive, parameters, self.limits, thresholds)):
            return why
        if not chosen.swing:
            return ""
        swing, leap = swing_of(chosen, parameters), at_once(chosen, parameters)
        least, largest = self._extremes
        ways = ((least - swing, leap), (largest + swing, -leap))
        reasons = (self.limits.rejection_reason(there, there + back) for there, back in ways)
        why = next(filter(None, reasons), "")
        return why and f"it swings by {swing_name(chosen, parameters)} = {swing:g} rad to either side, but {why}"

    def _parameters_of(self, name: str) -> Validated:
        return dict(self.settings.experiment_parameters).get(name, EXPERIMENTS[name].parameters)

    def start_experiment(self, name: str = "", parameters: Validated | None = None) -> None:
        """Start an experiment at the next sample, that of the settings by default; see `take_outcome`.

        Raises
        ------
        RuntimeError
            If one is running.
        ValueError
            If there is none of that name, the parameters are another's, or its law cannot be designed.
        """
        if self.experimenting:
            raise RuntimeError("already learning")
        name, chosen = self._named(name)
        parameters = parameters or self._parameters_of(name)
        if type(parameters) is not type(chosen.parameters):
            raise ValueError(
                f"{name} needs parameters of type {type(chosen.parameters).__name__}, got {type(parameters).__name__}"
            )
        law = design_law(self.drive, self.settings.with_law(chosen.law)) if chosen.law else IDLE
        period = self.settings.period
        self._experiment = ActingExperiment(
            name, chosen, parameters, law, self._overdamped(), self.drive, period, self.limits
        )
        self._begin(self._experiment.acting)

    def cancel(self, reason: str) -> None:
        """End the experiment, if any, without a result."""
        if self._experiment is not None:
            self._experiment.cancel(reason)

    def take_outcome(self) -> Outcome | Deferred | None:
        """Return, once, how an experiment ended or the work that will tell; None before."""
        self._conclude()
        outcome, self._outcome = self._outcome, None
        return outcome

    def _conclude(self) -> None:
        """If the experiment has ended, let the law hold the load from this sample on."""
        if self._experiment is None or self._experiment.outcome is None:
            return
        self._outcome = self._experiment.outcome
        self.memory.setpoint[POSITION] -= self._inputs.offset
        self._inputs.offset = self._inputs.torque = 0.0
        if self.holding and self._experiment.left_away:
            self._hold_at(self.load_angle)
        self._experiment = None
        self._begin(self._acting)  # it has not seen what the experiment did

    # The loop.

    def update(self, measured: Measurement, elapsed: float | None = None) -> float:
        """Take one sample and return the command, V or A; 0 while a fault is latched or if no finite command follows.

        Parameters
        ----------
        measured : this sample; nan where not measured
        elapsed : since the previous sample, s; the period by default
        """
        if self.latched:
            return 0.0
        if LAWS[self.law].both_encoders and math.isnan(measured[THETA_M] + measured[THETA_L]):
            self.calm()
        inputs = self._inputs
        inputs.elapsed = elapsed or self.settings.period
        if self._experiment is not None:
            before, excitation = self._experiment.acting, Excitation()
            if self.holding:
                excitation = self._experiment.excite(measured, self.estimate, self.command, inputs.elapsed)
            self._conclude()
            if self._experiment is not None:
                inputs.offset, inputs.torque, _ = excitation
                if self._experiment.acting is not before:
                    self._begin(self._experiment.acting)
        inputs.experimenting = float(self._experiment is not None)
        acting = self._stepped
        command = acting.tick(
            self.constants, self.memory.row, acting.law.constants, acting.state, self.segments, measured, inputs.row
        )
        if self.memory.fault:
            self.fail(Fault(int(self.memory.fault)), self.described_fault)
        return command

    def answered(self, at: float) -> None:
        """Note when the command of the last `update` was sent, s of a steady clock, if known."""
        if self._experiment is not None:
            self._experiment.answered(at)

    # For compiled loops, which call the tick themselves.

    @property
    def tick(self) -> Tick:
        """The tick with the law in it."""
        return self._chosen.tick

    @property
    def law_arrays(self) -> tuple[Array, Array]:
        """Constants and state of the law, the state updated in place."""
        return self._chosen.law.constants, self._chosen.state
