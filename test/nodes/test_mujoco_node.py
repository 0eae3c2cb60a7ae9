"""MuJoCo plays drives of the population against the controller node, over DDS in lockstep.

One that the node knows: `test/unit/test_mujoco_servo.py` plays ten against the same compiled servo without the node.
Ten of which it knows the data sheet go from unknown to quiet, and ten more with each encoder alone.
"""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import yaml
from data_sheet import Rig
from graph import Peer, Process
from lockstep_drive import LockstepDrive

if find_spec("mujoco") is None:
    pytest.skip("MuJoCo is not installed here; the locks in requirements have it", allow_module_level=True)

from mujoco_servo import HAS_DC_MOTOR, SEED, MujocoServoDrive, of_steel

from backlash_ros.drivetrain.parameters import values_of
from backlash_ros.studies.evaluation.population import draw_member
from backlash_ros.studies.evaluation.task import GAP_NEAR, STAND, first_reading, true_reading
from backlash_ros.studies.judging import PRECISE, QUIET, judge_move, threshold

NUMBER = 0
"""At 250 Hz, with friction on the load and a delay of half a period."""
OUTRUN = [number for number in range(12) if of_steel(number).can_outrun]
"""Drives whose far flank the motor can reach."""
UNSURE = 0.12
"""Share of a gap that one encoder tells by which it may be off: its largest standard uncertainty."""
RATTLES = pytest.mark.xfail(
    reason="it is learned and precise, and swings by 0.09 b, where 0.05 b are quiet", strict=True
)


@pytest.mark.grid
@pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor")
def test_the_node_is_quiet_and_precise_in_mujoco(start: Callable[..., Process], peer: Peer, tmp_path: Path) -> None:
    """A step of 1 rad of a drive that the node knows, sooner than the over-damped gains could."""
    member = draw_member(SEED, NUMBER, "core")
    b, count = member.drive.gear.backlash_angle, member.load_count
    file = tmp_path / "drive.yaml"
    known = {"loop_delay": member.delay.mean, "backlash_angle": b, "identified": True, "law": "planned"}
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


@pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor")
@pytest.mark.grid
@pytest.mark.parametrize("number", [pytest.param(k, marks=RATTLES if k == 11 else []) for k in OUTRUN])
def test_a_drive_of_mujoco_goes_from_unknown_to_quiet(rig: Callable[..., Rig], number: int) -> None:
    member = of_steel(number)
    b, count = member.drive.gear.backlash_angle, member.load_count
    made = rig(member, plant=MujocoServoDrive(member))
    answer = made.drive.call("identify")
    assert answer.success, answer.message
    assert made.in_use()["backlash_angle"] == pytest.approx(b, abs=max(GAP_NEAR * b, count))
    made.drive.run(round(STAND * member.rate))  # the load rattled before, so it comes to rest first
    time, position = made.step(1.0, 4.0)
    move = judge_move(time, position, made.start + 1.0, b, count)
    assert move.swing <= threshold(QUIET, b, count)
    assert move.error <= threshold(PRECISE, b, count)


@pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor")
@pytest.mark.grid
@pytest.mark.parametrize("number", OUTRUN)
@pytest.mark.parametrize("encoders", ["load", "motor"])
def test_with_one_encoder_it_is_learned_or_refused_and_quiet(
    rig: Callable[..., Rig], encoders: str, number: int
) -> None:
    member = of_steel(number, encoders)
    b, count = member.drive.gear.backlash_angle, member.load_count
    made = rig(member, plant=MujocoServoDrive(member))
    answer = made.drive.call("identify")
    known = made.in_use()
    # A gap may be told with a friction that is not sure enough to plan moves.
    assert answer.success or not known["identified"]
    if answer.success:
        assert known["backlash_angle"] == pytest.approx(b, abs=UNSURE * b)
    else:
        assert answer.message.startswith("nothing was identified: ")
    made.drive.run(round(STAND * member.rate))
    time, position = made.step(1.0, 4.0)
    move = judge_move(time, position, made.start + 1.0, b, count)
    assert move.swing <= threshold(QUIET, b, count)
