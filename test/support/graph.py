"""The test's hold on a ROS graph: node processes, a peer that waits for conditions, parameter clients."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

PATIENCE = 120.0
"""Seconds after which a condition counts as never met: far more than discovery on a loaded machine takes."""


class Process:
    """A node of the package in a process of its own, in the domain of the test, its output kept.

    It is forked from a process that has loaded what nodes load, which takes a tenth of the time of a start. ``fresh``
    starts it as users do, as does ``under``, a command that it runs under.
    """

    def __init__(
        self,
        name: str,
        arguments: list[str],
        log: Path,
        non_ros: Sequence[str] = (),
        under: Sequence[str] = (),
        fresh: bool = False,
    ) -> None:
        self.log = log
        words = [*non_ros, "--ros-args", *arguments]
        if fresh or under:
            self._process: _Started | _Forked = _Started([*under, sys.executable, "-m", _module(name), *words], log)
        else:
            self._process = _Forked(name, words, log)
        assert self._process.pid is not None
        self.pid = self._process.pid

    @property
    def running(self) -> bool:
        return self._process.code() is None

    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):  # it has ended
            os.kill(self.pid, number)

    def wait(self, seconds: float = PATIENCE) -> int:
        """Return the exit code, minus the signal where one killed it."""
        code = self._process.code(seconds)
        assert code is not None, f"{self.log.stem} still runs after {seconds:g} s"
        return code

    def stop(self) -> int:
        self.signal(signal.SIGINT)
        return self.wait()

    def kill(self) -> None:
        self.signal(signal.SIGKILL)
        self.wait()


def _module(name: str) -> str:
    return "backlash_ros.dashboard.command" if name == "dashboard" else f"backlash_ros.nodes.{name}"


class _Started(subprocess.Popen[bytes]):
    """A process of a command."""

    def __init__(self, command: Sequence[str], log: Path) -> None:
        # Tests that were started by nohup would hand on that a hang-up is ignored.
        inherited = signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with log.open("wb") as output:
            super().__init__(command, stdout=output, stderr=subprocess.STDOUT)
        signal.signal(signal.SIGHUP, inherited)

    def code(self, seconds: float = 0.0) -> int | None:
        try:
            return self.wait(seconds)
        except subprocess.TimeoutExpired:
            return None


_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["warm"])


class _Forked(_FORKS.Process):  # type: ignore[name-defined, misc]
    """A node in a fork of a process that has everything loaded, and no participant."""

    def __init__(self, name: str, words: Sequence[str], log: Path) -> None:
        log.touch()
        super().__init__(target=_become, args=(name, words, str(log), dict(os.environ), os.getcwd()))
        path = os.environ.get("PYTHONPATH", "")
        with pytest.MonkeyPatch.context() as patch:  # until Python 3.13 it preloads from here alone
            patch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *filter(None, [path])]))
            forkserver.ensure_running()
        self.start()

    def code(self, seconds: float = 0.0) -> int | None:
        self.join(seconds)
        return self.exitcode


def _become(name: str, words: Sequence[str], log: str, environment: dict[str, str], folder: str) -> None:
    """Be a node: its output, its environment, its signals."""
    with open(log, "ab") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    sys.exit(import_module(_module(name)).main(words))


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

    def request(self, service: str) -> Future:
        """Ask for a service of the controller once, and do not wait for its answer."""
        client = self.node.create_client(Trigger, f"controller/{service}")
        self.wait("the service", client.service_is_ready)
        return client.call_async(Trigger.Request())

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
