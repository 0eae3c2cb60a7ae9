"""The controller as a node: joint states in, one call of the servo, a command out at once.

Everything that decides is in `backlash_ros.control.Servo`. Here are the topics, the lifecycle, and the watchdog that
latches a fault, and puts 0 V out, when no good sample comes.
"""

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, UInt8

from backlash_ros.control import LAWS, BacklashEstimate, Servo
from backlash_ros.control.tick import MISSING
from backlash_ros.drivetrain.signals import THETA_L, THETA_M, Measurement
from backlash_ros.nodes.learn_service import LearnService, describe_outcome
from backlash_ros.nodes.parameters import declare_controller, refuse_unknown
from backlash_ros.nodes.start_lines import margins_line, untold_drive
from backlash_ros.nodes.tunables import Tunables
from backlash_ros.ros.diagnostics import ERROR, OK, WARN, Window, milliseconds, rate_level, status
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.messages import BadSampleError, answer, read_joint_state, stamp_label
from backlash_ros.ros.overrides import values_given
from backlash_ros.ros.run import run
from backlash_ros.ros.timer import Timer, now
from backlash_ros.ros.topics import TRANSIENT_LOCAL

_LEARN_PATIENCE = 5.0
"""Time that a request to learn waits for the first joint states, s: discovery may take some."""

_SHOWN = ("law", "gain_set", "gains.fast.k", "gains.overdamped.k", "backlash_angle")
"""Parameters that the diagnostics repeat; all of them are in ~/parameters_in_use."""

_ACKNOWLEDGED = Duration(seconds=0.02)
"""How long the last command waits for readers that acknowledge: a stalled one must not stop the other axes' loops."""

_CLOCKS_DIFFER = 10.0
"""Age of a sample that says more of the clocks than of the sample, s."""


class Controller(ManagedNode):
    """Two-region servo of one geared drive."""

    def __init__(self, namespace: str = "") -> None:
        super().__init__("controller", namespace)
        given = declare_controller(self)
        self._drive, self._joints, self._rate = given.drive, given.joints, given.rate
        self._state_timeout = given.state_timeout
        self._telemetry_every = max(1, round(given.rate / given.telemetry_rate))
        self._tunables = Tunables(self, self._drive, self._rate)
        refuse_unknown(self)
        self._servo = Servo(self._drive, self._tunables.settings, self._tunables.limits)
        self._tunables.rejection_reason, self._tunables.changed = self._servo.rejection_reason, self._use
        self._measured = Measurement(np.empty(5))
        self._estimated = False
        self._answered = self._dropped = self._late = self._jumps = 0
        self._last_drop = self._refused = ""
        self._step_time, self._age = Window(), Window()
        self._last_stamp = 0
        self._last_sample: float | None = None
        self._unheard = False
        self._since = now()
        self._seen = now(), 0, 0, 0, 0

    # The lifecycle.

    def prepare(self) -> None:
        """Come up; say so where the drive is not described."""
        if text := untold_drive(values_given(self)):
            self.get_logger().warning(text)
        super().prepare()

    def _tell_margins(self) -> None:
        for name, margins in self._tunables.margins().items():
            text, warn = margins_line(name, margins, 1.0 / self._rate)
            if warn:
                self.get_logger().warning(text)
            else:
                self.get_logger().info(text)

    def configure(self) -> None:
        """Compile every law, so that choosing another one stalls no loop, and take up the topics."""
        self._tell_margins()
        at_rest = read_joint_state(JointState(name=["load"], position=[0.0]), "", "load", 1.0)
        for law in LAWS:
            with suppress(ValueError):  # one that cannot be designed for this drive is refused when it is chosen
                Servo(self._drive, self._tunables.settings.with_law(law)).update(at_rest)
        self._servo.reset()
        self._command = self.speak(Float64MultiArray, "command")
        self._error = self.speak(Float64, "~/tracking_error")
        self._region = self.speak(UInt8, "~/region")
        self._torque = self.speak(Float64, "~/load_torque_estimate")
        self._estimate = self.speak(Float64, "~/backlash_estimate", TRANSIENT_LOCAL)
        self._in_use = self.speak(ParameterEvent, "~/parameters_in_use", TRANSIENT_LOCAL)
        self.listen(JointState, "joint_states", self._on_joint_states)
        self.listen(Float64, "reference", self._on_reference)
        self._learn = self.held(LearnService(self), LearnService.close)
        self._watchdog = self.held(Timer(0.5 * self._state_timeout, self._watch), self.own_timers.remove)
        self.own_timers.append(self._watchdog)
        self._publish_in_use()
        self._publish_estimate()

    def activate(self) -> None:
        """Hold the position of the first sample that comes once somebody listens to ``command``."""
        self._last_stamp = self._dropped_stamp = 0
        self._last_sample = None
        self._refused = ""
        self._unheard = False
        gain_set = self._tunables.values["gain_set"]
        self.get_logger().info(f"ready at {self._rate:g} Hz with gain set {gain_set!r}: waiting for the drive")

    def deactivate(self) -> None:
        """Put 0 V out and see to it that it leaves."""
        self._send(0.0)  # first, whatever an experiment does when it is cancelled
        self._servo.release("the controller is not active any more")
        self._command.wait_for_all_acked(_ACKNOWLEDGED)
        self._end_learning()
        self.get_logger().info(f"stopped after {self._answered} samples, {self._dropped} messages dropped")

    # Parameters.

    def _use(self, names: set[str]) -> None:
        self._servo.use(self._tunables.settings, self._tunables.limits)
        if self.configured:
            self._publish_in_use()
        if self.configured and "backlash_angle" in names:
            self._publish_estimate()

    def _publish_in_use(self) -> None:
        self._in_use.publish(self._tunables.message())

    def _publish_estimate(self) -> None:
        angle = self._tunables.values["backlash_angle"]
        if angle > 0 or self._estimated:
            self._estimated = True
            self._estimate.publish(Float64(data=angle))

    # The loop.

    def _on_joint_states(self, message: JointState) -> None:
        if not self.active:
            return
        self._unheard = not (self._servo.holding or self._heard)
        if self._unheard:
            self._last_sample = None
            return
        began = now()
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        label = stamp_label(message.header.stamp)
        if stamp and self._last_sample is not None and self._out_of_order(stamp, label):
            return
        try:
            torque_constant = self._drive.motor.torque_constant
            measured = read_joint_state(message, *self._joints, torque_constant, out=self._measured)
            self._expect_joints(measured)
        except BadSampleError as error:
            self._refuse(f"unusable joint_states: {error}")
            self._servo.command = 0.0
            self._send(0.0, label)
            return
        if self._last_sample is None:
            self._since = began
        elapsed = self._elapsed(stamp, began)
        self._last_stamp, self._last_sample, self._refused = stamp, began, ""
        self._watchdog.due = began + self._state_timeout  # put off with every sample that can be used
        had_fault = self._servo.fault
        self._begin_learning()
        self._send(self._servo.update(measured, elapsed), label)
        self._end_learning()
        if self._servo.fault != had_fault:
            self._report(self._servo.fault)
        self._answered += 1
        if self._answered % self._telemetry_every == 0 and self._servo.holding:
            self._error.publish(Float64(data=self._servo.tracking_error))
            self._region.publish(UInt8(data=self._servo.region))
            self._torque.publish(Float64(data=self._servo.load_torque_estimate))
        self._age.add(1e-9 * (self.get_clock().now().nanoseconds - stamp))
        self._step_time.add(now() - began)

    @property
    def _heard(self) -> bool:
        """Whether anybody listens to the command, be it the drive or a recorder: before, no position is held."""
        return self._command.get_subscription_count() > 0

    def _expect_joints(self, measured: Measurement) -> None:
        """Refuse a sample that has another joint than those by which the position is held: their zeros may differ."""
        present = [not math.isnan(measured[angle]) for angle in (THETA_M, THETA_L)]
        if not self._servo.holding:
            self._present = present
        for name, before, now_there in zip(self._joints, self._present, present, strict=True):
            if before != now_there:
                change = "has come, which the loop was begun without" if now_there else "is missing, which was there"
                raise BadSampleError(f"joint {name!r} {change}")

    def _out_of_order(self, stamp: int, label: str) -> bool:
        """Whether a sample is not newer than the last one; a clock that was set back is told from a stray sample."""
        behind = 1e-9 * (self._last_stamp - stamp)
        if behind < 0:
            self._dropped_stamp = 0
            return False
        if behind == 0.0:
            self._refuse("joint_states repeated, with the stamp of the newest")
            self._send(self._servo.command, label)  # the drive has not heard the answer, or stands still
            return True
        if behind >= self._state_timeout or 0 < self._dropped_stamp < stamp:
            self._dropped_stamp = 0
            return False
        self._dropped_stamp = stamp
        self._refuse(f"joint_states out of order, {behind:g} s behind the newest")
        return True

    def _elapsed(self, stamp: int, at: float) -> float | None:
        """Return the time since the last sample, s, by the stamps unless they jump against the steady clock."""
        if self._last_sample is None:
            return None
        arrived, stamped = at - self._last_sample, 1e-9 * (stamp - self._last_stamp)
        if stamped > MISSING / self._rate:
            self._late += 1
        if stamp and 0 < stamped < arrived + self._state_timeout:
            return stamped
        if stamp:
            self._jumps += 1
            self.get_logger().warning(f"the clock of joint_states jumped by {stamped - arrived:.3g} s")
        return arrived

    def _on_reference(self, message: Float64) -> None:
        if not self.active:
            self._drop(f"reference {message.data:g} rad came while not active")
        elif refusal := self._servo.set_reference(message.data):
            self._drop(refusal)

    def _watch(self) -> None:
        if not self.active:
            if self._learn.take_request():
                self._learn.answer(False, "cannot learn: the controller is not active")
            return
        had_fault = self._servo.fault
        if self._last_sample is not None:
            self._last_sample = None
            why = f", only {self._refused}" if self._refused else ""
            self._servo.fail(f"no joint_states for {self._state_timeout:g} s{why}")
        self._send(0.0)  # first: the rest takes its time
        if self._servo.fault != had_fault:
            self._report(self._servo.fault)
        self._end_learning()
        if self._learn.waiting() > _LEARN_PATIENCE and self._learn.take_request():
            silence = "nobody listens to command" if self._unheard else "no joint_states"
            why = self._faulted() or f": {silence} for {_LEARN_PATIENCE:g} s"
            self._learn.answer(False, f"cannot learn{why}")
        self._unheard = False  # unless the next sample finds it so

    def _send(self, value: float, label: str = "") -> None:
        self._command.publish(answer(value, label))

    def _refuse(self, what: str) -> None:
        self._refused = what
        self._drop(what)

    def _drop(self, what: str) -> None:
        self._dropped += 1
        self._last_drop = what
        self.get_logger().warning(f"{what}; {self._dropped} messages dropped so far", throttle_duration_sec=1.0)

    # Learning.

    def _begin_learning(self) -> None:
        if not (self._servo.holding or self._servo.fault) or not self._learn.take_request():
            return
        if self._servo.fault:
            self._learn.answer(False, f"cannot learn{self._faulted()}")
        elif refusal := self._servo.experiment_refusal():
            self._learn.answer(False, f"cannot learn: {refusal}")
        else:
            self._servo.start_experiment()
            self.get_logger().info("learning the backlash")

    def _faulted(self) -> str:
        return f" while a fault is latched: {self._servo.fault}" if self._servo.fault else ""

    def _end_learning(self) -> None:
        outcome = self._servo.take_outcome()
        if outcome is None:
            return
        text, accepted = describe_outcome(outcome), outcome.valid
        self.get_logger().info(text)
        if isinstance(outcome, BacklashEstimate) and outcome.valid:
            result = self.set_parameters_atomically([Parameter("backlash_angle", value=outcome.angle)])
            if not result.successful:
                accepted, text = False, f"{text}, but it was refused: {result.reason}"
        self._learn.answer(accepted, text)

    # Faults and diagnostics.

    def _report(self, fault: str) -> None:
        self.get_logger().error(f"{fault}: command 0 {self._drive.command_unit} until reset_fault")
        self.publish_diagnostics()

    def reset_fault(self) -> tuple[bool, str]:
        """Forget a latched fault and hold the position where the next sample finds the load."""
        if not self._servo.fault:
            return True, "there was no fault"
        fault = self._servo.fault
        self._servo.reset()
        return True, f"reset: {fault}"

    def statuses(self) -> Sequence[DiagnosticStatus]:
        """Say what the servo does with which gains, and how steadily samples come and are answered."""
        values, servo = self._tunables.values, self._servo
        before, self._seen = self._seen, (now(), self._last_stamp, self._answered, self._late, self._dropped)
        passed, stamped, answered, late, dropped = (new - old for new, old in zip(self._seen, before, strict=True))
        state = [(OK, self.state)]
        if servo.fault:
            state.append((ERROR, servo.fault))
        if self.active and not self._heard and (self._unheard or servo.holding):
            state.append((WARN, f"nobody listens to command{' any more' if servo.holding else ''}"))
        elif self.active and self._last_sample is None:
            state.append((WARN, "waiting for joint_states"))
        if dropped:
            state.append((WARN, f"{dropped} messages dropped, the last one: {self._last_drop}"))
        if self.mismatches:
            state.append((WARN, f"{self.mismatches} publishers of a quality of service that does not match"))
        if self.configured and (commanders := self.count_publishers(self._command.topic_name)) > 1:
            state.append((WARN, f"{commanders} publishers on command"))
        age, step = self._age.take(), self._step_time.take()
        # By the stamps where they go on evenly: in simulated time the steady clock says nothing of the drive's rate.
        rate = answered / (1e-9 * stamped if before[1] and stamped > 0 else passed)
        steady = self.active and self._last_sample is not None and self._since < before[0]
        timing = [rate_level(rate, self._rate)] if steady and answered else [(OK, self.state)]
        if late:
            timing.append((WARN, f"{late} samples late within {passed:.1f} s"))
        if age[0] > _CLOCKS_DIFFER or age[0] < -_CLOCKS_DIFFER:
            timing.append((WARN, f"joint_states are {age[0]:.3g} s old: clocks differ, or use_sim_time does"))
        elif age[1] > self._state_timeout:
            timing.append((WARN, f"joint_states are {age[1]:.3g} s old"))
        if step[1] > 1.0 / self._rate:
            timing.append((ERROR, f"one step takes {step[1]:.3g} s, longer than a period"))
        name, hardware = self.get_fully_qualified_name(), ", ".join(self._joints)
        return [
            status(
                f"{name}: servo",
                hardware,
                state,
                {
                    "state": self.state,
                    "fault": servo.fault,
                    "learning": servo.experimenting,
                    "samples_answered": self._answered,
                    "messages_dropped": self._dropped,
                    "last_dropped": self._last_drop,
                    "parameters_version": self._tunables.version,
                    **{key: values[key] for key in _SHOWN},
                },
            ),
            status(
                f"{name}: timing",
                hardware,
                timing,
                {
                    "rate_Hz": f"{rate:.2f}",
                    "nominal_rate_Hz": f"{self._rate:g}",
                    "late_samples": self._late,
                    "clock_jumps": self._jumps,
                    "state_age": milliseconds(age),
                    "step_time": milliseconds(step),
                },
            ),
        ]


def main(args: Sequence[str] | None = None) -> int:
    """Run the controller, or one for each of ``--axes``."""
    return run("controller", Controller, args)


if __name__ == "__main__":
    raise SystemExit(main())
