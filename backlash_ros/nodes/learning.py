"""The services of learning: learn the backlash, identify the drive, find its zero, apply or offer what was found.

What was found is stored, and with that survives a restart.

Requests and estimates are handled by `backlash_ros.control.estimates`.
"""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from rclpy.parameter import Parameter
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from backlash_ros.control import Servo
from backlash_ros.control.estimates import Answer, DriveIdentity, Estimates
from backlash_ros.control.estimates.requests import EXPERIMENT_OF, LearnRequests, Reply, describe_outcome
from backlash_ros.control.experiment import BacklashEstimate, DriveEstimate, Method, ZeroEstimate
from backlash_ros.control.monitoring.wear import WearWatch
from backlash_ros.drivetrain.parameters import to_use
from backlash_ros.foundation.signals import Measurement
from backlash_ros.nodes.fixed_parameters import ControllerParameters
from backlash_ros.nodes.tunables import Tunables
from backlash_ros.ros.aside import Aside, InTurn
from backlash_ros.ros.diagnostics import OK, WARN
from backlash_ros.ros.later import LaterTrigger
from backlash_ros.ros.lifecycle import ManagedNode
from backlash_ros.ros.timer import Timer, now_ns
from backlash_ros.ros.topics import RECEIVE

_LOOK = 0.05
"""Time between checks whether the file has been written, s."""

_FINISH = 2.0
"""Longest wait for the file when the process ends, s."""


_DOING = {"learn": "learning the backlash", "identify": "identifying the drive", "home": "homing"}


class Learning:
    """The services of one controller that find something, ``~/cancel`` and ``~/apply_estimate``, and its estimate file.

    ``~/learn``, ``~/identify`` and ``~/home`` move the load; ``~/set_zero`` takes it where it is.
    """

    def __init__(self, node: ManagedNode, servo: Servo, tunables: Tunables, given: ControllerParameters) -> None:
        self._node, self._servo, self._tunables, self._given = node, servo, tunables, given
        self._requests = LearnRequests(servo, Aside(kind=not node.get_clock().ros_time_is_active))
        self._estimates = Estimates(self._put_in_use, InTurn())
        self._found: dict[str, list[tuple[str, float, float, str]]] = {}  # by service, the newest last
        self.wear, self._noticed = WearWatch(servo), (False, False)
        self._services = {name: LaterTrigger(node, f"~/{name}", partial(self._ask, name)) for name in EXPERIMENT_OF}
        self._services["apply_estimate"] = LaterTrigger(node, "~/apply_estimate", self._on_apply)
        self._services["set_zero"] = LaterTrigger(node, "~/set_zero", self._on_set_zero)
        self._switch: bool | None = None  # as it was told last
        node.listen(Bool, "home_switch", self._on_switch, RECEIVE)
        node.create_service(Trigger, "~/cancel", self._on_cancel)
        node.own_timers.append(Timer(_LOOK, self._tell))

    # The lifecycle.

    def configure(self) -> None:
        """Open the estimate file, and use it if the parameters say so; ValueError if it cannot be used."""
        given, node = self._given, self._node
        self._found.clear()
        self._switch = None
        drive = DriveIdentity(node.get_fully_qualified_name(), *given.joints, given.drive["gear.reduction"])
        node.held(self._estimates, Estimates.forget)
        if text := self._estimates.begin(given.estimate_file, drive, use=given.use_estimate_file):
            node.get_logger().info(text)

    def stop(self, why: str) -> None:
        """End a running experiment, and answer waiting requests."""
        self._reply(self._requests.end() or self._requests.stop(why))
        self._tell(wait_no_more=True)

    def finish(self) -> None:
        """Wait for the file, up to a time limit."""
        if not self._estimates.finish(_FINISH):
            self._node.get_logger().error("the estimate file could not be written before the node ended")

    # Called beside the samples.

    def look(self, measured: Measurement, elapsed: float) -> None:
        """Check an answered sample, ``elapsed`` s after the previous one, for wear; learn again if allowed."""
        learn, log = self.wear.look(measured, elapsed), self._node.get_logger()
        before, self._noticed = self._noticed, self.wear.kind
        if self._noticed != before and any(self._noticed):
            log.warning(self.wear.finding, throttle_duration_sec=10.0)
        if learn:
            refusal = self._ask("learn")
            log.info(f"not learned again: {refusal[1]}" if refusal else "learning anew")

    def begin(self) -> None:
        """Start a requested experiment, before a sample is taken."""
        self._reply(self._requests.begin())
        if self._switch:  # it may have closed since the request
            self._servo.trip()

    def end(self) -> None:
        """Check whether the experiment has ended."""
        self._reply(self._requests.end())

    def waited(self, now: int, silence: str) -> None:
        """Check whether it has ended or a request has waited too long; ``silence`` says why."""
        self._reply(self._requests.end() or self._requests.waited(now, silence))

    @property
    def doing(self) -> str:
        """The purpose of an experiment, for the log."""
        return _DOING[self._requests.service]

    # Services.

    def _ask(self, service: str) -> tuple[bool, str] | None:
        """Request a run of a service's experiment; return why it is refused."""
        if why := self._node.refusal or self._estimates.busy:
            return False, f"cannot {service}: {why}"
        if self._servo.barred:
            return False, f"cannot {service} {self._servo.barred}"
        by_switch = service == "home" and self._tunables.values["homing.switch"]
        if by_switch and self._switch is not False:
            why = "has not said anything" if self._switch is None else "is closed: move the load off it"
            return False, f"cannot home: home_switch {why}"
        refusal = self._requests.ask(now_ns(), service, "homing_by_switch" if by_switch else "")
        return refusal and refusal[:2]

    def _on_switch(self, message: Bool) -> None:
        """Tell a homing of a switch that has just closed."""
        if message.data and self._switch is False:
            self._servo.trip()
        self._switch = message.data

    def _on_set_zero(self) -> tuple[bool, str] | None:
        """Let the load's present position be 0."""
        servo = self._servo
        zero, refusal = servo.load_angle + servo.zero, self._node.refusal or self._estimates.busy or servo.hindrance
        if refusal := refusal or servo.rejection_reason(servo.limits, zero=zero):
            self._node.get_logger().info(f"cannot set the zero: {refusal}")
            return False, f"cannot set the zero: {refusal}"
        found = ZeroEstimate(0.0, Method.SET_ZERO, valid=True, reason="where the load is", zero=zero)
        text = self._with_hint(describe_outcome(found), found)
        self._estimates.learned(found, text, now_ns(), apply=True, service="set_zero")
        answer = self._look()
        return answer and answer[1:]

    def _on_cancel(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message, _ = self._requests.cancel()
        self._reply(self._requests.end() or self._requests.stop("cancelled on request"))
        return response

    def _on_apply(self) -> tuple[bool, str] | None:
        if refusal := self._estimates.apply(now_ns()):
            self._node.get_logger().info(refusal)
            return False, refusal
        answer = self._look()
        return answer and answer[1:]

    def _with_hint(self, text: str, estimate: BacklashEstimate) -> str:
        """Return the text of an estimate; of a zero with a hint if the next start will not know it."""
        if self._given.use_estimate_file or not isinstance(estimate, ZeroEstimate):
            return text
        return f"{text}; the next start does not know it, since learning.use_estimate_file is false"

    def _put_in_use(self, values: Mapping[str, Any]) -> str:
        """Set parameters like any client; return why they were refused, or an empty text."""
        parameters = [Parameter(name, value=value) for name, value in to_use(values).items()]
        result = self._node.set_parameters_atomically(parameters)
        return "" if result.successful else str(result.reason)

    def _reply(self, reply: Reply | None) -> None:
        """Apply what was learned, or answer why there is nothing to apply."""
        if reply is None:
            return
        if reply.estimate is None:
            self._node.get_logger().info(reply.text)
            self._services[self._requests.service].answer(reply.success, reply.text)
        else:
            service = self._requests.service
            apply = service == "home" or self._tunables.values["learning.apply"] == "auto"
            before, text = self._estimates.newest, self._with_hint(reply.text, reply.estimate)
            self._estimates.learned(reply.estimate, text, now_ns(), apply=apply, service=service)
            if self._estimates.newest is not before:
                self._found.pop(service, None)
                self._found[service] = quantities_of(reply.estimate)
            self._tell()

    def _look(self, *, wait_no_more: bool = False) -> Answer | None:
        """Return the answer that is due; log it and any trouble with the file, once."""
        before, log = self._estimates.trouble, self._node.get_logger()
        answer = self._estimates.poll(now_ns(), wait_no_more=wait_no_more)
        if answer is not None:
            if answer.service == "identify" and answer.success and not self._estimates.offer:
                answer = answer._replace(text=f"{answer.text}; law {self._servo.law} acts")
            log.info(answer.text)
        if self._estimates.trouble not in ("", before):
            log.error(f"the last estimate: {self._estimates.trouble}")
        return answer

    def _tell(self, *, wait_no_more: bool = False) -> None:
        """Answer the waiting request if the answer is due."""
        if answer := self._look(wait_no_more=wait_no_more):
            self._services[answer.service].answer(answer.success, answer.text)

    # Diagnostics.

    def remarks(self) -> Sequence[tuple[bytes, str]]:
        """Return remarks for the diagnostics: an estimate that waits, a file that could not be written, wear."""
        offer, trouble = self._estimates.offer, self._estimates.trouble
        return [(level, text) for level, text in ((OK, offer), (WARN, trouble), (WARN, self.wear.finding)) if text]

    def values(self) -> dict[str, Any]:
        """Return the newest estimate by name, what each service found last, and signs of wear."""
        found = json.dumps(self._found) if self._estimates.newest else ""
        return {**self._estimates.values(), "found": found, "wear": self.wear.finding}


def quantities_of(estimate: BacklashEstimate) -> list[tuple[str, float, float, str]]:
    """Return what was found: symbols, values, standard uncertainties, 0 where unknown, and units."""
    if isinstance(estimate, ZeroEstimate):
        return [("theta_0", estimate.zero, 0.0, "rad")]
    if isinstance(estimate, DriveEstimate):
        return [(each.symbol, each.value, each.uncertainty, each.unit) for each in estimate.findings if each.plans]
    return [("b", estimate.angle, estimate.uncertainty, "rad")]
