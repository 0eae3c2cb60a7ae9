"""The drive, simulated: publishes joint states at a fixed rate and takes the motor's voltage or current.

Simulated time goes with the steady clock, one period a beat, ``real_time_factor`` times as fast. The command that
arrives after sample k acts from sample k on, as if the controller took no time, so that the loop equals the offline one
as long as every answer comes within its period. A beat that comes late is made good by moving the plant on, not by
extra samples. In ``lockstep`` the next sample waits for the answer to the last one, and time is the plant's alone: the
loop then equals the offline one whatever the machine does, and runs as fast as the graph allows.

An answer says which sample it is for, in the label of its layout. That is how lockstep knows its answer, how a second
controller is found out, and how old a command is: as old as that sample, however long it waited on the way.
"""

import math
from collections import OrderedDict, deque
from collections.abc import Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock as SystemClock
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.drivetrain import IntegrationError, Plant
from backlash_ros.nodes.parameters import declare_simulator, refuse_unknown
from backlash_ros.ros.diagnostics import ERROR, OK, WARN, Window, milliseconds, rate_level, status
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.messages import label_of, stamp_label
from backlash_ros.ros.run import run
from backlash_ros.ros.timer import Timer, now

_REPEAT = 0.04
"""Silence after which a sample in lockstep is sent again, s: best effort may lose it, and a watchdog waits for it."""

_TWO = "two controllers on command: one sample was answered twice"


class PlantSimulator(ManagedNode):
    """Geared servo with backlash behind the topics of a drive.

    ``together``: the simulators of this process, in whose company it joins: in lockstep they step as one.
    """

    def __init__(self, namespace: str = "", together: "list[PlantSimulator] | None" = None) -> None:
        super().__init__("plant_simulator", namespace)
        given = declare_simulator(self)
        refuse_unknown(self)
        self._drive, self._joints, self._rate = given.drive, given.joints, given.rate
        self._period = 1.0 / given.rate
        self._beat_time = self._period / given.real_time_factor
        self._lockstep, self._command_timeout = given.lockstep, given.command_timeout
        self._wall = SystemClock()  # whatever use_sim_time says: time comes from a drive, not to it
        self._fault = ""
        self._ticks = self._rejected = self._late = self._beats = self._answered = self._answered_late = 0
        self._step_time = Window()
        self._seen = now(), 0, 0, 0
        self._together = [] if together is None else together
        self._together.append(self)
        alike = {(axis._lockstep, axis._rate) for axis in self._together}
        if len(alike) > 1 and any(lockstep for lockstep, _ in alike):
            raise ValueError("lockstep must be the same, and rate too, for all axes of one process")

    # The lifecycle.

    def configure(self) -> None:
        """Compile the plant, at rest in the middle of the gap, and take up the topics."""
        self._plant = Plant(self._drive)
        self._plant.advance(0.0, 0.0, self._period)  # compiles, or loads what was compiled before
        self._plant = Plant(self._drive)
        self._value = self._load_torque = 0.0
        self._sample = JointState(name=list(self._joints))
        self._states = self.speak(JointState, "joint_states")
        self._clock_publisher = self.speak(Clock, "/clock") if self._own_time else None
        self._fault = ""
        self._first = math.inf
        self.listen(Float64MultiArray, "command", self._on_command)
        self.listen(Float64, "load_torque", self._on_load_torque)

    def activate(self) -> None:
        """Begin to publish."""
        self._value = 0.0
        self._ticks = max(axis._ticks for axis in self._together)  # one time for all
        self._label, self._waiting, self._repeated = "", False, False
        self._replied: deque[str] = deque(maxlen=16)
        self._sent: OrderedDict[str, float] = OrderedDict()
        self._last_command = self._last_answer = -math.inf
        self._outdated = ""
        self._last_beat = now()
        self._due = 0
        self._seen = self._last_beat, self._beats, self._late, self._answered
        if self._lockstep:
            self._publish()
            self._timer = Timer(_REPEAT, self._repeat)
        else:
            # Axes of one process take turns: at once, the last one would wait for all the others each time.
            turn = self._together.index(self) / len(self._together)
            self._timer = Timer(self._beat_time, self._beat, turn * self._beat_time)
            self._start = self._timer.due - self._beat_time
        self.own_timers.append(self._timer)
        speed = "in lockstep" if self._lockstep else f"{self._period / self._beat_time:g} times real time"
        self.get_logger().info(
            f"simulating at {self._rate:g} Hz, {speed}, backlash {self._drive.gear.backlash_angle:g} rad at the output"
        )

    def deactivate(self) -> None:
        """Take the command off and stand still: no time passes while not active."""
        self._value = 0.0
        self.own_timers.remove(self._timer)
        self.get_logger().info(f"stopped after {self._beats} beats, {self._late} of them late")

    # Faults.

    def _fail(self, fault: str) -> None:
        self._value = 0.0
        if self._fault:
            return
        self._fault = fault
        self.get_logger().error(f"{fault}: motor at 0 {self._drive.command_unit} until reset_fault")
        self.publish_diagnostics()

    def reset_fault(self) -> tuple[bool, str]:
        """Forget a latched fault; the motor takes commands again."""
        forgotten, self._fault = self._fault, ""
        return True, f"reset: {forgotten}" if forgotten else "there was no fault"

    # Commands.

    def _reject(self, what: str) -> None:
        self._rejected += 1
        self.get_logger().warning(f"{what}; {self._rejected} messages rejected so far", throttle_duration_sec=1.0)

    def _on_command(self, message: Float64MultiArray) -> None:
        label = label_of(message)
        if not self.active:
            return
        if self._lockstep and not (self._waiting and label == self._label):
            if label in self._replied:
                self._fail(_TWO)
            return
        at = now()
        outdated = label not in self._sent and self._forgotten(label)
        if not outdated and label not in self._sent:
            label = ""  # it names no sample of this drive: a recording that is played, say
        sent = -math.inf if outdated else self._sent.get(label, at)
        if not message.data or not math.isfinite(message.data[0]):
            self._rejected += 1
            self._fail(f"command must hold one finite number, in {self._drive.command_unit}, got {list(message.data)}")
        elif label in self._replied:
            self._fail(_TWO)
        elif not label and message.data[0] and at - self._last_answer < self._command_timeout:
            foreign = f"{message.data[0]:g} {self._drive.command_unit}"
            self._fail(f"a second publisher on command: {foreign} between a controller's answers")
        elif message.data[0] and at - sent >= self._command_timeout and not self._lockstep:
            self._outdated = ", only answers to samples that are older"
            self._reject(f"command answers a sample that is older than command_timeout = {self._command_timeout:g} s")
        elif not self._fault:
            self._value, self._outdated = message.data[0], ""
        self._last_command = max(self._last_command, sent)
        if label:
            self._last_answer = max(self._last_answer, sent)
            if not self._repeated:  # one controller may well answer twice then
                self._replied.append(label)
            in_period = label == self._label
            self._answered += in_period
            self._answered_late += not in_period
        if self._lockstep:
            self._waiting = False
            self._step_together()

    def _forgotten(self, label: str) -> bool:
        """Whether a label that is not remembered is that of a sample sent since `configure`."""
        return bool(label) and self._first <= float(label) < float(next(iter(self._sent), math.inf))

    def _on_load_torque(self, message: Float64) -> None:
        if not math.isfinite(message.data):
            self._reject(f"load_torque must be finite, in N m, got {message.data}: kept {self._load_torque:g}")
            return
        self._load_torque = message.data

    # Time.

    @property
    def _own_time(self) -> bool:
        return self._lockstep or self._beat_time != self._period

    def _step_together(self) -> None:
        """In lockstep: when every axis of this process has its answer, all go on."""
        axes = [axis for axis in self._together if axis.active]
        if any(axis._waiting for axis in axes):
            return
        for axis in axes:
            axis._advance(1)
        for axis in axes:
            axis._publish()

    def _repeat(self) -> None:
        if not self._waiting:
            self._step_together()  # the axis that the others waited for may be active no more
        elif now() - self._last_beat > _REPEAT:
            self._repeated = True
            self._states.publish(self._sample)

    def _beat(self) -> None:
        at, stamp = now(), self._wall.now().to_msg()  # when the plant is there, however long the rest takes
        due = max(1, round((at - self._start) / self._beat_time) - self._due)
        self._due += due
        self._late += due - 1
        silence = at - self._last_command - self._command_timeout
        if self._value and silence > 0:
            # However late this beat is, the motor was powered no longer than the watchdog lets it.
            powered = max(0, due - math.floor(silence / self._beat_time))
            self._advance(powered)
            due -= powered
            self._fail(f"no command for {self._command_timeout:g} s{self._outdated}")
        self._advance(due)
        self._publish(stamp)

    def _advance(self, periods: int) -> None:
        began = now()
        try:
            self._plant.advance(self._value, self._load_torque, periods * self._period)
        except IntegrationError as error:
            torque, self._load_torque = self._load_torque, 0.0
            self._fail(f"cannot simulate with load_torque {torque:g} N m, which is 0 again: {error}")
        self._ticks += periods
        self._step_time.add(now() - began)

    def _publish(self, stamp: Time | None = None) -> None:
        plant = self._plant
        if stamp is None or self._own_time:
            seconds, nanoseconds = divmod(round((self._ticks + 1) * self._period * 1e9), 10**9)
            stamp = Time(sec=seconds, nanosec=nanoseconds)
        message = self._sample
        message.header.stamp = stamp
        message.position = [plant.motor_angle, plant.load_angle]
        message.velocity = [plant.motor_speed, plant.load_speed]
        message.effort = [plant.motor_torque, plant.gear_torque]
        before = self._together[: self._together.index(self)]
        if self._clock_publisher is not None and not any(axis.active for axis in before):
            self._clock_publisher.publish(Clock(clock=stamp))
        self._label, self._waiting, self._repeated, self._last_beat = stamp_label(stamp), True, False, now()
        self._sent[self._label] = self._last_beat
        while next(iter(self._sent.values())) < self._last_beat - self._command_timeout:
            self._sent.popitem(last=False)
        self._first = min(self._first, float(self._label))
        self._beats += 1
        self._states.publish(message)

    # Diagnostics.

    def statuses(self) -> Sequence[DiagnosticStatus]:
        """Say what the motor gets, how steady the beat is and how many samples were answered in time."""
        at, before = now(), self._seen
        self._seen = at, self._beats, self._late, self._answered
        passed, beats, late, answered = (new - old for new, old in zip(self._seen, before, strict=True))
        name, hardware = self.get_fully_qualified_name(), "simulated drive"
        drive = [(ERROR, self._fault) if self._fault else (OK, self.state)]
        if self.mismatches:
            drive.append((WARN, f"{self.mismatches} publishers of a quality of service that does not match"))
        timing = []
        if self.active and beats and not self._lockstep:
            timing.append(rate_level(beats / passed, 1.0 / self._beat_time))
            if late:
                timing.append((WARN, f"{late} beats late within {passed:.1f} s"))
        return [
            status(
                f"{name}: drive",
                hardware,
                drive,
                {
                    "state": self.state,
                    "fault": self._fault,
                    f"command_{self._drive.command_unit}": getattr(self, "_value", 0.0),
                    "load_torque_Nm": getattr(self, "_load_torque", 0.0),
                    "messages_rejected": self._rejected,
                },
            ),
            status(
                f"{name}: timing",
                hardware,
                timing or [(OK, self.state)],
                {
                    "rate_Hz": f"{beats / passed:.2f}",
                    "nominal_rate_Hz": f"{1.0 / self._beat_time:g}",
                    "samples": self._beats,
                    "late_beats": self._late,
                    "answered_in_period": self._answered,
                    "answered_late": self._answered_late,
                    "answered_percent": f"{100 * answered / beats:.2f}" if beats else "",
                    "integration": milliseconds(self._step_time.take()),
                },
            ),
        ]


def main(args: Sequence[str] | None = None) -> int:
    """Run the plant simulator, or one for each of ``--axes``."""
    together: list[PlantSimulator] = []
    return run("plant_simulator", lambda namespace: PlantSimulator(namespace, together), args)


if __name__ == "__main__":
    raise SystemExit(main())
