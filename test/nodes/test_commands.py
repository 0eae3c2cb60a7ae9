"""Every `ros2 run backlash_ros` of README and docs starts its node, with the files that the pages speak of."""

import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from graph import Peer, Process
from pages import DESIGNED, ROOT, commands

READY = r"ready at 250 Hz|simulating at 250 Hz|recording|^http://|waiting for the requests to configure"
AXES = [f"axis{k}" for k in range(1, 7)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder like the reader's."""
    shutil.copytree(ROOT / "config", tmp_path / "config")
    shutil.copy(ROOT / "config" / "nominal_drive.yaml", tmp_path / "my_drive.yaml")
    shutil.copy(ROOT / "config" / "ros2_control.yaml", tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.corners(4)
@pytest.mark.parametrize("command", commands("test_commands.py"))
def test_the_node_starts(command: str, start: Callable[..., Process], peer: Peer, folder: Path) -> None:
    if "gains.yaml" in command:
        (folder / "gains.yaml").write_text(DESIGNED)
    command = command.replace("$(ros2 pkg prefix --share backlash_ros)", ".").replace("axis{1..6}", " ".join(AXES))
    name, *words = shlex.split(command)[3:]
    ros = words.index("--ros-args") if "--ros-args" in words else len(words)
    arguments = words[ros + 1 :]
    if name == "dashboard":  # another one may use the port that it has by default
        arguments += ["-p", "port:=0"]
    node = start(name, *arguments, non_ros=words[:ros])
    count = len(AXES) if "--axes" in words else 1
    peer.wait(lambda: f"the node, which said {node.output()}", lambda: ready(node) >= count)
    assert node.stop() == 0, node.output()


def ready(node: Process) -> int:
    return len(re.findall(READY, node.output(), re.MULTILINE))
