"""The topics between drive, controller and user: their types, and the quality of service of each side."""

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import TransitionEvent
from rcl_interfaces.msg import ParameterEvent
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float32, Float64, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

TOPICS: dict[str, type] = {
    "joint_states": JointState,
    "command": Float64MultiArray,
    "reference": Float64,
    "joint_trajectory": JointTrajectory,
    "setpoint": JointTrajectory,
    "speed_scaling": Float32,
    "load_torque": Float64,
    "home_switch": Bool,
    "controller/state": DiagnosticArray,
    "controller/parameters_in_use": ParameterEvent,
    "plant_simulator/parameters_in_use": ParameterEvent,
    "/diagnostics": DiagnosticArray,
    "controller/backlash_estimate": Float64,
    "controller/in_position": String,
    "parameter_events": ParameterEvent,
    "controller/transition_event": TransitionEvent,
    "plant_simulator/transition_event": TransitionEvent,
    "/clock": Clock,
}
"""All topics of the interface, and the changes of parameters."""

HEARS = "hears"
"""Printed by the recorder, with the topic's name, when its first message has arrived: programs can wait for it."""

SEND = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=1000)
"""QoS of every publisher: a subscriber that must miss nothing, such as a recorder, can ask for reliable delivery, and
may be a second late at 1 kHz."""

RECEIVE = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=1)
"""QoS of every subscription to control data: the newest sample, no resending of old ones."""

RECEIVE_PAIR = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=2)
"""The same for joint states: motor and load may come in messages of their own, one right after the other."""

RECEIVE_STREAM = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=10)
"""QoS of a subscription to a path whose points come one by one: each counts, but none is worth a wait."""

WATCH = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=8)
"""QoS of who looks at the newest joint states now and then."""

TRANSIENT_LOCAL = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
)
"""QoS of values that hold until they change: a late subscriber gets the last one."""

HISTORY = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
)
"""The same if each value counts: the last ten, so that a slow recorder misses no change."""


def overridable() -> QoSOverridingOptions:
    """Let the user override a topic's quality of service with ``qos_overrides`` parameters."""
    return QoSOverridingOptions.with_default_policies()
