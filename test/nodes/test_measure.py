"""`backlash measure`: a drive that runs, from the command line to its certificate."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import Parameters, Peer, Process

from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.measure.command import _part
from backlash_ros.recordings.bag import Series
from backlash_ros.recordings.samples import Columns, Reading
from backlash_ros.ros.client import ClientError

Start = Callable[..., Process]
PAGE = (Path(__file__).parents[2] / "docs" / "identification.md").read_text()
COUNTED = {"sensors__motor_counts": 4096.0, "sensors__load_counts": 65536.0}


def backlash(*words: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "backlash_ros.cli", "measure", *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def begin(start: Start, peer: Peer, *arguments: str) -> Parameters:
    """Start both nodes, in lockstep; no watchdog acts where this machine is busy."""
    start("plant_simulator", *arguments, lockstep=True, real_time_factor=2.0, load__inertia=8e-4, **COUNTED)
    start("controller", *arguments, state_timeout=10.0, use_sim_time=True, learning__apply="ask")
    return Parameters(peer, "axis/controller" if arguments else "controller")


def test_a_running_drive_is_measured_and_certified(start: Start, peer: Peer, tmp_path: Path) -> None:
    parameters = begin(start, peer, "-r", "__ns:=/axis")
    assert parameters.get("learning.experiment") == ["auto"]
    out = tmp_path / "measured"
    words = PAGE.split("    backlash measure ")[1].splitlines()[0].replace("my_axis", str(out)).split()
    program = backlash(*words, "--namespace", "/axis")
    said, _ = program.communicate(timeout=480)
    assert program.returncode == 0, said
    assert "by gap_probe" in said
    assert sorted(path.name for path in out.iterdir()) == [
        "bag",
        "certificate.html",
        "figures.json",
        "identified.yaml",
        "told.yaml",
    ]
    assert Drive.read(out / "told.yaml") == NOMINAL_DRIVE
    found = Drive.read(out / "identified.yaml")
    assert found.gear.backlash_angle == pytest.approx(NOMINAL_DRIVE.gear.backlash_angle, rel=0.03)
    assert found.load.inertia == pytest.approx(8e-4, rel=0.02)
    figures = json.loads((out / "figures.json").read_text())
    assert {row["symbol"]: row["value"] for row in figures["findings"]}["b"] == pytest.approx(
        found.gear.backlash_angle, rel=1e-5
    )
    assert f"backlash measure --out {out}" in (out / "certificate.html").read_text()
    assert parameters.get("learning.experiment", "backlash_angle") == ["auto", 0.0]


@pytest.mark.grid
@pytest.mark.parametrize("terminal", [False, True], ids=["SIGTERM", "Ctrl-C, which the recorder gets, too"])
def test_it_is_stopped_at_rest_and_leaves_nothing(start: Start, peer: Peer, tmp_path: Path, terminal: bool) -> None:
    parameters = begin(start, peer)
    program = backlash("--out", tmp_path / "measured", "--experiment", "gap_map")
    under_way: list[str] = []

    def on_state(message: DiagnosticArray) -> None:
        under_way.extend(each.value for each in message.status[0].values if each.key == "progress")

    peer.node.create_subscription(DiagnosticArray, "controller/state", on_state, 10)
    peer.wait(
        lambda: f"the experiment, got to {under_way[-3:]}; {program.poll()}",
        lambda: any(float(progress) > 0.02 for progress in under_way),
        seconds=240,
    )
    assert parameters.get("learning.experiment") == ["gap_map"]
    if terminal:
        os.killpg(program.pid, signal.SIGINT)
    else:
        program.send_signal(signal.SIGTERM)
    said, _ = program.communicate(timeout=600)
    assert program.returncode == 130, said
    assert "stopped: the experiment was cancelled, and nothing was written" in said
    assert not list(tmp_path.glob("*measured*"))
    assert parameters.get("learning.experiment") == ["auto"]


def test_an_experiment_that_acted_for_no_time_is_said_to_have() -> None:
    row, time = np.arange(3.0), np.array([99.5, 100.0, 100.5, 101.0, 101.5])
    columns = Columns(row, row, row, row, ("t", "m", "l", "c"), str, epoch=100.0)

    def part(*acts: float) -> Reading:
        return _part(columns, Series(time, np.array(acts)))

    assert part(0, 0, 1, 1, 0) == Reading(start=0.5, end=1.0)
    assert part(0, 0, 0, 0, 0) == Reading()
    with pytest.raises(ClientError, match="the recording does not show the experiment"):
        part(0, 0, 1, 0, 0)
    with pytest.raises(ClientError, match="the recorder started late"):
        part(1, 1, 1, 1, 0)


@pytest.mark.grid  # waits for ten seconds
def test_without_a_controller_it_says_so(domain: int, tmp_path: Path) -> None:
    program = backlash("--out", tmp_path / "measured", "--namespace", "/nobody")
    said, _ = program.communicate(timeout=600)
    assert program.returncode == 1
    assert "no controller found at /nobody/controller/learn: waited 10 s for" in said
    assert not list(tmp_path.iterdir())


def test_a_folder_that_exists_is_left_alone(tmp_path: Path) -> None:
    program = backlash("--out", tmp_path)
    said, _ = program.communicate(timeout=60)
    assert program.returncode == 2
    assert "--out: must be a new folder" in said
