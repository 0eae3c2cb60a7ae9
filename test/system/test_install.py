"""Installed as users do, with colcon in a workspace and with pip in a fresh environment: it starts and talks.

It finds a copy of the code that was compiled of these sources here: whose text it is counts, not where it lies.
"""

import os
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterator
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import Peer

from backlash_ros.foundation import compiled as _compiled  # noqa: F401  the function; the module is below
from backlash_ros.ros.isolation import isolated

_COMPILED: Path = sys.modules["backlash_ros.foundation.compiled"]._CACHE
ROOT = Path(__file__).parents[2]
ROS_WHEELS = not os.environ.get("ROS_DISTRO")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """What git has of the project, in a folder of its own."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    copy = tmp_path / "workspace" / "src" / "backlash_ros"
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    return copy


@pytest.fixture
def clean(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of a shell that knows nothing of this one's but the domain, and where compiled code is."""
    shutil.copytree(_COMPILED, tmp_path / "compiled" / _COMPILED.parent.name / _COMPILED.name)
    mine = ("VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    with isolated():
        kept = {name: value for name, value in os.environ.items() if name not in mine or not ROS_WHEELS}
        yield {**kept, "NUMBA_CACHE_DIR": str(tmp_path / "compiled")}


def starts_and_talks(executables: Path, variables: dict[str, str], log: Path) -> None:
    """Start simulator and controller; the controller's telemetry says that both hear each other."""
    peer = Peer()
    told: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "controller/state", told.append, 10)
    processes = []
    try:
        with log.open("wb") as output:
            processes = [
                subprocess.Popen(
                    [executables / name],
                    env=variables,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    cwd=log.parent,
                )
                for name in ("plant_simulator", "controller")
            ]
        peer.wait("telemetry of the installed controller", lambda: told, 250)
        for process in processes:
            process.terminate()
        assert [process.wait(timeout=30) for process in processes] == [0, 0]
    finally:
        for process in processes:
            process.kill()
            process.wait()
        peer.close()
        print(log.read_text())


@pytest.mark.grid
def test_colcon_build_installs_executables_that_talk(source: Path, tmp_path: Path, clean: dict[str, str]) -> None:
    workspace = tmp_path / "workspace"
    colcon = [sys.executable, "-m", "colcon", "build", "--event-handlers", "console_direct+"]
    built = subprocess.run(colcon, cwd=workspace, env=clean, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    prefix = workspace / "install" / "backlash_ros"
    assert (prefix / "share/ament_index/resource_index/packages/backlash_ros").is_file()
    assert (prefix / "share/backlash_ros/package.xml").is_file()
    assert (prefix / "share/backlash_ros/config/nominal_drive.yaml").is_file()
    assert (prefix / "share/backlash_ros/config/plotjuggler_layout.xml").is_file()
    assert (prefix / "share/backlash_ros/config/foxglove_layout.json").is_file()
    assert (prefix / "share/backlash_ros/launch/servo.launch.py").is_file()
    assert (prefix / "share/backlash_ros/config/loopback_udp.xml").is_file()
    sourced = subprocess.run(
        ["bash", "-c", ". install/setup.bash && env -0"],
        cwd=workspace,
        env=clean,
        capture_output=True,
        text=True,
        check=True,
    )
    variables = dict(entry.split("=", 1) for entry in sourced.stdout.split("\0") if "=" in entry)
    assert str(prefix) in variables["AMENT_PREFIX_PATH"]
    starts_and_talks(prefix / "lib" / "backlash_ros", variables, tmp_path / "colcon.log")


@pytest.mark.grid
@pytest.mark.skipif(not ROS_WHEELS, reason="a fresh environment has no ROS but the wheels")
def test_pip_install_in_a_fresh_environment_gives_executables_that_talk(
    source: Path, tmp_path: Path, clean: dict[str, str]
) -> None:
    """What setup.py asks for must be among what is locked: pip may fetch nothing, and what is newer cannot matter."""
    fresh = tmp_path / "fresh"
    venv.create(fresh)
    not_ours = shutil.ignore_patterns("*backlash_ros*", "bin", "lib64", "pyvenv.cfg")
    shutil.copytree(sys.prefix, fresh, copy_function=os.symlink, ignore=not_ours, dirs_exist_ok=True)
    pip = [fresh / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-index", "--no-build-isolation"]
    installed = subprocess.run(
        [*pip, ".[contract]"], cwd=source, env=clean, capture_output=True, text=True, check=False
    )
    assert installed.returncode == 0, installed.stdout + installed.stderr
    assert (fresh / "share/backlash_ros/config/nominal_drive.yaml").is_file()
    profile = subprocess.run(
        [fresh / "bin" / "python", "-c", "from backlash_ros.ros.transport import LOOPBACK; print(LOOPBACK)"],
        cwd=tmp_path,
        env=clean,
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(profile.stdout.strip()).is_file()
    assert Path(profile.stdout.strip()).is_relative_to(fresh)
    starts_and_talks(fresh / "bin", clean, tmp_path / "pip.log")
    kit = [fresh / "bin" / "python", "-m", "pytest", "--pyargs", "backlash_ros.contract", "--collect-only", "-q"]
    collected = subprocess.run(
        [*kit, "--drive-command", "true"], cwd=tmp_path, env=clean, capture_output=True, text=True, check=False
    )
    assert "test_drive.py::test_rate" in collected.stdout, collected.stdout + collected.stderr
