"""What the drive contract kit does where no drive runs: options, a drive that ends, samples that are not finite."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
from kit import judge, kit
from sensor_msgs.msg import JointState

from backlash_ros.contract.bench import Recording, described
from backlash_ros.contract.test_drive import not_finite

ROOT = Path(__file__).parents[2]


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


@pytest.mark.grid
def test_says_that_the_drive_ended(tmp_path: Path) -> None:
    verdict = judge(tmp_path, "false", "-k", "joints")
    assert list(verdict.failed) == ["test_samples_name_the_joints"]
    assert "the drive ended with code 1 while the kit waited for publisher on /joint_states" in verdict.output


def test_is_not_collected_unless_a_drive_is_named(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-o", "addopts=", "backlash_ros"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED, done.stdout + done.stderr


def test_parameter_file_describes_the_drive_and_options_override_it(tmp_path: Path) -> None:
    file = tmp_path / "my_drive.yaml"
    motor = "{torque_constant: 0.1, resistance: 0.5, inertia: 1.0e-4}"
    parameters = f"rate: 500.0, load_joint: arm, command_interface: current, motor: {motor}, gear: {{reduction: 100.0}}"
    file.write_text(f"/**: {{ros__parameters: {{{parameters}, load: {{inertia: 1.0}}}}}}\n")
    told = described([file], "true", value=None, command_timeout=0.1, motor_joint="")
    assert (told.gear_ratio, told.torque_constant, told.resistance) == (0.01, 0.1, 0.5)
    assert told.inertia == pytest.approx(2e-4)
    assert (told.rate, told.joints, told.unit, told.value) == (500.0, ["arm"], "A", 0.05)
    assert described([file], "true", value=2.0, command_timeout=0.1, rate=250.0).rate == 250.0


def test_refuses_a_parameter_file_that_it_cannot_use(tmp_path: Path) -> None:
    file = tmp_path / "my_drive.yaml"
    file.write_text("/**: {ros__parameters: {gear: {reduction: -10.0}}}\n")
    done = kit(tmp_path, "--drive-command", "true", "--params-file", str(file))
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "gear.reduction must be" in done.stderr
