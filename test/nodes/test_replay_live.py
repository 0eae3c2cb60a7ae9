"""The replay of a live controller: over DDS in lockstep, whatever is done to it meanwhile, to the last bit."""

from collections.abc import Callable
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import PATIENCE, Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from backlash_ros.control.telemetry import HOMING, IDENTIFYING, LEARNING
from backlash_ros.studies.replay.again import replay
from backlash_ros.studies.replay.recorded import read_recorded
from backlash_ros.studies.replay.what_if import Changes

KEPT = {f"qos_overrides./{topic}.publisher.depth": 20_000 for topic in ("joint_states", "command", "controller/state")}
"""So that a recorder on a busy machine loses nothing."""
PERIOD = 0.004


class Session:
    """A user of a controller whose samples come as fast as it answers; time is counted in samples."""

    def __init__(self, peer: Peer) -> None:
        self._peer, self.values = peer, dict[str, float]()
        node = peer.node
        node.create_subscription(DiagnosticArray, "controller/state", self._on_state, QoSProfile(depth=1000))
        self.reference, self.torque = (node.create_publisher(Float64, t, 10) for t in ("reference", "load_torque"))

    def _on_state(self, message: DiagnosticArray) -> None:
        self.values = {entry.key: float(entry.value) for entry in message.status[0].values}

    def wait(self, seconds: float) -> None:
        """Wait for so much simulated time."""
        until = self.values["samples"] + seconds / PERIOD
        self._peer.wait(f"{seconds:g} s of simulated time", lambda: self.values["samples"] >= until)

    def begin(self, service: str, experiment: int) -> None:
        """Ask for an experiment, once: its answer takes as long as a busy machine takes."""
        client = self._peer.node.create_client(Trigger, f"controller/{service}")
        self._peer.wait(service, client.service_is_ready)
        client.call_async(Trigger.Request())
        self._peer.wait(f"{service} to begin", lambda: self.values["experiment"] == experiment)

    def put_in_use(self, service: str, experiment: int) -> None:
        """Let what an experiment finds be put in use."""
        before = self.values["parameters_version"]
        self.begin(service, experiment)
        self._peer.wait(
            f"the result of {service}", lambda: self.values["parameters_version"] > before, seconds=5 * PATIENCE
        )

    def go(self, target: float, seconds: float) -> None:
        self.reference.publish(Float64(data=target))
        self._peer.wait(f"reference {target:g}", lambda: self.values["reference"] == target)
        self.wait(seconds)


@pytest.mark.grid  # the demo is replayed, too
def test_a_session_is_replayed_to_the_last_bit(start: Callable[..., Process], peer: Peer, tmp_path: Path) -> None:
    session = Session(peer)
    recorder = start("recorder", output=tmp_path / "bag")
    start("controller", state_timeout=10.0, use_sim_time=True, autostart=False, **KEPT)
    start("plant_simulator", lockstep=True, real_time_factor=0.0, **KEPT)
    parameters, lifecycle = Parameters(peer, "controller"), Lifecycle(peer, "controller")
    assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
    for said in ("hears /joint_states", "hears /controller/parameters_in_use", "recording /controller/state"):
        peer.wait(said, lambda said=said: said in recorder.output())
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    peer.wait("samples", lambda: session.values.get("samples", 0.0) > 0.0)
    peer.wait("both", lambda: session.reference.get_subscription_count() + session.torque.get_subscription_count() == 4)

    session.go(1.0, 1.0)
    session.put_in_use("learn", LEARNING)
    session.go(-0.5, 1.0)
    session.go(0.5, 0.02)
    assert parameters.set(gains__fast__q=[300.0, 1.0]) == (True, "")
    session.wait(1.0)
    session.torque.publish(Float64(data=0.1))
    session.wait(1.0)
    assert parameters.set(law="planned", identified=True) == (True, "")
    session.go(1.5, 1.5)
    session.begin("learn", LEARNING)
    session.wait(0.5)
    peer.call(Trigger, "controller/cancel", Trigger.Request())
    peer.wait("the end", lambda: session.values["experiment"] == 0)
    session.torque.publish(Float64(data=-0.2))
    session.go(-1.0, 1.5)
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    assert parameters.set(gain_set="nominal") == (True, "")
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    peer.wait("samples again", lambda: session.values["holding"] == 1.0)
    session.go(0.3, 1.0)
    session.put_in_use("identify", IDENTIFYING)
    session.go(-0.3, 1.0)

    assert recorder.stop() == 0
    recorded = read_recorded(tmp_path / "bag")
    done = [replay(recorded, activation, Changes({}))[0] for activation in recorded.activations]
    assert [(each.equal, each.lost, each.unanswered, each.notes) for each in done] == [(True, 0, 0, ())] * 2
    assert sum(len(each.stamps) for each in done) >= 12.0 / PERIOD


@pytest.mark.grid  # without ROS test_replay.py has it, too
def test_a_homing_by_a_switch_is_replayed_to_the_last_bit(
    start: Callable[..., Process], peer: Peer, tmp_path: Path
) -> None:
    session, switch = Session(peer), peer.node.create_publisher(Bool, "home_switch", 10)
    recorder = start("recorder", output=tmp_path / "bag")
    home = {"homing__switch": True, "homing__speed": -0.5, "homing__way": 1.0, "homing__back_off": 0.05}
    start("controller", state_timeout=10.0, use_sim_time=True, autostart=False, **home, **KEPT)
    start("plant_simulator", lockstep=True, real_time_factor=0.0, **KEPT)
    lifecycle = Lifecycle(peer, "controller")
    assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
    for said in ("hears /joint_states", "hears /controller/parameters_in_use", "recording /controller/state"):
        peer.wait(said, lambda said=said: said in recorder.output())
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    peer.wait("samples", lambda: session.values.get("samples", 0.0) > 0.0)
    peer.wait("controller and recorder", lambda: switch.get_subscription_count() == 2)
    switch.publish(Bool(data=False))
    session.wait(0.5)
    session.begin("home", HOMING)
    peer.wait("the way", lambda: session.values["load_angle"] < -0.05)
    switch.publish(Bool(data=True))
    peer.wait("the zero", lambda: session.values["experiment"] == 0 and session.values["parameters_version"] > 1)
    session.go(0.2, 1.0)
    assert recorder.stop() == 0
    recorded = read_recorded(tmp_path / "bag")
    (done,) = (replay(recorded, activation, Changes({}))[0] for activation in recorded.activations)
    assert (done.equal, done.lost, done.unanswered, done.notes) == (True, 0, 0, ())
