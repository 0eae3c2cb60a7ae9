"""What simulator and controller share: the lifecycle, a latched fault with its reset, and diagnostics once a second."""

import traceback
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.srv import ChangeState
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from backlash_ros.ros.overrides import COMMAND_LINE
from backlash_ros.ros.parameter_requests import ParameterRequests
from backlash_ros.ros.parameters import declare_autostart
from backlash_ros.ros.timer import Timer
from backlash_ros.ros.topics import RECEIVE, SEND, overridable

RESULT = TransitionCallbackReturn
E = TypeVar("E")


class Outlet:
    """A publisher that exists while its node is configured."""

    def __init__(self) -> None:
        self._publisher: Publisher | None = None
        self.publish: Callable[[Any], None] = self._refuse

    def _refuse(self, _message: Any) -> None:
        self.publisher.publish(_message)

    def open(self, publisher: Publisher) -> None:
        """Use ``publisher`` from now on."""
        self._publisher = publisher
        self.publish = publisher.publish  # without indirection: it is called for each sample

    def close(self) -> None:
        """Stop publishing: further calls raise the RuntimeError of `publisher`."""
        self._publisher = None
        self.publish = self._refuse

    @property
    def publisher(self) -> Publisher:
        """The publisher; RuntimeError while the node is not configured."""
        if self._publisher is None:
            raise RuntimeError("there is no publisher while the node is not configured")
        return self._publisher


class ManagedNode(LifecycleNode):
    """A managed node with a motor behind it.

    A subclass defines its transitions, its faults and its diagnostics. Every end of the active state goes through
    `deactivate`, which leaves the motor at 0 V.
    """

    linger = 0.0

    def __init__(self, name: str, namespace: str) -> None:
        rules = list(COMMAND_LINE.get())
        super().__init__(name, namespace=namespace, cli_args=rules, start_parameter_services=False)
        self._parameter_requests = ParameterRequests(self)
        self.autostart = declare_autostart(self)
        self.mismatches = 0
        self.broken = False
        self._held = ExitStack()
        self._topics: list[Callable[[], None]] = []
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", SEND)
        self.create_service(Trigger, "~/reset_fault", self._on_reset)
        self.own_timers = [Timer(1.0, self.publish_diagnostics)]

    # For subclasses.

    def configure(self) -> None:
        """Compile and design; the topics already exist. ValueError refuses the transition."""
        raise NotImplementedError

    def activate(self) -> None:
        """Start; ValueError refuses the transition."""
        raise NotImplementedError

    def deactivate(self) -> None:
        """Command 0 V and stop."""
        raise NotImplementedError

    def state_changed(self) -> None:
        """Note that the node has become active or inactive."""

    def reset_fault(self) -> tuple[bool, str]:
        """Clear a latched fault; return whether that was possible, and which fault it was or why not."""
        raise NotImplementedError

    def statuses(self) -> Sequence[DiagnosticStatus]:
        """Return the diagnostics of the last second."""
        raise NotImplementedError

    # The lifecycle.

    @property
    def state(self) -> str:
        """The lifecycle's state: unconfigured, inactive, active, finalized."""
        return str(self._state_machine.current_state[1])

    @property
    def configured(self) -> bool:
        """Whether the topics exist: inactive or active."""
        return self.state in {"inactive", "active"}

    @property
    def finished(self) -> bool:
        """Whether the node cannot come back: shut down, or ``broken`` by a failed transition."""
        return self.state == "finalized"

    @property
    def active(self) -> bool:
        """Whether the motor may be driven."""
        return self._active

    @property
    def refusal(self) -> str:
        """Why a controller refuses what needs the motor; empty while active."""
        return "" if self._active else f"the controller must be active, but is {self.state}"

    _active = False

    def held(self, entity: E, destroy: Callable[[E], Any]) -> E:
        """Return ``entity``, to be destroyed when the node is cleaned up or its configuration fails."""
        self._held.callback(destroy, entity)
        return entity

    def speak(self, kind: type, topic: str, qos: QoSProfile = SEND) -> "Outlet":
        """Return a publisher that exists while configured; its QoS can be overridden."""
        outlet = Outlet()
        self._topics.append(lambda: self._open(outlet, kind, topic, qos))
        return outlet

    def _open(self, outlet: "Outlet", kind: type, topic: str, qos: QoSProfile) -> None:
        made = self.create_publisher(kind, topic, qos, qos_overriding_options=overridable())
        self.held(made, self.destroy_publisher)
        outlet.open(made)
        self.held(outlet, Outlet.close)

    def listen(self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile = RECEIVE) -> None:
        """Subscribe to control data while configured; publishers with an incompatible QoS are reported."""
        self._topics.append(lambda: self._hear(kind, topic, callback, qos))

    def _hear(self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        made = self.create_subscription(
            kind,
            topic,
            callback,
            qos,
            qos_overriding_options=overridable(),
            event_callbacks=self._mismatch_events(topic),
        )
        self.held(made, self.destroy_subscription)

    def _take_up_topics(self) -> None:
        for open_topic in self._topics:
            open_topic()

    def prepare(self) -> None:
        """Configure if ``autostart`` is true; RuntimeError if that fails."""
        if not self.autostart:
            self.get_logger().info("autostart is false: waiting for the requests to configure and activate")
        self._come_up(self.trigger_configure)

    def start(self) -> None:
        """Activate if ``autostart`` is true; RuntimeError if that fails."""
        self._come_up(self.trigger_activate)

    def _come_up(self, transition: Callable[[], TransitionCallbackReturn]) -> None:
        if self.autostart and transition() != RESULT.SUCCESS:
            raise RuntimeError(f"{self.get_name()} did not come up: still {self.state}")

    def stop(self) -> None:
        """Shut down from any state; the context is still alive."""
        if not self.finished:
            self.trigger_shutdown()

    def _guarded(
        self,
        name: str,
        then: Callable[[LifecycleState], TransitionCallbackReturn],
        state: LifecycleState,
        *actions: Callable[[], None],
    ) -> TransitionCallbackReturn:
        """Execute a transition, and ``then`` rclpy's part; log errors, which rclpy would swallow."""
        try:
            for action in actions:
                action()
        except ValueError as error:
            self.get_logger().error(f"cannot {name}: {error}")
            return RESULT.FAILURE
        except Exception as error:
            self.get_logger().error(f"{name} failed: {type(error).__name__}: {error}")
            self.get_logger().debug(traceback.format_exc())
            return RESULT.ERROR
        self.get_logger().debug(f"{name} done")
        return then(state)

    def _begin(self) -> None:
        self.activate()
        self._active = True
        self.state_changed()

    def _end(self) -> None:
        if self._active:
            self.deactivate()
            self._active = False
            self.state_changed()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Compile, design, create the topics."""
        result = self._guarded("configure", super().on_configure, state, self._take_up_topics, self.configure)
        if result != RESULT.SUCCESS:
            self._held.close()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin."""
        return self._guarded("activate", super().on_activate, state, self._begin)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Command 0 V and stop."""
        return self._guarded("deactivate", super().on_deactivate, state, self._end)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Remove the topics."""
        return self._guarded("clean up", super().on_cleanup, state, self._held.close)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Command 0 V, remove the topics."""
        return self._guarded("shut down", super().on_shutdown, state, self._end, self._held.close)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle a failed transition, which is already logged: command 0 V, again if need be; remove the topics."""
        ended = self._guarded("recover", super().on_error, state, self._end)
        self._active = False
        closed = self._guarded("recover", super().on_error, state, self._held.close)
        self.broken = not ended == closed == RESULT.SUCCESS
        return RESULT.FAILURE if self.broken else RESULT.SUCCESS

    def _LifecycleNodeMixin__on_change_state(  # noqa: N802
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Answer success=False to an impossible transition; with rclpy's own answer the node would crash."""
        before = self.state
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)
        except Exception as error:
            wanted = request.transition.label or request.transition.id
            self.get_logger().error(f"transition {wanted!r} is not possible in state {before}: {error}")
            response.success = False
            return response

    # Faults and diagnostics.

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self.reset_fault()
        self.get_logger().info(f"reset_fault: {response.message}")
        self.publish_diagnostics()
        return response

    def _mismatch_events(self, topic: str) -> SubscriptionEventCallbacks:
        """Return the callback for a publisher with an incompatible QoS."""

        def report(event: Any) -> None:
            self.mismatches = event.total_count
            self.get_logger().warning(f"a publisher on {topic} offers an incompatible QoS: none of its messages arrive")

        return SubscriptionEventCallbacks(incompatible_qos=report)

    def publish_diagnostics(self) -> None:
        """Publish the diagnostics now."""
        message = DiagnosticArray(status=list(self.statuses()))
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
