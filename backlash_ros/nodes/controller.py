"""The controller as a node: joint states in, one call of the servo, voltage out at once.

Everything that decides is in `backlash_ros.control.Servo`. Here are the topics, the parameters, and the watchdog that
puts 0 V out while there is no good sample to answer.
"""

import math
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, UInt8

from backlash_ros.control import LAWS, LearningSettings, Servo, ServoSettings, design_law
from backlash_ros.drivetrain import Quantity
from backlash_ros.nodes.gain_parameters import (
    CUSTOM,
    DEFAULT_WEIGHTS,
    NO_WEIGHTS,
    REGIONS,
    expand,
    gain_set_of,
    resolve_set,
)
from backlash_ros.nodes.interface import (
    LATCHED,
    RECEIVE,
    SEND,
    STEADY,
    BadSampleError,
    declare_joints,
    overridable,
    read_joint_state,
)
from backlash_ros.nodes.learn_service import LearnService, describe_estimate
from backlash_ros.nodes.parameters import (
    as_float,
    declare_drive,
    declare_duration,
    declare_number,
    declare_quantities,
    declare_rate,
    describe,
    take,
)
from backlash_ros.nodes.run import StoppableNode, run

_LEARN_PATIENCE = 5.0
"""Time that a request to learn waits for the first joint states, s: discovery may take some."""


class Controller(StoppableNode):
    """Two-region servo of one geared drive."""

    def __init__(self) -> None:
        super().__init__("controller")
        self._drive = declare_drive(self)
        self._joints = declare_joints(self)
        self._rate = declare_rate(self)
        self._state_timeout = declare_duration(
            self, "state_timeout", 0.1, "silence on joint_states after which the command is 0 V"
        )
        telemetry = Quantity("rate of tracking error, region and load torque", "Hz", 0.0, self._rate, True)
        telemetry_rate = declare_number(self, "telemetry_rate", min(50.0, self._rate), telemetry)
        self._telemetry_every = max(1, round(self._rate / telemetry_rate))
        self._sets = self._declare_gain_sets()
        self._values = self._declare_tunables()
        self._floats = {name for name, value in self._values.items() if isinstance(value, float)}
        self._candidate = self._values, self._settings_of(self._values)
        self._servo = Servo(self._drive, self._candidate[1])
        self._warm_up()

        self._last_stamp = 0
        self._last_sample: float | None = None
        self._answered = 0
        self._estimated = False
        self._dropped = 0
        self._command = self.create_publisher(Float64MultiArray, "command", SEND, qos_overriding_options=overridable())
        self._error = self.create_publisher(Float64, "~/tracking_error", SEND)
        self._region = self.create_publisher(UInt8, "~/region", SEND)
        self._torque = self.create_publisher(Float64, "~/load_torque_estimate", SEND)
        self._estimate = self.create_publisher(Float64, "~/backlash_estimate", LATCHED)
        self._accept_parameters()
        self.create_subscription(
            JointState, "joint_states", self._on_joint_states, RECEIVE, qos_overriding_options=overridable()
        )
        self.create_subscription(
            Float64, "reference", self._on_reference, RECEIVE, qos_overriding_options=overridable()
        )
        self._publish_estimate()
        self._learn = LearnService(self)
        self.create_timer(0.5 * self._state_timeout, self._watch, clock=STEADY)
        self.get_logger().info(f"ready at {self._rate:g} Hz with gain set {self._values['gain_set']!r}")

    # Parameters: declared once, a request validated as a whole, swapped as one value.

    def _declare_gain_sets(self) -> dict[str, dict[str, list[float]]]:
        text = "names of the gain sets, each under gain_sets.<name>"
        names = self.declare_parameter("gain_set_names", ["nominal"], describe(text, read_only=True)).value
        sets = {}
        for name in names:
            if name == CUSTOM or names.count(name) > 1:
                raise ValueError(f"gain_set_names must be different from each other and from {CUSTOM!r}, got {names}")
            defaults = DEFAULT_WEIGHTS if name == "nominal" else dict.fromkeys(REGIONS, NO_WEIGHTS)
            chosen = {}
            for region in REGIONS:
                prefix = f"gain_sets.{name}.{region}"
                k = self.declare_parameter(
                    f"{prefix}.k", [0.0, 0.0, 0.0], describe("gains [V/rad, V s/rad, V/A]", read_only=True)
                ).value
                given = any(k)
                q = self.declare_parameter(
                    f"{prefix}.q",
                    NO_WEIGHTS if given else defaults[region],
                    describe("LQR weights [Q11, Q22] of eq 14, in place of gains", read_only=True),
                ).value
                chosen[region] = {"q": list(q), "k": list(k)}
            sets[name] = resolve_set(name, chosen, self._drive)
        return sets

    def _declare_tunables(self) -> dict[str, Any]:
        first = next(iter(self._sets), None)
        if first is None:
            raise ValueError("gain_set_names must name at least one gain set")
        values: dict[str, Any] = {
            "law": self.declare_parameter(
                "law", "two_region", describe("control law", constraint=f"one of {sorted(LAWS)}")
            ).value,
        }
        values |= declare_quantities(self, LearningSettings(), read_only=False)
        # A set stands for its gains; gains given beside it at the start make it custom, as they do later.
        given: dict[str, Any] = {}
        start = self._sets[first]
        names = describe("gain set in use; setting it sets the gains", constraint=str([*self._sets, CUSTOM]))
        asked = {"gain_set": self.declare_parameter("gain_set", first, names).value}
        for region in REGIONS:
            for kind, text in (("k", "gains [V/rad, V s/rad, V/A] in use"), ("q", "LQR weights they come from, or 0")):
                name = f"gains.{region}.{kind}"
                value = self.declare_parameter(name, start[name], describe(text)).value
                if list(value) != start[name]:
                    given[name] = list(value)
        if given and asked["gain_set"] == first:
            asked = {"gain_set": CUSTOM}
        values |= start | expand({**asked, **given}, self._sets, self._drive)
        settings = ServoSettings(gain_set_of(values, self._sets, self._drive, 1 / self._rate))
        values |= declare_quantities(self, settings, read_only=False)
        changed = [
            Parameter(name, value=value)
            for name, value in values.items()
            if name.startswith("gain") and self.get_parameter(name).value != value
        ]
        if changed:
            self.set_parameters_atomically(changed)
        return values

    def _settings_of(self, values: dict[str, Any]) -> ServoSettings:
        settings = take(
            ServoSettings,
            values,
            gains=gain_set_of(values, self._sets, self._drive, 1 / self._rate),
            law=values["law"],
            period=1 / self._rate,
            learning=take(LearningSettings, values),
        )
        design_law(self._drive, settings)  # refuses what cannot be designed
        return settings

    def _accept_parameters(self) -> None:
        self.add_pre_set_parameters_callback(self._complete)
        self.add_on_set_parameters_callback(self._validate)
        self.add_post_set_parameters_callback(self._swap)

    def _complete(self, parameters: list[Parameter]) -> list[Parameter]:
        """Add what a request implies: a set's gains, gains designed from weights."""
        changes = {p.name: p.value for p in parameters}
        for name in changes.keys() & self._floats:
            changes[name] = as_float(changes[name])
        try:
            full = expand(changes, self._sets, self._drive)
        except (ValueError, TypeError):
            return parameters  # refused, with its reason, when it is validated
        kept = [p for p in parameters if full[p.name] is p.value]
        names = {p.name for p in kept}
        return kept + [Parameter(name, value=value) for name, value in full.items() if name not in names]

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        values = {**self._values, **{p.name: p.value for p in parameters if p.name in self._values}}
        try:
            self._candidate = values, self._settings_of(values)
        except (ValueError, TypeError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _swap(self, parameters: list[Parameter]) -> None:
        if not any(p.name in self._values for p in parameters):
            return
        relearned = self._candidate[0]["backlash_angle"] != self._values["backlash_angle"]
        self._values, settings = self._candidate
        self._servo.use(settings)
        if relearned:
            self._publish_estimate()

    def _warm_up(self) -> None:
        """Compile the law before the first sample, or load what was compiled before."""
        self._servo.update(read_joint_state(JointState(name=["load"], position=[0.0]), "", "load", 1.0))
        self._servo.release("")

    # The loop.

    def _on_joint_states(self, message: JointState) -> None:
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        now = STEADY.now().nanoseconds * 1e-9
        behind = (self._last_stamp - stamp) * 1e-9
        if stamp and self._last_sample is not None and 0 <= behind < self._state_timeout:
            self._drop(f"joint_states out of order, {behind:g} s behind the newest")
            return
        try:
            measured = read_joint_state(message, *self._joints, self._drive.motor.torque_constant)
        except BadSampleError as error:
            self._drop(f"unusable joint_states: {error}")
            self._send(0.0)
            return
        self._last_stamp, self._last_sample = stamp, now
        self._begin_learning()
        self._send(self._servo.update(measured))
        self._end_learning()
        if not self._servo.holding:
            self._drop("joint_states from which no finite command follows: 0 V, holding from the next sample on")
            return
        self._answered += 1
        if self._answered % self._telemetry_every == 0:
            self._error.publish(Float64(data=self._servo.tracking_error))
            self._region.publish(UInt8(data=self._servo.region))
            self._torque.publish(Float64(data=self._servo.load_torque_estimate))

    def _on_reference(self, message: Float64) -> None:
        if not math.isfinite(message.data):
            self._drop(f"reference must be finite, in rad, got {message.data}")
        elif self._servo.learning:
            self._drop(f"reference {message.data:g} rad came while learning")
        elif not self._servo.holding:
            self._drop(f"reference {message.data:g} rad came while there are no joint states")
        else:
            self._servo.reference = message.data

    def _watch(self) -> None:
        now = STEADY.now().nanoseconds * 1e-9
        if self._last_sample is not None and now - self._last_sample <= self._state_timeout:
            return
        if self._last_sample is not None:
            self.get_logger().warning(f"no joint_states for {self._state_timeout:g} s: 0 V until they are back")
            self._last_sample = None
            self._servo.release("joint_states stopped")
            self._end_learning()
        if self._learn.waiting() > _LEARN_PATIENCE and self._learn.take_request():
            self._learn.answer(False, f"cannot learn: no joint_states for {_LEARN_PATIENCE:g} s")
        self._send(0.0)

    def _begin_learning(self) -> None:
        if not self._learn.take_request():
            return
        self._servo.start_learning()
        self.get_logger().info("learning the backlash")

    def _end_learning(self) -> None:
        estimate = self._servo.take_learned()
        if estimate is None:
            return
        text = describe_estimate(estimate)
        self.get_logger().info(text)
        accepted = estimate.valid
        if estimate.valid:
            result = self.set_parameters_atomically([Parameter("backlash_angle", value=estimate.angle)])
            if not result.successful:
                accepted, text = False, f"{text}, but it was refused: {result.reason}"
        self._learn.answer(accepted, text)

    def _send(self, voltage: float) -> None:
        self._command.publish(Float64MultiArray(data=[voltage]))

    def _publish_estimate(self) -> None:
        if self._values["backlash_angle"] > 0 or self._estimated:
            self._estimated = True
            self._estimate.publish(Float64(data=self._values["backlash_angle"]))

    def _drop(self, what: str) -> None:
        self._dropped += 1
        self.get_logger().warning(f"{what}; {self._dropped} messages dropped so far", throttle_duration_sec=1.0)

    def stop(self) -> None:
        """Put 0 V out and wait until it has arrived."""
        self._servo.release("the controller is stopping")
        self._send(0.0)
        self._command.wait_for_all_acked(Duration(seconds=0.5))
        self._learn.close()
        self.get_logger().info(f"stopped after {self._answered} samples, {self._dropped} messages dropped")


def main(args: Sequence[str] | None = None) -> int:
    """Run the controller."""
    return run(Controller, args)


if __name__ == "__main__":
    raise SystemExit(main())
