"""~/identify over DDS: a drive drawn at random is found, its parameters are in use, and it is quiet from then on."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from data_sheet import FAULTS, NAMES, OTHERS, Rig, Start
from diagnostic_msgs.msg import DiagnosticArray
from graph import Parameters, Peer

from backlash_ros.control import DEFAULT_WEIGHTS, FaultThresholds, design_gains
from backlash_ros.control.estimates import DriveIdentity, parse
from backlash_ros.control.laws.planned.memory import PHASES
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.parameters import FOUND, drive_of
from backlash_ros.studies.evaluation.population import draw_member
from backlash_ros.studies.evaluation.task import DELAY_NEAR, EFFORT_NEAR, GAP_NEAR, INERTIA_NEAR, SPEEDS, STAND
from backlash_ros.studies.judging import OVERSHOOT, PRECISE, QUIET, judge_move, threshold

SEED = 20261122


@pytest.mark.grid  # the demo identifies a drive, too
def test_a_random_drive_is_found_and_quiet_from_then_on_and_at_the_next_start(
    rig: Callable[..., Rig], peer: Peer, tmp_path: Path
) -> None:
    member = draw_member(SEED, 16, "full")
    file = tmp_path / "estimates.yaml"
    made = rig(member, learning__estimate_file=file)
    told, progress = made.in_use(), list[float]()

    def hear(message: DiagnosticArray) -> None:
        state = {entry.key: float(entry.value) for entry in message.status[0].values}
        progress.extend([state["progress"]] if state["experiment"] else [])

    peer.node.create_subscription(DiagnosticArray, "controller/state", hear, 100)
    answer = made.drive.call("identify")
    assert answer.success, answer.message
    assert progress == sorted(progress)
    assert progress[-1] > 0.3
    found = made.in_use()
    # What is set is near the truth, by the tolerances of the evaluation.
    drive, load = member.drive, member.drive.load
    gap = drive.gear.backlash_at(0.0)
    assert found["load.inertia"] == pytest.approx(load.inertia, rel=INERTIA_NEAR)
    assert found["backlash_angle"] == pytest.approx(gap, abs=max(GAP_NEAR * gap, member.load_count))
    assert found["gear.backlash_angle"] == found["backlash_angle"]
    assert found["expected_load_torque"] == pytest.approx(member.standing_torque, abs=5e-3)
    assert (told["identified"], found["identified"]) == (False, True)
    assert found["loop_delay"] == pytest.approx(member.delay.command, abs=DELAY_NEAR / member.rate)
    for speed in SPEEDS:
        effort = found["load.viscous_friction"] * speed + found["load.coulomb_friction"]
        assert effort == pytest.approx(load.viscous_friction * speed + load.coulomb_friction, rel=EFFORT_NEAR)
    # What follows from it is in use: gains, thresholds; what is no finding is as told.
    model = drive_of(found)
    for region, weights in DEFAULT_WEIGHTS.items():
        designed = design_gains(region, model, weights).as_array()
        np.testing.assert_allclose(found[f"gains.{region}.k"], designed, rtol=1e-9)
    assert found["gains.fast.k"] != told["gains.fast.k"]
    thresholds = FaultThresholds.of(model)
    assert [found[name] for name in FAULTS] == [thresholds.velocity, thresholds.load_torque, thresholds.gap]
    assert {name for name in NAMES if told[name] != found[name]} <= {
        *OTHERS,
        *(n for n in NAMES if n.startswith(FOUND)),
    }
    assert all(text in answer.message for text in ("J_l = ", "b = ", "tau_l", "delay", "offset"))
    (kept,) = parse(file.read_bytes(), DriveIdentity("/controller", "motor", "load", drive.gear.reduction)).estimates
    assert kept.applied
    assert dict(kept.parameters) == {name: found[name] for name in kept.parameters}
    assert kept.uncertainties["load.inertia"] > 0.0
    # And the drive is quiet with it, as evaluated: the load rattled before, so it comes to rest first.
    made.drive.run(round(STAND * member.rate))
    time, position = made.step(0.5, 6.0)
    b, count = drive.gear.backlash_angle, member.load_count
    move = judge_move(time, position, made.start + 0.5, b, count)
    assert move.swing <= threshold(QUIET, b, count)
    assert move.error <= threshold(PRECISE, b, count)
    assert move.overshoot <= threshold(OVERSHOOT, b, count)
    # The next start has it from the file, with all that follows from it.
    assert made.process.stop() == 0
    again = rig(member, learning__estimate_file=file, learning__use_estimate_file=True)
    assert again.in_use() == found


@pytest.mark.grid  # test_identify_experiment.py has it offline
@pytest.mark.parametrize(("encoder", "number"), [("load", 4), ("motor", 5)])
def test_one_encoder_is_enough_from_unknown_to_quiet(rig: Callable[..., Rig], encoder: str, number: int) -> None:
    """Identified by the relay: the default law plans its move with that encoder alone, lands and rests.

    Drive 4 has a load too light to be seen from the motor.
    """
    member = draw_member(SEED, number, "core", encoder)
    made = rig(member)
    answer = made.drive.call("identify")
    assert answer.success, answer.message
    found, drive, gap = made.in_use(), member.drive, member.drive.gear.backlash_at(0.0)
    assert found["identified"]
    assert found["backlash_angle"] == pytest.approx(gap, rel=GAP_NEAR)
    assert found["load.inertia"] == pytest.approx(drive.load.inertia, rel=INERTIA_NEAR)
    assert "K_m" not in answer.message  # one encoder does not show it
    assert answer.message.endswith("; law planned acts")
    made.drive.run(round(STAND * member.rate))
    time, position = made.step(0.5, 3.0)
    move = judge_move(time, position, made.start + 0.5, gap, member.load_count)
    assert move.swing <= threshold(QUIET, gap, member.load_count)
    assert move.error <= threshold(PRECISE, gap, member.load_count)
    assert "law 'auto' is 'planned'" in made.process.output()


@pytest.mark.grid  # the demo shows it, too
def test_from_unknown_to_quiet_with_the_law_of_planned_moves(rig: Callable[..., Rig], peer: Peer) -> None:
    """Learned and identified by services, the law by parameter: it plans its move, lands and rests."""
    member = draw_member(SEED, 2, "core")
    made = rig(member)
    for service in ("learn", "identify"):
        answer = made.drive.call(service)
        assert answer.success, answer.message
    assert made.parameters.set(law="planned") == (True, "")
    phases = list[str]()

    def hear(message: DiagnosticArray) -> None:
        phases.extend(PHASES.get(int(float(v.value)), "") for v in message.status[0].values if v.key == "phase")

    peer.node.create_subscription(DiagnosticArray, "controller/state", hear, 1000)
    time, position = made.step(1.0, 3.0)
    b, count = member.drive.gear.backlash_angle, member.load_count
    move = judge_move(time, position, made.start + 1.0, b, count)
    assert move.swing <= threshold(QUIET, b, count)
    assert move.error <= threshold(PRECISE, b, count)
    assert "flight" in phases
    assert phases[-1] == "hold"


@pytest.mark.grid  # test_applying.py has it by unit, test_estimates.py with another experiment
def test_with_ask_it_is_offered_and_applied_together(rig: Callable[..., Rig]) -> None:
    made = rig(draw_member(SEED, 1, "core"), learning__apply="ask")
    told = made.in_use()
    answer = made.drive.call("identify")
    assert answer.success, answer.message
    assert answer.message.endswith("; call apply_estimate to use it")
    assert made.in_use() == told
    applied = made.drive.call("apply_estimate")
    assert applied.success, applied.message
    assert "load.inertia = " in applied.message
    found = made.in_use()
    assert found["load.inertia"] == pytest.approx(made.member.drive.load.inertia, rel=INERTIA_NEAR)
    assert found["gains.fast.k"] != told["gains.fast.k"]


@pytest.mark.grid  # test_applying.py has it by unit
def test_what_would_make_the_design_refuse_is_refused_with_the_reason_and_changes_nothing(
    rig: Callable[..., Rig],
) -> None:
    """Gains that a user gave as numbers would be unstable with the delay that is found."""
    member = replace(draw_member(SEED, 4, "core"), load_torque=0.0)
    member = replace(member, delay=replace(member.delay, command=0.008))
    sets = {"gain_sets__hard__fast__k": "[150.0, 0.9, 0.1]", "gain_sets__hard__overdamped__q": "[4.0, 0.0]"}
    made = rig(member, gain_set_names="[nominal, hard]", **sets)
    told = made.in_use()
    answer = made.drive.call("identify")
    assert not answer.success
    why = "but it was refused: gain_sets.hard.fast.k = [150, 0.9, 0.1] is unstable at 250 Hz with a delay of 0.00"
    assert why in answer.message
    assert made.in_use() == told


def test_a_drive_is_told_by_hand_while_it_moves(rig: Callable[..., Rig]) -> None:
    """All or nothing, between two samples, as gains are; the simulator's own stays as it is."""
    made = rig(replace(draw_member(SEED, 4, "core"), load_torque=0.0))
    told = made.in_use()
    for changes, says in (
        ({"load__inertia": -1.0}, "load.inertia must be >= 1e-09 kg m^2 and <= 100000 kg m^2, got -1.0"),
        ({"load__inertia": math.nan}, "load.inertia must be >= 1e-09 kg m^2 and <= 100000 kg m^2, got nan"),
        ({"loop_delay": 0.05}, "loop_delay must be >= 0 s and <= 0.04 s, got 0.05"),
        ({"loop_delay": 0.04, "gains__fast__k": told["gains.fast.k"]}, "gains.fast.k = "),
        (
            {"contact__law": "glue"},
            "contact.law must be one of ['elastic', 'hunt_crossley', 'power', 'power_no_pull', 'restitution']",
        ),
        ({"contact__power__exponent": 20}, "contact.power.exponent must be an odd"),
        ({"motor__inertia": 1.0}, "motor.inertia is read-only"),
        ({"gear__reduction": 1.0}, "gear.reduction is read-only"),
        ({"gains__fast__k": [1e5, 0.0, 0.0]}, "gains.fast.k = [100000, 0, 0] is unstable"),
    ):
        accepted, reason = made.parameters.set(load__coulomb_friction=0.01, **changes)
        assert (accepted, reason[: len(says)]) == (False, says)
        assert made.in_use() == told
    made.drive.set_reference(made.start + 0.5)
    made.drive.run(8)
    before, unmoved = made.drive.step(), made.in_use()
    accepted, reason = made.parameters.set(load__inertia=1e3 * told["load.inertia"])
    assert not accepted
    assert reason.startswith(
        "load.inertia must change the inertia at the output by a factor of 3 at most while the load"
    )
    assert made.in_use() == unmoved == told
    inertia = 1.3 * told["load.inertia"]
    assert made.parameters.set(load__inertia=inertia, load__coulomb_friction=0.01) == (True, "")
    limit = made.member.drive.motor.voltage_limit
    assert abs(made.drive.step() - before) < 0.2 * limit
    now = made.in_use()
    assert (now["load.inertia"], now["load.coulomb_friction"], now["gain_set"]) == (inertia, 0.01, "nominal")
    assert now["gains.fast.k"] != told["gains.fast.k"]
    made.drive.run(1500)
    rest = made.drive.run(250)
    assert np.ptp(rest) < made.member.drive.gear.backlash_angle


def test_thresholds_follow_the_drive_unless_they_were_given(start: Start, peer: Peer) -> None:
    start("controller", faults__velocity=200.0, gear__backlash_angle=0.03)
    parameters = Parameters(peer, "controller")
    drive = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, backlash_angle=0.03))
    before = FaultThresholds.of(drive)
    assert parameters.get(*FAULTS) == [200.0, before.load_torque, before.gap]
    wide = replace(drive, gear=replace(drive.gear, backlash_angle=0.09))
    assert parameters.set(gear__backlash_angle=0.09) == (True, "")
    after = FaultThresholds.of(wide)
    assert after.gap > before.gap
    assert parameters.get(*FAULTS) == [200.0, after.load_torque, after.gap]
    assert parameters.set(gear__backlash_angle=0.03, faults__gap=0.4) == (True, "")
    assert parameters.get(*FAULTS) == [200.0, before.load_torque, 0.4]
