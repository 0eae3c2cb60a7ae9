"""Axes that move together: while one of them cannot, the others come to rest along their ways, and follow nothing.

Each axis of a group says on the topic ``/GROUP/axes`` why it cannot move, or, with an empty text, that it can. An axis
that ends or hangs without a word is missed by its liveliness.
"""

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import KeyValue
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from backlash_ros.control import Servo
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.timer import Timer

_LEASE = 0.5
"""Time without a sign of life after which an axis is missed, s: as long as a busy machine may keep it waiting."""
_SIGNS = 5
"""Signs of life in that time."""

SAYS = QoSProfile(
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
    liveliness_lease_duration=Duration(seconds=_LEASE),
)
"""QoS of both sides: whoever comes later is told what each axis said last, and a node that hangs is not alive."""


class Group:
    """One axis of a group; with an empty name it is alone, and nothing happens.

    Parameters
    ----------
    held : is called when the axis was brought to rest for another one
    """

    def __init__(self, node: ManagedNode, servo: Servo, name: str, held: Callable[[], None]) -> None:
        self._node, self._servo, self._name, self._held = node, servo, name, held
        self._said: str | None = None
        self._others: dict[str, str] = {}
        self._alive = self._most = 0  # axes, this one too
        if name:
            self._topic = f"/{name}/axes"
            self._says = node.speak(KeyValue, self._topic, SAYS)
            node.own_timers.append(Timer(_LEASE / _SIGNS, self._live))

    def configure(self) -> None:
        """Join the group."""
        if not self._name:
            return
        self._said, self._others, self._alive, self._most = None, {}, 0, 0
        events = SubscriptionEventCallbacks(liveliness=self._on_liveliness)
        made = self._node.create_subscription(KeyValue, self._topic, self._on_axis, SAYS, event_callbacks=events)
        self._node.held(made, self._node.destroy_subscription)
        self.tell()

    def tell(self) -> None:
        """Say whether this axis can move, if that has changed."""
        if not self._name:
            return
        fault = self._servo.latched
        why = f"has the fault {fault.name}" if fault else "" if self._node.active else "is not active"
        if why != self._said:
            self._said = why
            self._says.publish(KeyValue(key=self._node.get_fully_qualified_name(), value=why))

    def forget(self) -> None:
        """Go on without the axes that are gone: somebody has reset this one, and knows."""
        if not self._name:
            return
        there = {f"{space.rstrip('/')}/{name}" for name, space in self._node.get_node_names_and_namespaces()}
        self._others = {axis: why for axis, why in self._others.items() if axis in there}
        self._most = self._alive
        self._look()

    def _live(self) -> None:
        if self._node.configured:
            self._says.publisher.assert_liveliness()

    def _on_axis(self, message: KeyValue) -> None:
        if message.key != self._node.get_fully_qualified_name():
            self._others[message.key] = message.value
            self._look()

    def _on_liveliness(self, event: Any) -> None:
        self._alive = event.alive_count
        self._most = max(self._most, self._alive)
        self._look()

    def _look(self) -> None:
        """Come to rest, and end an experiment, if another axis has just become unable to move."""
        why, before, log = self._why, self._servo.barred, self._node.get_logger()
        if why == before:
            return
        if why and not before:
            self._servo.cancel(f"ended {why}")
        stops = why and not before and self._node.active and not self._servo.stop()
        self._servo.barred = why
        if stops:
            self._held()
            log.warning(f"comes to rest, and follows nothing {why}")
        else:
            log.info(f"follows nothing {why}" if why else f"all axes of group {self._name!r} can move")

    @property
    def _why(self) -> str:
        """Why this axis must not move; empty if it may."""
        for axis, why in self._others.items():
            if why:
                return f"while {axis} of group {self._name!r} {why}"
        if self._alive < self._most:
            return (
                f"while {self._most - self._alive} of {self._most} axes of group {self._name!r} do not answer: "
                "call reset_fault to go on without"
            )
        return ""
