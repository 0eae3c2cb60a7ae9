"""Storms of parameter requests on the live controller: each is taken whole or not at all, and used at once."""

import math
from collections.abc import Callable
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
import pytest
from graph import Parameters, Peer, Process
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from lockstep_drive import LockstepDrive
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.parameter import Parameter as RclpyParameter
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile

from backlash_ros.control.design.gain_sets import CUSTOM, REGIONS, expand
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, THETA_L
from backlash_ros.ros.parameters import convert

REFERENCE = 0.2
SETS = ("nominal", "gentle")
IMPLIED = ("gain_set", *(f"gains.{region}.{kind}" for region in REGIONS for kind in "kq"))


class Item(NamedTuple):
    """One parameter of a request, and whether it may be taken."""

    name: str
    value: Any
    valid: bool

    def message(self) -> Parameter:
        if isinstance(self.value, ParameterValue):
            return Parameter(name=self.name, value=self.value)
        return RclpyParameter(self.name, value=self.value).to_parameter_msg()


def items(name: str, valid: Any, *invalid: Any) -> Any:
    wrong = st.sampled_from([*invalid, ParameterValue(), ParameterValue(type=42), "text \x01", [b"x"], [True]])
    return st.one_of(valid.map(lambda v: Item(name, v, True)), wrong.map(lambda v: Item(name, v, False)))


def numbers(low: float, high: float) -> Any:
    return st.one_of(st.floats(low, high), st.integers(math.ceil(low), math.floor(high)))


GAINS = st.sampled_from([[20.0, 0.6, 0.1], [30, 1, 0], [31.5, 0.8, 0.125], [12.0, 0.5, 0.1]])
WEIGHTS = st.sampled_from([[1000.0, 1.0], [400, 1], [4.0, 0.0], [90.0, 0.5]])
BAD_GAINS = ([1e5, 0.0, 0.0], [20.0, math.nan, 0.1], [math.inf, 0.0, 0.0], [-1.0, 0.5, 0.0], [20.0, 0.6], 20.0)
BAD_WEIGHTS = ([-1.0, 0.0], [math.nan, 1.0], [1.0], [4.0, 0.0, 0.0], [0.0, 1.0], 4)
ITEM = st.one_of(
    items("law", st.sampled_from(["fast", "overdamped"]), "bang_bang", "", 1),
    items("gain_set", st.sampled_from([*SETS, CUSTOM]), "nosuch", 3.0),
    *(items(f"gains.{region}.k", GAINS, *BAD_GAINS) for region in REGIONS),
    *(items(f"gains.{region}.q", WEIGHTS, *BAD_WEIGHTS) for region in REGIONS),
    items("backlash_angle", numbers(0, 3.2), -1e-9, 3.3, math.nan, math.inf, -1),
    items("laws.two_region.hysteresis", numbers(0, 10), 10.000001, -math.inf, math.nan),
    items("limits.command", numbers(1, 30), 0.0, -0.0, 0, math.nan),
    items("limits.position_upper", numbers(1, 100), REFERENCE / 2, 2e9, -2e9),
    items("learning.limit_cycle.cycles", st.one_of(st.integers(3, 1000), st.just(5.0)), 2, 5.5, math.nan),
    st.sampled_from(
        [
            Item("rate", 200.0, False),
            Item("gain_sets.gentle.fast.k", [21.0, 0.6, 0.1], False),
            Item("nosuch", 1.0, False),
            Item("", 1.0, False),
        ]
    ),
)
KINDS = {"law": RclpyParameter.Type.STRING, "gain_set": RclpyParameter.Type.STRING}
KINDS |= {"learning.limit_cycle.cycles": RclpyParameter.Type.INTEGER}


def stored(item: Item) -> Any:
    """What the node keeps of a valid item: whole numbers stand for floats."""
    of_gains = RclpyParameter.Type.DOUBLE_ARRAY if item.name.startswith("gains.") else RclpyParameter.Type.DOUBLE
    return convert(item.value, KINDS.get(item.name, of_gains))


REQUEST = st.lists(ITEM, min_size=1, max_size=4, unique_by=lambda item: item.name)
STORM = st.lists(st.tuples(st.booleans(), st.booleans(), REQUEST), min_size=1, max_size=3)
"""Requests: from which of two clients, atomic or one by one, and of what."""


def acceptable(request: list[Item]) -> bool:
    """Whether every item is valid, and none contradicts another."""
    given = {item.name: item.value for item in request}
    both = any({f"gains.{region}.k", f"gains.{region}.q"} <= given.keys() for region in REGIONS)
    other = given.get("gain_set") in SETS and any(name.startswith("gains.") for name in given)
    return all(item.valid for item in request) and not both and not other


def command(values: dict[str, Any], state: np.ndarray) -> Any:
    """What the law in use answers to a state (eq 15 without load torque), where all of it is measured."""
    limit = min(24.0, values["limits.command"])
    error = np.array([state[THETA_L] - REFERENCE, state[OMEGA_L], state[CURRENT]])
    voltage = float(np.clip(-np.array(values[f"gains.{values['law']}.k"]) @ error, -limit, limit))
    return pytest.approx(voltage, rel=1e-9, abs=1e-9)


class Storm:
    """Two clients, a drive and what is in use, around one live controller."""

    def __init__(self, peer: Peer, other: Peer) -> None:
        self.peer, self.other = peer, other
        self.in_use: list[tuple[int, dict[str, Any]]] = []
        transient_local = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        peer.node.create_subscription(ParameterEvent, "controller/parameters_in_use", self._hear, transient_local)
        self.parameters = Parameters(peer, "controller")
        Parameters(other, "controller").get("law")
        self.clients = [
            (
                self._client(side, SetParameters, "set_parameters"),
                self._client(side, SetParametersAtomically, "set_parameters_atomically"),
            )
            for side in (peer, other)
        ]
        self.drive = LockstepDrive(peer).matched()
        self.drive.set_reference(REFERENCE)
        self.drive.run(3)
        peer.wait("what is in use", lambda: self.in_use)
        self.sets = {name: self._gains_of(name) for name in reversed(SETS)}

    def _client(self, side: Peer, kind: type, name: str) -> Client:
        client = side.node.create_client(kind, f"controller/{name}")
        side.wait(name, client.service_is_ready)
        empty = kind.Request()
        side.ask(name, lambda: client.call_async(empty))  # the first answer may be lost, see Peer.ask
        return client

    def _gains_of(self, name: str) -> dict[str, Any]:
        assert self.parameters.set(gain_set=name) == (True, "")
        return dict(zip(IMPLIED, self.parameters.get(*IMPLIED), strict=True))

    def _hear(self, message: ParameterEvent) -> None:
        values = {p.name: parameter_value_to_python(p.value) for p in message.new_parameters}
        self.in_use.append((values.pop("version"), values))

    def rage(self, storm: list[tuple[bool, bool, list[Item]]]) -> None:
        before = dict(zip(self.in_use[-1][1], self.parameters.get(*self.in_use[-1][1]), strict=True))
        self.peer.wait("the newest in use", lambda: self.in_use[-1][1] == before)
        version = self.in_use[-1][0]
        futures = []
        for side, atomic, request in storm:
            client = self.clients[side][atomic]
            futures.append(client.call_async(client.srv_type.Request(parameters=[i.message() for i in request])))
        state, meanwhile = self.drive.plant.state, self.drive.step()
        self.peer.wait("answers", lambda: self.other.spin() or all(future.done() for future in futures))
        taken = [
            request for sent, future in zip(storm, futures, strict=True) for request in judge(sent, future.result())
        ]
        # As many versions as requests that were taken, each the one before with one of these requests, whole.
        self.peer.wait("the last version", lambda: self.in_use[-1][0] >= version + len(taken))
        used = [values for number, values in self.in_use if number >= version]
        assert [number for number, _ in self.in_use if number >= version] == list(range(version, version + len(used)))
        assert len(used) == 1 + len(taken)
        assert any(
            all(
                after == self._changed(now, request) for now, request, after in zip(used, order, used[1:], strict=False)
            )
            for order in permutations(taken)
        )
        assert list(used[-1].values()) == self.parameters.get(*used[-1])
        assert any(meanwhile == command(values, state) for values in used)
        state = self.drive.plant.state
        assert self.drive.step() == command(used[-1], state)

    def _changed(self, values: dict[str, Any], request: list[Item]) -> dict[str, Any]:
        changes = {item.name: stored(item) for item in request}
        return {**values, **expand(changes, self.sets, NOMINAL_DRIVE)}


def judge(sent: tuple[bool, bool, list[Item]], response: Any) -> list[list[Item]]:
    """Check the answers to one request and return what was taken of it."""
    _, atomic, request = sent
    parts = [request] if atomic else [[item] for item in request]
    results = [response.result] if atomic else response.results
    taken = []
    for part, result in zip(parts, results, strict=True):
        assert result.successful == acceptable(part), (part, result.reason)
        if result.successful:
            taken.append(part)
        else:
            assert any(item.name in result.reason for item in part), (part, result.reason)
    return taken


@pytest.mark.grid
def test_storm_of_parameter_requests__each_is_taken_whole_or_not_at_all__none_needed(
    start: Callable[..., Process], peer: Peer
) -> None:
    process = start(
        "controller",
        law="fast",
        torque_bandwidth=0.0,
        state_timeout=10.0,
        faults__load_torque=1e9,  # the drive stands still, whatever the command
        gain_set_names="[nominal, gentle]",
        gain_sets__gentle__fast__k="[10.0, 0.4, 0.1]",
        gain_sets__gentle__overdamped__q="[4.0, 0.0]",
    )
    other = Peer()
    storm = Storm(peer, other)

    @settings(
        max_examples=60,
        deadline=None,
        database=None,
        phases=[Phase.generate],  # shrinking would send thousands of requests more
        suppress_health_check=list(HealthCheck),
    )
    @given(STORM)
    def rage(requests: list[tuple[bool, bool, list[Item]]]) -> None:
        storm.rage(requests)

    try:
        rage()
        assert process.running
    finally:
        other.close()
