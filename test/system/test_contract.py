"""The drive contract kit judges drives: sound ones pass, each broken one fails by the name of the check for it."""

import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from broken_drive import DEFECTS
from broken_drive import RATE as BROKEN_RATE
from kit import CHECKS, Verdict, judge

ROOT = Path(__file__).parents[2]
SIMULATOR = f"{sys.executable} -m backlash_ros.nodes.plant_simulator"
BROKEN = f"{sys.executable} {ROOT / 'test/support/broken_drive.py'} --defect"
OF_CURRENT = ["--command-interface", "current"]
OF_BROKEN = ["--drive-rate", str(BROKEN_RATE)]
NOT_MEASURED = {"adapter": 3}
"""Checks that a drive without velocity and effort skips."""

RELIABLE = "test_joint_states_are_published_reliably"
NAMES = "test_samples_name_the_joints"
ARRAYS = "test_arrays_fit_the_names"
FINITE = "test_values_are_finite"
RATE = "test_rate"
ONCE = "test_each_sample_is_published_once"
INCREASE = "test_stamps_increase"
NOW = "test_stamps_are_of_now"
RESTS, FORWARD, BACK, RADIANS, GOES_ON, VELOCITY = (
    {side: f"{check}[{side}]" for side in ("motor", "load")}
    for check in (
        "test_rests_without_command_and_at_zero",
        "test_positive_command_turns_forward",
        "test_negative_command_turns_back",
        "test_position_is_in_radians",
        "test_position_goes_on_beyond_a_turn",
        "test_velocity_is_the_rate_of_the_position",
    )
)
OF_MOTOR, OF_LOAD = (
    [check[side] for check in (RESTS, FORWARD, BACK, RADIANS, GOES_ON, VELOCITY)] for side in ("motor", "load")
)
SEEN_BY_CHANCE = {*GOES_ON.values()}
"""Checks that are skipped unless the drive moves far enough."""
RATIO = "test_load_travels_gear_ratio_times_the_motor"
EFFORT = "test_motor_effort_is_its_torque"
DOUBLE = "test_double_command_is_faster"
ZERO = "test_zero_command_slows_down"
EXTRAS = "test_stamp_and_further_elements_are_no_obstacle"
SILENCE = "test_stops_when_commands_stop"
NAN, INF, EMPTY = (f"test_stops_on_a_bad_command[{bad}]" for bad in ("nan", "inf", "empty"))
SIGTERM = "test_ends_on_a_signal[SIGTERM]"
FAILS = {
    "best_effort": [RELIABLE],
    "wrong_names": [NAMES, *OF_MOTOR, *OF_LOAD, RATIO, EFFORT, DOUBLE, ZERO, EXTRAS],
    "motor_twice": [NAMES],
    "missing_positions": [ARRAYS, *OF_LOAD, RATIO],
    "missing_velocities": [ARRAYS],
    "missing_efforts": [ARRAYS],
    "nan_in_states": [FINITE],
    "half_rate": [RATE],
    "drops_samples": [RATE],
    "bursts": [RATE],
    "extra_samples": [RATE],
    "double_publishing": [ONCE],
    "frozen_stamps": [INCREASE, NOW],
    "stamps_backward": [INCREASE],
    "stamps_since_start": [NOW],
    "stamps_ahead": [NOW],
    "creeps": [*RESTS.values()],
    "sign_flipped": [*FORWARD.values(), *BACK.values(), EFFORT],
    "load_sign_flipped": [FORWARD["load"], BACK["load"], RATIO],
    "load_before_gear": [RADIANS["load"], RATIO],
    "degrees": [*RADIANS.values()],
    "revolutions": [*RADIANS.values()],
    "load_wraps": [GOES_ON["load"]],
    "velocity_in_rpm": [*VELOCITY.values()],
    "effort_in_amperes": [EFFORT],
    "effort_sign_flipped": [EFFORT],
    "bang_bang": [DOUBLE],
    "holds_at_zero": [ZERO],
    "strict_length": [EXTRAS],
    "no_watchdog": [SILENCE],
    "keeps_voltage_on_nan": [NAN, INF],
    "spreads_nan": [NAN, INF],
    "full_voltage_on_inf": [INF],
    "dies_on_empty_command": [EMPTY],
    "ignores_sigterm": [SIGTERM],
    "leaves_child": [SIGTERM],
}
"""Broken drive to the checks that it fails; it passes the others that look at the recording.

The rate is judged only where it is meant: that of several drives at a time on a shared machine is no claim.
"""

TAKE_CURRENT = ["effort_in_amperes", "no_watchdog"]
"""Broken drives that are tried with a current too."""

SOUND = {
    "simulator": [SIMULATOR],
    "simulator, current": [f"{SIMULATOR} --ros-args -p command_interface:=current", *OF_CURRENT],
    "none": [f"{BROKEN} none", *OF_BROKEN, "--whole-turn"],
    "adapter": [f"{sys.executable} {ROOT / 'docs/examples/drive_adapter.py'}"],
}
BROKEN_DRIVES = {
    **{defect: [f"{BROKEN} {defect}", *OF_BROKEN] for defect in FAILS},
    "load_wraps": [f"{BROKEN} load_wraps", *OF_BROKEN, "--whole-turn"],
    **{
        f"{defect}, current": [f"{BROKEN} {defect} {' '.join(OF_CURRENT)}", *OF_BROKEN, *OF_CURRENT]
        for defect in TAKE_CURRENT
    },
}
"""Drive to its command line and the kit's further options."""

FEW = {"simulator", "degrees", "no_watchdog"}
"""Drives that are judged with every change; the others are a grid."""


def cases(drives: Iterable[str]) -> list[Any]:
    return [pytest.param(drive, marks=[] if drive in FEW else pytest.mark.grid) for drive in drives]


def expected_failures(drive: str) -> list[str]:
    return FAILS.get(drive.removesuffix(", current"), [])


@pytest.fixture(scope="module")
def verdicts(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future]]:
    """Judge the drives that tests of this run ask for, two at a time, while tests that need none go on."""
    parameters = [getattr(item, "callspec", None) for item in request.session.items]
    asked = [p.params["drive"] for p in parameters if p and "drive" in p.params]

    def judged(drive: str) -> Verdict:
        command, *options = {**SOUND, **BROKEN_DRIVES}[drive]
        checks = " or ".join([f"not (test_stops or test_ends or {RATE})", *expected_failures(drive)])
        if drive in SOUND:
            checks = f"not {RATE}"
        meant = sorted(expected_failures(drive))
        for _ in range(2):  # once more where the verdict is another one: this machine may have stood still
            verdict = judge(tmp_path_factory.mktemp("kit"), command, *options, "-k", checks)
            if sorted(verdict.failed) == meant:
                break
        return verdict

    with ThreadPoolExecutor(2) as pool:
        yield {drive: pool.submit(judged, drive) for drive in asked}


def test_simulator_keeps_its_rate(tmp_path: Path) -> None:
    verdict = judge(tmp_path, SIMULATOR, "-k", RATE)  # alone on the machine
    assert verdict.passed == {RATE}, verdict.output


@pytest.mark.parametrize("drive", cases(SOUND))
def test_sound_drive_passes_every_other_check(drive: str, verdicts: dict[str, Future]) -> None:
    verdict = verdicts[drive].result()
    assert not verdict.failed, verdict.output
    assert len(verdict.passed - SEEN_BY_CHANCE) == CHECKS - 3 - NOT_MEASURED.get(drive, 0)
    assert drive != "none" or verdict.passed >= SEEN_BY_CHANCE


@pytest.mark.parametrize("drive", cases(BROKEN_DRIVES))
def test_broken_drive_fails_the_check_that_is_meant_and_no_other(drive: str, verdicts: dict[str, Future]) -> None:
    verdict = verdicts[drive].result()
    assert sorted(verdict.failed) == sorted(expected_failures(drive)), verdict.output
    assert len(verdict.passed) >= 5


def test_every_defect_and_every_check_is_tried() -> None:
    assert set(FAILS) | {"none"} == set(DEFECTS)
    tried = {name for names in FAILS.values() for name in names}
    assert (
        len(tried) == CHECKS - 1
    )  # the drive that ignores SIGINT differs from the one that ignores SIGTERM in name only
