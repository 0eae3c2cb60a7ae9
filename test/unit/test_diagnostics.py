"""Diagnostics as values: what a window of times says, and which level a rate and a status get."""

import math

import pytest

pytest.importorskip("diagnostic_msgs", reason="needs ROS messages")

from backlash_ros.control import GainSet, Servo, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.gates import SampleGate
from backlash_ros.nodes.reports import ControllerReport, NodeFacts
from backlash_ros.ros.diagnostics import ERROR, OK, WARN, Window, age_level, milliseconds, rate_level, status


def window(*values: float) -> Window:
    made = Window()
    for value in values:
        made.add(value)
    return made


@pytest.mark.parametrize(("count", "p99"), [(1, 1.0), (99, 99.0), (100, 99.0), (101, 100.0), (1000, 990.0)])
def test_window_gives_mean_p99_and_maximum(count: int, p99: float) -> None:
    """The 99th percentile is the least value that 99 % do not exceed."""
    assert window(*(float(k) for k in range(count, 0, -1))).take() == ((count + 1) / 2, p99, count)


def test_window_starts_anew_after_a_look() -> None:
    seen = window(1.0, 2.0)
    assert len(seen) == 2
    seen.take()
    assert len(seen) == 0
    assert all(math.isnan(value) for value in seen.take())
    seen.add(3.0)
    assert seen.take() == (3.0, 3.0, 3.0)


def test_times_are_told_in_milliseconds() -> None:
    assert milliseconds((0.001, 0.0125, 2.0)) == "mean 1.000, p99 12.500, max 2000.000 ms"


@pytest.mark.parametrize(
    ("measured", "level"),
    [(250, OK), (238, OK), (262, OK), (237, WARN), (263, WARN), (201, WARN), (299, WARN), (199, ERROR), (301, ERROR)],
)
def test_rate_is_judged_by_its_deviation(measured: float, level: bytes) -> None:
    assert rate_level(measured, 250.0) == (level, f"{measured:.1f} Hz, nominal 250 Hz")


def test_rate_that_is_not_known_is_an_error() -> None:
    assert rate_level(math.nan, 250.0) == (ERROR, "nan Hz, nominal 250 Hz")


@pytest.mark.parametrize(
    ("judgements", "level", "message"),
    [
        ([], OK, ""),
        ([(OK, "active"), (OK, "250 Hz")], OK, "active; 250 Hz"),
        ([(OK, "active"), (WARN, "slow"), (ERROR, "late")], ERROR, "slow; late"),
        ([(WARN, "slow"), (OK, "active")], WARN, "slow"),
    ],
)
def test_status_is_as_bad_as_the_worst_and_says_what_is_not_good(
    judgements: list[tuple[bytes, str]], level: bytes, message: str
) -> None:
    made = status("servo", "drive", judgements, {"fault": "", "period": 0.004})
    assert (made.level, made.message) == (level, message)
    assert (made.name, made.hardware_id) == ("servo", "drive")
    assert [(entry.key, entry.value) for entry in made.values] == [("fault", ""), ("period", "0.004")]


@pytest.mark.parametrize(("step", "level"), [(0.0039, OK), (0.0041, ERROR)])
def test_step_that_takes_longer_than_a_period_is_an_error(gains: GainSet, step: float, level: bytes) -> None:
    report, servo = ControllerReport(250.0, 0.1), Servo(NOMINAL_DRIVE, ServoSettings(gains))
    report.step_time.add(step)
    report.age.add(0.001)
    facts, gate = NodeFacts("controller", "active", 0), SampleGate(10**8, 6 * 10**6)
    _, timing = report.statuses(facts, ("motor", "load"), servo, gate, {})
    assert timing.level == level
    assert ("one step takes 0.0041 s, longer than a period" in timing.message) == (level == ERROR)


def test_age_of_samples_without_a_stamp_is_not_half_a_century() -> None:
    assert age_level(window().take(), 0.1, unstamped=True) == (WARN, "the drive does not stamp its samples")
    assert age_level(window(0.01).take(), 0.1, unstamped=True) == (OK, "joint_states are 0.01 s old")
