"""The controller as a node: joint states in, the gate, one call of the servo, a command out at once.

All decisions are made without ROS: `backlash_ros.gates.SampleGate` decides which samples are taken, and
`backlash_ros.control.Servo` how they are answered. This file has the topics and the lifecycle; `learning` has the
services of learning.
"""

import math
from collections.abc import MutableSequence, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.control import AUTO, LAWS, Servo
from backlash_ros.control.acting import IDLE, ActingLaw
from backlash_ros.control.design.choice import chosen_for_rate
from backlash_ros.control.settings import CONTINUE
from backlash_ros.control.telemetry import telemetry
from backlash_ros.control.tick import MISSING
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.messages import BadSampleError, NotOurJointsError, read_joint_state, stamp_ns
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement
from backlash_ros.gates import Action, Fault, Judged, SampleGate
from backlash_ros.nodes.fixed_parameters import declare_controller, refuse_unknown
from backlash_ros.nodes.group import Group
from backlash_ros.nodes.learning import Learning
from backlash_ros.nodes.motion import Motion
from backlash_ros.nodes.reports import ONE_IS_LOST, ControllerReport, NodeFacts
from backlash_ros.nodes.start_lines import drive_found, margins_line, stands_in, untold_drive
from backlash_ros.nodes.tunables import Tunables
from backlash_ros.ros.diagnostics import ERROR, OK, UNSTAMPED, status
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.messages import Answer, answer, to_stamp
from backlash_ros.ros.overrides import values_given
from backlash_ros.ros.publisher_watch import PublisherWatch
from backlash_ros.ros.run import run
from backlash_ros.ros.timer import Timer, in_ns, now, now_ns
from backlash_ros.ros.topics import HISTORY, RECEIVE_PAIR, TRANSIENT_LOCAL

_SHOWN = ("law", "gain_set", "gains.fast.k", "gains.overdamped.k", "backlash_angle")
"""Parameters that the diagnostics repeat; all of them are in ~/parameters_in_use."""

_LAW = {"law", "backlash_angle", "identified"}
"""Parameters that determine which law acts."""

_WATCH = 0.02
"""Time between two looks at who publishes joint states, s."""

_ACKNOWLEDGED = Duration(seconds=0.02)
"""Longest wait for acknowledgements of the last command: a stalled reader must not stop the other axes' loops."""


class Controller(ManagedNode):
    """Two-region servo of one geared drive."""

    def __init__(self, namespace: str = "") -> None:
        super().__init__("controller", namespace)
        given = declare_controller(self)
        self._joints, self._rate = given.joints, given.rate
        self._state_timeout = given.state_timeout
        self._telemetry_every = max(1, round(given.rate / given.telemetry_rate))
        self._tunables = Tunables(self, given.drive, self._rate)
        refuse_unknown(self)
        _, drive, _, settings, limits = self._tunables.in_use
        self._servo = Servo(drive, settings, limits)
        self._servo.count_from(self._tunables.values["zero"])
        self._tunables.rejection_reason, self._tunables.changed = self._servo.rejection_reason, self._use
        timeout, late_after = in_ns(self._state_timeout), in_ns(MISSING / self._rate)
        self._gate = SampleGate(timeout, late_after, self._joints, wraps=given.wraps, angles=(THETA_M, THETA_L))
        self._tell_gate()
        self._measured, self._answer = Measurement(np.empty(5)), Answer()
        self._values = cast("MutableSequence[float]", memoryview(self._measured))  # the same, as the gate takes it
        self._told_chosen: set[str] = set()
        self._told, self._said, self._lost = Fault.NONE, (False, False, Fault.NONE, False), ""
        self._encoders = ""  # which ones the log has named
        self._estimated = self._changed = False
        self._owed = False  # whether a message was sent between samples, so that the next sample must repeat it
        self._report = ControllerReport(self._rate, self._state_timeout)
        self._command = self.speak(Float64MultiArray, "command")
        self._state = self.speak(DiagnosticArray, "~/state")
        self._estimate = self.speak(Float64, "~/backlash_estimate", TRANSIENT_LOCAL)
        self._in_use = self.speak(ParameterEvent, "~/parameters_in_use", HISTORY)
        self.listen(JointState, "joint_states", self._on_joint_states, RECEIVE_PAIR)
        self.listen(Float64, "reference", self._on_reference)
        self._learning = Learning(self, self._servo, self._tunables, given)
        self._motion = Motion(self, self._servo, given, self._took)
        self._group = Group(self, self._servo, given.group, lambda: self._took(""))
        self._watchdog = Timer(0.5 * self._state_timeout, self._watch)
        self.own_timers += [self._watchdog, Timer(_WATCH, self._watch_publishers)]

    # The lifecycle.

    def prepare(self) -> None:
        """Start; warn if the drive is not described."""
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

    def _tell_chosen(self) -> None:
        """Say what was chosen for the rate and the delay, once."""
        for text in chosen_for_rate(self._tunables.in_use):
            if text not in self._told_chosen:
                self.get_logger().info(text)
                self._told_chosen.add(text)

    def configure(self) -> None:
        """Read the estimate file; compile every law, also the one of experiments that act alone.

        So neither a change of the law nor the first sample of a drive with one encoder stalls the loop. A law that
        needs an identified drive is compiled for one.
        """
        self._neighbours = self.held(PublisherWatch(self, "joint_states", self._joints), PublisherWatch.close)
        self._learning.configure()
        self._tell_margins()
        self._tell_chosen()
        ActingLaw(IDLE)
        at_rest = Measurement(np.zeros(5))
        alone = Measurement(np.where(np.arange(5) == THETA_M, np.nan, 0.0))
        gap = NOMINAL_DRIVE.gear.backlash_angle
        settings = replace(self._tunables.in_use.settings, identified=True, backlash_angle=gap)
        for law, named in LAWS.items():
            # A law that cannot be designed for this drive may be possible once the drive is identified.
            for drive in (self._servo.drive, NOMINAL_DRIVE):
                with suppress(ValueError):
                    Servo(drive, settings.with_law(law)).warm_up(at_rest)
                    if named.one_encoder:
                        Servo(drive, settings.with_law(law)).warm_up(alone)
                    break
        self._servo.reset()
        self._publish_in_use()
        self._publish_estimate()
        self._motion.configure()
        self._group.configure()

    def activate(self) -> None:
        """Hold the position of the first sample received once ``command`` has a subscriber."""
        self._open_gate()
        self._learning.wear.forget()  # the drive may have been repaired
        self._watchdog.due = now() + 0.5 * self._state_timeout
        gain_set = self._tunables.values["gain_set"]
        self.get_logger().info(f"ready at {self._rate:g} Hz with gain set {gain_set!r}: waiting for the drive")
        if text := stands_in(self._servo.drive, self._servo.settings):
            self.get_logger().info(text)

    def _open_gate(self) -> None:
        self._gate.open()
        if self.configured:
            self._neighbours.forget()

    def deactivate(self) -> None:
        """Command 0 V and wait until it is sent."""
        self._command.publish(answer(0.0))  # first, before an experiment is cancelled
        self._servo.release("the controller is no longer active")
        self._motion.released()
        self._command.publisher.wait_for_all_acked(_ACKNOWLEDGED)
        self._learning.stop("the controller is no longer active")
        self.get_logger().info(f"stopped after {self._gate.taken} samples, {self._gate.dropped} messages dropped")

    def destroy_node(self) -> None:
        """Stop, once the last estimate is on the disk or writing takes too long."""
        self._learning.finish()
        super().destroy_node()

    def state_changed(self) -> None:
        """Publish whether the node is active."""
        self._group.tell()
        self._publish_state(self.get_clock().now().nanoseconds)

    # Parameters.

    def _use(self, names: set[str]) -> None:
        values, drive, _, settings, limits = self._tunables.in_use
        self._servo.use(settings, limits, drive)
        self._servo.count_from(values["zero"])
        self._tell_gate()
        self._changed = True
        if self.configured:
            self._publish_in_use()
        if self.configured and "backlash_angle" in names:
            self._publish_estimate()
        self._tell_chosen()
        if _LAW & names and (text := stands_in(drive, settings)):
            self.get_logger().info(text)

    def _tell_gate(self) -> None:
        """Tell the gate beyond which speeds no motion explains a jump, and whether one encoder may be enough."""
        drive, settings = self._servo.drive, self._servo.settings
        load = settings.thresholds_of(drive).velocity
        self._gate.fastest = load / drive.gear.ratio, load
        self._gate.may_lose = settings.on_lost_encoder == CONTINUE

    def _publish_in_use(self) -> None:
        self._in_use.publish(self._tunables.message())

    def _publish_estimate(self) -> None:
        angle = self._tunables.values["backlash_angle"]
        if angle > 0 or self._estimated:
            self._estimated = True
            self._estimate.publish(Float64(data=angle))

    # The loop.

    def _on_joint_states(self, message: JointState) -> None:
        began, stamp = now_ns(), stamp_ns(message.header.stamp)
        if not self.active:
            return
        unusable = ""
        try:
            read_joint_state(
                message,
                *self._joints,
                self._servo.drive.motor.torque_constant,
                out=self._measured,
                nan_is_absent=self._gate.may_lose and self._gate.begun,
            )
        except NotOurJointsError:
            return
        except BadSampleError as error:
            unusable = str(error)
        judged = self._gate.sample(
            stamp or None,
            began,
            joints=(not math.isnan(self._measured[THETA_M]), not math.isnan(self._measured[THETA_L])),
            values=None if unusable else self._values,
            content=None if unusable else self._measured.tobytes(),
            unusable=unusable,
            heard=self._gate.begun or self._heard,
            publishers=1 if self._gate.begun else self._neighbours.count,
        )
        command = self._act(judged.action, 1e-9 * judged.elapsed)
        if judged.action is Action.TAKE:
            self._motion.newest_sample = stamp
        if judged.action is not Action.IGNORE:
            self._command.publish(self._answer.to(message.header.stamp, command))
        answered, clock = now_ns(), self.get_clock()
        self._report.step_time.add(1e-9 * (answered - began))
        if stamp:
            age = 1e-9 * (clock.now().nanoseconds - stamp)
            self._report.age.add(age)
        else:
            age, stamp = math.inf, clock.now().nanoseconds
            if not self._report.unstamped:
                self._report.unstamped = True
                self.get_logger().warning(f"{UNSTAMPED}: they are taken by the time of their arrival")
        if judged.action is Action.TAKE:
            # In simulated time, or if time stands still until the answer, no answer is late.
            if abs(age) < self._state_timeout and not clock.ros_time_is_active:
                self._servo.answered(1e-9 * answered)
            self._learning.look(self._measured, 1e-9 * judged.elapsed)
            self._motion.look(self._measured, 1e-9 * judged.elapsed)
        self._after(judged, stamp)

    def _act(self, action: Action, elapsed: float) -> float:
        """Return the command that answers a sample."""
        if self._gate.fault:
            self._servo.fail(self._gate.fault, self._gate.why)
        if action is Action.TAKE:
            self._learning.begin()
            return self._servo.update(self._measured, elapsed)
        if action is Action.REFUSE:
            self._servo.command = 0.0
        return self._servo.command

    def _after(self, judged: Judged, stamp: int) -> None:
        """Report what a sample has changed, after its answer was sent."""
        if judged.action is Action.TAKE:
            self._watchdog.due = now() + self._state_timeout  # postponed by every usable sample
        if judged.reason and judged.action is Action.TAKE:
            self._changed = True
            self.get_logger().warning(judged.reason, throttle_duration_sec=1.0)
        elif judged.reason:
            dropped = self._gate.dropped
            self.get_logger().warning(f"{judged.reason}; {dropped} messages dropped so far", throttle_duration_sec=1.0)
        found = self._servo.settings.encoders
        if judged.action is Action.TAKE and found != self._encoders and not self._servo.lost_encoder:
            self._encoders = found
            self.get_logger().info(drive_found(found))
        if self._servo.experimenting and not self._said[1]:
            self.get_logger().info(self._learning.doing)
        self._tell_fault()
        if self._servo.lost_encoder != self._lost:
            self._lost, self._changed = self._servo.lost_encoder, True
            if self._lost:
                self.get_logger().warning(f"{ONE_IS_LOST.format(self._lost)}; reset_fault begins with both again")
        regular = judged.action is Action.TAKE and self._gate.taken % self._telemetry_every == 0
        if regular or ((self._news or self._owed) and judged.action in (Action.TAKE, Action.REFUSE)):
            self._publish_state(stamp, 1e-9 * judged.elapsed)
            self._owed = False
        self._learning.end()  # its changes act on the next sample, which reports them

    @property
    def _doing(self) -> tuple[bool, bool, Fault, bool]:
        servo = self._servo
        return servo.holding, servo.experimenting, servo.latched, servo.tripped

    @property
    def _news(self) -> bool:
        """Whether something has changed since the last ~/state."""
        return self._changed or self._doing != self._said

    @property
    def _heard(self) -> bool:
        """Whether the command has a subscriber, a drive or a recorder: before that, no position is held."""
        return self._command.publisher.get_subscription_count() > 0

    def _on_reference(self, message: Float64) -> None:
        refusal = f"reference {message.data:g} rad came while not active"
        if self.active:
            refusal = self._servo.set_reference(message.data)
        self._took(refusal)

    def _took(self, refusal: str, *, often: bool = True) -> None:
        """Publish a new reference, or say why it was refused: once a second if such messages may come ``often``."""
        if not refusal:
            self._changed = True
            return
        self._gate.drop(refusal)
        text = f"{refusal}; {self._gate.dropped} messages dropped so far"
        if often:
            self.get_logger().warning(text, throttle_duration_sec=1.0)
        else:
            self.get_logger().warning(text)

    def _watch_publishers(self) -> None:
        if self.active and not self._gate.fault and (why := self._neighbours.look()):
            self._gate.fail(Fault.SECOND_DRIVE, why)
            self._fail()

    def _fail(self) -> None:
        """Command 0 for a fault that the gate has found between samples."""
        self._servo.fail(self._gate.fault, self._gate.why)
        self._command.publish(answer(0.0))  # first, since the rest takes a while
        self._tell_fault()

    def _watch(self) -> None:
        if not self.active:
            return
        at = now_ns()
        if self._gate.silent(at):
            self._fail()
        else:
            self._command.publish(answer(0.0))
        silence = "command has no subscriber" if self._gate.unheard else "no joint_states"
        self._learning.waited(at, silence)
        if self._news:
            self._publish_state(self.get_clock().now().nanoseconds)
            self._owed = True
        self._gate.unheard = False  # unless the next sample changes it

    def _publish_state(self, stamp: int, elapsed: float = math.nan) -> None:
        """Publish the telemetry, as numbers by name; ``elapsed`` (s) if it is about a sample."""
        self._changed, self._said = False, self._doing
        values = telemetry(
            self._servo,
            self._learning.wear,
            active=self.active,
            parameters_version=self._tunables.version,
            samples=self._gate.taken,
            elapsed=elapsed,
        )
        level = (ERROR, self._servo.latched.name) if self._servo.latched else (OK, "")
        message = DiagnosticArray(status=[status("servo", "", [level], values)])
        message.header.stamp = to_stamp(stamp)
        self._state.publish(message)

    # Faults and diagnostics.

    def _tell_fault(self) -> None:
        """Log and publish a fault that was just latched."""
        before, self._told = self._told, self._servo.latched
        if self._told and self._told is not before:
            self._motion.released()
            self._group.tell()
            unit = self._servo.drive.command_unit
            self.get_logger().error(f"{self._told.name}: {self._servo.fault}: command 0 {unit} until reset_fault")
            self.publish_diagnostics()

    def reset_fault(self) -> tuple[bool, str]:
        """Clear a latched fault and hold the position of the next sample."""
        fault, text, lost = self._servo.latched, self._servo.fault, self._servo.lost_encoder
        self._group.forget()
        if not fault and not lost:
            return True, "no fault was latched"
        self._open_gate()
        self._servo.reset()
        self._told = Fault.NONE
        if self.configured:
            self._group.tell()
        return True, f"reset {fault.name}: {text}" if fault else f"reset the loss of the {lost}'s encoder"

    def statuses(self) -> Sequence[DiagnosticStatus]:
        """Report the servo's state and gains, and the timing of samples and answers."""
        values = self._tunables.values
        commanders = self.count_publishers(self._command.publisher.topic_name) if self.configured else 0
        heard = self.configured and self._heard
        remarks, learned = [*self._learning.remarks()], self._learning.values()
        chosen = self._servo.settings
        if chosen.law != AUTO and (text := stands_in(self._servo.drive, chosen)):
            remarks.append((OK, text))
        facts = NodeFacts(self.get_fully_qualified_name(), self.state, self.mismatches, commanders, heard, remarks)
        shown = {
            "parameters_version": self._tunables.version,
            "law_in_use": self._servo.law,
            "speed_scaling": self._servo.pace,
            **{key: values[key] for key in _SHOWN},
            **learned,
        }
        return self._report.statuses(facts, self._joints, self._servo, self._gate, shown)


ABOUT = """\
Answers each sample of a geared drive with a command, and learns the drive's backlash.

topics, relative to the namespace
  subscribes  joint_states    sensor_msgs/JointState       motor and load: rad, rad/s, N m
              reference       std_msgs/Float64             target angle of the load, rad
              home_switch     std_msgs/Bool                ends ~/home, with homing.switch:=true
              joint_trajectory  trajectory_msgs/JointTrajectory  path of the load, by the name of its joint
              setpoint        trajectory_msgs/JointTrajectory  one point of a path, 50 to 250 a second
              speed_scaling   std_msgs/Float32             0 to 1: share of its speed at which a trajectory is followed
  publishes   command         std_msgs/Float64MultiArray   data[0]: V, or A with command_interface:=current
              ~/in_position   std_msgs/String              released, moving, settled, holding or limit
              ~/state         diagnostic_msgs/DiagnosticArray, ~/backlash_estimate, ~/parameters_in_use, /diagnostics
services (std_srvs/Trigger)
  ~/learn, ~/identify, ~/apply_estimate, ~/home, ~/set_zero, ~/cancel, ~/hold, ~/reset_fault; also the lifecycle
  services
action (control_msgs/FollowJointTrajectory, where that is installed)
  ~/follow_joint_trajectory

The command is 0 after a fault, when deactivated and when the node ends. 0 does not hold a hanging load.

example: ros2 run backlash_ros controller --ros-args --params-file my_drive.yaml"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the controller, or one for each of ``--axes``."""
    return run("controller", ABOUT, Controller, args)


if __name__ == "__main__":
    raise SystemExit(main())
