"""The configuration of docs/real_drive.md, as it stands there, against what ros2_control puts before a drive."""

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from graph import Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from ros2_control import Ros2Control
from std_msgs.msg import Float64

from backlash_ros.drivetrain import NOMINAL_DRIVE

Start = Callable[..., Process]
ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "real_drive.md").read_text()
CONFIG = yaml.safe_load((ROOT / "config" / "ros2_control.yaml").read_text())


def urdf() -> ElementTree.Element:
    """The guide's <ros2_control> tag."""
    (tag,) = re.findall(r"<ros2_control .*?</ros2_control>", GUIDE, re.DOTALL)
    return ElementTree.fromstring(tag)


def interfaces(kind: str) -> dict[str, tuple[str, ...]]:
    """Joint to the interfaces of that kind which the guide's URDF gives it."""
    return {
        joint.attrib["name"]: tuple(element.attrib["name"] for element in joint.findall(kind))
        for joint in urdf().findall("joint")
    }


def controller_arguments() -> list[str]:
    """What the guide starts the controller with."""
    (line,) = re.findall(r"^ros2 run backlash_ros controller (.*ros2_control\.yaml.*)$", GUIDE, re.MULTILINE)
    return shlex.split(line)


@pytest.fixture(params=["voltage", pytest.param("current", marks=pytest.mark.grid)])
def control(start: Start, peer: Peer, tmp_path: Path, request: pytest.FixtureRequest) -> Ros2Control:
    """The guide's configuration, and the same one with the other interface; the controller answers."""
    config = tmp_path / "ros2_control.yaml"
    text = (ROOT / "config" / config.name).read_text()
    config.write_text(re.sub(r"(interface(?:_name)?:) voltage", rf"\1 {request.param}", text))
    files = {"my_drive.yaml": ROOT / "config" / "nominal_drive.yaml", config.name: config}
    words = [str(files.get(word, word)) for word in controller_arguments()]
    assert words.pop(0) == "--ros-args"
    made = Ros2Control(
        peer, config, interfaces("state_interface"), replace(NOMINAL_DRIVE, command_interface=request.param)
    )
    start("controller", *words, "-p", "controller:state_timeout:=10.0")  # the test may be slow
    lifecycle = Lifecycle(peer, "controller")
    assert lifecycle.change(Transition.TRANSITION_CONFIGURE)
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    made.matched()
    assert made.interface == f"motor/{request.param}"
    assert Parameters(peer, "controller").get("command_interface") == [request.param]
    return made


def test_names_of_file_and_urdf_fit() -> None:
    forward = CONFIG["motor_controller"]["ros__parameters"]
    controller = CONFIG["/**/controller"]["ros__parameters"]
    assert forward["joints"] == [controller["motor_joint"]]
    assert forward["interface_name"] == controller["command_interface"]
    assert CONFIG["joint_state_broadcaster"]["ros__parameters"]["update_rate"] == controller["rate"]
    assert interfaces("command_interface") == {
        controller["motor_joint"]: (controller["command_interface"],),
        "load": (),
    }
    assert all("position" in names for names in interfaces("state_interface").values())


def test_sample_is_as_joint_state_broadcaster_has_it(peer: Peer) -> None:
    made = Ros2Control(peer, ROOT / "config" / "ros2_control.yaml", interfaces("state_interface"), NOMINAL_DRIVE)
    sample = made.sample()
    assert list(sample.name) == ["gripper", "load", "motor"]
    assert np.isnan(sample.effort).tolist() == [True, True, False]


@pytest.mark.grid
def test_learns_and_lands_a_step_behind_ros2_control(control: Ros2Control, peer: Peer) -> None:
    answer = peer.request("learn")
    while not answer.done():
        control.step()
        assert control.samples < 50_000
    assert answer.result().success, answer.result().message
    (learned,) = Parameters(peer, "controller").get("backlash_angle")
    assert learned == pytest.approx(0.02, rel=0.02)

    reference = peer.node.create_publisher(Float64, "reference", 1)
    peer.wait("the controller", lambda: reference.get_subscription_count() > 0)
    angles = []
    for _ in range(750):
        reference.publish(Float64(data=1.0))  # again and again: one may be lost
        control.step()
        angles.append(control.plant.load_angle)
    assert max(angles) < 1.0 + 0.5 * 0.02
    assert np.all(np.abs(np.array(angles[-250:]) - 1.0) < 0.1 * 0.02)
