"""The test's hold on a ROS graph: node processes, a peer that waits for conditions, parameter clients."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions

PATIENCE = 60.0
"""Seconds after which a condition counts as never met: far more than discovery on a loaded machine takes."""


class Process:
    """A node of the package in a process of its own, in the domain of the test, its output kept."""

    def __init__(
        self,
        name: str,
        arguments: list[str],
        log: Path,
        non_ros: Sequence[str] = (),
        under: Sequence[str] = (),
    ) -> None:
        self.log = log
        # Tests that were started by nohup would hand on that a hang-up is ignored.
        inherited = signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [*under, sys.executable, "-m", f"backlash_ros.nodes.{name}", *non_ros, "--ros-args", *arguments],
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        signal.signal(signal.SIGHUP, inherited)
        self.pid = self._process.pid

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def wait(self, seconds: float = PATIENCE) -> int:
        return self._process.wait(timeout=seconds)

    def stop(self) -> int:
        if self.running:
            self.signal(signal.SIGINT)
        return self.wait()

    def kill(self) -> None:
        if self.running:
            self._process.kill()
        self._process.wait()


class Peer:
    """The test's own side of the graph, in its domain: a node, and waiting for conditions while it spins."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("peer", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def spin(self, seconds: float = 0.0) -> None:
        self._executor.spin_once(timeout_sec=seconds)

    def wait(self, what: str | Callable[[], str], condition: Callable[[], Any], seconds: float = PATIENCE) -> Any:
        """Spin until ``condition`` returns something true, and return that."""
        end = time.monotonic() + seconds
        while not (value := condition()):
            assert time.monotonic() < end, f"waited {seconds:g} s for {what if isinstance(what, str) else what()}"
            self.spin(0.02)
        return value

    def ask(self, what: str, send: Callable[[], Any]) -> Any:
        """Send a request that may be sent twice, and return its answer.

        The first answer of a service can be lost: the client may know the server before the server knows the client.
        """
        for _ in range(4):
            future = send()
            end = time.monotonic() + PATIENCE / 4
            while not future.done() and time.monotonic() < end:
                self.spin(0.02)
            if future.done():
                return future.result()
            future.cancel()
        raise AssertionError(f"waited {PATIENCE:g} s for {what}")

    def call(self, kind: type, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.wait(name, client.service_is_ready)
        return self.ask(name, lambda: client.call_async(request))

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


class Parameters:
    """A node's parameters through the standard services."""

    def __init__(self, peer: Peer, node: str) -> None:
        self._peer = peer
        self._client = AsyncParameterClient(peer.node, node)
        peer.wait(f"the parameter services of {node}", self._client.services_are_ready)

    def get(self, *names: str) -> list[Any]:
        values = self._peer.ask("parameters", lambda: self._client.get_parameters(list(names))).values
        return [parameter_value_to_python(value) for value in values]

    def set(self, **changes: Any) -> tuple[bool, str]:
        """Set all or none; names with double underscores for dots."""
        request = [Parameter(name.replace("__", "."), value=value) for name, value in changes.items()]
        result = self._peer.ask("parameters", lambda: self._client.set_parameters_atomically(request)).result
        return result.successful, result.reason


class Lifecycle:
    """A node's lifecycle services."""

    def __init__(self, peer: Peer, node: str) -> None:
        self._peer, self._node = peer, node

    @property
    def state(self) -> str:
        return self._peer.call(GetState, f"{self._node}/get_state", GetState.Request()).current_state.label

    def change(self, transition: int) -> bool:
        """Request once: a transition whose answer was lost must not be asked for again."""
        client = self._peer.node.create_client(ChangeState, f"{self._node}/change_state")
        assert self.state  # the services know this peer by now
        self._peer.wait("the service", client.service_is_ready)
        request = ChangeState.Request(transition=Transition(id=transition))
        future = client.call_async(request)
        self._peer.wait("the transition", future.done)
        return future.result().success
