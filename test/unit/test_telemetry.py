"""What there is to plot: every quantity of the table, as a number, and the table in docs/interface.md."""

import math
from pathlib import Path

import numpy as np
import pytest
from telemetry_table import telemetry_table

from backlash_ros.control import GainSet, Servo, ServoSettings
from backlash_ros.control.monitoring.wear import WearWatch
from backlash_ros.control.telemetry import TELEMETRY, telemetry
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import Measurement
from backlash_ros.gates import Fault
from backlash_ros.simulation import SimulatedDrive

HELD = Measurement(np.array([3.0, 0.0, 0.3, 0.0, 0.0]))


def test_telemetry_has_what_the_table_names_in_its_order(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, backlash_angle=0.02))
    before = telemetry(servo, WearWatch(servo), active=False, parameters_version=1, samples=0, elapsed=0.004)
    assert list(before) == list(TELEMETRY)
    assert (before["active"], before["holding"], before["region"]) == (0, 0, 0)
    assert math.isnan(before["reference"])
    servo.update(HELD)
    servo.set_reference(0.5)
    command = servo.update(HELD)
    after = telemetry(servo, WearWatch(servo), active=True, parameters_version=7, samples=0, elapsed=0.004)
    assert (after["active"], after["holding"], after["fault"], after["parameters_version"]) == (1, 1, 0, 7)
    assert (after["reference"], after["setpoint"]) == (0.5, 0.5)
    assert after["error"] == pytest.approx(0.2)
    assert (after["motor_angle"], after["load_angle"], after["command"]) == (3.0, 0.3, command)
    assert (after["range_low"], after["range_high"], after["backlash_angle"]) == (-24.0, 24.0, 0.02)
    assert TELEMETRY["region"].words[int(after["region"])] == "over-damped gains"  # for the least dwell still


def test_telemetry_tells_experiment_and_fault(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    servo.update(HELD)
    servo.start_experiment("limit_cycle")
    servo.update(HELD)
    during = telemetry(servo, WearWatch(servo), active=True, parameters_version=1, samples=0, elapsed=0.004)
    assert (during["experiment"], during["offset"], during["torque"]) == (1, 0.025, 0.0)
    assert during["progress"] > 0
    assert (during["setpoint"], during["error"]) == (0.325, pytest.approx(0.0, abs=1e-12))
    servo.fail(Fault.NO_SAMPLES, "silence")
    after = telemetry(servo, WearWatch(servo), active=True, parameters_version=1, samples=0, elapsed=0.004)
    assert (TELEMETRY["fault"].words[int(after["fault"])], after["command"]) == ("NO_SAMPLES", 0.0)


def test_telemetry_tells_what_the_planned_law_does(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, law="planned", backlash_angle=0.02, identified=True))
    plant = SimulatedDrive(NOMINAL_DRIVE, 0.004)

    def after(samples: int) -> list[str]:
        for _ in range(samples):
            plant.advance(servo.update(plant.sample(), plant.elapsed), 0.1)
        values = telemetry(servo, WearWatch(servo), active=True, parameters_version=1, samples=0, elapsed=0.004)
        return [TELEMETRY[name].words[int(values[name])] for name in ("phase", "flank")]

    assert after(500) == ["hold", "holds the load back"]
    servo.set_reference(1.0)
    assert after(5)[0] == "flight"
    assert after(500) == ["hold", "holds the load back"]
    servo.calm()
    assert after(1) == ["none", "none"]


def test_readme_has_the_table() -> None:
    assert telemetry_table() in (Path(__file__).parents[2] / "docs" / "interface.md").read_text(), "renew it: make docs"
