"""What /diagnostics says, once a second: rates, ages, times and what is in use, with the level that it deserves."""

import re
import signal
from collections.abc import Callable

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph import Parameters, Peer, Process
from lockstep_drive import LockstepDrive
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header

from backlash_ros.ros.messages import answer, stamp_label

Start = Callable[..., Process]
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
PATIENT = {"state_timeout": 5.0}


class Diagnostics:
    """The statuses of both nodes, newest and all."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self.heard: list[DiagnosticStatus] = []
        peer.node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: self.heard.extend(m.status), 100)

    def wait(self, name: str, what: str, condition: Callable[[DiagnosticStatus], bool]) -> dict[str, str]:
        """Wait for a status of ``name`` that meets ``condition`` and return its values."""

        def found() -> DiagnosticStatus | None:
            return next((status for status in reversed(self.heard) if status.name == name and condition(status)), None)

        status = self._peer.wait(f"{name} to be {what}; heard {[(s.level, s.message) for s in self.heard[-4:]]}", found)
        return {entry.key: entry.value for entry in status.values}


def test_healthy_pair_is_ok_and_says_how_it_runs(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    start("controller", backlash_angle=0.02, rate=50.0, **PATIENT)
    start("plant_simulator", rate=50.0)
    waiting = diagnostics.wait("/controller: servo", "waiting or active", lambda s: s.level in {OK, WARN})
    assert waiting["state"] in {"active", "inactive"}
    values = diagnostics.wait("/controller: servo", "active and ok", lambda s: s.level == OK and s.message == "active")
    assert values["fault"] == ""
    assert (values["law"], values["law_in_use"]) == ("auto", "two_region")
    assert (values["gain_set"], values["backlash_angle"]) == ("nominal", "0.02")
    assert values["gains.fast.k"].startswith("[31.6")
    timing = diagnostics.wait(
        "/controller: timing", "in time", lambda s: s.level == OK and "nominal 50 Hz" in s.message
    )
    assert float(timing["rate_Hz"]) == pytest.approx(50, rel=0.05)
    for key in ("state_age", "step_time"):
        assert re.fullmatch(r"mean -?[\d.]+, p99 -?[\d.]+, max -?[\d.]+ ms", timing[key])
    drive = diagnostics.wait(
        "/plant_simulator: timing",
        "in time and answered",
        lambda s: (
            s.level == OK
            and "Hz" in s.message
            and any(v.key == "answered_in_period" and v.value != "0" for v in s.values)
        ),
    )
    assert float(drive["rate_Hz"]) == pytest.approx(50, rel=0.05)
    assert float(drive["answered_percent"]) > 0
    assert re.fullmatch(r"mean [\d.]+, p99 [\d.]+, max [\d.]+ ms", drive["integration"])


def test_a_law_that_another_stands_in_for_is_said_to_wait(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    process = start("controller", law="planned", backlash_angle=0.02, **PATIENT)
    start("plant_simulator")
    waits = "law 'planned' uses the over-damped gains, which are slow, until the drive is identified: call identify"
    diagnostics.wait("/controller: servo", "waiting", lambda s: s.level == OK and s.message == f"active; {waits}")
    assert process.output().count(waits) == 1
    assert Parameters(peer, "controller").set(identified=True) == (True, "")
    diagnostics.wait("/controller: servo", "as asked for", lambda s: s.level == OK and s.message == "active")
    assert Parameters(peer, "controller").set(identified=False) == (True, "")
    peer.wait("the line in the log", lambda: process.output().count(waits) == 2)


def test_auto_takes_the_law_of_planned_moves_once_the_drive_is_identified(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    process = start("controller", backlash_angle=0.02, **PATIENT)
    start("plant_simulator")
    until = "law 'auto' is 'two_region' until the drive is identified, and 'planned' from then on: call identify"
    peer.wait("the line in the log", lambda: until in process.output())
    assert Parameters(peer, "controller").set(identified=True) == (True, "")
    values = diagnostics.wait("/controller: servo", "the other law", lambda s: "planned" in str(s.values))
    assert (values["law"], values["law_in_use"]) == ("auto", "planned")


@pytest.mark.parametrize(("rate", "level"), [(225.0, WARN), (125.0, ERROR)])
def test_drive_at_another_rate_is_a_warning_or_an_error(start: Start, peer: Peer, rate: float, level: bytes) -> None:
    diagnostics = Diagnostics(peer)
    start("controller", **PATIENT)
    start("plant_simulator", rate=rate)
    diagnostics.wait("/controller: timing", "off", lambda s: s.level == level and "nominal 250 Hz" in s.message)


def test_waiting_for_joint_states_is_a_warning(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    start("controller")
    diagnostics.wait(
        "/controller: servo", "waiting", lambda s: s.level == WARN and "waiting for joint_states" in s.message
    )


def many_late(status: DiagnosticStatus) -> bool:
    late = re.search(r"(\d+) samples late", status.message)
    return status.level >= WARN and late is not None and int(late[1]) >= 200


def test_late_samples_are_skipped_and_reported(start: Start, peer: Peer) -> None:
    """A simulator that stood still publishes no burst: each that is missing counts as late."""
    diagnostics = Diagnostics(peer)
    process = start("plant_simulator")
    diagnostics.wait("/plant_simulator: timing", "beating", lambda s: "Hz" in s.message)
    process.signal(signal.SIGSTOP)
    before = len(diagnostics.heard)
    end = peer.node.get_clock().now().nanoseconds + 10**9
    peer.wait("a second", lambda: peer.node.get_clock().now().nanoseconds > end)
    process.signal(signal.SIGCONT)
    diagnostics.wait("/plant_simulator: timing", "late by about 250 samples", many_late)
    assert len(diagnostics.heard) > before


def test_dropped_messages_are_a_warning(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    start("controller", **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.exchange(drive.sample(position=[0.0]))
    text = "messages dropped, the last one: unusable joint_states: 2 names but 1 positions"
    values = diagnostics.wait("/controller: servo", "warning", lambda s: s.level == WARN and text in s.message)
    assert int(values["messages_dropped"]) > 0


def test_late_samples_are_a_warning(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    start("controller", **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.run(20)
    drive.tick += 1
    drive.run(1)
    values = diagnostics.wait(
        "/controller: timing", "warning", lambda s: s.level >= WARN and "samples late within" in s.message
    )
    assert int(values["late_samples"]) > 0


def test_samples_that_come_old_are_a_warning(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    start("controller", state_timeout=2.0)
    drive = LockstepDrive(peer).matched()

    def told() -> bool:
        drive.exchange(drive.sample(header=Header(stamp=(peer.node.get_clock().now() - Duration(seconds=3)).to_msg())))
        texts = [s.message for s in diagnostics.heard if s.name == "/controller: timing" and s.level >= WARN]
        return any(re.search(r"joint_states are [3-9][.\d]* s old(;|$)", text) for text in texts)

    peer.wait("a warning", told)


def test_answers_to_another_sample_than_the_newest_are_counted_as_late(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    start("plant_simulator", command_timeout=10.0)
    publisher = peer.node.create_publisher(Float64MultiArray, "command", 1)
    samples: list[JointState] = []
    peer.node.create_subscription(JointState, "joint_states", samples.append, 100)

    def late() -> bool:
        if len(samples) > 100:
            publisher.publish(answer(0.0, stamp_label(samples[-100].header.stamp)))
        newest = next((s.values for s in reversed(diagnostics.heard) if s.name == "/plant_simulator: timing"), [])
        values = {entry.key: entry.value for entry in newest}
        assert values.get("answered_in_period", "0") == "0"
        return int(values.get("answered_late", "0")) > 0

    peer.wait("a late answer", late)


def test_clocks_that_differ_are_told(start: Start, peer: Peer) -> None:
    """Lockstep stamps with simulated time; a controller without use_sim_time takes them for half a century old."""
    diagnostics = Diagnostics(peer)
    start("controller", **PATIENT)
    start("plant_simulator", lockstep=True, real_time_factor=0.0)
    diagnostics.wait(
        "/controller: timing",
        "suspicious",
        lambda s: s.level == WARN and "the clocks or use_sim_time differ" in s.message,
    )
    assert Parameters(peer, "controller").get("use_sim_time") == [False]


def test_samples_without_a_stamp_are_told_once(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    process = start("controller", **PATIENT)
    drive = LockstepDrive(peer).matched()

    def told() -> bool:
        assert drive.exchange(drive.sample(header=Header())) == 0.0
        texts = [s.message for s in diagnostics.heard if s.name == "/controller: timing" and s.level >= WARN]
        return any("the drive does not stamp its samples" in text for text in texts)

    peer.wait("a warning", told)
    assert process.output().count("the drive does not stamp its samples") == 1
    assert "clocks" not in process.output()


def test_node_that_is_not_active_says_its_state(start: Start, peer: Peer) -> None:
    diagnostics = Diagnostics(peer)
    for node, status in (("controller", "servo"), ("plant_simulator", "drive")):
        start(node, autostart=False)
        values = diagnostics.wait(f"/{node}: {status}", "unconfigured", lambda s: s.message == "unconfigured")
        assert values["state"] == "unconfigured"
