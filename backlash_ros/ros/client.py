"""A client of a controller, and nodes of this package as separate processes, for programs that run them."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future
from std_srvs.srv import Trigger

from backlash_ros.ros.topics import HEARS

SERVICES = ("learn", "identify", "cancel")
"""Of the controller, that are called here."""
PATIENCE = 120.0
"""Default waiting time, s: generous, since a busy machine may take long to start a node or to fit a recording."""
_END = 60.0
"""Time that a node may take to end, s: a recorder first writes what has arrived, and the processor may be busy."""


class ClientError(RuntimeError):
    """A wait timed out or a request was refused; the text says which."""


class TimedOutError(ClientError):
    """A wait timed out."""


def start_node(name: str, log: Path, *ros_arguments: str) -> subprocess.Popen[bytes]:
    """Start a node of this package, as ``python -m`` would, with its output in ``log``."""
    command = [sys.executable, "-m", f"backlash_ros.nodes.{name}", "--ros-args", *ros_arguments]
    with log.open("wb") as output:
        return subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)


def stop_node(process: subprocess.Popen[bytes]) -> int:
    """End a node as Ctrl-C does and return its exit code; kill it if it does not end in time."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        return process.wait(timeout=_END)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def _done_or_over(future: Future, end: float) -> bool:
    return future.done() or time.monotonic() > end


class Client:
    """A user of a controller's services and parameters.

    Parameters
    ----------
    node : the client's node, which is spun while waiting
    children : processes that must run while waiting, by name
    controller : name of the controller's node
    """

    def __init__(
        self, node: Node, children: dict[str, subprocess.Popen[bytes]], controller: str = "controller"
    ) -> None:
        self.node, self.children = node, children
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self.services = {name: node.create_client(Trigger, f"{controller}/{name}") for name in SERVICES}
        self.parameters = AsyncParameterClient(node, controller)

    def wait(self, what: str, condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
        """Spin until ``condition`` holds; ClientError if it does not within ``seconds`` or if a child has ended."""
        end = time.monotonic() + seconds
        while not condition():
            for name, child in self.children.items():
                if child.poll() is not None:
                    raise ClientError(f"{name} ended with code {child.returncode}")
            if time.monotonic() > end:
                raise TimedOutError(f"waited {seconds:g} s for {what}")
            self._executor.spin_once(timeout_sec=0.05)

    def pause(self, seconds: float) -> None:
        """Let time pass."""
        end = time.monotonic() + seconds
        self.wait("time to pass", lambda: time.monotonic() >= end, seconds + PATIENCE)

    def wait_for_controller(self, seconds: float = PATIENCE) -> None:
        """Wait until the controller's services are there."""
        for name, service in self.services.items():
            self.wait(f"the controller's service {name}", service.service_is_ready, seconds)
        self.wait("the controller's parameters", self.parameters.services_are_ready, seconds)

    def wait_for_recorder(self, log: Path, topic: str, seconds: float = PATIENCE) -> None:
        """Wait until the recorder that writes ``log`` has heard a topic."""
        self.wait(f"the recorder to hear {topic}", lambda: f"{HEARS} {topic}\n" in log.read_text(), seconds)

    def call(self, service: str, seconds: float = PATIENCE) -> tuple[bool, str]:
        """Call a service once and return its answer: whether it succeeded, and the text."""
        future = self.services[service].call_async(Trigger.Request())
        self.wait(f"the answer of {service}", future.done, seconds)
        response = future.result()
        return response.success, response.message

    def _ask(self, what: str, send: Callable[[], Future]) -> Any:
        """Send a request, repeatedly if needed, and return its answer.

        The first answer of a service can be lost: the client may know the server before the server knows the client.
        """
        for _ in range(3):
            future = send()
            self.wait(what, partial(_done_or_over, future, time.monotonic() + PATIENCE / 3))
            if future.done():
                return future.result()
            future.cancel()
        raise TimedOutError(f"waited {PATIENCE:g} s for {what}")

    def get(self, *names: str) -> dict[str, Any]:
        """Return parameters of the controller by name, all of them if none is named."""
        if not names:
            names = tuple(self._ask("parameter names", self.parameters.list_parameters).result.names)
        values = self._ask("parameters", lambda: self.parameters.get_parameters(names)).values
        return dict(zip(names, map(parameter_value_to_python, values), strict=True))

    def set(self, parameters: dict[str, Any]) -> tuple[bool, str]:
        """Set parameters of the controller, all or none; return whether that succeeded, and why not."""
        request = [Parameter(name, value=value) for name, value in parameters.items()]
        result = self._ask("parameters", lambda: self.parameters.set_parameters_atomically(request)).result
        return result.successful, result.reason

    def must_set(self, parameters: dict[str, Any]) -> None:
        """Set parameters; ClientError if they are refused."""
        accepted, reason = self.set(parameters)
        if not accepted:
            raise ClientError(f"the controller refused {parameters}: {reason}")
