"""A service whose answer comes later, from the loop that goes on meanwhile.

A callback that waited would stop the executor. rclpy's events executor loses a coroutine as callback (ros2/rclpy issue
1473, mended in 7.1.11); what it does with a callback's result is `Service.send_response`, in every version, and that is
put off here.
"""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger


class LaterTrigger:
    """A Trigger service; ``ask`` is called with each request and returns its answer, or None where that comes later.

    Answers that come later are sent by `answer`, to all who wait.
    """

    def __init__(self, node: Node, name: str, ask: Callable[[], tuple[bool, str] | None]) -> None:
        self._ask = ask
        self._waiting: list[tuple[Trigger.Response, Any]] = []
        self._later = False
        service = node.create_service(Trigger, name, self._on_request)
        self._send = service.send_response
        service.send_response = self._send_or_keep

    def _on_request(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        said = self._ask()
        self._later = said is None
        if said is not None:
            response.success, response.message = said
        return response

    def _send_or_keep(self, response: Trigger.Response, header: Any) -> None:
        if self._later:
            self._waiting.append((response, header))
        else:
            self._send(response, header)

    def answer(self, success: bool, message: str) -> None:
        """Answer everybody who waits."""
        waiting, self._waiting = self._waiting, []
        for response, header in waiting:
            response.success, response.message = success, message
            self._send(response, header)
