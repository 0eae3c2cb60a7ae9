"""What becomes of an estimate on the live controller: offered, applied, kept in a file, taken from it at the start."""

import json
import math
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph import Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from lockstep_drive import LockstepDrive
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from backlash_ros.control import Method
from backlash_ros.control.estimates import DriveIdentity, History, KeptEstimate, parse, render

Start = Callable[..., Process]
QUICK = {"state_timeout": 10.0, "learning__experiment": "limit_cycle"}
ASK = {**QUICK, "learning__apply": "ask"}
DRIVE = DriveIdentity("/controller", "motor", "load", 10.0)
ANGLE = {"backlash_angle": 0.0195}
KEPT = History(
    DRIVE, (KeptEstimate(datetime(2026, 3, 29, tzinfo=timezone.utc), Method.GAP_PROBE, ANGLE, {}, applied=True),)
)
TRANSIENT_LOCAL = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "kept" / "estimates.yaml"


@pytest.fixture(autouse=True)
def _folder(file: Path) -> None:
    file.parent.mkdir()


def apply(peer: Peer) -> Trigger.Response:
    answer = peer.request("apply_estimate")  # once: asked again it is refused
    peer.wait("an answer", answer.done)
    return answer.result()


def kept(file: Path, drive: DriveIdentity = DRIVE) -> list[tuple[float, bool]]:
    return [(each.parameters["backlash_angle"], each.applied) for each in parse(file.read_bytes(), drive).estimates]


class Said:
    """The newest diagnostics of the servo, and every estimate in use."""

    def __init__(self, peer: Peer) -> None:
        self.status = DiagnosticStatus()
        self.in_use: list[float] = []
        self._peer = peer
        peer.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        peer.node.create_subscription(
            Float64, "controller/backlash_estimate", lambda m: self.in_use.append(m.data), TRANSIENT_LOCAL
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.status = next((s for s in message.status if s.name == "/controller: servo"), self.status)

    def wait(self, level: bytes, text: str) -> dict[str, str]:
        self._peer.wait(
            lambda: f"{text}: {self.status.message}", lambda: text in self.status.message and self.status.level == level
        )
        return {entry.key: entry.value for entry in self.status.values}


def test_an_estimate_is_offered_and_applied_when_asked(start: Start, peer: Peer, file: Path) -> None:
    """Under a law that does not rattle while the backlash is not known: that would be a warning of its own."""
    start("controller", learning__estimate_file=file, law="overdamped", **ASK)
    said, parameters, drive = Said(peer), Parameters(peer, "controller"), LockstepDrive(peer).matched()
    assert (
        apply(peer).message
        == "there is no estimate to apply: none has been learned since the controller was configured"
    )
    answer = drive.call("learn")
    assert answer.success, answer.message
    assert answer.message.endswith("; call apply_estimate to use it")
    assert parameters.get("backlash_angle") == [0.0]
    ((angle, applied),) = kept(file)
    assert angle == pytest.approx(0.02, rel=0.05)
    assert not applied
    values = said.wait(DiagnosticStatus.OK, f"an estimate waits for apply_estimate: backlash_angle = {angle:.6g} rad")
    assert (values["estimate_rad"], values["estimate_method"]) == (str(angle), "gap_travel")
    assert (values["estimate_applied"], values["estimate_file"]) == ("False", str(file))
    assert json.loads(values["found"])["learn"][0][:2] == ["b", angle]
    assert said.in_use == []
    answer = apply(peer)
    assert (answer.success, answer.message) == (True, f"in use: backlash_angle = {angle:.6g} rad")
    assert parameters.get("backlash_angle") == [angle]
    assert kept(file) == [(angle, True)]
    peer.wait("the estimate", lambda: said.in_use == [angle])
    answer = apply(peer)
    assert not answer.success
    assert "has already been applied" in answer.message


@pytest.mark.grid
def test_the_offer_outlives_a_failed_learning_and_deactivation_but_not_clean_up(start: Start, peer: Peer) -> None:
    start("controller", learning__limit_cycle__attempts=1, **ASK)
    parameters, drive = Parameters(peer, "controller"), LockstepDrive(peer).matched()
    lifecycle = Lifecycle(peer, "controller")
    assert drive.call("learn").success
    drive.load_torque = 0.1
    answer = drive.call("learn")
    assert not answer.success
    assert "no valid cycle" in answer.message
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    assert apply(peer).success
    assert parameters.get("backlash_angle") == [pytest.approx(0.02, rel=0.05)]
    drive.load_torque = 0.0
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    drive.run(100)
    assert drive.call("learn").success
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    assert lifecycle.change(Transition.TRANSITION_CLEANUP)
    assert apply(peer).message.startswith("there is no estimate to apply")
    assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
    assert apply(peer).message.startswith("there is no estimate to apply")


@pytest.mark.grid
def test_applying_while_it_moves_is_setting_the_parameter(start: Start, peer: Peer) -> None:
    def moved(change: Callable[[], bool]) -> np.ndarray:
        process = start("controller", backlash_angle=0.1, **ASK)  # five times too wide, so that it matters, and quiet
        drive = LockstepDrive(peer).matched()
        assert drive.call("learn").success
        drive.run(1500)
        drive.set_reference(0.5)
        before = drive.run(10)
        assert change()
        angles = np.concatenate([before, drive.run(300)])
        process.stop()
        return angles

    found: list[float] = []

    def applied() -> bool:
        accepted = apply(peer).success
        found.extend(Parameters(peer, "controller").get("backlash_angle"))
        return bool(accepted)

    by_service, untouched = moved(applied), moved(lambda: True)
    by_parameter = moved(lambda: Parameters(peer, "controller").set(backlash_angle=found[0])[0])
    np.testing.assert_allclose(by_service, by_parameter, rtol=0, atol=1e-4)
    assert np.max(np.abs(by_service - untouched)) > 0.02


def test_auto_keeps_it_as_applied_and_the_next_start_uses_it(start: Start, peer: Peer, file: Path) -> None:
    began = datetime.now(timezone.utc).replace(microsecond=0)
    process = start("controller", learning__estimate_file=file, **QUICK)
    drive = LockstepDrive(peer).matched()
    answer = drive.call("learn")
    assert answer.success, answer.message
    (learned,) = Parameters(peer, "controller").get("backlash_angle")
    assert kept(file) == [(learned, True)]
    (estimate,) = parse(file.read_bytes(), DRIVE).estimates
    assert began <= estimate.learned_at <= datetime.now(timezone.utc)
    assert process.stop() == 0
    content = file.read_bytes()
    process = start("controller", learning__estimate_file=file, learning__use_estimate_file=True, **QUICK)
    said = Said(peer)
    peer.wait("the estimate", lambda: said.in_use == [learned])
    assert Parameters(peer, "controller").get("backlash_angle") == [learned]
    assert f"from {file}" in process.output()
    assert file.read_bytes() == content


@pytest.mark.parametrize(("friction", "identified"), [({}, False), ({"load.coulomb_friction": 0.01}, True)])
def test_a_drive_is_identified_by_inertia_and_friction_together(
    start: Start, peer: Peer, file: Path, friction: dict[str, float], identified: bool
) -> None:
    found = {"load.inertia": 4e-4, **friction}
    estimate = KeptEstimate(datetime(2026, 3, 29, tzinfo=timezone.utc), Method.IDENTIFY, found, {}, applied=True)
    file.write_text(render(History(DRIVE, (estimate,))))
    start("controller", learning__estimate_file=file, learning__use_estimate_file=True, **QUICK)
    parameters = Parameters(peer, "controller")
    peer.wait("the estimate", lambda: parameters.get("load.inertia") == [4e-4])
    assert parameters.get("identified") == [identified]


def test_apply_is_changed_while_it_runs_and_counts_at_the_end(start: Start, peer: Peer) -> None:
    process = start("controller", **QUICK)
    parameters, drive = Parameters(peer, "controller"), LockstepDrive(peer).matched()
    accepted, reason = parameters.set(learning__apply="never")
    assert (accepted, reason) == (False, "learning.apply must be one of ['auto', 'ask'], got 'never'")
    answer = peer.request("learn")
    drive.until(lambda: "learning the backlash" in process.output())
    assert parameters.set(learning__apply="ask") == (True, "")
    drive.until(answer.done)
    assert answer.result().success
    assert parameters.get("backlash_angle") == [0.0]


def test_without_a_file_yet_it_starts_with_the_parameter(start: Start, peer: Peer, file: Path) -> None:
    process = start(
        "controller", learning__estimate_file=file, learning__use_estimate_file=True, backlash_angle=0.015, **QUICK
    )
    assert Parameters(peer, "controller").get("backlash_angle") == [0.015]
    assert f"{file} has no applied estimate: the parameters stay" in process.output()
    assert kept(file) == []


@pytest.mark.corners(2)
@pytest.mark.parametrize("use", [True, False])
@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("0.0195", "7.1", "estimates[0].parameters.backlash_angle must be > 0 rad and <= 3.2 rad, got 7.1"),
        (
            "load_joint: load",
            "load_joint: wrist",
            "drive.load_joint must be 'load', as in this controller, got 'wrist'",
        ),
        ("  applied: true\n", "", "estimates[0] must have the key 'applied'"),
    ],
)
def test_a_file_that_is_not_ours_is_refused_before_anything_moves(
    start: Start, peer: Peer, file: Path, use: bool, old: str, new: str, why: str
) -> None:
    file.write_text(render(KEPT).replace(old, new))
    content = file.read_bytes()
    process = start(
        "controller", learning__estimate_file=file, learning__use_estimate_file=use, autostart=False, **QUICK
    )
    lifecycle = Lifecycle(peer, "controller")
    assert not lifecycle.change(Transition.TRANSITION_CONFIGURE)
    assert lifecycle.state == "unconfigured"
    assert f"cannot configure: learning.estimate_file {file}: {why}" in process.output()
    assert Parameters(peer, "controller").get("backlash_angle") == [0.0]
    assert file.read_bytes() == content
    file.write_text(render(KEPT))
    assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
    assert Parameters(peer, "controller").get("backlash_angle") == [0.0195 if use else 0.0]


def test_a_start_with_a_file_that_cannot_be_used_ends_with_a_line_that_says_why(start: Start, tmp_path: Path) -> None:
    process = start("controller", learning__estimate_file=tmp_path / "nosuch" / "estimates.yaml")
    assert process.wait() == 1
    assert f"there is no folder {tmp_path / 'nosuch'}" in process.output()
    assert "controller did not come up: still unconfigured" in process.output()


def test_two_axes_cannot_share_a_file(start: Start, file: Path) -> None:
    """Their joints have the same names, each in its own namespace."""
    process = start("controller", non_ros=["--axes", "a", "b"], learning__estimate_file=file)
    assert process.wait() == 1
    assert "drive.controller must be '/b/controller', as in this controller, got '/a/controller'" in process.output()
    assert "ready" not in process.output()
    assert kept(file, DriveIdentity("/a/controller", "motor", "load", 10.0)) == []


def test_each_axis_has_its_file(start: Start, peer: Peer, tmp_path: Path) -> None:
    files = {axis: tmp_path / f"{axis}.yaml" for axis in "ab"}
    parameters = tmp_path / "axes.yaml"
    parameters.write_text(
        "".join(f"/{a}/controller: {{ros__parameters: {{learning.estimate_file: {files[a]}}}}}\n" for a in "ab")
    )
    start("controller", "--params-file", str(parameters), non_ros=["--axes", "a", "b"])
    for axis in "ab":
        assert Lifecycle(peer, f"{axis}/controller").state == "active"
        assert kept(files[axis], DriveIdentity(f"/{axis}/controller", "motor", "load", 10.0)) == []


def test_a_write_that_fails_is_told_and_disturbs_nothing(start: Start, peer: Peer, file: Path) -> None:
    process = start("controller", learning__estimate_file=file, **QUICK)
    said, drive = Said(peer), LockstepDrive(peer).matched()
    file.unlink()
    file.parent.rmdir()
    answer = drive.call("learn")
    assert answer.success
    assert f"it could not be stored in {file}: [Errno 2] No such file or directory" in answer.message
    assert Parameters(peer, "controller").get("backlash_angle") == [pytest.approx(0.02, rel=0.05)]
    said.wait(DiagnosticStatus.WARN, "it could not be stored in")
    assert f"the last estimate: it could not be stored in {file}" in process.output()
    assert drive.follows(0.3)


SLOW_DISK = """
import os, time

fsync = os.fsync


def slow(descriptor):
    while not os.path.exists({gate!r}):
        time.sleep(0.01)
    fsync(descriptor)


os.fsync = slow
"""


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a file without which the disk of nodes that are started does not go on; it is there."""
    gate, plugin = tmp_path / "gate", tmp_path / "slow_disk.py"
    plugin.write_text(SLOW_DISK.format(gate=str(gate)))
    monkeypatch.setenv("BACKLASH_ROS_PLUGINS", str(plugin))
    gate.touch()
    return gate


@pytest.mark.grid
def test_samples_are_answered_while_the_disk_is_slow(start: Start, peer: Peer, file: Path, gate: Path) -> None:
    start("controller", learning__estimate_file=file, fresh=True, **QUICK)
    parameters, drive = Parameters(peer, "controller"), LockstepDrive(peer).matched()
    gate.unlink()
    answer = peer.request("learn")
    while parameters.get("backlash_angle") == [0.0]:
        drive.run(50)
        assert drive.tick < 50_000
    assert np.all(np.isfinite(drive.run(50)))
    assert not answer.done()
    refusal = peer.call(Trigger, "controller/learn", Trigger.Request())
    assert refusal.message == "cannot learn: the previous estimate is still being written"
    assert kept(file) == []
    gate.touch()
    peer.wait("an answer", answer.done)
    assert answer.result().success
    assert math.isclose(kept(file)[0][0], parameters.get("backlash_angle")[0])


@pytest.mark.grid
def test_the_end_of_the_process_waits_for_the_file_but_not_for_ever(
    start: Start, peer: Peer, file: Path, gate: Path
) -> None:
    process = start("controller", learning__estimate_file=file, fresh=True, **QUICK)
    parameters, drive = Parameters(peer, "controller"), LockstepDrive(peer).matched()
    gate.unlink()
    answer = peer.request("learn")
    while parameters.get("backlash_angle") == [0.0]:
        drive.run(50)
        assert drive.tick < 50_000
    assert process.stop() == 0
    peer.wait("an answer", answer.done)
    assert f"it is still being written to {file}" in answer.result().message
    assert "the estimate file could not be written before the node ended" in process.output()
    assert kept(file) == []
