"""What the controller node does with samples, without ROS, written into a bag as the recorder writes it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from plain_bag import EVENT, in_use_event
from rosbags.typesys import Stores, get_typestore

from backlash_ros.control import DEFAULT_WEIGHTS, EXPERIMENTS, LAWS, FaultThresholds, Limits, Servo
from backlash_ros.control.design.gain_sets import resolve_set
from backlash_ros.control.homing import HOMING
from backlash_ros.control.monitoring.wear import WearWatch
from backlash_ros.control.motion.profile_parameters import ProfileParameters
from backlash_ros.control.settings import ServoSettings
from backlash_ros.control.telemetry import telemetry
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE
from backlash_ros.drivetrain.parameters import values_of
from backlash_ros.foundation.quantity import quantities
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M
from backlash_ros.gates.faults import Fault
from backlash_ros.recordings.bag_writer import BagWriter
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.replay.what_if import tuning_of

PERIOD = 0.004
_NS = 4_000_000
_BEGIN = 1_700_000_000 * 10**9


def nominal_values(**changes: Any) -> dict[str, Any]:
    """Return all parameters of a controller by name, as ``~/parameters_in_use`` has them."""
    drive, values = NOMINAL_DRIVE, dict[str, Any]()
    parts = [entry.parameters for room in (LAWS, EXPERIMENTS, HOMING) for entry in room.values()]
    for part in (
        *parts,
        *(kind() for kind in CONTACTS.values()),
        Limits.of(drive),
        FaultThresholds.of(drive),
        ProfileParameters(),
    ):
        values |= {f"{part.section}.{name}": getattr(part, name) for name in quantities(type(part))}
    values |= {name: ServoSettings.__dataclass_fields__[name].default for name in quantities(ServoSettings)}
    values |= values_of(drive) | {"gear.load_radius": drive.gear.load_radius}
    given = {region: {"q": list(weights), "k": [0.0] * 3} for region, weights in DEFAULT_WEIGHTS.items()}
    for region, of_region in given.items():
        values |= {f"gain_sets.nominal.{region}.{kind}": value for kind, value in of_region.items()}
    values |= resolve_set("nominal", given, drive, PERIOD, 0.0)
    values |= {"gain_set": "nominal", "gain_set_names": ["nominal"], "rate": 250.0, "state_timeout": 0.1}
    values |= {"motor_joint": "motor", "load_joint": "load", "loop_delay": 0.0, "identified": False}
    values |= {"learning.experiment": "auto", "learning.apply": "ask", "learning.renew": False, "law": "two_region"}
    values |= {"faults.on_lost_encoder": "stop", "profile.mode": "step", "zero": 0.0, "homing.switch": False}
    return values | changes


@dataclass
class NodeOffline:
    """A controller and its drive, sample by sample; ``messages`` is the bag: time of receipt (ns), topic, content."""

    values: dict[str, Any] = field(default_factory=nominal_values)
    load_torque: float = 0.0
    messages: list[tuple[int, str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        store = get_typestore(Stores.ROS2_JAZZY)
        self._types: dict[str, Any] = store.types
        self.samples, self.version, self._now, self._stamp, self._news = 0, 0, _BEGIN, 0, True
        self._plant = SimulatedDrive(NOMINAL_DRIVE, PERIOD)
        self._command, self._refused, self._begun, self._active = 0.0, False, False, False
        self._told: tuple[bool, bool, Fault, bool] | None = None
        self.use()
        self.active(True)

    # What others do between samples.

    def use(self, **changes: Any) -> None:
        """Use other values, named with double underscores for dots."""
        given = {name.replace("__", "."): value for name, value in changes.items()}
        tuning = tuning_of(self.values)
        choice = tuning.choice(self.values)
        choice = tuning.choice({**self.values, **tuning.completed(given, choice)})
        self.values, self.version, self._news = choice.values, self.version + 1, True
        if self.version == 1:
            self.servo = Servo(choice.drive, choice.settings, choice.limits)
            self._wear = WearWatch(self.servo)
        else:
            self.servo.use(choice.settings, choice.limits, choice.drive)
        self.servo.count_from(self.values["zero"])
        self._put("/controller/parameters_in_use", self.version)

    def refer(self, reference: float) -> None:
        assert not self.servo.set_reference(reference)
        self._news = True

    def learn(self, name: str = "") -> None:
        self.servo.start_experiment(name)

    def cancel(self) -> None:
        self.servo.cancel("cancelled on request")
        self.servo.take_outcome()

    def silence(self) -> None:
        """Let no sample come for a while."""
        self.servo.fail(Fault.NO_SAMPLES, "silence")
        self._refused, self._now = True, self._now + 2 * 10**8
        self._tell(math.nan)
        self.servo.take_outcome()

    def reset(self) -> None:
        self.servo.reset()
        self._refused = self._begun = False

    def active(self, active: bool) -> None:
        if active:
            self._wear.forget()
        else:
            self.servo.release("not active")
            self.servo.take_outcome()
        self._begun, self._active = False, active
        self._tell(math.nan)

    # Samples.

    def run(self, count: int, *, without: str = "") -> "NodeOffline":
        """Take so many samples; ``without`` one of the joints."""
        for _ in range(count):
            self._plant.advance(self._command, self.load_torque)
            self._now += _NS
            self.sample(without)
        return self

    def sample(self, without: str = "", *, again: bool = False) -> None:
        """Take a sample, or the last one ``again``, and answer it."""
        measured = self._plant.measured if again else self._plant.sample().copy()
        if not again:
            self._before, self._stamp = self._stamp, self._now
        self._put("/joint_states", (self._stamp, measured, without))
        if again:
            self._put("/command", (self._stamp, self._command))
            return
        if self._refused or without:
            self._command = 0.0
            if without:
                self.servo.command, self._stamp = 0.0, self._before
            self._put("/command", (self._now, 0.0))
            if self._news or self._doing != self._told:
                self._tell(0.0)
            return
        elapsed = 1e-9 * (self._stamp - self._before) if self._begun else 0.0
        self._begun, self.samples = True, self.samples + 1
        self._command = self.servo.update(measured, elapsed)
        self._put("/command", (self._stamp, self._command))
        self._wear.look(measured, elapsed)
        if self._news or self._doing != self._told or self.samples % 5 == 0:
            self._tell(elapsed)
        self.servo.take_outcome()

    @property
    def _doing(self) -> tuple[bool, bool, Fault, bool]:
        servo = self.servo
        return servo.holding, servo.experimenting, servo.latched, servo.tripped

    def _tell(self, elapsed: float) -> None:
        self._news, self._told = math.isnan(elapsed), self._doing  # the next sample tells it again
        counts = {"parameters_version": self.version, "samples": self.samples, "elapsed": elapsed}
        values = telemetry(self.servo, self._wear, active=self._active, **counts)
        self._put("/controller/state", (self._now if math.isnan(elapsed) else self._stamp, values))

    # The bag.

    def _put(self, topic: str, content: Any) -> None:
        if topic == "/controller/parameters_in_use":
            content = (content, dict(self.values))
        self.messages.append((self._now, topic, content))

    def _time(self, ns: int) -> Any:
        return self._types["builtin_interfaces/msg/Time"](*divmod(ns, 10**9))

    def _joint_states(self, content: tuple[int, Any, str]) -> Any:
        stamp, measured, without = content
        torque = NOMINAL_DRIVE.motor.torque_constant * measured[CURRENT]
        rows = [
            ("load", measured[THETA_L], measured[OMEGA_L], 0.0),
            ("motor", measured[THETA_M], measured[OMEGA_M], torque),
        ]
        names, *columns = zip(*(row for row in rows if row[0] != without), strict=True)
        header = self._types["std_msgs/msg/Header"](self._time(stamp), "")
        return self._types["sensor_msgs/msg/JointState"](header, list(names), *(np.array(each) for each in columns))

    def _commands(self, content: tuple[int, float]) -> Any:
        stamp, command = content
        label = f"{stamp // 10**9}.{stamp % 10**9:09d}" if stamp else ""
        dimension = self._types["std_msgs/msg/MultiArrayDimension"](label, 1, 1)
        layout = self._types["std_msgs/msg/MultiArrayLayout"]([dimension], 0)
        return self._types["std_msgs/msg/Float64MultiArray"](layout, np.array([command]))

    def _state(self, content: tuple[int, Mapping[str, float]]) -> Any:
        stamp, values = content
        pairs = [self._types["diagnostic_msgs/msg/KeyValue"](name, str(value)) for name, value in values.items()]
        status = self._types["diagnostic_msgs/msg/DiagnosticStatus"](0, "servo", "", "", pairs)
        header = self._types["std_msgs/msg/Header"](self._time(stamp), "")
        return self._types["diagnostic_msgs/msg/DiagnosticArray"](header, [status])

    def _parameters(self, content: tuple[int, Mapping[str, Any]]) -> Any:
        version, values = content
        return in_use_event(self._time(_BEGIN), version, values, "/controller")

    def write(self, path: Path, keep: Callable[[str, Any], bool] = lambda _topic, _content: True) -> Path:
        """Write the bag, of the messages that ``keep`` keeps."""
        store = get_typestore(Stores.ROS2_JAZZY)
        topics: dict[str, tuple[str, Callable[[Any], Any]]] = {
            "/joint_states": ("sensor_msgs/msg/JointState", self._joint_states),
            "/command": ("std_msgs/msg/Float64MultiArray", self._commands),
            "/controller/state": ("diagnostic_msgs/msg/DiagnosticArray", self._state),
            "/controller/parameters_in_use": (EVENT, self._parameters),
        }
        writer = BagWriter(path, "jazzy")
        made = {topic: writer.add_connection(topic, kind, typestore=store) for topic, (kind, _) in topics.items()}
        for k, (received, topic, content) in enumerate(self.messages):
            if keep(topic, content):
                kind, message = topics[topic]
                writer.write(made[topic], received, bytes(store.serialize_cdr(message(content), kind)), received)
            if k % 500 == 0:
                writer.save()
        writer.close()
        return path
