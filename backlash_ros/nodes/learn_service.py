"""The service ``~/learn``, whose answer takes seconds: served beside the control loop, which goes on meanwhile.

A service callback that waits would stop the node's executor, and a coroutine as callback is lost by rclpy's events
executor (ros2/rclpy issue 1473). So the service lives on a hidden node with an executor and a thread of its own.
"""

import threading
import time
from contextlib import suppress

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from backlash_ros.control import BacklashEstimate
from backlash_ros.control.experiment import Outcome


class LearnService:
    """Hands requests to the control loop and its answer back.

    The loop calls `take_request` on each sample and `answer` once for each request taken.
    """

    def __init__(self, owner: Node) -> None:
        self._asked = threading.Event()
        self._answered = threading.Event()
        self._response = (False, "")
        self._closed: Future[None] = Future()
        self._asked_at = 0.0
        self._node = Node(
            f"_{owner.get_name()}_learn",
            context=owner.context,
            namespace=owner.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._node.create_service(Trigger, owner.resolve_service_name("~/learn"), self._serve)
        self._executor = SingleThreadedExecutor(context=owner.context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="learn service")
        self._thread.start()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin_until_future_complete(self._closed)

    def _serve(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._answered.clear()
        self._response = (False, "the controller is stopping")
        self._asked_at = time.monotonic()
        self._asked.set()
        while not self._closed.done() and not self._answered.wait(0.2):
            pass
        response.success, response.message = self._response
        return response

    def waiting(self) -> float:
        """Return for how long a request has not been taken, s; 0 where there is none."""
        return time.monotonic() - self._asked_at if self._asked.is_set() else 0.0

    def take_request(self) -> bool:
        """Whether somebody has asked since the last call."""
        if not self._asked.is_set():
            return False
        self._asked.clear()
        return True

    def answer(self, success: bool, message: str) -> None:
        """Answer the request that is waiting."""
        self._response = (success, message)
        self._answered.set()

    def close(self) -> None:
        """Refuse what is waiting and end the thread."""
        self._closed.set_result(None)
        self._thread.join()
        self._executor.remove_node(self._node)
        self._node.destroy_node()


def describe_outcome(outcome: Outcome) -> str:
    """Return the answer's text: the estimate and how it was made, or why there is none."""
    if not (isinstance(outcome, BacklashEstimate) and outcome.valid):
        return outcome.reason
    return f"backlash {outcome.angle:.6g} rad at the output, by {outcome.method.value}, from {outcome.reason}"
