"""A control law, a contact law and an experiment, each added as one new file from a folder of its own."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from backlash_ros.control import EXPERIMENTS, LAWS, GainSet, Limits, Servo, ServoSettings
from backlash_ros.control import laws as laws_room
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.registry import Registry
from backlash_ros.foundation.signals import POSITION, Measurement
from backlash_ros.simulation import Scenario, run, run_experiment

LAW = '''"""Proportional control of the load's angle with a brake on its speed: two parameters."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, ControlLaw, NamedLaw
from backlash_ros.foundation.quantity import quantity
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.signals import OMEGA_L, POSITION, THETA_L


@dataclass(frozen=True)
class BrakeParameters(Validated):
    section: ClassVar[str] = "laws.brake"

    stiffness: float = quantity("gain on the error", "V/rad", above=0, at_most=1e3, default=10.0)
    brake: float = quantity("gain on the speed", "V s/rad", at_least=0, at_most=1e3, default=SLOPE)


@compiled_as(LAW_SIGNATURE)
def step(law, state, estimate, path, low, high):
    voltage = law[0] * (path[0, POSITION] - estimate[THETA_L]) - law[1] * estimate[OMEGA_L]
    return clamp(voltage, low, high)


def design(drive, settings, parameters):
    return ControlLaw(step, np.array([parameters.stiffness, parameters.brake]), np.array([float(FAST_REGION)]))


LAWS = {"NAME": NamedLaw("proportional with a brake", design, BrakeParameters())}
'''

EXPERIMENT = '''"""How far the load goes under a torque: pushes for a while and says how far it came."""

from dataclasses import dataclass
from typing import ClassVar

from backlash_ros.control.experiment import Excitation, NamedExperiment
from backlash_ros.foundation.quantity import quantity
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.signals import THETA_L


@dataclass(frozen=True)
class PushParameters(Validated):
    section: ClassVar[str] = "learning.push"

    torque: float = quantity("torque at the output", "N m", above=0, at_most=10, default=0.2)
    duration: float = quantity("how long", "s", above=0, at_most=10, default=0.2)


@dataclass(frozen=True)
class Pushed:
    way: float
    valid: bool
    reason: str


class Push:
    def __init__(self, drive, parameters, period, limits):
        self.outcome, self._parameters, self._period = None, parameters, period
        self._tick, self._start = 0, 0.0

    @property
    def progress(self):
        return min(1.0, self._tick * self._period / self._parameters.duration)

    def cancel(self, reason):
        self.outcome = self.outcome or Pushed(0.0, False, reason)

    def step(self, measured, estimate, command, elapsed, late):
        if self.outcome is not None:
            return Excitation()
        if self._tick == 0:
            self._start = float(measured[THETA_L])
        self._tick += 1
        if self.progress >= 1.0:
            self.outcome = Pushed(float(measured[THETA_L]) - self._start, True, "pushed")
            return Excitation()
        return Excitation(torque=self._parameters.torque)


EXPERIMENTS = {"NAME": NamedExperiment("push", Push, PushParameters(), law="overdamped")}
'''


def write(folder: Path, name: str, text: str, **changes: str) -> Path:
    for old, new in {"NAME": name, **changes}.items():
        text = text.replace(old, new)
    file = folder / f"{name}.py"
    file.write_text(text)
    return file


def final_angle(gains: GainSet, law: str, seconds: float = 2.0, **parameters: float) -> float:
    settings = ServoSettings(gains)
    own = type(LAWS[law].parameters)(**parameters)
    result = run(NOMINAL_DRIVE, settings.with_law(law, own), Scenario(np.ones(round(seconds / settings.period))))
    assert result.fault == ""
    return float(result.load_angle[-1])


def test_a_law_is_added_as_a_file_and_runs_with_its_parameters(gains: GainSet, tmp_path: Path) -> None:
    assert LAWS.add(write(tmp_path, "brake", LAW, SLOPE="0.5")) == ["brake"]
    assert abs(final_angle(gains, "brake") - 1.0) < 0.02
    assert final_angle(gains, "brake", 0.2, brake=5.0) < 0.5 * final_angle(gains, "brake", 0.2)
    with pytest.raises(ValueError, match=r"laws\.brake\.stiffness must be > 0 V/rad and <= 1000 V/rad, got 0"):
        type(LAWS["brake"].parameters)(stiffness=0)
    with pytest.raises(ValueError, match=r"laws\.brake needs parameters of type BrakeParameters, got CascadeParam"):
        run(
            NOMINAL_DRIVE,
            ServoSettings(gains).with_law("brake", LAWS["cascade"].parameters),
            Scenario(np.ones(3)),
        )


def test_an_added_law_that_is_edited_is_compiled_again(gains: GainSet, tmp_path: Path) -> None:
    """Two folders, as two versions would be; machine code is kept under the text of the file."""
    for k, slope in enumerate(("0.5", "8.0")):
        folder = tmp_path / str(k)
        folder.mkdir()
        text = LAW.replace("- law[1] * estimate", f"- {slope} * law[1] * estimate")
        LAWS.add(write(folder, f"edited{k}", text, SLOPE="0.5"))
    assert final_angle(gains, "edited1", 0.2) < 0.5 * final_angle(gains, "edited0", 0.2)


def test_an_experiment_is_added_as_a_file_and_runs_with_its_parameters(gains: GainSet, tmp_path: Path) -> None:
    EXPERIMENTS.add(write(tmp_path, "push", EXPERIMENT))
    settings = ServoSettings(gains)
    short, long = (
        run_experiment(
            NOMINAL_DRIVE, settings, "push", type(EXPERIMENTS["push"].parameters)(torque=torque, duration=0.3)
        )
        for torque in (0.05, 0.1)
    )
    assert short.valid
    assert 0.005 < short.way < 0.7 * long.way
    with pytest.raises(ValueError, match=r"learning\.push\.torque must be > 0 N m and <= 10 N m, got -1"):
        type(EXPERIMENTS["push"].parameters)(torque=-1)
    with pytest.raises(ValueError, match="push needs parameters of type PushParameters, got LimitCycleSettings"):
        run_experiment(NOMINAL_DRIVE, settings, "push", EXPERIMENTS["limit_cycle"].parameters)
    servo = Servo(NOMINAL_DRIVE, settings)
    assert servo.experiment_refusal("push") == ""


def test_names_and_tables_that_are_no_use_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^law must be one of \[.*\], got 'nothing'$"):
        LAWS.choose("law", "nothing")
    with pytest.raises(FileNotFoundError, match=r"no Python file at .*missing.py"):
        LAWS.add(tmp_path / "missing.py")
    with pytest.raises(ValueError, match=r"must have a table LAWS of its entries by name, and has none"):
        LAWS.add(write(tmp_path, "empty", '"""Nothing."""\n'))
    before = dict(LAWS)
    with pytest.raises(ValueError, match=r"LAWS: 'fast' in .* is the name of another entry"):
        LAWS.add(write(tmp_path, "again", LAW, NAME="fast", SLOPE="0.5"))
    assert dict(LAWS) == before


def test_a_variable_adds_files_for_every_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write(tmp_path, "everywhere", LAW, SLOPE="0.5")
    monkeypatch.setenv("BACKLASH_ROS_PLUGINS", str(file))
    laws: Registry[object] = Registry("backlash_ros.control.laws", laws_room.__path__, "LAWS", first="two_region")
    assert next(iter(laws)) == "fast"
    assert "everywhere" in laws
    assert "backlash_ros_plugins.everywhere" in sys.modules


BROKEN = """from dataclasses import dataclass
from backlash_ros.control.experiment import Excitation, NamedExperiment
from backlash_ros.foundation.quantity import quantity
from backlash_ros.foundation.quantity import Validated


@dataclass(frozen=True)
class Parameters(Validated):
    swing: float = quantity("offset", "rad", above=0, at_most=1, default=0.05)


class Broken:
    outcome, progress = None, 0.0

    def __init__(self, *_):
        pass

    def step(self, measured, estimate, command, elapsed, late):
        STEP

    def cancel(self, reason):
        CANCEL


EXPERIMENTS = {"NAME": NamedExperiment("broken", Broken, Parameters(), swing="swing")}
"""
HELD = Measurement(np.zeros(5))
FAR = Measurement(np.array([3.0, 0.0, 0.3, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("name", "step", "cancel", "says"),
    [
        ("raises", "raise OSError('no disk')", "pass", r"it failed: OSError\('no disk'\)"),
        ("leaps", "return Excitation(offset=1e3)", "raise KeyError('x')", "an offset of 1000 rad .* and it could not"),
        ("pushes", "return Excitation(torque=float('inf'))", "raise KeyError('x')", "a torque of inf N m"),
    ],
)
def test_an_experiment_that_misbehaves_ends_and_the_position_is_held(
    gains: GainSet, tmp_path: Path, name: str, step: str, cancel: str, says: str
) -> None:
    EXPERIMENTS.add(write(tmp_path, name, BROKEN, STEP=step, CANCEL=cancel))
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    servo.update(HELD)
    servo.start_experiment(name)
    assert servo.update(HELD) == 0.0
    outcome = servo.take_outcome()
    assert outcome is not None
    assert not outcome.valid
    assert re.search(says, outcome.reason)
    assert not servo.experimenting
    assert servo.update(HELD) == 0.0
    assert servo.tracking_error == 0.0


def test_an_experiment_does_not_take_the_load_beyond_an_end(gains: GainSet, tmp_path: Path) -> None:
    EXPERIMENTS.add(write(tmp_path, "out", BROKEN, STEP="return Excitation(offset=0.05)", CANCEL="pass"))
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), position_upper=0.32))
    servo.update(FAR)
    servo.start_experiment("out")
    servo.update(FAR)
    assert servo.memory.setpoint[POSITION] == pytest.approx(0.32)
    assert servo.tracking_error == pytest.approx(0.0)


def test_a_law_that_leaves_its_range_does_not_take_the_motor_with_it(gains: GainSet, tmp_path: Path) -> None:
    LAWS.add(write(tmp_path, "wild", LAW.replace("clamp(voltage, low, high)", "1e9"), SLOPE="0.5"))
    limits = replace(Limits.of(NOMINAL_DRIVE), position_upper=0.3, soft_zone=0.1)
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains).with_law("wild"), limits)
    assert servo.update(HELD) == 24.0
    for angle, most in ((0.25, 12.0), (0.3, 0.0), (0.35, 0.0)):
        servo.release("test")
        assert servo.update(Measurement(np.array([10 * angle, 0.0, angle, 0.0, 0.0]))) == pytest.approx(most)


def test_a_redesigned_law_with_another_state_begins_anew(gains: GainSet, tmp_path: Path) -> None:
    text = LAW.replace("np.array([float(FAST_REGION)])", "np.ones(1 + round(parameters.brake))")
    LAWS.add(write(tmp_path, "taps", text, SLOPE="4.0"))
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains).with_law("taps"))
    servo.update(HELD)
    servo.use(ServoSettings(gains).with_law("taps", type(LAWS["taps"].parameters)(brake=40.0)))
    assert servo.law_arrays[1].shape == (41,)
    servo.update(HELD)


def test_a_plugin_that_fails_leaves_nothing_half_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = write(tmp_path, "halfway", LAW + "\n1 / 0\n", SLOPE="0.5")
    good = write(tmp_path, "whole", LAW, SLOPE="0.5")
    monkeypatch.setenv("BACKLASH_ROS_PLUGINS", f"{broken}:{good}")
    laws: Registry[object] = Registry("backlash_ros.control.laws", list(laws_room.__path__), "LAWS", first="two_region")
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            list(laws)
    assert "backlash_ros_plugins.halfway" not in sys.modules
    monkeypatch.setenv("BACKLASH_ROS_PLUGINS", str(good))
    assert "whole" in laws
