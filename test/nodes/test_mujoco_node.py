"""MuJoCo plays a drive of the population against the controller node, over DDS in lockstep.

One drive: `test/unit/test_mujoco_servo.py` plays ten against the same compiled servo without the node.
"""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import yaml
from graph import Peer, Process
from lockstep_drive import LockstepDrive

if find_spec("mujoco") is None:
    pytest.skip("MuJoCo is not installed here; the locks in requirements have it", allow_module_level=True)

from mujoco_servo import HAS_DC_MOTOR, SEED, MujocoServoDrive

from backlash_ros.analysis.evaluation.population import draw_member
from backlash_ros.analysis.evaluation.task import first_reading, true_reading
from backlash_ros.analysis.judging import PRECISE, QUIET, judge_move, threshold
from backlash_ros.drivetrain.parameters import values_of

NUMBER = 0
"""At 250 Hz, with friction on the load and a delay of half a period."""


@pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor")
def test_the_node_is_quiet_and_precise_in_mujoco(start: Callable[..., Process], peer: Peer, tmp_path: Path) -> None:
    """A step of 1 rad of a drive that the node knows, sooner than the over-damped gains could."""
    member = draw_member(SEED, NUMBER, "core")
    b, count = member.drive.gear.backlash_angle, member.load_count
    file = tmp_path / "drive.yaml"
    known = {"loop_delay": member.delay.mean, "backlash_angle": b, "identified": True, "law": "two_encoder"}
    values = {**values_of(member.drive), **known, "rate": member.rate, "state_timeout": 10.0}
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
    start("controller", "--params-file", str(file))
    drive = LockstepDrive(peer, member.rate, simulated=MujocoServoDrive(member)).matched()
    drive.load_torque = member.load_torque
    drive.run(round(0.5 * member.rate))
    target, before = first_reading(member) + 1.0, drive.load_angle
    drive.set_reference(target)
    position = true_reading(member, np.array([before, *drive.run(round(2.5 * member.rate))]))
    move = judge_move(np.arange(position.size) / member.rate, position, target, b, count)
    assert move.swing <= threshold(QUIET, b, count)
    assert move.error <= threshold(PRECISE, b, count)
    assert move.settle <= 0.5
