"""The simulated drive: publishes joint states at a fixed rate and takes the motor's voltage or current.

Simulated time follows the steady clock, ``real_time_factor`` times as fast, in steps of one period. The command that
arrives after sample k acts from sample k on, as if the controller took no time, so that the loop equals the offline one
as long as every answer comes within its period. After a late step the plant is advanced to catch up, without extra
samples. In ``lockstep`` the next sample waits for the answer to the last one, and only the simulation sets the time:
the loop then equals the offline one on any machine. It runs as fast as the graph allows, but no faster than
``real_time_factor`` says, unless that is 0.

`backlash_ros.gates.CommandGate` decides the motor's command, `backlash_ros.simulation` computes the motion.
"""

import math
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent, SetParametersResult
from rclpy.clock import Clock as SystemClock
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.drivetrain import IntegrationError
from backlash_ros.foundation.messages import answered_sample
from backlash_ros.foundation.signals import CURRENT
from backlash_ros.gates import CommandGate, Fault
from backlash_ros.nodes.fixed_parameters import declare_simulator, refuse_unknown
from backlash_ros.nodes.reports import NodeFacts, SimulatorReport
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.messages import fill_joint_state, to_stamp
from backlash_ros.ros.parameters import in_use, sensors_of
from backlash_ros.ros.run import run
from backlash_ros.ros.timer import Timer, in_ns, now, now_ns
from backlash_ros.ros.topics import HISTORY
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.simulation.simulated_drive import largest_load_torque

_REPEAT = 0.04
"""Silence after which a sample in lockstep is sent again, s: best-effort delivery may lose it, and the controller's
watchdog waits for it."""


class PlantSimulator(ManagedNode):
    """Geared servo with backlash behind the topics of a drive.

    ``together``: the simulators of this process, to which this one is added: in lockstep they step together.
    """

    def __init__(self, namespace: str = "", together: "list[PlantSimulator] | None" = None) -> None:
        super().__init__("plant_simulator", namespace)
        given = declare_simulator(self)
        refuse_unknown(self)
        self._drive, self._joints, self._rate = given.drive, given.joints, given.rate
        self._turn = 1.0 / given.rate / given.real_time_factor if given.real_time_factor else 0.0
        self._lockstep, self._delay, self._seed, self._values = given.lockstep, given.delay, given.seed, given.sensors
        self._simulated = self._at_rest()
        self._gate = CommandGate(in_ns(given.command_timeout), self._drive.command_unit, lockstep=self._lockstep)
        self._wall = SystemClock()  # independent of use_sim_time: a drive is a source of time
        self._own_time = self._lockstep or given.real_time_factor != 1.0
        self._load_torque, self._largest_load_torque = 0.0, largest_load_torque(self._drive)
        self._ticks = self._due = 0
        self._start = self._sent_at = self._next = 0.0
        self._told = Fault.NONE
        self._report = SimulatorReport(math.nan if self._lockstep else 1.0 / self._turn)
        self._sample = JointState()
        self._states = self.speak(JointState, "joint_states")
        self._in_use, self._version = self.speak(ParameterEvent, "~/parameters_in_use", HISTORY), 1
        self._clock_topic = self.speak(Clock, "/clock") if self._own_time else None
        self.listen(Float64MultiArray, "command", self._on_command)
        self.listen(Float64, "load_torque", self._on_load_torque)
        self.add_on_set_parameters_callback(self._validate)
        self.add_post_set_parameters_callback(self._measure)
        self._timer = Timer(_REPEAT, self._repeat) if self._lockstep else Timer(self._turn, self._go_on)
        self._together = [] if together is None else together
        self._together.append(self)
        alike = {(axis._lockstep, axis._rate) for axis in self._together}
        if len(alike) > 1 and any(lockstep for lockstep, _ in alike):
            raise ValueError("lockstep and rate must be the same for all axes of one process")

    def _at_rest(self) -> SimulatedDrive:
        sensors = sensors_of(self._values)
        made = SimulatedDrive(self._drive, 1.0 / self._rate, sensors=sensors, delay=self._delay, seed=self._seed)
        made.sample()
        return made

    # The lifecycle.

    def configure(self) -> None:
        """Compile the plant, at rest in the middle of the gap."""
        self._simulated.advance(0.0)  # compiles, or loads compiled code
        self._simulated, self._load_torque = self._at_rest(), 0.0
        self._gate.reset()
        self._told = Fault.NONE
        self._publish_in_use()

    def activate(self) -> None:
        """Start to publish."""
        self._gate.open()
        self._ticks = max(axis._ticks for axis in self._together)  # the same time for all
        self._due = 0
        self._report.begin(self._gate)
        # Axes of one process take turns: if all were due at once, the last one would always wait for the others.
        self._timer.restart(0.0 if self._lockstep else self._turn * self._together.index(self) / len(self._together))
        self._start = self._timer.due - self._turn
        self.own_timers.append(self._timer)
        if self._lockstep:
            self._publish()
        factor = f"{1.0 / self._rate / self._turn:g} times real time" if self._turn else "as fast as possible"
        speed = f"in lockstep, {factor}{' at most' if self._turn else ''}" if self._lockstep else factor
        self.get_logger().info(
            f"simulating at {self._rate:g} Hz, {speed}, backlash {self._drive.gear.backlash_angle:g} rad at the output"
        )

    def deactivate(self) -> None:
        """Remove the command and stop: no time passes while not active."""
        self._gate.open()
        self.own_timers.remove(self._timer)
        self.get_logger().info(f"stopped after {self._report.samples} samples, {self._report.late} of them late")

    # Parameters.

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            sensors_of(self._values | {p.name: p.value for p in parameters if p.name in self._values})
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _measure(self, parameters: list[Parameter]) -> None:
        changed = {p.name: p.value for p in parameters if p.name in self._values}
        if not changed:
            return  # rclpy declares parameters for the QoS of each topic
        self._values |= changed
        self._simulated.use(sensors_of(self._values))
        self._version += 1
        if self.configured:
            self._publish_in_use()

    def _publish_in_use(self) -> None:
        self._in_use.publish(in_use(self, self._version, self._values))

    # Faults.

    def _tell_fault(self) -> None:
        """Log and publish a fault that was just latched."""
        before, self._told = self._told, self._gate.fault
        if self._told and self._told is not before:
            unit = self._drive.command_unit
            self.get_logger().error(f"{self._told.name}: {self._gate.why}: motor at 0 {unit} until reset_fault")
            self.publish_diagnostics()

    def reset_fault(self) -> tuple[bool, str]:
        """Clear a latched fault; the motor takes commands again."""
        fault, text = self._gate.fault, self._gate.why
        self._gate.reset()
        self._told = Fault.NONE
        return True, f"reset {fault.name}: {text}" if fault else "no fault was latched"

    # Subscriptions.

    def _on_command(self, message: Float64MultiArray) -> None:
        if not self.active:
            return
        if not self._lockstep and self._timer.overdue > self._turn:
            self._timer.call()  # first simulate up to now with the old command
        if why := self._gate.command(message.data, answered_sample(message), now_ns()):
            rejected = self._gate.rejected
            self.get_logger().warning(f"{why}; {rejected} commands rejected so far", throttle_duration_sec=1.0)
        self._tell_fault()
        if self._lockstep and not self._gate.waiting:
            self._step_together()

    def _on_load_torque(self, message: Float64) -> None:
        if abs(message.data) <= self._largest_load_torque:
            self._load_torque = message.data
            return
        self._report.rejected += 1
        bound = f"within +-{self._largest_load_torque:g} N m, ten times what the motor holds"
        why = f"load_torque must be {bound}, got {message.data:g}: {self._load_torque:g} stays"
        self.get_logger().warning(why, throttle_duration_sec=1.0)

    # Time.

    def _step_together(self) -> None:
        """In lockstep: when every axis of this process has its answer, all continue."""
        axes = [axis for axis in self._together if axis.active]
        if any(axis._gate.waiting for axis in axes):
            return
        if now() < (due := max(axis._next for axis in axes)):
            self._timer.due = due
            return
        for axis in axes:
            axis._next = max(axis._next, now() - axis._turn) + axis._turn
            axis._advance(1, axis._gate.output(now_ns()))
        for axis in axes:
            axis._publish()

    def _repeat(self) -> None:
        if not self._gate.waiting:
            self._step_together()  # the axis that the others waited for may have been deactivated
        elif now() - self._sent_at > _REPEAT:
            self._gate.sent_again()
            self._states.publish(self._sample)

    def _go_on(self) -> None:
        """Simulate the periods that are due with the motor's command, and publish the result."""
        at, wall = now(), self._wall.now().nanoseconds  # the time of the plant's state, however long the rest takes
        due = max(1, round((at - self._start) / self._turn) - self._due)
        self._due += due
        self._report.late += due - 1
        expires, before = self._gate.expires, self._gate.value
        command = self._gate.output(in_ns(at))
        if expires is not None and self._gate.fault:
            # However late this call is, the motor is powered no longer than the watchdog allows.
            powered = max(0, due - math.floor((in_ns(at) - expires) / in_ns(self._turn)))
            self._advance(powered, before)
            due -= powered
        self._advance(due, command)
        self._tell_fault()
        self._publish(wall)

    def _advance(self, periods: int, command: float) -> None:
        began = now()
        try:
            for _ in range(periods):
                self._simulated.advance(command, self._load_torque)
                self._simulated.sample()
        except IntegrationError as error:
            torque, self._load_torque = self._load_torque, 0.0
            why = f"cannot simulate with load_torque {torque:g} N m, so it was set to 0: {error}"
            self._gate.fail(Fault.CANNOT_SIMULATE, why)
            self._tell_fault()
        self._ticks += periods
        self._report.step_time.add(now() - began)

    def _publish(self, wall: int = 0) -> None:
        arrives = round((self._ticks + 1) * 1e9 / self._rate) if self._own_time else wall
        stamp = arrives - in_ns(self._simulated.age)  # time of measurement
        measured = self._simulated.measured
        torques = self._drive.motor.torque_constant * float(measured[CURRENT]), self._simulated.gear_torque
        fill_joint_state(self._sample, self._joints, measured, torques)
        self._sample.header.stamp = to_stamp(stamp)
        before = self._together[: self._together.index(self)]
        if self._clock_topic is not None and not any(axis.active for axis in before):
            self._clock_topic.publish(Clock(clock=to_stamp(arrives)))
        self._sent_at = now()
        self._gate.sent(stamp, now_ns())
        self._report.samples += 1
        self._states.publish(self._sample)

    def statuses(self) -> Sequence[DiagnosticStatus]:
        """Report the motor's command, the timing of the samples, and how many were answered in time."""
        facts = NodeFacts(self.get_fully_qualified_name(), self.state, self.mismatches)
        return self._report.statuses(facts, self._gate, self._drive.command_unit, self._load_torque)


ABOUT = """\
Simulates a geared drive with backlash: publishes joint states at a fixed rate and takes the motor's command.

topics, relative to the namespace
  publishes   joint_states    sensor_msgs/JointState       motor and load: rad, rad/s, N m
              ~/parameters_in_use, /diagnostics; /clock if simulated time is not real time
  subscribes  command         std_msgs/Float64MultiArray   data[0]: V, or A with command_interface:=current
              load_torque     std_msgs/Float64             on the output, N m; positive turns it forward
services
  ~/reset_fault (std_srvs/Trigger); also the lifecycle services

example: ros2 run backlash_ros plant_simulator --ros-args -p gear.backlash_angle:=0.01 -p load.coulomb_friction:=0.02"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the plant simulator, or one for each of ``--axes``."""
    together: list[PlantSimulator] = []
    return run("plant_simulator", ABOUT, lambda namespace: PlantSimulator(namespace, together), args)


if __name__ == "__main__":
    raise SystemExit(main())
