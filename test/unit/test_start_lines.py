"""What the controller says when it starts."""

import math
from dataclasses import replace

import pytest

from backlash_ros.control import GainSet, Margins, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.nodes.start_lines import drive_found, margins_line, stands_in, untold_drive


def test_the_encoders_that_are_there_are_named() -> None:
    assert drive_found("both") == "drive found: both encoders"
    assert drive_found("load") == "drive found: the load's encoder alone"


def margins(degrees: float, delay: float) -> Margins:
    return Margins(math.radians(degrees), delay, 5.0, 80.0)


@pytest.mark.parametrize("given", [[], ["rate", "law", "limits.command"], ["load_joint"]])
def test_a_drive_that_nobody_described_is_named_with_what_matters_most(given: list[str]) -> None:
    line = untold_drive(given)
    assert all(name in line for name in ("motor.torque_constant", "gear.reduction", "load.inertia"))


@pytest.mark.parametrize("name", ["motor.inertia", "gear.reduction", "load.inertia"])
def test_a_drive_that_somebody_described_is_not_mentioned(name: str) -> None:
    assert untold_drive(["rate", name]) == ""


def test_margins_are_told_by_region() -> None:
    line, warn = margins_line(
        "stiff", {"fast": margins(62.4, 0.0195), "overdamped": margins(math.inf, math.inf)}, 0.004
    )
    told = "fast 62 deg of phase, 19.5 ms of delay; overdamped any phase, any delay"
    assert line == f"gain set 'stiff', margins: {told}"
    assert not warn


@pytest.mark.parametrize(("degrees", "delay"), [(29.0, 0.02), (60.0, 0.0039)])
def test_tight_margins_are_a_warning_that_names_the_region(degrees: float, delay: float) -> None:
    line, warn = margins_line("stiff", {"fast": margins(degrees, delay), "overdamped": margins(80, 0.4)}, 0.004)
    assert warn
    assert line.endswith("; fast below 30 deg or one period, 4 ms: lower the gains")


def test_auto_says_what_it_stands_for_and_why(gains: GainSet) -> None:
    known = ServoSettings(gains, backlash_angle=0.02, identified=True)
    until = "law 'auto' is 'two_region' until the drive is identified, and 'planned' from then on: call identify"
    assert stands_in(NOMINAL_DRIVE, known) == "law 'auto' is 'planned' from now on"
    assert stands_in(NOMINAL_DRIVE, replace(known, identified=False)) == until
    steep = stands_in(NOMINAL_DRIVE, replace(known, expected_load_torque_slope=100.0))
    assert steep.startswith("law 'auto' stays 'two_region': expected_load_torque_slope must be within")
