"""The drive contract kit judges drives: sound ones pass, each broken one fails by the name of the check for it."""

import math
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest
from broken_drive import DEFECTS
from broken_drive import RATE as BROKEN_RATE
from sensor_msgs.msg import JointState

from backlash_ros.contract.bench import Recording
from backlash_ros.contract.test_drive import not_finite

ROOT = Path(__file__).parents[2]
SIMULATOR = f"{sys.executable} -m backlash_ros.nodes.plant_simulator"
BROKEN = f"{sys.executable} {ROOT / 'test/support/broken_drive.py'} --defect"
OF_CURRENT = ["--command-interface", "current"]
OF_BROKEN = ["--drive-rate", str(BROKEN_RATE)]
CHECKS = 29
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
RESTS, FORWARD, BACK, RADIANS, VELOCITY = (
    {side: f"{check}[{side}]" for side in ("motor", "load")}
    for check in (
        "test_rests_without_command_and_at_zero",
        "test_positive_command_turns_forward",
        "test_negative_command_turns_back",
        "test_position_is_in_radians",
        "test_velocity_is_the_rate_of_the_position",
    )
)
OF_MOTOR, OF_LOAD = ([check[side] for check in (RESTS, FORWARD, BACK, RADIANS, VELOCITY)] for side in ("motor", "load"))
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

TAKE_CURRENT = [
    "sign_flipped",
    "degrees",
    "effort_in_amperes",
    "bang_bang",
    "holds_at_zero",
    "no_watchdog",
    "keeps_voltage_on_nan",
]
"""Broken drives that are tried with a current too."""

SOUND = {
    "simulator": [SIMULATOR],
    "simulator, current": [f"{SIMULATOR} --ros-args -p command_interface:=current", *OF_CURRENT],
    "none": [f"{BROKEN} none", *OF_BROKEN],
    "adapter": [f"{sys.executable} {ROOT / 'docs/examples/drive_adapter.py'}"],
}
BROKEN_DRIVES = {
    **{defect: [f"{BROKEN} {defect}", *OF_BROKEN] for defect in FAILS},
    **{
        f"{defect}, current": [f"{BROKEN} {defect} {' '.join(OF_CURRENT)}", *OF_BROKEN, *OF_CURRENT]
        for defect in TAKE_CURRENT
    },
}
"""Drive to its command line and the kit's further options."""


def expected_failures(drive: str) -> list[str]:
    return FAILS.get(drive.removesuffix(", current"), [])


class Verdict(NamedTuple):
    passed: set[str]
    failed: dict[str, str]
    output: str


def kit(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the kit as a user does, from a folder of no importance; -p, as the entry point may not be installed."""
    words = ["-p", "backlash_ros.contract.plugin", "--pyargs", "backlash_ros.contract", *arguments]
    return subprocess.run(
        [sys.executable, "-m", "pytest", *words],
        cwd=folder,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},  # other plugins take as long to load as a few moves
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )


def judge(folder: Path, command: str, *arguments: str) -> Verdict:
    done = kit(folder, "--junitxml=result.xml", "--drive-command", command, *arguments)
    failed, passed = {}, set()
    for case in ElementTree.parse(folder / "result.xml").iter("testcase"):
        name = case.get("name", "")
        faults = [fault.get("message", "") for kind in ("failure", "error") for fault in case.iter(kind)]
        if faults:
            failed[name] = faults[0]
        elif case.find("skipped") is None:
            passed.add(name)
    return Verdict(passed, failed, done.stdout + done.stderr)


@pytest.fixture(scope="module")
def verdicts(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future]]:
    """Judge the drives that tests of this run ask for, a few at a time: they wait more than they compute."""
    parameters = [getattr(item, "callspec", None) for item in request.session.items]
    asked = [p.params["drive"] for p in parameters if p and "drive" in p.params]

    def judged(drive: str) -> Verdict:
        command, *options = {**SOUND, **BROKEN_DRIVES}[drive]
        checks = " or ".join([f"not (test_stops or test_ends or {RATE})", *expected_failures(drive)])
        if drive in SOUND:
            checks = f"not {RATE}"
        return judge(tmp_path_factory.mktemp("kit"), command, *options, "-k", checks)

    with ThreadPoolExecutor(4) as pool:
        yield {drive: pool.submit(judged, drive) for drive in asked}


def test_simulator_keeps_its_rate(tmp_path: Path) -> None:
    verdict = judge(tmp_path, SIMULATOR, "-k", RATE)  # alone on the machine
    assert verdict.passed == {RATE}, verdict.output


@pytest.mark.parametrize("drive", SOUND)
def test_sound_drive_passes_every_other_check(drive: str, verdicts: dict[str, Future]) -> None:
    verdict = verdicts[drive].result()
    assert not verdict.failed, verdict.output
    assert len(verdict.passed) == CHECKS - 1 - NOT_MEASURED.get(drive, 0)


@pytest.mark.parametrize("drive", BROKEN_DRIVES)
def test_broken_drive_fails_the_check_that_is_meant_and_no_other(drive: str, verdicts: dict[str, Future]) -> None:
    verdict = verdicts[drive].result()
    assert sorted(verdict.failed) == sorted(expected_failures(drive)), verdict.output
    assert len(verdict.passed) >= 5


@pytest.mark.parametrize(
    ("field", "values", "fault"),
    [
        ("velocity", [math.nan, math.nan], ""),
        ("effort", [math.nan, math.nan], ""),
        ("velocity", [0.0, math.nan], "velocity of joint 'motor' is nan in 1 of 2 samples"),
        ("effort", [math.nan, 0.0], "effort of joint 'motor' is nan in 1 of 2 samples"),
        ("effort", [math.inf, math.inf], "effort of joint 'motor' is inf in 2 of 2 samples"),
        ("velocity", [math.nan, -math.inf], "velocity of joint 'motor' is nan in 2 of 2 samples"),
        ("position", [math.nan, math.nan], "position of joint 'motor' is nan in 2 of 2 samples"),
        ("position", [0.0, math.inf], "position of joint 'motor' is inf in 1 of 2 samples"),
    ],
)
def test_nan_throughout_a_velocity_or_an_effort_is_not_measured(field: str, values: list[float], fault: str) -> None:
    samples = [JointState(name=["load", "motor"], **{field: [0.0, value]}) for value in values]
    assert not_finite(Recording(samples, [0, 1], {}, reliable=True)) == fault


def test_every_defect_and_every_check_is_tried() -> None:
    assert set(FAILS) | {"none"} == set(DEFECTS)
    tried = {name for names in FAILS.values() for name in names}
    assert (
        len(tried) == CHECKS - 1
    )  # the drive that ignores SIGINT differs from the one that ignores SIGTERM in name only


def test_refuses_to_run_on_nothing(tmp_path: Path) -> None:
    done = kit(tmp_path)
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "the drive contract kit needs --drive-command" in done.stderr


def test_refuses_a_program_that_is_not_there(tmp_path: Path) -> None:
    done = kit(tmp_path, "--drive-command", "no_such_program --rate 250")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "no such program: 'no_such_program'" in done.stderr


def test_refuses_a_number_that_is_out_of_bounds(tmp_path: Path) -> None:
    done = kit(tmp_path, "--drive-command", "true", "--drive-rate", "-250")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "--drive-rate: must be a finite number > 0, got '-250'" in done.stderr


def test_says_that_the_drive_ended(tmp_path: Path) -> None:
    verdict = judge(tmp_path, "false")
    assert len(verdict.failed) == CHECKS
    assert "the drive ended with code 1 while the kit waited for publisher on /joint_states" in verdict.output


def test_is_not_collected_unless_a_drive_is_named(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-o", "addopts=", "backlash_ros"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED, done.stdout + done.stderr
