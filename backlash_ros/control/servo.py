"""The controller without ROS: samples in, commands out. The node and offline runs both call it."""

import math
from dataclasses import replace

import numpy as np

from backlash_ros.control.acting import ActingLaw
from backlash_ros.control.changes import drive_rejection, limits_rejection
from backlash_ros.control.encoders import Encoders, encoders_of
from backlash_ros.control.experiment import Deferred, Excitation, NamedExperiment, Outcome
from backlash_ros.control.experiment_in_use import ExperimentInUse, choose, parameters_of, swing_refusal
from backlash_ros.control.law import REGION
from backlash_ros.control.law_in_use import LawInUse
from backlash_ros.control.laws import LAWS, design_law, law_of
from backlash_ros.control.limits import Limits
from backlash_ros.control.memory import InputRow, TickRow
from backlash_ros.control.monitoring.fault_texts import describe_fault
from backlash_ros.control.monitoring.monitor import forget_ends
from backlash_ros.control.motion.motion_limits import motion_limits
from backlash_ros.control.motion.plan import Fastest, Plan
from backlash_ros.control.motion.profile import MotionLimits
from backlash_ros.control.motion.setpoint import AtRest, Source, Stop, is_reference
from backlash_ros.control.observer import keep_estimate
from backlash_ros.control.settings import BOTH, CONTINUE, LOAD, MOTOR, ServoSettings
from backlash_ros.control.tick import Tick, tick_constants_at, tick_with
from backlash_ros.control.tick_constants import tick_constants
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import (
    LOAD_TORQUE,
    OMEGA_L,
    POSITION,
    THETA_L,
    THETA_M,
    VELOCITY,
    Estimate,
    Measurement,
    Setpoint,
)
from backlash_ros.gates.faults import Fault

_SLOW = 0.02
"""Share of faults.velocity below which the load counts as at rest. Tuned."""
_NEAR = 0.01
"""Distance from the setpoint, rad, within which the load is there, if the gap is not wider: half the nominal gap."""


class Servo:
    """The servo of one axis: the tick with a plan of the setpoint, a law, and an experiment beside it.

    After construction and after every `release` it holds the position of the first sample. A fault, found by the tick
    or reported by `fail`, is ``latched``, with its text in ``fault``: 0 V until `reset`.

    Parameters
    ----------
    drive : the drive as the controller knows it
    limits : `Limits.of` the drive by default
    watched : whether the monitor is on; offline runs may do without it
    """

    settings: ServoSettings
    limits: Limits
    barred = ""
    """Why no reference is followed, by others' decision; empty if that is not so. `stop` brings the load to rest."""
    constants: Array
    motion: MotionLimits | None
    """Limits of the setpoint's motion to a reference; None if it leaps there."""
    _law: LawInUse

    def __init__(
        self, drive: Drive, settings: ServoSettings, limits: Limits | None = None, *, watched: bool = True
    ) -> None:
        self.drive = drive
        self.latched, self.fault = Fault.NONE, ""
        self.memory, self._inputs = TickRow(), InputRow()
        self.estimate: Estimate = self.memory.estimate
        self._watched, self._encoders = watched, Encoders(drive.gear.ratio)
        self._plan = Plan(self.memory, self._inputs)
        self._experiment = ExperimentInUse()
        self.use(settings, limits or Limits.of(drive))

    # Tuning.

    def use(self, settings: ServoSettings, limits: Limits | None = None, drive: Drive | None = None) -> None:
        """Use ``settings`` from the next sample on; the memory of the observer, and of an unchanged law, is kept.

        A new law starts with the voltage that holds the load. A profile goes on within its new limits. A new ``drive``
        may have another load, friction and teeth, but must have the same motor, reduction and command. A running
        experiment keeps its settings.

        Raises
        ------
        ValueError
            If the law cannot be designed; nothing changes.
        """
        limits, drive = limits or self.limits, drive or self.drive
        settings = replace(settings, largest_command=limits.command)
        if self._encoders.used not in ("", settings.encoders):
            settings = replace(settings, encoders=self._encoders.used)
        if settings.on_lost_encoder == CONTINUE and settings.encoders == BOTH:
            for one in (MOTOR, LOAD):  # not first when it is needed, between two samples
                tick_with(design_law(drive, replace(settings, encoders=one)).step)
        law, observer = design_law(drive, settings), settings.observer(drive)
        if drive != self.drive:
            keep_estimate(observer, self.memory.observer)
            keep_estimate(observer, self.memory.monitor.observer)
            self.drive = drive
        name, first = law_of(drive, settings), not hasattr(self, "settings")
        # Under the same name in the settings, another law may have taken its place.
        if first or self.settings.law != settings.law or self._law.chosen.law.step is not law.step:
            self._law = LawInUse(name, law)
            self._begin(self._law.chosen)
        elif self._law.redesign(name, law):
            self._begin(self._law.chosen)
        others = first or limits != self.limits
        self.settings, self.limits, self.motion = settings, limits, motion_limits(self.drive, settings, limits)
        self._tell_tick(others_ends=others)
        if (profile := self._plan.profile) is not None and self.motion is not None and not self.arrived:
            self.set_reference(profile.reference)

    def _tell_tick(self, *, others_ends: bool) -> None:
        """Tell the tick what is in use; ``others_ends``: whether the ends of the travel are other ones than before.

        The tick counts as the readings do. While a run looks for the zero it knows of no ends.
        """
        run = self._experiment.run
        limits = self.limits.endless if run is not None and run.finds_zero else self.limits.moved(self.zero)
        observer, ahead = self.settings.observer(self.drive), self._law.chosen.law.ahead
        self.constants = tick_constants(self.drive, self.settings, limits, observer, ahead=ahead, watched=self._watched)
        if others_ends:
            forget_ends(self.memory.monitor)

    def rejection_reason(self, limits: Limits, drive: Drive | None = None, zero: float | None = None) -> str:
        """Return why ``limits``, a new ``drive`` or another ``zero``, rad, cannot be used now; empty if they can.

        Limits are refused if the plan goes outside of them, except a load that was found outside and is held there. A
        drive is refused while the load moves, since a wrong unit would accelerate it. Another zero is refused unless
        the load rests where it should, within the limits.
        """
        if not self.holding:
            return ""
        why = drive_rejection(self.drive, drive or self.drive) if self._moves else ""
        if zero is None or zero == self.zero:
            return why or limits_rejection(self.limits, limits, self._plan.extremes)
        return why or self._zero_rejection(zero, limits)

    # The zero.

    @property
    def zero(self) -> float:
        """The reading of the load's angle from which all positions of this class count, rad.

        The tick, its law, observers, monitors and experiments go on with the readings, so another zero moves nothing,
        and what they have learned stays where it is on the gear.
        """
        return self._plan.zero

    def count_from(self, zero: float) -> None:
        """Let positions count from another reading, rad; `rejection_reason` says whether this is a time for it."""
        if zero != self.zero:
            self._plan.count_from(zero)
            self._tell_tick(others_ends=True)

    def _zero_rejection(self, zero: float, limits: Limits) -> str:
        hindrance = self.hindrance
        if not hindrance and (not self.arrived or self._moves or self._away):
            hindrance = "while the load moves, or is away from its reference: call hold"
        if hindrance:
            return f"the zero must not change {hindrance}"
        there = self.load_angle + self.zero - zero
        why = limits.rejection_reason(there, there)
        return why and f"with zero = {zero:.6g} rad the load is at {there:.6g} rad, but {why}"

    # The law.

    def _begin(self, acting: ActingLaw) -> None:
        """Start a law again; if the load is held, from the voltage that holds it."""
        acting.start()
        if self.holding:
            acting.take_over(self.estimate, self.memory.setpoint, self.holding_voltage)

    @property
    def law(self) -> str:
        """The name of the law in use, also where the settings leave the choice to `AUTO`."""
        return self._law.name

    @property
    def calmed(self) -> bool:
        """Whether the over-damped gains act instead of the law."""
        return self._law.calmed

    def calm(self) -> None:
        """Let the over-damped gains act instead of the law, until other settings are used or the load is released.

        This is the answer to wear, and to a missing encoder if the law needs both.
        """
        if not self.calmed and self.holding:
            self._law.calm(design_law(self.drive, self.settings.with_law("overdamped")))
            self._begin(self._law.acting)

    @property
    def _acting(self) -> ActingLaw:
        """The law that acts now, also in an experiment."""
        run = self._experiment.run
        return run.acting if run else self._law.acting

    @property
    def region(self) -> int:
        """1 while the fast gains act, 2 while the over-damped ones do."""
        return int(self._acting.state[REGION])

    def shown(self, name: str) -> int:
        """Return the "phase" or "flank" of the law that acts; 0 if it has none."""
        value = self._shown_by_law(name)
        return 0 if math.isnan(value) else int(value)

    def _shown_by_law(self, name: str) -> float:
        """Return what the law that acts knows by this name, see `ControlLaw.shown`; nan if it does not."""
        acting = self._acting
        at = acting.law.shown.get(name)
        return math.nan if at is None else float(acting.state[at])

    # Holding and faults.

    def release(self, reason: str) -> None:
        """Release the drive: command 0, reset the observer, end an experiment; hold the position of the next sample."""
        self.memory.forget()
        self._law.start()
        self._plan.hold()
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

    @property
    def described_fault(self) -> str:
        """The fault that the tick has found, in words; empty for none."""
        fault, thresholds = Fault(int(self.memory.fault)), self.settings.thresholds_of(self.drive)
        return describe_fault(fault, self.memory.details, self.limits, thresholds, self.zero) if fault else ""

    # The reference.

    def set_reference(self, reference: float) -> str:
        """Take a reference at rest, rad, and return an empty text; or change nothing and return why it is refused."""
        if not math.isfinite(reference):
            return f"reference must be finite, in rad, got {reference}"
        if self.motion is None:
            return self.follow(AtRest(reference))
        return self._plan.go_to(reference, self.motion, self.limits, self._fastest, self.hindrance or self.barred)

    @property
    def _stopped_at(self) -> float:
        """Speed beyond which the monitor stops the load, rad/s."""
        return float(tick_constants_at(self.constants).monitor.velocity)

    @property
    def _fastest(self) -> Fastest:
        """Speed that no plan may exceed."""
        stopped, able = self._stopped_at, self.drive.no_load_speed
        return Fastest(able, "the drive's no-load speed") if able < stopped else Fastest(stopped, "faults.velocity")

    def follow(self, source: Source, *, at_once: bool = False, paced: bool = False) -> str:
        """Plan ``source`` from the present setpoint on; return an empty text, or why it is refused.

        Parameters
        ----------
        at_once : whether the plan began with the last sample, as a path does that goes on from there; by default it
            begins with the next one, whenever that comes
        paced : whether it may be slowed down, see `pace`
        """
        return self._follow(source, self.hindrance or self.barred, at_once=at_once, paced=paced)

    def _follow(self, source: Source, hindrance: str = "", *, at_once: bool = False, paced: bool = False) -> str:
        return self._plan.follow(source, self.limits, self._fastest, hindrance, at_once=at_once, paced=paced)

    @property
    def pace(self) -> float:
        """How fast paths are followed that may be slowed down: 1 as planned, 0 they stand still.

        A change accelerates the setpoint within what the drive can do.
        """
        return self._plan.pace

    def set_pace(self, pace: float) -> str:
        """Follow paths at another `pace`; return an empty text, or change nothing and return why it is refused."""
        if not 0.0 <= pace <= 1.0:  # nan, too
            return f"speed_scaling must be a share from 0 to 1, got {pace:g}"
        self._plan.pace = pace
        return ""

    def stop(self) -> str:
        """Come to rest along the path and hold there; return an empty text, or why nothing is held.

        A step, whose setpoint is at its end already, stops where the load can.
        """
        if self.hindrance:
            return f"nothing is held {self.hindrance}"
        refusal = self._come_to_rest()
        self._plan.asked = False
        return refusal

    def _come_to_rest(self) -> str:
        limits, start = self.limits, self.setpoint
        stands = not np.any(start[VELOCITY:])
        if stands and (self._moves or self._away):
            start[POSITION], start[VELOCITY], stands = self.load_angle, self.estimate[OMEGA_L], not self._moves
        elif stands and is_reference(self.segments):
            return ""
        deceleration = float(tick_constants_at(self.constants).motion.acceleration)
        stopping = Stop(start, deceleration, limits.position_lower, limits.position_upper)
        if not stands and not self._follow(stopping, at_once=True):
            return ""
        # A load that stands, or for which no smooth stop fits before an end of the travel, is held at once.
        return self._follow(AtRest(limits.clamp(float(start[POSITION]))))

    @property
    def _moves(self) -> bool:
        return bool(abs(self.estimate[OMEGA_L]) > _SLOW * self._stopped_at)

    @property
    def _away(self) -> bool:
        return abs(self.tracking_error) > max(self.settings.backlash_angle, _NEAR)

    @property
    def hindrance(self) -> str:
        """Why nothing is followed now, whatever it is; empty if that is not so."""
        if self.latched:
            return f"while {self.latched.name} is latched: call reset_fault"
        if self.experimenting:
            return "while homing" if self.experiment.startswith("homing") else "while learning"
        return "" if self.holding else "while no position is held"

    @property
    def segments(self) -> Array:
        """The plan of the tick: as `Source.segments` returns it, but in readings, which do not count from `zero`."""
        return self._plan.segments

    @segments.setter
    def segments(self, segments: Array) -> None:
        self._plan.segments = segments

    @property
    def reference(self) -> float:
        """The end of the plan, rad; nan while no position is held."""
        return self._plan.end

    @property
    def holding(self) -> bool:
        """Whether a sample has been seen since the last `release`."""
        return self._plan.holding

    @property
    def arrived(self) -> bool:
        """Whether the setpoint is at the end of the plan, at rest."""
        return self._plan.arrived

    @property
    def asked(self) -> bool:
        """Whether the end of the plan was asked for: it is not where the load was found or stopped."""
        return self._plan.asked

    @asked.setter
    def asked(self, asked: bool) -> None:
        self._plan.asked = asked

    # Results of the tick.

    @property
    def command(self) -> float:
        """The command in force, V or A."""
        return self.memory.command

    @command.setter
    def command(self, value: float) -> None:
        self.memory.command = value

    @property
    def setpoint(self) -> Setpoint:
        """The last setpoint, with an experiment's offset."""
        return self._plan.setpoint

    @property
    def load_angle(self) -> float:
        """theta_l, rad."""
        return float(self.estimate[THETA_L]) - self.zero

    @property
    def tracking_error(self) -> float:
        """Setpoint - theta_l, rad, without an experiment's offset."""
        return self._plan.position - self.load_angle

    @property
    def load_torque_estimate(self) -> float:
        """Torque on the output shaft, N m; 0 with the load encoder alone."""
        return float(self.estimate[LOAD_TORQUE])

    @property
    def holding_voltage(self) -> float:
        """Voltage that holds the load, V.

        It does not use the law's estimate: there is none with the load's encoder alone, and ``torque_bandwidth`` may be
        0. While the monitor is off, there is no other.
        """
        found = float(self.memory.monitor.unexplained_torque)
        return self._voltage_against(found if self._watched else self.load_torque_estimate)

    def _voltage_against(self, load_torque: float) -> float:
        """Return the voltage that holds a load torque (N m) as far as the limits allow, V."""
        drive = self.drive
        reach = drive.standstill_torque(self.limits.command)
        torque = min(max(load_torque, -reach), reach)
        return -torque * drive.gear.ratio * drive.motor.resistance / drive.motor.torque_constant

    # Experiments.

    @property
    def experimenting(self) -> bool:
        """Whether an experiment is running, or its outcome has not been taken."""
        return self._experiment.pending

    @property
    def experiment(self) -> str:
        """The name of the experiment that is running; empty if none is."""
        run = self._experiment.run
        return "" if run is None else run.name

    @property
    def progress(self) -> float:
        """Its progress, from 0 to 1; 0 if none is running."""
        run = self._experiment.run
        return 0.0 if run is None else run.progress

    @property
    def excitation(self) -> Excitation:
        """The experiment's excitation for the last sample."""
        return Excitation(self._inputs.offset, self._inputs.torque)

    def _choose(self, name: str, parameters: Validated | None) -> tuple[str, NamedExperiment, Validated]:
        both = not np.isnan(self.memory.used[[THETA_M, THETA_L]]).any()
        name, chosen = choose(name, self.settings, both_encoders=bool(both))
        return name, chosen, parameters or parameters_of(name, self.settings)

    def experiment_refusal(self, name: str = "", parameters: Validated | None = None) -> str:
        """Return why an experiment cannot begin, or would exceed the limits from the held position."""
        name, chosen, parameters = self._choose(name, parameters)
        thresholds = self.settings.thresholds_of(self.drive)
        if chosen.refusal and (why := chosen.refusal(self.drive, parameters, self.limits, thresholds)):
            return why
        return swing_refusal(chosen, parameters, self.limits, *self._plan.extremes)

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
        name, chosen, parameters = self._choose(name, parameters)
        run = self._experiment.start(name, chosen, parameters, self.drive, self.settings, self.limits)
        if run.finds_zero:
            self._tell_tick(others_ends=True)
        self._begin(run.acting)

    def cancel(self, reason: str) -> None:
        """End the experiment, if any, without a result."""
        if self._experiment.run is not None:
            self._experiment.run.cancel(reason)

    def trip(self) -> None:
        """Tell the experiment, if any, that its switch has closed."""
        if self._experiment.run is not None:
            self._experiment.run.trip()

    @property
    def tripped(self) -> bool:
        """Whether the switch that the experiment waits for has closed."""
        return self._experiment.run is not None and self._experiment.run.tripped

    def take_outcome(self) -> Outcome | Deferred | None:
        """Return, once, how an experiment ended or the work that will tell; None before."""
        self._conclude()
        return self._experiment.take_outcome()

    def _conclude(self) -> None:
        """If the experiment has ended, let the law hold the load from this sample on."""
        ended = self._experiment.conclude()
        if ended is None:
            return
        self.memory.setpoint[POSITION] -= self._inputs.offset
        self._inputs.offset = self._inputs.torque = 0.0
        if ended.finds_zero:
            self._tell_tick(others_ends=True)
        if self.holding and ended.left_away:
            self._plan.hold_at(self.load_angle)
        self._begin(self._law.acting)  # it has not seen what the experiment did

    def _excite(self, measured: Measurement) -> None:
        """Let the experiment that is running act in this sample."""
        run, inputs, excitation = self._experiment.run, self._inputs, Excitation()
        assert run is not None
        before = run.acting
        if self.holding:
            excitation = run.excite(measured, self.estimate, self.command, inputs.elapsed)
        self._conclude()
        if self._experiment.run is None:
            return
        inputs.offset, inputs.torque, _ = excitation
        # If the experiment has asked for the over-damped law, that one begins.
        if run.acting is not before:
            self._begin(run.acting)

    # The loop.

    @property
    def lost_encoder(self) -> str:
        """The encoder that is lost while the other one goes on, "motor" or "load"; empty if none is."""
        return self._encoders.lost

    def _look_at_encoders(self, measured: Measurement) -> Measurement:
        """Return the sample as the law may use it.

        The first one shows which encoders there are. If one of two is lost later, the settings say whether the other
        goes on alone; else a law that needs both is calmed.
        """
        encoders = self._encoders
        if not self.holding:
            encoders.forget()
            encoders.first = encoders_of(measured)
            if encoders.first != self.settings.encoders:
                self.use(self.settings)
        elif encoders.used == BOTH and (seen := encoders_of(measured)) != BOTH:
            if self.settings.on_lost_encoder == CONTINUE:
                self._lose(MOTOR if seen == LOAD else LOAD)
            elif LAWS[self._law.name].both_encoders:
                self.calm()
        return encoders.seen(measured)

    def _lose(self, side: str) -> None:
        """Go on without an encoder: the law for the other one alone takes over from the last good sample."""
        self.cancel(f"the {side}'s encoder is lost")
        self._encoders.lose(side)
        estimate, torque = self._encoders.shifted(self.estimate), self._shown_by_law("load_torque")
        holding = self.holding_voltage if math.isnan(torque) else self._voltage_against(torque)
        self._encoders.go_on(tick_constants_at(self.constants).observer, self.memory)
        self.use(self.settings)
        self._law.start()
        self._law.acting.take_over(estimate, self.memory.setpoint, holding)

    def warm_up(self, at_rest: Measurement) -> None:
        """Compile, or load, what a sample needs, and a change to this law while the load is held.

        For a servo that controls nothing: the first time takes seconds, for which a loop must not wait.
        """
        self.update(at_rest)
        self._begin(self._law.chosen)

    def update(self, measured: Measurement, elapsed: float | None = None) -> float:
        """Take one sample and return the command, V or A; 0 while a fault is latched or if no finite command follows.

        Parameters
        ----------
        measured : this sample; nan where not measured
        elapsed : since the previous sample, s; the period by default
        """
        if self.latched:
            return 0.0
        inputs = self._inputs
        inputs.elapsed = elapsed or self.settings.period
        sample = self._look_at_encoders(measured)
        if self._experiment.run is not None:
            self._excite(sample)
        inputs.experimenting = 0.0 if self._experiment.run is None else 1.0
        watches = self.settings.on_lost_encoder == CONTINUE and self._encoders.used == BOTH
        before = self.memory.row.copy() if watches else None
        command = self._tick(sample)
        if before is not None:
            command = self._watch_encoders(sample, before, command)
        if self.memory.fault:
            self.fail(Fault(int(self.memory.fault)), self.described_fault)
        return command

    def _tick(self, sample: Measurement) -> float:
        acting, inputs, segments = self._acting, self._inputs.row, self._plan.segments
        return acting.tick(
            self.constants, self.memory.row, acting.law.constants, acting.state, segments, sample, inputs
        )

    def _watch_encoders(self, measured: Measurement, before: Array, command: float) -> float:
        """Return the command, or that with one encoder where the sample's fault shows that the other one is lost.

        ``before`` is the tick's memory before this sample.
        """
        memory, encoders = self.memory, self._encoders
        if not memory.fault:
            encoders.look(measured, self._shown_by_law("middle"))
            return command
        lost = encoders.lost_by(Fault(int(memory.fault)), float(memory.details.bound))
        if not lost:
            return command
        memory.row[:] = before
        self._lose(lost)
        return self._tick(encoders.seen(measured))

    def answered(self, at: float) -> None:
        """Note when the command of the last `update` was sent, s of a steady clock, if known."""
        if self._experiment.run is not None:
            self._experiment.run.answered(at)

    # For compiled loops, which call the tick themselves.

    @property
    def tick(self) -> Tick:
        """The tick with the law in it."""
        return self._law.chosen.tick

    @property
    def law_arrays(self) -> tuple[Array, Array]:
        """Constants and state of the law, the state updated in place."""
        return self._law.chosen.law.constants, self._law.chosen.state
