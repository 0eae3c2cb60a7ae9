"""MuJoCo plays drives of the population against the law of planned moves, which is quiet and precise there, too.

The servo, compiled as the node calls it, gets the samples of MuJoCo's plant; `test/nodes/test_mujoco_node.py` plays one
of the drives against the node itself, which over DDS would take too long for all. The servo knows each drive, and so
does MuJoCo: the export of docs/simulators.md, whose teeth are not those of our simulator. Judged as docs/evaluation.md
says. With one encoder, the relay tells the gap in MuJoCo, too, or refuses.
"""

from importlib.util import find_spec

import numpy as np
import pytest

if find_spec("mujoco") is None:
    pytest.skip("MuJoCo is not installed here; the locks in requirements have it", allow_module_level=True)

from mujoco_servo import HAS_DC_MOTOR, SEED, MujocoServoDrive, known, of_steel

from backlash_ros.control import Servo
from backlash_ros.control.experiment import BacklashEstimate
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.simulation import SimulatedDrive, excite
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.evaluation.task import first_reading, settings_for, true_reading
from backlash_ros.studies.judging import PRECISE, QUIET, judge_move, threshold

pytestmark = [
    pytest.mark.population,
    pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor"),
]

DRIVES = 10
HOLD, MOVE = 0.5, 2.5
"""Lengths of the parts, s; swing and error are those of the last second."""


def judged(member: Member, plant: SimulatedDrive) -> tuple[bool, bool]:
    """Play a hold, a step of 1 rad and one of 5 b; return whether both steps are quiet, and precise."""
    servo, b, count = Servo(member.drive, known(member)), member.drive.gear.backlash_angle, member.load_count

    def run(seconds: float) -> np.ndarray:
        angles = []
        for _ in range(round(seconds * member.rate)):
            angles.append(float(plant.state[THETA_L]))
            plant.advance(servo.update(plant.sample(), plant.elapsed), member.load_torque)
        return true_reading(member, np.array(angles))

    run(HOLD)
    quiet = precise = True
    reference = first_reading(member)
    for way in (1.0, 5.0 * b):
        reference += way
        assert servo.set_reference(reference) == ""
        position = run(MOVE)
        move = judge_move(np.arange(position.size) / member.rate, position, reference, b, count)
        quiet &= move.swing <= threshold(QUIET, b, count)
        precise &= move.error <= threshold(PRECISE, b, count)
    assert servo.fault == ""
    return quiet, precise


@pytest.mark.corners(1)
@pytest.mark.parametrize("number", range(DRIVES))
def test_it_is_quiet_and_precise_in_mujoco_as_in_our_simulator(number: int) -> None:
    member = draw_member(SEED, number, "core")
    ours = SimulatedDrive(member.drive, 1.0 / member.rate, sensors=member.sensors, delay=member.delay)
    here, there = judged(member, ours), judged(member, MujocoServoDrive(member))
    assert here == (True, True)
    assert there == (True, True)


LEARNED = [("load", 0)]
"""A gap 35 % too wide was told of it, by 3.5 standard uncertainties, before free teeth began like steel, too."""
OTHERS = [(encoder, k) for encoder in ("load", "motor") for k in range(12) if of_steel(k).can_outrun]


@pytest.mark.parametrize(
    ("encoder", "number"), [*LEARNED, *(pytest.param(*each, marks=pytest.mark.grid) for each in OTHERS[1:])]
)
def test_one_encoder_tells_the_gap_between_teeth_of_steel_or_refuses(encoder: str, number: int) -> None:
    member = of_steel(number, encoder)
    model = told_model(member, "identified")
    servo = Servo(model, settings_for(model, member, 0.0))
    estimate = excite(servo, MujocoServoDrive(member), "relay", load_torque=member.load_torque)
    assert isinstance(estimate, BacklashEstimate)
    assert estimate.valid or (encoder, number) not in LEARNED
    if estimate.valid:
        assert abs(estimate.angle - member.drive.gear.backlash_angle) < 2.0 * estimate.uncertainty
