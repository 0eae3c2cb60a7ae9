"""A service whose answer comes later, while the loop goes on.

A waiting callback would stop the executor. rclpy's events executor loses a coroutine as callback (ros2/rclpy issue
1473, fixed in 7.1.11). Every version passes a callback's result to `Service.send_response`, and that call is postponed
here.
"""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger


class LaterTrigger:
    """A Trigger service; ``ask`` is called with each request and returns its answer, or None if that comes later.

    Later answers are sent by `answer`, to all waiting clients.
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
        """Answer all waiting clients."""
        waiting, self._waiting = self._waiting, []
        for response, header in waiting:
            response.success, response.message = success, message
            self._send(response, header)
